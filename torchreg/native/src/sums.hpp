// Sums in the order of `lane_sums` (torchreg/geometry/numerics/sums.py): entry k goes to lane k mod L, then the upper half
// of the lanes is added to the lower one until one is left. A kernel adds to its lanes itself and folds them here.
#pragma once

#include "common.hpp"

namespace torchreg {

constexpr int64_t NEIGHBOR_LANES = 16;  // of sums over the slots of a neighborhood, or the bins of a histogram
constexpr int64_t SAMPLE_LANES = 64;    // of sums over the points of a sample

// The largest power of two below n, which is 2 at least.
inline int64_t half_of(int64_t n) {
    int64_t half = 1;
    while (2 * half < n) half *= 2;
    return half;
}

// Folds n lanes, or any n entries by halves; overwrites them. 0 for none.
template <typename T>
inline T fold(T* lanes, int64_t n) {
    if (n == 0) return T(0);
    for (int64_t half = half_of(n); n > 1; n = half, half /= 2) {
#pragma GCC ivdep
        for (int64_t k = 0; k < n - half; ++k) lanes[k] += lanes[k + half];
    }
    return lanes[0] + T(0);
}

// As `fold`, of a number of lanes that the compiler knows.
template <int64_t N, typename T>
inline T fold(T* lanes) {
    if constexpr (N == 1) {
        return lanes[0] + T(0);
    } else {
#pragma GCC ivdep
        for (int64_t k = 0; k < N / 2; ++k) lanes[k] += lanes[k + N / 2];
        return fold<N / 2>(lanes);
    }
}

// As `fold`, of n rows of `width` sums each; the totals are the first row.
template <typename T>
inline void fold_rows(T* rows, int64_t n, int64_t width) {
    for (int64_t half = half_of(n); n > 1; n = half, half /= 2)
        for (int64_t k = 0; k < (n - half) * width; ++k) rows[k] += rows[k + half * width];
}

// Sums side by side over the points of a sample, few of which count: lanes that nothing was added to cost nothing.
class SparseLanes {
   public:
    explicit SparseLanes(int64_t sums) : width_(sums), sums_(SAMPLE_LANES * sums) {}

    void clear() { used_ = 0; }

    // The sums in the lane of an entry, to be added to.
    double* at(int64_t entry) {
        const int64_t lane = entry % SAMPLE_LANES;
        double* sums = sums_.data() + lane * width_;
        if (!(used_ >> lane & 1)) {
            used_ |= uint64_t(1) << lane;
            std::fill(sums, sums + width_, 0.0);
        }
        return sums;
    }

    // Folds the lanes; the totals stay until the next `clear`.
    const double* fold() {
        if (used_ == 0) std::fill(sums_.begin(), sums_.begin() + width_, 0.0);
        for (int64_t half = SAMPLE_LANES / 2; half > 0; half /= 2) {
            for (int64_t lane = 0; lane < half; ++lane) {
                if (!(used_ >> (lane + half) & 1)) continue;
                double* lower = sums_.data() + lane * width_;
                const double* upper = lower + half * width_;
                if (used_ >> lane & 1)
                    for (int64_t i = 0; i < width_; ++i) lower[i] += upper[i];
                else
                    std::copy(upper, upper + width_, lower);
                used_ |= uint64_t(1) << lane;
            }
        }
        return sums_.data();
    }

   private:
    int64_t width_;
    uint64_t used_ = 0;
    std::vector<double> sums_;
};

}  // namespace torchreg
