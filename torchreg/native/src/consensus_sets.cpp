// Consensus sets in a graph of correspondences: torchreg/solvers/compatibility/sets.py.
#include "bits.hpp"

namespace torchreg {
namespace {

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

}  // namespace

// Equals `consensus_sets` of sets.py, for all nodes of a symmetric graph (N, N) of zeros and ones, the diagonal zero.
//
// `wide` is below N, `narrow` at most wide + 1. Writes members (N, narrow) int64 and weights (N, narrow) float64.
KERNEL(consensus_sets, const float* graph, int64_t count, int64_t wide, int64_t narrow, int64_t* members,
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

}  // namespace torchreg
