// PFH (125), by pcl::PFHEstimation; it has no version for several threads.
#include "reference.hpp"

#include <pcl/features/pfh.h>

int main(int count, char** words) {
    return reference::run(count, words, [](const reference::Input& input) {
        pcl::PFHEstimation<pcl::PointXYZ, pcl::Normal, pcl::PFHSignature125> estimation;
        reference::set(estimation, input);
        pcl::PointCloud<pcl::PFHSignature125> result;
        const double seconds = reference::timed([&] { estimation.compute(result); });
        return reference::Output{seconds, reference::rows(result, 125, [](const auto& p) { return p.histogram; })};
    });
}
