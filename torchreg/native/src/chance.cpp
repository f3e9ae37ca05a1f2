// How many correspondences agree by chance: torchreg/solvers/compatibility/nodes.py.
#include "distances.hpp"

namespace torchreg {
namespace {

// Counts of the distances of one point from anchors (3, number), in bins by their squares times per_square.
template <typename Real>
inline void histogram(const Real* point, const Real* anchors, int64_t number, Real per_square, int64_t bins,
                      Real* bin, int32_t* counts) {
    const Real last = Real(bins - 1);
    for (int64_t j = 0; j < number; ++j) {
        const Real square = Sides<Real>::Point::square(point, anchors, number, j) * per_square;
        Real k = std::min(std::floor(std::sqrt(square)), last);
        k += Real((k + 1) * (k + 1) <= square);
        k -= Real(k * k > square);
        bin[j] = std::min(k, last);
    }
    std::fill_n(counts, bins, 0);
    for (int64_t j = 0; j < number; ++j) ++counts[int64_t(bin[j])];
}

// The sum over bins of the products of two histograms, each summed over neighboring bins.
inline double alike(const int32_t* one, const int32_t* other, int64_t bins, int64_t smoothed) {
    int64_t total = 0, sum_one = 0, sum_other = 0;
    for (int64_t k = 0; k < bins + smoothed - 1; ++k) {
        sum_one += k < bins ? one[k] : 0;
        sum_other += k < bins ? other[k] : 0;
        if (k >= smoothed) {
            sum_one -= one[k - smoothed];
            sum_other -= other[k - smoothed];
        }
        total += sum_one * sum_other;
    }
    return double(total);
}

}  // namespace

template <typename Real>
int64_t chance(const Real* source, const Real* target, int64_t count, const Real* source_anchors, int64_t of_source,
               const Real* target_anchors, int64_t of_target, double per_square, int64_t bins, int64_t smoothed,
               double* result, int64_t threads) {
    const Sides<Real> points{source, target, count};
    parallel(threads, count, 64, [&](int64_t begin, int64_t end, int64_t) {
        std::vector<int32_t> counts(2 * bins);
        std::vector<Real> bin(std::max(of_source, of_target));
        for (int64_t i = begin; i < end; ++i) {
            const auto one = points.at(i);
            histogram(one.p, source_anchors, of_source, Real(per_square), bins, bin.data(), counts.data());
            histogram(one.q, target_anchors, of_target, Real(per_square), bins, bin.data(), counts.data() + bins);
            result[i] = alike(counts.data(), counts.data() + bins, bins, smoothed);
        }
    });
    return 0;
}

// Equals `_chance` of nodes.py: how alike the distances of both points of each correspondence to anchors are.
//
// source and target (3, M), meters; anchors (3, of_source) and (3, of_target); per_square is one over a bin's squared
// width, `smoothed` how many neighboring bins are summed. Writes result (M) float64.
KERNELS(chance,
        (const Real* source, const Real* target, int64_t count, const Real* source_anchors, int64_t of_source,
         const Real* target_anchors, int64_t of_target, double per_square, int64_t bins, int64_t smoothed,
         double* result, int64_t threads),
        (source, target, count, source_anchors, of_source, target_anchors, of_target, per_square, bins, smoothed,
         result, threads))

}  // namespace torchreg
