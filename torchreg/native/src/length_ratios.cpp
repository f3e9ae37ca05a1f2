// Ratios of lengths between matches, counted in bins: torchreg/verification/length_ratios.py.
#include "common.hpp"

namespace torchreg {
namespace {

// Where numbers stand among ascending positive edges, by the leading bits of the number: at most a few comparisons.
class Bins {
   public:
    Bins(const double* edges, int64_t count) : edges_(edges), count_(count), base_(key(edges[0])) {
        const int64_t keys = key(edges[count - 1]) - base_ + 1;
        for (int64_t k = 0, edge = 0; k < keys; ++k) {
            while (edge < count && key(edges[edge]) < base_ + k) ++edge;
            starts_.push_back(int32_t(edge));
        }
    }
    // The number of edges below a positive value.
    int64_t of(double value) const {
        const int64_t k = key(value) - base_;
        if (k < 0) return 0;
        if (k >= int64_t(starts_.size())) return count_;
        int64_t edge = starts_[k];
        while (edge < count_ && edges_[edge] < value) ++edge;
        return edge;
    }

   private:
    static int64_t key(double value) {
        int64_t bits;
        std::memcpy(&bits, &value, sizeof bits);
        return bits >> 45;  // seven bits of the fraction: steps below 1 %
    }
    const double* edges_;
    int64_t count_, base_;
    std::vector<int32_t> starts_;
};

void squared_lengths(const double* points, const int64_t* first, const int64_t* second, int64_t lengths, double* out) {
    for (int64_t k = 0; k < lengths; ++k) {
        const double *a = points + 3 * first[k], *b = points + 3 * second[k];
        const double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
        out[k] = x * x + y * y + z * z;
    }
}

}  // namespace

// Equals `_counted` of length_ratios.py.
//
// source and target (M, 3) float64, meters; first and second (L) int64, rows of the ends of L lengths; edges (E)
// float64, ascending, positive. Writes counts (1 + S, E + 1) int64, which are zero before: how many ratios of squared
// lengths, target over source, fall between the edges, then with the targets' lengths rolled by S even steps; and
// longs (1 + S) int64, how many are compared: those whose squares are both above `least`.
KERNEL(length_ratio_counts, const double* source, const double* target, const int64_t* first, const int64_t* second,
                            const double* edges, int64_t* counts, int64_t* longs, int64_t lengths, int64_t edge_count,
                            int64_t steps, double least, int64_t) {
    std::vector<double> p(lengths), q(lengths);
    squared_lengths(source, first, second, lengths, p.data());
    squared_lengths(target, first, second, lengths, q.data());
    const Bins bins(edges, edge_count);
    for (int64_t s = 0; s <= steps; ++s) {
        const int64_t shift = s * lengths / (steps + 1);
        int64_t* count = counts + s * (edge_count + 1);
        longs[s] = 0;
        for (int64_t k = 0; k < lengths; ++k) {
            const double other = q[k >= shift ? k - shift : k - shift + lengths];
            if (!(p[k] > least && other > least)) continue;
            ++longs[s];
            ++count[bins.of(other / p[k])];
        }
    }
    return 0;
}

}  // namespace torchreg
