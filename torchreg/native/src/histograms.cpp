// Histograms of neighbors, summed by the inverse squares of their distances.
#include "slots.hpp"
#include "sums.hpp"

// torch's embedding_bag, which is the definition, adds by fused multiply-adds: the one place where they are wanted.
#if defined(__AVX2__) && defined(__GNUC__)
#define FUSED __attribute__((target("fma")))
#else
#define FUSED
#endif

namespace torchreg {
namespace {

constexpr int64_t STEP = 16;  // columns of the table that are summed at a time

struct Weighted {
    const float* rows[BLOCK];
    float weight[BLOCK];
    int64_t count;
};

// sums (blocks x 16) += weight x row, neighbor by neighbor. Lanes of their own: compilers keep them in registers.
template <int64_t BLOCKS>
FUSED void add_rows(const Weighted& near, float* sums) {
    float held[BLOCKS][STEP];
    std::memcpy(held, sums, sizeof(held));
    for (int64_t k = 0; k < near.count; ++k) {
        const float* row = near.rows[k];
        const float weight = near.weight[k];
#pragma GCC unroll 4
        for (int64_t block = 0; block < BLOCKS; ++block)
            for (int64_t j = 0; j < STEP; ++j) held[block][j] = std::fma(weight, row[STEP * block + j], held[block][j]);
    }
    std::memcpy(sums, held, sizeof(held));
}

void add_all(Weighted& near, int64_t pitch, float* sums) {
    int64_t done = 0;
    auto step = [&](auto add, int64_t columns) {
        add(near, sums + done);
        for (int64_t k = 0; k < near.count; ++k) near.rows[k] += columns;
        done += columns;
    };
    while (pitch - done >= 3 * STEP) step(add_rows<3>, 3 * STEP);
    while (pitch - done >= STEP) step(add_rows<1>, STEP);
}

}  // namespace

// add_weighted_neighbors of descriptors/histograms.py in float32: histograms (P, D) of D / bins blocks, neighborhoods
// (P, K) with squared distances; `least` stands in for smaller ones -> out (P, D).
KERNEL(add_weighted_neighbors, const float* histograms, const int64_t* index, int64_t index_stride,
                              const uint8_t* valid, int64_t valid_stride, const float* square, int64_t square_stride,
                              int64_t count, int64_t width, int64_t columns, int64_t bins, int64_t keep_own,
                              double least, float* out, int64_t threads) {
    const int64_t pitch = (columns + STEP - 1) / STEP * STEP;
    std::vector<float> table(pitch * count);
    for (int64_t row = 0; row < count; ++row)
        std::memcpy(&table[pitch * row], histograms + columns * row, columns * sizeof(float));
    const Slots slots{index, index_stride, valid, valid_stride, width, count};
    const float smallest = static_cast<float>(least);
    parallel(threads, count, ROWS, [&](int64_t begin, int64_t end, int64_t) {
        std::vector<float> sums(pitch);
        Weighted near;
        for (int64_t row = begin; row < end; ++row) {
            const int64_t* indices = slots.index_of(row);
            const uint8_t* flags = slots.valid_of(row);
            const float* squares = square + square_stride * row;
            std::fill(sums.begin(), sums.end(), 0.0f);
            for (int64_t first = 0; first < width; first += BLOCK) {
                near.count = 0;
                for (int64_t k = first; k < std::min(first + BLOCK, width); ++k) {
                    near.rows[near.count] = table.data() + pitch * indices[k];
                    near.weight[near.count] = squares[k];
                    near.count += flags[k] != 0 && squares[k] > 0.0f;
                }
                for (int64_t k = 0; k < near.count; ++k)
                    near.weight[k] = 1.0f / (near.weight[k] < smallest ? smallest : near.weight[k]);
                add_all(near, pitch, sums.data());
            }
            for (int64_t block = 0; block < columns; block += bins) {
                float lanes[NEIGHBOR_LANES] = {};
                for (int64_t bin = 0; bin < bins; ++bin) lanes[bin % NEIGHBOR_LANES] += sums[block + bin];
                const float total = fold<NEIGHBOR_LANES>(lanes);
                const float scale = total > 0.0f ? (1.0f / total) * 100.0f : 0.0f;
                for (int64_t bin = block; bin < block + bins; ++bin) {
                    const float result = sums[bin] * scale;
                    out[columns * row + bin] = keep_own ? result + histograms[columns * row + bin] : result;
                }
            }
        }
    });
    return 0;
}

}  // namespace torchreg
