// Unique shape contexts (1960), by pcl::UniqueShapeContext, whose frames are SHOT's. NaN where a point has none; it has
// no version for several threads. The innermost radius is a tenth and that of densities a fifth of the radius, and frames
// have the radius of the neighborhoods.
#include "reference.hpp"

#include <pcl/features/usc.h>

int main(int count, char** words) {
    return reference::run(count, words, [](const reference::Input& input) {
        pcl::UniqueShapeContext<pcl::PointXYZ, pcl::UniqueShapeContext1960, pcl::ReferenceFrame> estimation;
        reference::set_cloud(estimation, input, input.points);
        estimation.setMinimalRadius(input.radius / 10);
        estimation.setPointDensityRadius(input.radius / 5);
        estimation.setLocalRadius(input.radius);
        pcl::PointCloud<pcl::UniqueShapeContext1960> result;
        const double seconds = reference::timed([&] { estimation.compute(result); });
        return reference::Output{seconds, reference::rows(result, 1960, [](const auto& p) { return p.descriptor; })};
    });
}
