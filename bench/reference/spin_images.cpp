// Spin images (153), by pcl::SpinImageEstimation; it has no version for several threads.
// Options: cosine of the support angle (0), structure: "rectangular" or "radial", content: "counts" or "angles".
#include "reference.hpp"

#include <pcl/features/spin_image.h>

int main(int count, char** words) {
    return reference::run(count, words, [](const reference::Input& input) {
        const auto option = [&](std::size_t i) { return i < input.options.size() ? input.options[i] : std::string(); };
        using Image = pcl::Histogram<153>;
        pcl::SpinImageEstimation<pcl::PointXYZ, pcl::Normal, Image> estimation(8, std::atof(option(0).c_str()), 0);
        reference::set(estimation, input);
        estimation.setRadialStructure(option(1) == "radial");
        estimation.setAngularDomain(option(2) == "angles");
        pcl::PointCloud<Image> result;
        const double seconds = reference::timed([&] { estimation.compute(result); });
        return reference::Output{seconds, reference::rows(result, 153, [](const auto& p) { return p.histogram; })};
    });
}
