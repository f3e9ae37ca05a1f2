// What pairs of surfels need at each update: residuals, medians, normal equations.
#include "gauss_newton.hpp"

namespace torchreg {
namespace {

// The value at place k of `values` (count) in ascending order; no NaN. Overwrites them. Only values between two of a
// sample need to be put in order, as the one at place k is nearly always among them.
inline double selected(std::vector<double>& values, int64_t count, int64_t k) {
    constexpr int64_t SAMPLE = 256, AROUND = 28;
    const auto all = values.begin();
    if (count > 4 * SAMPLE) {
        double sample[SAMPLE];
        for (int64_t i = 0; i < SAMPLE; ++i) sample[i] = values[i * count / SAMPLE];
        std::sort(sample, sample + SAMPLE);
        const int64_t place = k * SAMPLE / count;
        const double low = sample[std::max<int64_t>(0, place - AROUND)];
        const double high = sample[std::min(SAMPLE - 1, place + AROUND)];
        std::vector<double> between(count);
        int64_t below = 0, inside = 0;
        for (int64_t i = 0; i < count; ++i) {
            const double value = values[i];
            between[inside] = value;
            below += value < low;
            inside += (value >= low) & (value <= high);
        }
        if (below <= k && k < below + inside) {
            const auto middle = between.begin() + (k - below);
            std::nth_element(between.begin(), middle, between.begin() + inside);
            return *middle;
        }
    }
    std::nth_element(all, all + k, all + count);
    return values[k];
}

}  // namespace

// Equals `SurfelPairs.residuals` without shades: moved (3, n, 256), partner (A, n, 256) with normal and variance from
// column 3 on, extra (E, n, 256) normal and variance of the source, rotation (B, 3, 3), pair (n), inside (n, 256),
// faced (B) whether the sign of normals counts; least cosine between normals. Writes distance, variance (n, 256), normals (3, n, 256) of the
// source, turned, and alike (n, 256).
KERNEL(surfel_residuals, const double* moved, const double* partner, const double* extra, const double* rotation,
                        const int64_t* pair, const bool* inside, const bool* faced, int64_t n, double facing,
                        double* distance, double* variance, double* normals, bool* alike, int64_t threads) {
    const int64_t stride = n * BLOCK;
    parallel(threads, n, 16, [&](int64_t begin, int64_t end, int64_t) {
        for (int64_t block = begin; block < end; ++block) {
            const double* R = rotation + 9 * pair[block];
            const bool signs = faced[pair[block]];
            const int64_t from = block * BLOCK, to = from + BLOCK;
            for (int64_t r = from; r < to; ++r) {
                double along[3], facings[3];
                const double own[3] = {extra[r], extra[stride + r], extra[2 * stride + r]};
                for (int i = 0; i < 3; ++i) {
                    const double normal = partner[(3 + i) * stride + r];
                    along[i] = (moved[i * stride + r] - partner[i * stride + r]) * normal;
                    const double there = turned(R, i, own[0], own[1], own[2]);
                    normals[i * stride + r] = there;
                    facings[i] = there * normal;
                }
                distance[r] = (along[0] + along[1]) + along[2];
                const double both = extra[3 * stride + r] + partner[6 * stride + r];
                variance[r] = both < 1e-24 ? 1e-24 : both;
                const double cosine = (facings[0] + facings[1]) + facings[2];
                alike[r] = inside[r] && (signs ? cosine : std::abs(cosine)) > facing;
            }
        }
    });
    return 0;
}

// Equals `medians`: values and kept (n, 256), first_block (B + 1). Writes B medians, 0 where a pair has none.
KERNEL(block_medians, const double* values, const bool* kept, const int64_t* first_block, int64_t pairs, double* out,
                     int64_t threads) {
    parallel(threads, pairs, 1, [&](int64_t b, int64_t, int64_t) {
        const int64_t begin = first_block[b] * BLOCK, end = first_block[b + 1] * BLOCK;
        std::vector<double> own(end - begin);
        int64_t count = 0;
        bool numbers = true;
        for (int64_t r = begin; r < end; ++r) {
            own[count] = values[r];
            numbers = numbers && !(kept[r] && std::isnan(values[r]));
            count += kept[r];
        }
        if (count == 0)
            out[b] = 0.0;
        else
            out[b] = numbers ? selected(own, count, (count - 1) / 2) : std::numeric_limits<double>::quiet_NaN();
    });
    return 0;
}

// Equals `normal_equations` without shades: moved and normal (3, n, 256), distance, deviation, alike (n, 256), cut (B),
// pair (n), first_block (B + 1). Writes sums (B, 28).
KERNEL(surfel_equations, const double* moved, const double* normal, const double* distance, const double* deviation,
                        const bool* alike, const double* cut, const int64_t* pair, const int64_t* first_block, int64_t n,
                        int64_t pairs, double* sums, int64_t threads) {
    std::vector<double> partial(n * PRODUCTS);
    parallel(threads, n, 8, [&](int64_t begin, int64_t end, int64_t) {
        for (int64_t block = begin; block < end; ++block) {
            const int64_t at = block * BLOCK;
            double p[3][BLOCK], d[3][BLOCK], weight[BLOCK];
            for (int i = 0; i < 3; ++i) {
                std::copy_n(moved + i * n * BLOCK + at, BLOCK, p[i]);
                std::copy_n(normal + i * n * BLOCK + at, BLOCK, d[i]);
            }
            const double scale = cut[pair[block]];
            for (int64_t r = 0; r < BLOCK; ++r) {
                const double unit = deviation[at + r];
                const double share = (distance[at + r] / unit) / scale;
                double rest = 1 - share * share;
                rest = rest < 0 ? 0.0 : rest;
                weight[r] = rest * rest * (alike[at + r] ? 1.0 : 0.0) / (unit * unit);
            }
            block_products(p, d, distance + at, weight, partial.data() + block * PRODUCTS);
        }
    });
    for (int64_t b = 0; b < pairs; ++b) {
        double* own = partial.data() + first_block[b] * PRODUCTS;
        fold_rows(own, first_block[b + 1] - first_block[b], PRODUCTS);
        std::copy_n(own, PRODUCTS, sums + b * PRODUCTS);
    }
    return 0;
}

}  // namespace torchreg
