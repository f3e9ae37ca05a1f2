// 3D shape contexts (1980), by pcl::ShapeContext3DEstimation; it has no version for several threads. The class draws an
// x axis at random and does not tell which: here a copy of its generator draws the same, and rows are 9 + 1980 numbers,
// the axes x, y, z and the descriptor. The innermost radius is a tenth and that of densities a fifth of the radius, as
// in PCL's example.
#include "reference.hpp"

#include <pcl/features/3dsc.h>

#include <algorithm>

namespace {

class WithFrames : public pcl::ShapeContext3DEstimation<pcl::PointXYZ, pcl::Normal, pcl::ShapeContext1980> {
   public:
    std::vector<Eigen::Matrix3f> frames;  // axes in columns

   protected:
    void computeFeature(PointCloudOut& output) override {
        frames.clear();
        for (std::size_t i = 0; i < indices_->size(); ++i) {
            std::mt19937 copy = rng_;
            std::vector<float> values(descriptor_length_);
            frames.push_back(frame(copy, (*normals_)[(*indices_)[i]].getNormalVector3fMap()));
            computePoint(i, *normals_, output[i].rf, values);
            std::copy(values.begin(), values.end(), output[i].descriptor);
        }
    }

   private:
    // The frame whose x axis is drawn in the octant of positive numbers and moved along one axis into the plane.
    static Eigen::Matrix3f frame(std::mt19937& generator, const Eigen::Vector3f& normal) {
        std::uniform_real_distribution<float> uniform(0.0f, 1.0f);
        Eigen::Vector3f x;
        for (int axis = 0; axis < 3; ++axis) x[axis] = uniform(generator);
        int moved = 2;
        while (moved > 0 && std::fabs(normal[moved]) < 1e-8f) --moved;
        x[moved] = 0;
        x[moved] = -normal.dot(x) / normal[moved];
        x.normalize();
        Eigen::Matrix3f result;
        result << x, normal.cross(x), normal;
        return result;
    }
};

}  // namespace

int main(int count, char** words) {
    return reference::run(count, words, [](const reference::Input& input) {
        WithFrames estimation;
        reference::set(estimation, input);
        estimation.setMinimalRadius(input.radius / 10);
        estimation.setPointDensityRadius(input.radius / 5);
        pcl::PointCloud<pcl::ShapeContext1980> result;
        reference::Output output;
        output.seconds = reference::timed([&] { estimation.compute(result); });
        for (std::size_t i = 0; i < result.size(); ++i) {
            const float* frame = estimation.frames[i].data();
            output.values.insert(output.values.end(), frame, frame + 9);
            output.values.insert(output.values.end(), result[i].descriptor, result[i].descriptor + 1980);
        }
        return output;
    });
}
