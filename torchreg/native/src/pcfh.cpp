// Histograms of color differences.
#include "slots.hpp"

namespace torchreg {
namespace {

constexpr float VOTE_STEPS = 1024.0f;  // of descriptors/pcfh.py

struct Channel {
    const float* values;
    const float* saturation;  // weighs votes where it is not null
    bool circular;
};

// Votes (bins,) of `count` neighbors of a point for one channel; returns their number.
int64_t vote(const Channel& channel, const int64_t* kept, int64_t count, int64_t row, int64_t bins, int32_t* votes) {
    alignas(64) float value[BLOCK];
    alignas(64) int32_t bin[BLOCK], weight[BLOCK];
    const float own = channel.values[row], last = static_cast<float>(bins - 1);
    for (int64_t k = 0; k < count; ++k) value[k] = channel.values[kept[k]];
    const float scale = static_cast<float>(channel.circular ? 2 * bins : bins);
    const bool circular = channel.circular;
    for (int64_t k = 0; k < count; ++k) {
        float difference = std::fabs(value[k] - own);
        const float around = 1.0f - difference;
        difference = circular && around < difference ? around : difference;
        const float place = difference * scale, low = place > 0.0f ? place : 0.0f;
        bin[k] = static_cast<int32_t>(low < last ? low : last);
    }
    if (channel.saturation == nullptr) {
        for (int64_t k = 0; k < count; ++k) ++votes[bin[k]];
        return count;
    }
    int64_t total = 0;
    for (int64_t k = 0; k < count; ++k) {
        const float product = channel.saturation[kept[k]] * channel.saturation[row];
        weight[k] = static_cast<int32_t>(std::nearbyint(product * VOTE_STEPS));
    }
    for (int64_t k = 0; k < count; ++k) {
        votes[bin[k]] += weight[k];
        total += weight[k];
    }
    return total;
}

}  // namespace
}  // namespace torchreg

using namespace torchreg;

// _own_histograms of descriptors/pcfh.py in float32: one column (P,) per channel as rows of `columns` (C, P), the
// saturation (P,) that weighs votes on circular channels or null, bit c of `circular` set where channel c is,
// neighborhoods (P, K) -> out (P, C x bins), enough (P,) bool.
KERNEL color_histograms_f32(const float* columns, const float* saturation, int64_t channels, int64_t circular,
                            const int64_t* index, int64_t index_stride, const uint8_t* valid, int64_t valid_stride,
                            int64_t count, int64_t width, int64_t bins, int64_t least, float* out, uint8_t* enough,
                            int64_t threads) {
    const Slots slots{index, index_stride, valid, valid_stride, width};
    parallel(threads, count, ROWS, [&](int64_t begin, int64_t end, int64_t) {
        std::vector<int32_t> votes(channels * bins);
        std::vector<int64_t> totals(channels);
        int64_t kept[BLOCK + 1];
        for (int64_t row = begin; row < end; ++row) {
            const int64_t* indices = slots.index_of(row);
            const uint8_t* flags = slots.valid_of(row);
            std::fill(votes.begin(), votes.end(), 0);
            std::fill(totals.begin(), totals.end(), 0);
            int64_t neighbors = 0;
            for (int64_t first = 0; first < width; first += BLOCK) {
                int64_t taken = 0;
                for (int64_t k = first; k < std::min(first + BLOCK, width); ++k) {
                    kept[taken] = indices[k];
                    taken += flags[k] != 0 && indices[k] != row;
                }
                for (int64_t c = 0; c < channels; ++c) {
                    const bool round = (circular >> c) & 1;
                    const Channel channel{columns + c * count, round ? saturation : nullptr, round};
                    totals[c] += vote(channel, kept, taken, row, bins, &votes[c * bins]);
                }
                neighbors += taken;
            }
            enough[row] = neighbors >= least;
            for (int64_t c = 0; c < channels; ++c) {
                const float share = (1.0f / static_cast<float>(std::max<int64_t>(totals[c], 1))) * 100.0f;
                for (int64_t bin = c * bins; bin < (c + 1) * bins; ++bin)
                    out[channels * bins * row + bin] = static_cast<float>(votes[bin]) * share * (enough[row] ? 1.0f : 0.0f);
            }
        }
    });
    return 0;
}
