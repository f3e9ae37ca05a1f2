// PFHRGB (250), by pcl::PFHRGBEstimation; it has no version for several threads.
#include "reference.hpp"

#include <pcl/features/pfhrgb.h>

int main(int count, char** words) {
    return reference::run(count, words, [](const reference::Input& input) {
        pcl::PFHRGBEstimation<pcl::PointXYZRGB, pcl::Normal, pcl::PFHRGBSignature250> estimation;
        reference::set_colored(estimation, input);
        pcl::PointCloud<pcl::PFHRGBSignature250> result;
        const double seconds = reference::timed([&] { estimation.compute(result); });
        return reference::Output{seconds, reference::rows(result, 250, [](const auto& p) { return p.histogram; })};
    });
}
