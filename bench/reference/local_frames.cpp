// Local reference frames (9: the axes x, y, z), by pcl::SHOTLocalReferenceFrameEstimation. NaN where there is none.
// Options: "omp" for SHOTLocalReferenceFrameEstimationOMP.
#include "reference.hpp"

#include <pcl/features/shot_lrf.h>
#include <pcl/features/shot_lrf_omp.h>

template <typename Estimation>
reference::Output frames(const reference::Input& input, Estimation& estimation) {
    reference::set_cloud(estimation, input, input.points);
    pcl::PointCloud<pcl::ReferenceFrame> result;
    const double seconds = reference::timed([&] { estimation.compute(result); });
    return reference::Output{seconds, reference::rows(result, 9, [](const auto& p) { return p.rf; })};
}

int main(int count, char** words) {
    return reference::run(count, words, [](const reference::Input& input) {
        if (!input.options.empty() && input.options[0] == "omp") {
            pcl::SHOTLocalReferenceFrameEstimationOMP<pcl::PointXYZ> estimation;
            estimation.setNumberOfThreads(input.threads);
            return frames(input, estimation);
        }
        pcl::SHOTLocalReferenceFrameEstimation<pcl::PointXYZ> estimation;
        return frames(input, estimation);
    });
}
