// Histograms of color differences.
#include "slots.hpp"

namespace torchreg {
namespace {

constexpr float VOTE_STEPS = 1024.0f;  // of descriptors/pcfh.py, as the places
constexpr int64_t HUE = 0, SATURATION = 1;

// Votes (bins,) of `count` neighbors (count, 4) of a point for the channel at `place`; returns their number.
int64_t vote(const float* near, const float* query, int64_t place, bool weighted, int64_t count, int64_t bins,
             int32_t* votes) {
    alignas(64) int32_t bin[BLOCK], weight[BLOCK];
    const bool circular = place == HUE;
    const float own = query[place], scale = static_cast<float>(circular ? 2 * bins : bins);
    const float last = static_cast<float>(bins - 1);
    for (int64_t k = 0; k < count; ++k) {
        float difference = std::fabs(near[RECORD * k + place] - own);
        const float around = 1.0f - difference;
        difference = circular && around < difference ? around : difference;
        const float scaled = difference * scale, low = scaled > 0.0f ? scaled : 0.0f;
        bin[k] = static_cast<int32_t>(low < last ? low : last);
    }
    if (!weighted || !circular) {
        for (int64_t k = 0; k < count; ++k) ++votes[bin[k]];
        return count;
    }
    for (int64_t k = 0; k < count; ++k)
        weight[k] = static_cast<int32_t>(
            std::nearbyint(near[RECORD * k + SATURATION] * query[SATURATION] * VOTE_STEPS));
    int64_t total = 0;
    for (int64_t k = 0; k < count; ++k) {
        votes[bin[k]] += weight[k];
        total += weight[k];
    }
    return total;
}

}  // namespace

// _own_histograms of descriptors/pcfh.py in float32: values (P, 3) hue, saturation and value, places (C,) of the
// channels among them, whether saturation weighs votes on hue, neighborhoods (P, K), `least` neighbors that are enough
// -> out (P, C x bins), enough (P,) bool.
KERNEL(color_histograms, const float* values, const int64_t* places, int64_t channels, int64_t weighted,
                        const int64_t* index, int64_t index_stride, const uint8_t* valid, int64_t valid_stride,
                        int64_t count, int64_t width, int64_t bins, int64_t least, float* out, uint8_t* enough,
                        int64_t threads) {
    const Slots slots{index, index_stride, valid, valid_stride, width, count};
    const std::vector<float> table = records(values, count);
    parallel(threads, count, ROWS, [&](int64_t begin, int64_t end, int64_t) {
        alignas(64) float near[RECORD * (BLOCK + 1)];
        std::vector<int32_t> votes(channels * bins);
        std::vector<int64_t> totals(channels);
        for (int64_t row = begin; row < end; ++row) {
            const int64_t* indices = slots.index_of(row);
            const uint8_t* flags = slots.valid_of(row);
            const int64_t used = slots.used(row);
            std::fill(votes.begin(), votes.end(), 0);
            std::fill(totals.begin(), totals.end(), 0);
            int64_t neighbors = 0;
            for (int64_t first = 0; first < used; first += BLOCK) {
                int64_t taken = 0;
                for (int64_t k = first, last = std::min(first + BLOCK, used); k < last; ++k) {
                    std::memcpy(near + RECORD * taken, table.data() + RECORD * indices[k], RECORD * sizeof(float));
                    taken += (flags[k] != 0) & (indices[k] != row);
                }
                for (int64_t c = 0; c < channels; ++c)
                    totals[c] += vote(near, table.data() + RECORD * row, places[c], weighted != 0, taken, bins,
                                      votes.data() + c * bins);
                neighbors += taken;
            }
            enough[row] = neighbors >= least;
            const float kept = enough[row] ? 1.0f : 0.0f;
            float* result = out + channels * bins * row;
            for (int64_t c = 0; c < channels; ++c) {
                const float share = (1.0f / static_cast<float>(std::max<int64_t>(totals[c], 1))) * 100.0f;
                for (int64_t bin = c * bins; bin < (c + 1) * bins; ++bin)
                    result[bin] = static_cast<float>(votes[bin]) * share * kept;
            }
        }
    });
    return 0;
}

}  // namespace torchreg
