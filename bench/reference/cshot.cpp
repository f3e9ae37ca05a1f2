// SHOT with colors (1344), by pcl::SHOTColorEstimation. NaN where a point has no frame.
// Options: "omp" for SHOTColorEstimationOMP.
#include "reference.hpp"

#include <pcl/features/shot.h>
#include <pcl/features/shot_omp.h>

template <typename Estimation>
reference::Output described(const reference::Input& input, Estimation& estimation) {
    reference::set_colored(estimation, input);
    pcl::PointCloud<pcl::SHOT1344> result;
    const double seconds = reference::timed([&] { estimation.compute(result); });
    return reference::Output{seconds, reference::rows(result, 1344, [](const auto& p) { return p.descriptor; })};
}

int main(int count, char** words) {
    return reference::run(count, words, [](const reference::Input& input) {
        if (!input.options.empty() && input.options[0] == "omp") {
            pcl::SHOTColorEstimationOMP<pcl::PointXYZRGB, pcl::Normal> estimation;
            estimation.setNumberOfThreads(input.threads);
            return described(input, estimation);
        }
        pcl::SHOTColorEstimation<pcl::PointXYZRGB, pcl::Normal> estimation;
        return described(input, estimation);
    });
}
