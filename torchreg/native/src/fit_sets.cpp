// Rigid transforms of weighted sets of correspondences: torchreg/solvers/compatibility/sets.py.
#include "best_rotation.hpp"

namespace torchreg {
namespace {

// `_spans_plane` of sets.py, of the entries of a covariance: whether the second principal spread is not small beside the first.
inline bool spans_plane(double xx, double yy, double zz, double xy, double xz, double yz, double least) {
    const double trace = xx + yy + zz;
    const double minors = (xx * yy - xy * xy) + (xx * zz - xz * xz) + (yy * zz - yz * yz);
    return minors > least * trace * trace;
}

}  // namespace

// Equals `fit_sets` of sets.py: weighted least squares of S sets of K members, sums in the order of the members.
//
// source and target (3, N) float64, meters; members (S, K) int64 and weights (S, K) float64; `least`, the square of the
// least sine. Writes rotation (3, 3, S), translation (3, S), and broad (S) bool: both sides spread across a line.
KERNEL(fit_sets, const double* source, const double* target, int64_t count, const int64_t* members,
                const double* weights, int64_t sets, int64_t size, double least, double* rotation, double* translation,
                bool* broad, int64_t threads) {
    parallel(threads, sets, 4096 / std::max<int64_t>(1, size) + 1, [&](int64_t begin, int64_t end, int64_t) {
        std::vector<double> memory(7 * size);
        double* share = memory.data() + 6 * size;
        for (int64_t s = begin; s < end; ++s) {
            const int64_t* member = members + s * size;
            const double* weight = weights + s * size;
            double total = 0.0;
            for (int64_t k = 0; k < size; ++k) total += weight[k];
            const double divisor = total > 0 ? total : 1.0;
            double mean[6] = {0, 0, 0, 0, 0, 0};
            for (int64_t k = 0; k < size; ++k) {
                share[k] = weight[k] / divisor;
                double* point = memory.data() + 6 * k;
                for (int64_t i = 0; i < 3; ++i) {
                    point[i] = source[i * count + member[k]];
                    point[3 + i] = target[i * count + member[k]];
                }
                for (int64_t i = 0; i < 6; ++i) mean[i] += point[i] * share[k];
            }
            double cross[9] = {}, of_source[9] = {}, of_target[9] = {};
            for (int64_t k = 0; k < size; ++k) {
                const double* point = memory.data() + 6 * k;
                double p[3], q[3], weighted[3], other[3];
                for (int64_t i = 0; i < 3; ++i) {
                    p[i] = point[i] - mean[i];
                    q[i] = point[3 + i] - mean[3 + i];
                    weighted[i] = p[i] * share[k];
                    other[i] = q[i] * share[k];
                }
                for (int64_t i = 0; i < 3; ++i)
                    for (int64_t j = 0; j < 3; ++j) {
                        cross[3 * i + j] += weighted[i] * q[j];
                        of_source[3 * i + j] += weighted[i] * p[j];
                        of_target[3 * i + j] += other[i] * q[j];
                    }
            }
            double R[9], t[3];
            best_rotation(cross, R);
            best_translation(R, mean, mean + 3, t);
            for (int64_t i = 0; i < 9; ++i) rotation[i * sets + s] = R[i];
            for (int64_t i = 0; i < 3; ++i) translation[i * sets + s] = t[i];
            bool both = total > 0;
            for (const double* m : {of_source, of_target})
                both = spans_plane(m[0], m[4], m[8], m[1], m[2], m[5], least) && both;
            broad[s] = both;
        }
    });
    return 0;
}

}  // namespace torchreg
