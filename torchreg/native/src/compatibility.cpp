// The graph of correspondences that keep their distances, the consensus sets in it, and their moments
// (torchreg/solvers/compatibility/graph.py and sets.py).
#include "agreement.hpp"
#include "rotation.hpp"

using namespace torchreg;

namespace {

using Word = uint64_t;

struct Bits {  // rows of bits
    int64_t words;
    std::vector<Word> rows;

    Bits(int64_t count, int64_t width) : words((width + 63) / 64), rows(count * words) {}
    Word* row(int64_t i) { return rows.data() + i * words; }
    const Word* row(int64_t i) const { return rows.data() + i * words; }
};

inline bool holds(const Word* row, int64_t j) { return (row[j >> 6] >> (j & 63)) & 1; }

inline void set(Word* row, int64_t j) { row[j >> 6] |= Word(1) << (j & 63); }

#if defined(_MSC_VER)
inline int64_t ones(Word word) {
    word -= (word >> 1) & 0x5555555555555555ull;
    word = (word & 0x3333333333333333ull) + ((word >> 2) & 0x3333333333333333ull);
    return int64_t((((word + (word >> 4)) & 0x0f0f0f0f0f0f0f0full) * 0x0101010101010101ull) >> 56);
}
inline int64_t lowest(Word word) { return ones((word & (0 - word)) - 1); }
#else
inline int64_t ones(Word word) { return __builtin_popcountll(word); }
inline int64_t lowest(Word word) { return __builtin_ctzll(word); }
#endif

inline int64_t common(const Word* one, const Word* other, int64_t words) {
    int64_t count = 0;
    for (int64_t w = 0; w < words; ++w) count += ones(one[w] & other[w]);
    return count;
}

// Call visit(j) for the bits that are set in a row, ascending.
template <typename Visit>
inline void each(const Word* row, int64_t words, Visit visit) {
    for (int64_t w = 0; w < words; ++w)
        for (Word left = row[w]; left != 0; left &= left - 1) visit(w * 64 + lowest(left));
}

// Puts numbers in falling order of their counts, equal ones in the order they came in: by places for every count.
class Ranking {
  public:
    explicit Ranking(int64_t most) : first_(most + 2, 0) { numbers_.reserve(most), counts_.reserve(most); }

    void clear() { numbers_.clear(), counts_.clear(), highest_ = 0; }

    void add(int64_t number, int64_t count) {
        numbers_.push_back(int32_t(number));
        counts_.push_back(int32_t(count));
        highest_ = std::max(highest_, count);
    }

    // The `most` highest; returns how many there are.
    int64_t take(int64_t most, int64_t* out) {
        std::fill_n(first_.begin(), highest_ + 1, 0);
        for (const int32_t count : counts_) ++first_[count];
        int32_t total = 0;
        for (int64_t count = highest_; count >= 0; --count) {
            const int32_t here = first_[count];
            first_[count] = total;
            total += here;
        }
        for (size_t k = 0; k < numbers_.size(); ++k) {
            const int32_t place = first_[counts_[k]]++;
            if (place < most) out[place] = numbers_[k];
        }
        return std::min<int64_t>(most, numbers_.size());
    }

  private:
    std::vector<int32_t> first_, numbers_, counts_;
    int64_t highest_ = 0;
};

class Seeds {  // the sets of one seed after another, in memory of one thread
  public:
    Seeds(const Bits& graph, int64_t count, int64_t wide, int64_t narrow)
        : graph_(graph), wide_(wide), narrow_(narrow), ranking_(count), mask_(1, count), kept_(narrow, narrow),
          stride_((narrow + 7) / 8 * 8), partners_(wide + 1), places_(wide + 1), member_(narrow),
          agreement_(narrow * stride_), vector_(stride_), next_(stride_) {}

    void form(int64_t seed, int64_t* members, double* weights) {
        choose_partners(seed);
        choose_members(seed);
        weigh();
        std::copy_n(member_.data(), narrow_, members);
        std::copy_n(vector_.data(), narrow_, weights);
    }

  private:
    // Those that share the most partners with the seed; of equal ones the earlier first.
    void choose_partners(int64_t seed) {
        const Word* row = graph_.row(seed);
        ranking_.clear();
        each(row, graph_.words, [&](int64_t j) {
            const int64_t shared = common(row, graph_.row(j), graph_.words);
            if (shared > 0) ranking_.add(j, shared);
        });
        int64_t filled = ranking_.take(wide_, partners_.data());
        if (filled == wide_) return;
        mark(filled);
        for (int64_t j = 0; filled < wide_; ++j)
            if (j != seed && !holds(mask_.row(0), j)) partners_[filled++] = j;
    }

    // Of these, those that share the most partners with the seed inside the set.
    void choose_members(int64_t seed) {
        const Word* row = graph_.row(seed);
        mark(wide_);
        for (int64_t w = 0; w < graph_.words; ++w) mask_.row(0)[w] &= row[w];
        ranking_.clear();
        for (int64_t b = 0; b < wide_; ++b) {
            const int64_t partner = partners_[b];
            ranking_.add(b, holds(row, partner) ? common(mask_.row(0), graph_.row(partner), graph_.words) : 0);
        }
        ranking_.take(narrow_ - 1, places_.data());
        member_[0] = seed;
        for (int64_t a = 1; a < narrow_; ++a) member_[a] = partners_[places_[a - 1]];
    }

    // Set the bits of the first partners alone.
    void mark(int64_t number) {
        std::fill(mask_.rows.begin(), mask_.rows.end(), Word(0));
        for (int64_t b = 0; b < number; ++b) set(mask_.row(0), partners_[b]);
    }

    // The leading eigenvector of the members' second order, unscaled: whole numbers.
    void weigh() {
        std::fill(kept_.rows.begin(), kept_.rows.end(), Word(0));
        for (int64_t a = 0; a < narrow_; ++a) {
            const Word* row = graph_.row(member_[a]);
            for (int64_t b = 0; b < narrow_; ++b) kept_.row(a)[b >> 6] |= Word(holds(row, member_[b])) << (b & 63);
        }
        std::fill(agreement_.begin(), agreement_.end(), 0.0);
        std::fill(vector_.begin(), vector_.end(), 0.0);
        for (int64_t a = 0; a < narrow_; ++a)
            each(kept_.row(a), kept_.words, [&](int64_t b) {
                const double shared = double(common(kept_.row(a), kept_.row(b), kept_.words));
                agreement_[a * stride_ + b] = shared;
                vector_[a] += shared;
            });
        for (int64_t iteration = 1; iteration < 4; ++iteration) {
            std::fill(next_.begin(), next_.end(), 0.0);
            for (int64_t a = 0; a < narrow_; ++a) {
                const double value = vector_[a];
                const double* row = agreement_.data() + a * stride_;
                double* out = next_.data();
                for (int64_t b = 0; b < stride_; ++b) out[b] += row[b] * value;
            }
            vector_.swap(next_);
        }
    }

    const Bits& graph_;
    const int64_t wide_, narrow_;
    Ranking ranking_;
    Bits mask_, kept_;
    const int64_t stride_;
    std::vector<int64_t> partners_, places_, member_;
    std::vector<double> agreement_, vector_, next_;
};

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

// Six sums of three means' squares: whether the second principal spread is not small beside the first.
inline bool spans_plane(double xx, double yy, double zz, double xy, double xz, double yz, double least) {
    const double trace = xx + yy + zz;
    const double minors = (xx * yy - xy * xy) + (xx * zz - xz * xz) + (yy * zz - yz * yz);
    return minors > least * trace * trace;
}

}  // namespace

// Graphs (count, count) of zeros and ones of correspondences (3, count) twice in meters, per_square being one
// over the squared threshold: graph.first_order.
KERNEL first_order_f32(const float* source, const float* target, int64_t count, double per_square, float* graph,
                       int64_t threads) {
    return first_order(source, target, count, per_square, graph, threads);
}
KERNEL first_order_f64(const double* source, const double* target, int64_t count, double per_square, float* graph,
                       int64_t threads) {
    return first_order(source, target, count, per_square, graph, threads);
}

// How many of correspondences (3, count) twice agree with each, itself counted: degree (count): nodes.degrees.
KERNEL degrees_f32(const float* source, const float* target, int64_t count, double per_square, float* degree,
                   int64_t threads) {
    return degrees(source, target, count, per_square, degree, threads);
}
KERNEL degrees_f64(const double* source, const double* target, int64_t count, double per_square, double* degree,
                   int64_t threads) {
    return degrees(source, target, count, per_square, degree, threads);
}

// How many of others (3, others) twice agree with each of (3, count) twice: degree (count): nodes.degrees_among.
KERNEL degrees_among_f32(const float* source, const float* target, int64_t count, const float* other_source,
                         const float* other_target, int64_t others, double per_square, float* degree,
                         int64_t threads) {
    return degrees_among(source, target, count, other_source, other_target, others, per_square, degree, threads);
}
KERNEL degrees_among_f64(const double* source, const double* target, int64_t count, const double* other_source,
                         const double* other_target, int64_t others, double per_square, double* degree,
                         int64_t threads) {
    return degrees_among(source, target, count, other_source, other_target, others, per_square, degree, threads);
}

// How alike the distances of both points of each correspondence (3, count) to anchors (3, of_source) and (3, of_target)
// are, per_square being one over a bin's squared width: result (count): nodes._chance.
KERNEL chance_f32(const float* source, const float* target, int64_t count, const float* source_anchors,
                  int64_t of_source, const float* target_anchors, int64_t of_target, double per_square, int64_t bins,
                  int64_t smoothed, double* result, int64_t threads) {
    return chance(source, target, count, source_anchors, of_source, target_anchors, of_target, per_square, bins,
                  smoothed, result, threads);
}
KERNEL chance_f64(const double* source, const double* target, int64_t count, const double* source_anchors,
                  int64_t of_source, const double* target_anchors, int64_t of_target, double per_square, int64_t bins,
                  int64_t smoothed, double* result, int64_t threads) {
    return chance(source, target, count, source_anchors, of_source, target_anchors, of_target, per_square, bins,
                  smoothed, result, threads);
}

// The sets of all nodes of a symmetric graph (count, count) of zeros and ones, the diagonal zero: sets.consensus_sets.
// `wide` is below count, `narrow` at most wide + 1; members (count, narrow) and weights (count, narrow).
KERNEL consensus_sets(const float* graph, int64_t count, int64_t wide, int64_t narrow, int64_t* members,
                      double* weights, int64_t threads) {
    Bits bits(count, count);
    parallel(threads, count, 131072 / std::max<int64_t>(1, count) + 1, [&](int64_t begin, int64_t end, int64_t) {
        for (int64_t i = begin; i < end; ++i) {
            const float* values = graph + i * count;
            Word* row = bits.row(i);
            for (int64_t w = 0; w < bits.words; ++w) {
                const int64_t width = std::min<int64_t>(64, count - w * 64);
                Word word = 0;
                for (int64_t j = 0; j < width; ++j) word |= Word(values[w * 64 + j] != 0.0f) << j;
                row[w] = word;
            }
        }
    });
    parallel(threads, count, 32, [&](int64_t begin, int64_t end, int64_t) {
        Seeds seeds(bits, count, wide, narrow);
        for (int64_t seed = begin; seed < end; ++seed)
            seeds.form(seed, members + seed * narrow, weights + seed * narrow);
    });
    return 0;
}

// Weighted least squares of sets (sets, size) of members and weights of the points (3, count) twice, sums in the order
// of the members: rotations (3, 3, sets), translations (3, sets), and whether both sides spread across a line, by the
// square of the least sine: sets.fit_sets.
KERNEL fit_sets(const double* source, const double* target, int64_t count, const int64_t* members,
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
