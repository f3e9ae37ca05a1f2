// Features in the few directions along which they vary most: torchreg/matching/shadows.py.
#include "vectors.hpp"

namespace torchreg {

template <typename Real>
int64_t feature_shadows(const Real* rows, const double* center, const double* basis, int64_t count, int64_t width, int64_t some,
                double* shadow, double* norm, int64_t threads) {
    constexpr int64_t TOGETHER = 8;
    parallel(threads, count, 256, [&](int64_t from, int64_t to, int64_t) {
        std::vector<double> centered(TOGETHER * width);
        for (int64_t block = from; block < to; block += TOGETHER) {
            const int64_t tall = std::min(TOGETHER, to - block);
            double square[TOGETHER], kept[TOGETHER] = {0, 0, 0, 0, 0, 0, 0, 0};
            for (int64_t i = 0; i < tall; ++i) {
                const Real* row = rows + (block + i) * width;
                double* own = &centered[i * width];
                for (int64_t k = 0; k < width; ++k) own[k] = double(row[k]) - center[k];
                Eight sums = Eight::zero();
                int64_t k = 0;
                for (; k + 8 <= width; k += 8) sums = sums.plus_square(Eight::load(own + k));
                square[i] = total(sums);
                for (; k < width; ++k) square[i] += own[k] * own[k];
            }
            for (int64_t begin = 0; begin < some; begin += 8) {
                Eight sums[TOGETHER];
                for (int64_t i = 0; i < TOGETHER; ++i) sums[i] = Eight::zero();
                for (int64_t k = 0; k < width; ++k) {
                    const Eight direction = Eight::load(basis + k * some + begin);
                    for (int64_t i = 0; i < TOGETHER; ++i)
                        sums[i] = sums[i].plus_product(centered[i * width + k], direction);
                }
                for (int64_t i = 0; i < tall; ++i) {
                    sums[i].store(shadow + (block + i) * (some + 1) + begin);
                    kept[i] += total(Eight::zero().plus_square(sums[i]));
                }
            }
            for (int64_t i = 0; i < tall; ++i) {
                shadow[(block + i) * (some + 1) + some] = std::sqrt(std::max(0.0, square[i] - kept[i]));
                norm[block + i] = std::sqrt(square[i]);
            }
        }
    });
    return 0;
}

// For `_projected` of shadows.py: bounds are made of these numbers, so their last bits do not count.
//
// rows (N, D); center (D) and basis (D, K) float64, K a multiple of 8. Writes shadow (N, K + 1) float64, the last of which
// is the length of the rest, and norm (N) float64, the distance from the center.
KERNELS(feature_shadows,
        (const Real* rows, const double* center, const double* basis, int64_t count, int64_t width, int64_t some,
         double* shadow, double* norm, int64_t threads),
        (rows, center, basis, count, width, some, shadow, norm, threads))

}  // namespace torchreg
