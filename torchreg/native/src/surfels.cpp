// The moments of the neighbors that surfels are made of.
#include "common.hpp"

namespace torchreg {

// Equals `_moments` of refinement/surfels.py: centers (n, 3), points (P, 3) with weights (P) and colors (P, 3), or null;
// near (n, K) rows; `freedom` is the share of the weights that variances are divided by. Writes mean (n, 3) relative to
// the centers, spread (n, 3, 3), the upper triangle, reach (n) and mean colors (n, 3).
KERNEL(surfel_moments, const double* centers, const double* points, const double* weight, const double* colors,
                      const int64_t* near, int64_t n, int64_t neighbors, double freedom, double* mean, double* spread,
                      double* reach, double* mean_colors, int64_t threads) {
    parallel(threads, n, 256, [&](int64_t begin, int64_t end, int64_t) {
        std::vector<double> room(4 * neighbors);
        double* apart[3] = {room.data(), room.data() + neighbors, room.data() + 2 * neighbors};
        double* w = room.data() + 3 * neighbors;
        for (int64_t i = begin; i < end; ++i) {
            const int64_t* row = near + i * neighbors;
            double total = 0, farthest = 0, sums[3] = {0, 0, 0}, shades[3] = {0, 0, 0};
            for (int64_t k = 0; k < neighbors; ++k) {
                w[k] = weight[row[k]];
                total = total + w[k];
                for (int axis = 0; axis < 3; ++axis) {
                    apart[axis][k] = points[3 * row[k] + axis] - centers[3 * i + axis];
                    sums[axis] = sums[axis] + apart[axis][k] * w[k];
                    if (colors != nullptr) shades[axis] = shades[axis] + colors[3 * row[k] + axis] * w[k];
                }
                const double x = apart[0][k], y = apart[1][k], z = apart[2][k];
                farthest = std::max(farthest, (x * x + y * y) + z * z);
            }
            reach[i] = farthest;
            for (int axis = 0; axis < 3; ++axis) {
                const double middle = mean[3 * i + axis] = sums[axis] / total;
                for (int64_t k = 0; k < neighbors; ++k) apart[axis][k] = apart[axis][k] - middle;
                if (colors != nullptr) mean_colors[3 * i + axis] = shades[axis] / total;
            }
            const double share = total * freedom;
            double products[6] = {0, 0, 0, 0, 0, 0};
            for (int64_t k = 0; k < neighbors; ++k) {
                const double x = apart[0][k], y = apart[1][k], z = apart[2][k];
                const double each[6] = {x * x, x * y, x * z, y * y, y * z, z * z};
                for (int c = 0; c < 6; ++c) products[c] = products[c] + each[c] * w[k];
            }
            const int places[6] = {0, 1, 2, 4, 5, 8};
            for (int c = 0; c < 6; ++c) spread[9 * i + places[c]] = products[c] / share;
        }
    });
    return 0;
}

}  // namespace torchreg
