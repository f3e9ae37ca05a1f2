// SHOT (352), by pcl::SHOTEstimation. NaN where a point has no frame. Options: "omp" for SHOTEstimationOMP.
#include "reference.hpp"

#include <pcl/features/shot.h>
#include <pcl/features/shot_omp.h>

template <typename Estimation>
reference::Output described(const reference::Input& input, Estimation& estimation) {
    reference::set(estimation, input);
    pcl::PointCloud<pcl::SHOT352> result;
    const double seconds = reference::timed([&] { estimation.compute(result); });
    return reference::Output{seconds, reference::rows(result, 352, [](const auto& p) { return p.descriptor; })};
}

int main(int count, char** words) {
    return reference::run(count, words, [](const reference::Input& input) {
        if (!input.options.empty() && input.options[0] == "omp") {
            pcl::SHOTEstimationOMP<pcl::PointXYZ, pcl::Normal> estimation;
            estimation.setNumberOfThreads(input.threads);
            return described(input, estimation);
        }
        pcl::SHOTEstimation<pcl::PointXYZ, pcl::Normal> estimation;
        return described(input, estimation);
    });
}
