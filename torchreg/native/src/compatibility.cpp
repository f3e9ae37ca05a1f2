// Which correspondences keep their distances: torchreg/solvers/compatibility/graph.py and nodes.py.
#include "distances.hpp"

namespace torchreg {
namespace {

constexpr int64_t WIDE = 2048;  // correspondences beside which others are compared: they stay in the first cache

// How many of others in [begin, end) agree with a correspondence; where `both`, each of these counts it too.
template <bool both, typename Real>
inline int32_t compare(const typename Sides<Real>::Point& one, const Sides<Real>& others, int64_t begin, int64_t end,
                       Real per_square, int32_t* degree) {
    int32_t count = 0;
    for (int64_t j = begin; j < end; ++j) {
        const int32_t agrees = one.agrees(others, j, per_square);
        count += agrees;
        if (both) degree[j] += agrees;
    }
    return count;
}

}  // namespace

template <typename Real>
int64_t first_order(const Real* source, const Real* target, int64_t count, double per_square, float* graph,
                    int64_t threads) {
    const Sides<Real> points{source, target, count};
    parallel(threads, count, 65536 / std::max<int64_t>(1, count) + 1, [&](int64_t begin, int64_t end, int64_t) {
        for (int64_t i = begin; i < end; ++i) {
            float* row = graph + i * count;
            const auto one = points.at(i);
            for (int64_t j = 0; j < count; ++j) row[j] = one.agrees(points, j, Real(per_square)) ? 1.0f : 0.0f;
            row[i] = 0.0f;
        }
    });
    return 0;
}

// Equals `first_order` of graph.py.
//
// source and target (3, N), meters; per_square is one over the squared threshold. Writes graph (N, N) float32, of zeros
// and ones.
KERNELS(first_order,
        (const Real* source, const Real* target, int64_t count, double per_square, float* graph, int64_t threads),
        (source, target, count, per_square, graph, threads))

template <typename Real>
int64_t degrees(const Real* source, const Real* target, int64_t count, double per_square, Real* degree,
                int64_t threads) {
    const Sides<Real> points{source, target, count};
    const int64_t blocks = (count + WIDE - 1) / WIDE;
    const int64_t workers = std::max<int64_t>(1, std::min(threads, blocks * (blocks + 1) / 2));
    std::vector<int32_t> counts(workers * count, 0);
    parallel(workers, blocks * (blocks + 1) / 2, 1, [&](int64_t begin, int64_t end, int64_t worker) {
        int32_t* own = counts.data() + worker * count;
        for (int64_t piece = begin; piece < end; ++piece) {
            int64_t down = 0, across = piece;  // of the triangle of blocks
            while (across >= blocks - down) across -= blocks - down++;
            const int64_t first = down * WIDE, last = std::min(first + WIDE, count);
            const int64_t left = (down + across) * WIDE, right = std::min(left + WIDE, count);
            for (int64_t i = first; i < last; ++i)
                own[i] += across > 0 ? compare<true>(points.at(i), points, left, right, Real(per_square), own)
                                     : compare<false>(points.at(i), points, first, last, Real(per_square), own);
        }
    });
    for (int64_t i = 0; i < count; ++i) {
        int32_t total = 0;
        for (int64_t worker = 0; worker < workers; ++worker) total += counts[worker * count + i];
        degree[i] = Real(total);
    }
    return 0;
}

// Equals `degrees` of nodes.py: how many of the correspondences agree with each, itself counted.
//
// source and target (3, M), meters; per_square is one over the squared threshold. Writes degree (M).
KERNELS(degrees,
        (const Real* source, const Real* target, int64_t count, double per_square, Real* degree, int64_t threads),
        (source, target, count, per_square, degree, threads))

template <typename Real>
int64_t degrees_among(const Real* source, const Real* target, int64_t count, const Real* other_source,
                      const Real* other_target, int64_t others, double per_square, Real* degree, int64_t threads) {
    const Sides<Real> points{source, target, count}, among{other_source, other_target, others};
    parallel(threads, count, 65536 / std::max<int64_t>(1, others) + 1, [&](int64_t begin, int64_t end, int64_t) {
        for (int64_t i = begin; i < end; ++i)
            degree[i] = Real(compare<false>(points.at(i), among, 0, others, Real(per_square), nullptr));
    });
    return 0;
}

// Equals `degrees_among` of nodes.py: as `degrees`, of others (3, N) that agree with each of (3, M).
KERNELS(degrees_among,
        (const Real* source, const Real* target, int64_t count, const Real* other_source, const Real* other_target,
         int64_t others, double per_square, Real* degree, int64_t threads),
        (source, target, count, other_source, other_target, others, per_square, degree, threads))

}  // namespace torchreg
