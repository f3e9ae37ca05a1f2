// Hypotheses scored, refitted to their inliers, and thinned to distinct ones (torchreg/solvers/scoring.py,
// local_optimization.py and poses.py).
#include "best_rotation.hpp"
#include "sums.hpp"

namespace torchreg {
namespace {

struct Matches {  // of pairs side by side, (3, pairs, width) twice in meters; those behind the last of a pair not valid
    const double* source;
    const double* target;
    const bool* valid;
    int64_t pairs, width;

    const double* side(const double* points, int64_t axis, int64_t pair) const {
        return points + (axis * pairs + pair) * width;
    }
};

struct Support {
    int64_t count;
    double error;
};

// Inliers (width) of a pose, and their number and sum of squared residuals; `square` (width) is memory to work in.
inline Support score(const Matches& all, int64_t pair, const double* R, const double* t, double limit, bool* inliers,
                     double* square) {
    const double *x = all.side(all.source, 0, pair), *y = all.side(all.source, 1, pair),
                 *z = all.side(all.source, 2, pair);
    const double *u = all.side(all.target, 0, pair), *v = all.side(all.target, 1, pair),
                 *w = all.side(all.target, 2, pair);
    const bool* valid = all.valid + pair * all.width;
    int64_t count = 0;
    for (int64_t m = 0; m < all.width; ++m) {
        const double a = turned(R, 0, x[m], y[m], z[m]) + t[0] - u[m];
        const double b = turned(R, 1, x[m], y[m], z[m]) + t[1] - v[m];
        const double c = turned(R, 2, x[m], y[m], z[m]) + t[2] - w[m];
        square[m] = a * a + b * b + c * c;
    }
    for (int64_t m = 0; m < all.width; ++m) {
        const bool inside = (square[m] < limit) & valid[m];
        inliers[m] = inside;
        count += inside;
        square[m] = inside ? square[m] : 0.0;
    }
    return {count, fold(square, all.width)};
}

class Refit {  // least squares over the inliers of one pose after another, in memory of one thread
  public:
    explicit Refit(int64_t width) : column_(width), memory_(7 * width), width_(width) {}

    void fit(const Matches& all, int64_t pair, const bool* inliers, double* R, double* t) {
        int64_t n = 0;
        for (int64_t m = 0; m < all.width; ++m) {
            column_[n] = m;
            n += inliers[m];
        }
        const double total = double(std::max<int64_t>(1, n));
        double mean[6], covariance[9];
        double* sum = part(6);
        for (int64_t i = 0; i < 6; ++i) {
            const double* values = all.side(i < 3 ? all.source : all.target, i % 3, pair);
            double* own = part(i);
            for (int64_t k = 0; k < n; ++k) own[k] = values[column_[k]];
            std::copy_n(own, n, sum);
            mean[i] = fold(sum, n) / total;
            for (int64_t k = 0; k < n; ++k) own[k] -= mean[i];
        }
        for (int64_t i = 0; i < 3; ++i)
            for (int64_t j = 0; j < 3; ++j) {
                const double *p = part(i), *q = part(3 + j);
                for (int64_t k = 0; k < n; ++k) sum[k] = p[k] * q[k];
                covariance[3 * i + j] = fold(sum, n);
            }
        best_rotation(covariance, R);
        best_translation(R, mean, mean + 3, t);
    }

  private:
    double* part(int64_t i) { return memory_.data() + i * width_; }

    std::vector<int64_t> column_;
    std::vector<double> memory_;
    const int64_t width_;
};

inline void read(const double* rotation, const double* translation, int64_t count, int64_t h, double* R, double* t) {
    for (int64_t k = 0; k < 9; ++k) R[k] = rotation[k * count + h];
    for (int64_t k = 0; k < 3; ++k) t[k] = translation[k * count + h];
}

}  // namespace

// Equals `best_rotation` of geometry/best_rotation.py: covariance (3, 3, H) float64. Writes rotation (3, 3, H).
KERNEL(best_rotations, const double* covariance, int64_t count, double* rotation, int64_t threads) {
    parallel(threads, count, 64, [&](int64_t begin, int64_t end, int64_t) {
        for (int64_t h = begin; h < end; ++h) {
            double C[9], R[9];
            for (int64_t k = 0; k < 9; ++k) C[k] = covariance[k * count + h];
            best_rotation(C, R);
            for (int64_t k = 0; k < 9; ++k) rotation[k * count + h] = R[k];
        }
    });
    return 0;
}

// Equals `score` of scoring.py.
//
// rotation (3, 3, H), translation (3, H) float64, of the pairs pair (H) int64; limits (H) float64, squared thresholds;
// source and target (3, B, M) float64, meters, valid (B, M) bool. Writes inliers (H, M) bool, support (H) int64 and error
// (H) float64, square meters.
KERNEL(score_poses, const double* rotation, const double* translation, const int64_t* pair, const double* limits,
                   int64_t count, const double* source, const double* target, const bool* valid, int64_t pairs,
                   int64_t width, bool* inliers, int64_t* support, double* error, int64_t threads) {
    const Matches all{source, target, valid, pairs, width};
    parallel(threads, count, 65536 / std::max<int64_t>(1, width) + 1, [&](int64_t begin, int64_t end, int64_t) {
        std::vector<double> square(width);
        for (int64_t h = begin; h < end; ++h) {
            double R[9], t[3];
            read(rotation, translation, count, h, R, t);
            const Support found = score(all, pair[h], R, t, limits[h], inliers + h * width, square.data());
            support[h] = found.count;
            error[h] = found.error;
        }
    });
    return 0;
}

// Equals `optimize` of local_optimization.py: poses refitted in place to their inliers, at most `rounds` times each.
//
// As `score_poses`, with inliers, support and error of the poses as they come; quality (H) float64 is the support less
// `share` times error / limit.
KERNEL(optimize_poses, double* rotation, double* translation, const int64_t* pair, const double* limits, int64_t count,
                      const double* source, const double* target, const bool* valid, int64_t pairs, int64_t width,
                      int64_t rounds, double share, bool* inliers, int64_t* support, double* error, double* quality,
                      int64_t threads) {
    const Matches all{source, target, valid, pairs, width};
    parallel(threads, count, 8192 / std::max<int64_t>(1, width) + 1, [&](int64_t begin, int64_t end, int64_t) {
        Refit refit(width);
        std::vector<double> square(width);
        std::vector<uint8_t> memory(width);
        bool* inside = reinterpret_cast<bool*>(memory.data());
        for (int64_t h = begin; h < end; ++h)
            for (int64_t round = 0; round < rounds; ++round) {
                double R[9], t[3];
                refit.fit(all, pair[h], inliers + h * width, R, t);
                const Support found = score(all, pair[h], R, t, limits[h], inside, square.data());
                const double reached = double(found.count) - share * (found.error / limits[h]);
                if (!(reached > quality[h] || (reached == quality[h] && found.error < error[h]))) break;
                std::copy_n(inside, width, inliers + h * width);
                support[h] = found.count;
                error[h] = found.error;
                quality[h] = reached;
                for (int64_t k = 0; k < 9; ++k) rotation[k * count + h] = R[k];
                for (int64_t k = 0; k < 3; ++k) translation[k * count + h] = t[k];
            }
    });
    return 0;
}

template <typename Real>
int64_t spread_out(const Real* vectors, const int64_t* pair, const Real* limits, int64_t count, int64_t most,
                   int64_t* chosen, int64_t) {
    std::vector<uint8_t> apart(count, 1);
    std::vector<Real> square(count);
    int64_t number = 0;
    for (int64_t begin = 0; begin < count;) {
        int64_t end = begin;
        while (end < count && pair[end] == pair[begin]) ++end;
        const Real limit = limits[pair[begin]];
        int64_t taken = 0;
        for (int64_t h = begin; h < end && taken < most; ++h) {
            if (!apart[h]) continue;
            chosen[number++] = h;
            if (++taken == most) break;
            const int64_t left = end - h - 1;
            uint8_t* flags = apart.data() + h + 1;
            for (int64_t i = 0; i < 12; ++i) {
                const Real* row = vectors + i * count + h + 1;
                const Real at = row[-1];
                for (int64_t k = 0; k < left; ++k) {
                    const Real difference = row[k] - at, term = difference * difference;
                    square[k] = i == 0 ? term : square[k] + term;
                }
            }
            for (int64_t k = 0; k < left; ++k) flags[k] &= square[k] > limit;
        }
        begin = end;
    }
    return number;
}

// Equals `spread_out` of poses.py: which poses lie apart from those chosen before, pair by pair.
//
// vectors (12, H); pair (H) int64, ascending; limits (B), squared radii; at most `most` of a pair. Writes chosen (H) int64,
// of which as many are meant as are returned.
KERNELS(spread_out,
        (const Real* vectors, const int64_t* pair, const Real* limits, int64_t count, int64_t most, int64_t* chosen,
         int64_t threads),
        (vectors, pair, limits, count, most, chosen, threads))

}  // namespace torchreg
