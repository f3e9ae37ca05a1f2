// Simplified point feature histograms: the pair features of a point and its neighbors, their bins and votes.
#include "slots.hpp"

namespace torchreg {
namespace {

constexpr int64_t BINS = 11;
constexpr int64_t EDGES = 5;
constexpr int64_t ANGLES = 3;
constexpr int64_t PAIR_RECORD = 2 * RECORD;  // x y z nx ny nz and two zeros
constexpr int64_t COPIES = 4;  // of a histogram, so that votes on one bin do not wait for each other

inline float dot(float ax, float ay, float az, float bx, float by, float bz) { return ax * bx + ay * by + az * bz; }

inline int32_t unit_bin(float value) {
    const float place = (value + 1.0f) * 11.0f * 0.5f;
    const float low = place > 0.0f ? place : 0.0f;
    return static_cast<int32_t>(low < 10.0f ? low : 10.0f);
}

// compact_pair_features, angle_bins and unit_bins of a query point and `count` neighbors, a multiple of 16.
void bins_of(const float* near, const float* query, const float* edges, int64_t count, int32_t* f1, int32_t* f2,
             int32_t* f3) {
    const float px = query[0], py = query[1], pz = query[2], qx = query[3], qy = query[4], qz = query[5];
    const float e0 = edges[0], e1 = edges[1], e2 = edges[2], e3 = edges[3], e4 = edges[4];
#pragma GCC ivdep
    for (int64_t k = 0; k < count; ++k) {
        const float* other = near + PAIR_RECORD * k;
        const float dx = other[0] - px, dy = other[1] - py, dz = other[2] - pz;
        const float ox = other[3], oy = other[4], oz = other[5], gx = ox - qx, gy = oy - qy, gz = oz - qz;
        const float before = dot(qx, qy, qz, dx, dy, dz);
        const float change = dot(gx, gy, gz, dx, dy, dz);
        const bool exchanged = ((before + before) + change) * change > 0.0f;
        const float swap = exchanged ? 1.0f : 0.0f, sign = 1.0f - 2.0f * swap;
        const float nx = exchanged ? ox : qx, ny = exchanged ? oy : qy, nz = exchanged ? oz : qz;
        const float along = before + change * swap;
        const float vx = dy * nz - dz * ny, vy = dz * nx - dx * nz, vz = dx * ny - dy * nx;
        const float across = dot(vx, vy, vz, vx, vy, vz), length = dot(dx, dy, dz, dx, dy, dz);
        const float proper = across > 0.0f ? 1.0f : 0.0f, degenerate = 1.0f - proper;
        const float per_across = 1.0f / std::sqrt(across + degenerate) * proper;
        const float per_length = 1.0f / std::sqrt(length + degenerate) * proper;
        const float square = dot(nx, ny, nz, nx, ny, nz), turn = dot(nx, ny, nz, gx, gy, gz);
        const float cosine = (turn * sign + square) * proper + degenerate;
        const float sine = (square * change - along * turn) * per_across;
        const float ratio = cosine / (std::fabs(sine) + std::fabs(cosine));
        const float passed = (((((ratio < e0 ? 1.0f : 0.0f) + (ratio < e1 ? 1.0f : 0.0f)) + (ratio < e2 ? 1.0f : 0.0f)) +
                               (ratio < e3 ? 1.0f : 0.0f)) +
                              (ratio < e4 ? 1.0f : 0.0f));
        f1[k] = static_cast<int32_t>(std::copysign(passed, sine) + 5.0f);
        f2[k] = unit_bin(dot(vx, vy, vz, gx, gy, gz) * per_across);
        f3[k] = unit_bin(along * sign * per_length);
    }
}

// The histograms (33) of one row, in percent.
void row_histogram(const float* table, const float* edges, const Slots& slots, int64_t row, float* out) {
    alignas(64) float near[PAIR_RECORD * (BLOCK + 16)];
    alignas(64) int32_t bins[ANGLES][BLOCK];
    int32_t votes[COPIES][ANGLES * BINS] = {};
    int64_t total = 0;
    const int64_t* index = slots.index_of(row);
    const uint8_t* valid = slots.valid_of(row);
    const float* query = table + PAIR_RECORD * row;
    const int64_t used = slots.used(row);
    for (int64_t begin = 0; begin < used; begin += BLOCK) {
        const int64_t end = std::min(begin + BLOCK, used);
        int64_t count = 0;
        for (int64_t k = begin; k < end; ++k) {
            std::memcpy(near + PAIR_RECORD * count, table + PAIR_RECORD * index[k], PAIR_RECORD * sizeof(float));
            count += (valid[k] != 0) & (index[k] != row);
        }
        const int64_t filled = (count + 15) / 16 * 16;
        for (int64_t k = count; k < filled; ++k) std::memcpy(near + PAIR_RECORD * k, query, PAIR_RECORD * sizeof(float));
        bins_of(near, query, edges, filled, bins[0], bins[1], bins[2]);
        for (int64_t k = 0; k < count; ++k)
            for (int64_t angle = 0; angle < ANGLES; ++angle) ++votes[k % COPIES][angle * BINS + bins[angle][k]];
        total += count;
    }
    const float share = (1.0f / static_cast<float>(std::max<int64_t>(total, 1))) * 100.0f;
    for (int64_t bin = 0; bin < ANGLES * BINS; ++bin) {
        int32_t sum = 0;
        for (int64_t copy = 0; copy < COPIES; ++copy) sum += votes[copy][bin];
        out[bin] = static_cast<float>(sum) * share;
    }
}

}  // namespace

// simplified_histograms of descriptors/fpfh.py in float32: points and normals (P, 3), edges (5,) of f1, neighborhoods
// (P, K) -> out (P, 33).
KERNEL(simplified_histograms, const float* points, const float* normals, const float* edges, const int64_t* index,
                             int64_t index_stride, const uint8_t* valid, int64_t valid_stride, int64_t count,
                             int64_t width, float* out, int64_t threads) {
    std::vector<float> table(PAIR_RECORD * count);
    for (int64_t row = 0; row < count; ++row)
        for (int64_t axis = 0; axis < 3; ++axis) {
            table[PAIR_RECORD * row + axis] = points[3 * row + axis];
            table[PAIR_RECORD * row + 3 + axis] = normals[3 * row + axis];
        }
    const Slots slots{index, index_stride, valid, valid_stride, width, count};
    parallel(threads, count, ROWS, [&](int64_t begin, int64_t end, int64_t) {
        for (int64_t row = begin; row < end; ++row)
            row_histogram(table.data(), edges, slots, row, out + ANGLES * BINS * row);
    });
    return 0;
}

}  // namespace torchreg
