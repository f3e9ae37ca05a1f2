// Point feature histograms: the angles, and the color ratios, of all pairs of neighbors.
#include "slots.hpp"

namespace torchreg {
namespace {

constexpr int64_t BINS = 5;  // of descriptors/neighbor_pairs.py
constexpr int64_t CELLS = BINS * BINS * BINS;
constexpr int64_t LANES = 16;
constexpr int64_t COPIES = 4;  // of a histogram, so that votes on one cell do not wait for each other
constexpr int64_t ROWS_OF_PAIRS = 8;

inline float dot(float ax, float ay, float az, float bx, float by, float bz) { return ax * bx + ay * by + az * bz; }

inline int32_t unit_bin(float value) {
    const float place = (value + 1.0f) * 5.0f * 0.5f;
    const float low = place > 0.0f ? place : 0.0f;
    return static_cast<int32_t>(low < 4.0f ? low : 4.0f);
}

// _ratio_bins of two values of one color channel.
inline int32_t ratio_bin(float first, float second, const float* edges) {
    const bool black = second == 0.0f;
    const float quotient = black ? 1.0f : first / (black ? 1.0f : second);
    const float ratio = quotient > 1.0f ? -(1.0f / quotient) : quotient;
    return ((ratio >= edges[0]) + (ratio >= edges[1])) + ((ratio >= edges[2]) + (ratio >= edges[3]));
}

// The neighbors of a point side by side: COLUMNS arrays of `width` numbers each, which is a multiple of LANES.
template <int64_t COLUMNS>
struct Side {
    explicit Side(int64_t slots) : width((slots + LANES - 1) / LANES * LANES), values(COLUMNS * width), cells(2 * width) {}

    int64_t width;
    std::vector<float> values;
    std::vector<int32_t> cells;

    const float* column(int64_t c) const { return values.data() + c * width; }

    // Fills the columns from the valid slots of a row; returns how many there are.
    int64_t fill(const float* table, const Slots& slots, int64_t row) {
        const int64_t* index = slots.index_of(row);
        const uint8_t* valid = slots.valid_of(row);
        const int64_t used = slots.used(row);
        int64_t count = 0;
        for (int64_t k = 0; k < used; ++k) {
            if (!valid[k]) continue;
            for (int64_t c = 0; c < COLUMNS; ++c) values[c * width + count] = table[COLUMNS * index[k] + c];
            ++count;
        }
        for (int64_t c = 0; c < COLUMNS; ++c)
            std::fill(&values[c * width + count], &values[c * width] + (count + LANES - 1) / LANES * LANES, 0.0f);
        return count;
    }
};

// _cells of descriptors/pfh.py (EXCHANGE) or of descriptors/pfhrgb.py, of point `one` of a side and each of the `count`
// first ones; FORWARD says that `one` is the first point of the pairs. `count` is a multiple of LANES.
template <bool EXCHANGE, bool FORWARD, int64_t COLUMNS>
void angle_cells(const Side<COLUMNS>& side, int64_t one, int64_t count, const float* edges, int32_t* cells) {
    const float *x = side.column(0), *y = side.column(1), *z = side.column(2);
    const float *nx = side.column(3), *ny = side.column(4), *nz = side.column(5);
    const float ox = x[one], oy = y[one], oz = z[one], onx = nx[one], ony = ny[one], onz = nz[one];
    const float e0 = edges[0], e1 = edges[1];
#pragma GCC ivdep
    for (int64_t k = 0; k < count; ++k) {
        const float px = FORWARD ? ox : x[k], py = FORWARD ? oy : y[k], pz = FORWARD ? oz : z[k];
        const float qx = FORWARD ? onx : nx[k], qy = FORWARD ? ony : ny[k], qz = FORWARD ? onz : nz[k];
        const float dx = (FORWARD ? x[k] : ox) - px, dy = (FORWARD ? y[k] : oy) - py, dz = (FORWARD ? z[k] : oz) - pz;
        const float rx = FORWARD ? nx[k] : onx, ry = FORWARD ? ny[k] : ony, rz = FORWARD ? nz[k] : onz;
        const float gx = rx - qx, gy = ry - qy, gz = rz - qz;
        const float before = dot(qx, qy, qz, dx, dy, dz);
        const float change = dot(gx, gy, gz, dx, dy, dz);
        const bool exchanged = EXCHANGE && ((before + before) + change) * change > 0.0f;
        const float swap = exchanged ? 1.0f : 0.0f, sign = 1.0f - 2.0f * swap;
        const float mx = exchanged ? rx : qx, my = exchanged ? ry : qy, mz = exchanged ? rz : qz;
        const float along = before + change * swap;
        const float vx = dy * mz - dz * my, vy = dz * mx - dx * mz, vz = dx * my - dy * mx;
        const float across = dot(vx, vy, vz, vx, vy, vz), length = dot(dx, dy, dz, dx, dy, dz);
        const float proper = across > 0.0f ? 1.0f : 0.0f, degenerate = 1.0f - proper;
        const float per_across = 1.0f / std::sqrt(across + degenerate) * proper;
        const float per_length = 1.0f / std::sqrt(length + degenerate) * proper;
        const float square = dot(mx, my, mz, mx, my, mz), turn = dot(mx, my, mz, gx, gy, gz);
        const float cosine = (turn * sign + square) * proper + degenerate;
        const float sine = (square * change - along * turn) * per_across;
        const float ratio = cosine / (std::fabs(sine) + std::fabs(cosine));
        const float passed = (ratio < e0 ? 1.0f : 0.0f) + (ratio < e1 ? 1.0f : 0.0f);
        const int32_t f1 = static_cast<int32_t>(std::copysign(passed, sine) + 2.0f);
        const int32_t f2 = unit_bin(dot(vx, vy, vz, gx, gy, gz) * per_across);
        const int32_t f3 = unit_bin(along * sign * per_length);
        cells[k] = f1 + f2 * int32_t(BINS) + f3 * int32_t(BINS * BINS);
    }
}

// The cells of color ratios of the same pairs.
template <bool FORWARD, int64_t COLUMNS>
void color_cells(const Side<COLUMNS>& side, int64_t one, int64_t count, const float* edges, int32_t* cells) {
    const float *r = side.column(6), *g = side.column(7), *b = side.column(8);
    const float red = r[one], green = g[one], blue = b[one];
#pragma GCC ivdep
    for (int64_t k = 0; k < count; ++k) {
        const int32_t c1 = ratio_bin(FORWARD ? red : r[k], FORWARD ? r[k] : red, edges);
        const int32_t c2 = ratio_bin(FORWARD ? green : g[k], FORWARD ? g[k] : green, edges);
        const int32_t c3 = ratio_bin(FORWARD ? blue : b[k], FORWARD ? b[k] : blue, edges);
        cells[k] = c1 + c2 * int32_t(BINS) + c3 * int32_t(BINS * BINS);
    }
}

// Points of COLUMNS numbers each from tables of three.
template <int64_t COLUMNS>
std::vector<float> joined(const float* const (&tables)[COLUMNS / 3], int64_t count) {
    std::vector<float> out(COLUMNS * count);
    for (int64_t row = 0; row < count; ++row)
        for (int64_t c = 0; c < COLUMNS; ++c) out[COLUMNS * row + c] = tables[c / 3][3 * row + c % 3];
    return out;
}

inline float share_of(int64_t count) {
    return (1.0f / static_cast<float>(std::max<int64_t>(count * (count - 1) / 2, 1))) * 100.0f;
}

inline int64_t whole_lanes(int64_t count) { return (count + LANES - 1) / LANES * LANES; }

void write(const int32_t (&votes)[COPIES][CELLS], float share, float* out) {
    for (int64_t cell = 0; cell < CELLS; ++cell) {
        int32_t sum = 0;
        for (int64_t copy = 0; copy < COPIES; ++copy) sum += votes[copy][cell];
        out[cell] = static_cast<float>(sum) * share;
    }
}

}  // namespace

// pair_histograms of descriptors/pfh.py in float32: points and normals (P, 3), edges (2,) of f1, neighborhoods (P, K)
// -> out (P, 125).
KERNEL(pair_histograms, const float* points, const float* normals, const float* edges, const int64_t* index,
                       int64_t index_stride, const uint8_t* valid, int64_t valid_stride, int64_t count, int64_t width,
                       float* out, int64_t threads) {
    const std::vector<float> table = joined<6>({points, normals}, count);
    const Slots slots{index, index_stride, valid, valid_stride, width, count};
    parallel(threads, count, ROWS_OF_PAIRS, [&](int64_t begin, int64_t end, int64_t) {
        Side<6> side(width);
        for (int64_t row = begin; row < end; ++row) {
            int32_t votes[COPIES][CELLS] = {};
            const int64_t neighbors = side.fill(table.data(), slots, row);
            int32_t* cells = side.cells.data();
            for (int64_t one = 1; one < neighbors; ++one) {
                angle_cells<true, true>(side, one, whole_lanes(one), edges, cells);
                for (int64_t k = 0; k < one; ++k) ++votes[k % COPIES][cells[k]];
            }
            write(votes, share_of(neighbors), out + CELLS * row);
        }
    });
    return 0;
}

// colored_pair_histograms of descriptors/pfhrgb.py in float32: points, normals and colors (P, 3), edges (2,) of f1 and
// (4,) of color ratios, neighborhoods (P, K) -> out (P, 250).
KERNEL(colored_pair_histograms, const float* points, const float* normals, const float* colors, const float* edges,
                               const float* ratio_edges, const int64_t* index, int64_t index_stride,
                               const uint8_t* valid, int64_t valid_stride, int64_t count, int64_t width, float* out,
                               int64_t threads) {
    const std::vector<float> table = joined<9>({points, normals, colors}, count);
    const Slots slots{index, index_stride, valid, valid_stride, width, count};
    parallel(threads, count, ROWS_OF_PAIRS, [&](int64_t begin, int64_t end, int64_t) {
        Side<9> side(width);
        for (int64_t row = begin; row < end; ++row) {
            int32_t angles[COPIES][CELLS] = {}, ratios[COPIES][CELLS] = {};
            const int64_t neighbors = side.fill(table.data(), slots, row);
            int32_t *cells = side.cells.data(), *colored = cells + side.width;
            auto vote = [&](int64_t pairs) {
                for (int64_t k = 0; k < pairs; ++k) {
                    ++angles[k % COPIES][cells[k]];
                    ++ratios[k % COPIES][colored[k]];
                }
            };
            for (int64_t one = 1; one < neighbors; ++one) {
                const int64_t lanes = whole_lanes(one);
                angle_cells<false, true>(side, one, lanes, edges, cells);
                color_cells<true>(side, one, lanes, ratio_edges, colored);
                vote(one);
                angle_cells<false, false>(side, one, lanes, edges, cells);
                color_cells<false>(side, one, lanes, ratio_edges, colored);
                vote(one);
            }
            write(angles, share_of(neighbors), out + 2 * CELLS * row);
            write(ratios, share_of(neighbors), out + 2 * CELLS * row + CELLS);
        }
    });
    return 0;
}

}  // namespace torchreg
