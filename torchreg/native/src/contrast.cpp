// Local color contrast: spread and shift of every color channel, near a point and farther.
#include "slots.hpp"
#include "sums.hpp"

namespace torchreg {
namespace {

constexpr int64_t COLUMNS = 10;

constexpr int64_t SUMS = 4;  // of a channel's differences and of their squares, of the near neighbors and of all

// _moments: mean and standard deviation, from sums over `share` reciprocal.
struct Moments {
    float mean, spread;
    Moments(float sum, float squares, float share) {
        mean = sum * share;
        float variance = squares * share - mean * mean;
        variance = variance < 0.0f ? 0.0f : variance;
        spread = variance * (1.0f / std::sqrt(std::max(variance, std::numeric_limits<float>::min())));
    }
};

float share_of(int64_t count) { return 1.0f / static_cast<float>(std::max<int64_t>(count, 1)); }

}  // namespace

// contrast of descriptors/contrast.py in float32: colors (P, 3), neighborhoods (P, K) with squared distances, inner
// (P,) the square of the near radius, `level` added to means that divide, `constant` the last entry -> out (P, 10).
KERNEL(contrast, const float* colors, const int64_t* index, int64_t index_stride, const uint8_t* valid,
                int64_t valid_stride, const float* square, int64_t square_stride, const float* inner, int64_t count,
                int64_t width, double level, double constant, float* out, int64_t threads) {
    const Slots slots{index, index_stride, valid, valid_stride, width, count};
    const std::vector<float> table = records(colors, count);
    const float least = static_cast<float>(level);
    parallel(threads, count, ROWS, [&](int64_t begin, int64_t end, int64_t) {
        for (int64_t row = begin; row < end; ++row) {
            const int64_t* indices = slots.index_of(row);
            const uint8_t* flags = slots.valid_of(row);
            const float* squares = square + square_stride * row;
            const float* own = table.data() + RECORD * row;
            const float radius = inner[row];
            const int64_t used = slots.used(row);
            alignas(64) float lanes[3 * SUMS][NEIGHBOR_LANES] = {};
            float sums[3 * SUMS];
            int64_t near_count = 0, far_count = 0;
            for (int64_t first = 0; first < used; first += NEIGHBOR_LANES) {
                alignas(64) float others[RECORD * NEIGHBOR_LANES], core[NEIGHBOR_LANES], whole[NEIGHBOR_LANES];
                const int64_t here = std::min(NEIGHBOR_LANES, used - first);
                for (int64_t k = 0; k < NEIGHBOR_LANES; ++k) {
                    const int64_t slot = first + std::min(k, here - 1);
                    std::memcpy(others + RECORD * k, table.data() + RECORD * indices[slot], RECORD * sizeof(float));
                    const bool counted = (k < here) & (flags[slot] != 0), close = counted & (squares[slot] < radius);
                    whole[k] = static_cast<float>(counted);
                    core[k] = static_cast<float>(close);
                    far_count += counted;
                    near_count += close;
                }
                for (int64_t c = 0; c < 3; ++c)
                    for (int64_t k = 0; k < NEIGHBOR_LANES; ++k) {
                        const float value = others[RECORD * k + c] - own[c];
                        const float near = value * core[k], far = value * whole[k];
                        lanes[SUMS * c][k] += near;
                        lanes[SUMS * c + 1][k] += near * value;
                        lanes[SUMS * c + 2][k] += far;
                        lanes[SUMS * c + 3][k] += far * value;
                    }
            }
            for (int64_t sum = 0; sum < 3 * SUMS; ++sum) sums[sum] = fold<NEIGHBOR_LANES>(lanes[sum]);
            const float described = far_count > 1 ? 1.0f : 0.0f;
            float* result = out + COLUMNS * row;
            for (int64_t c = 0; c < 3; ++c) {
                const float* of_channel = sums + SUMS * c;
                const Moments near(of_channel[0], of_channel[1], share_of(near_count));
                const Moments far(of_channel[2], of_channel[3], share_of(far_count));
                const float far_level = own[c] + far.mean + least, near_level = own[c] + near.mean + least;
                result[3 * c] = near.spread / near_level * described;
                result[3 * c + 1] = far.spread / far_level * described;
                result[3 * c + 2] = (near.mean - far.mean) / far_level * described;
            }
            result[COLUMNS - 1] = static_cast<float>(constant) * described;
        }
    });
    return 0;
}

}  // namespace torchreg
