// Surface normals: the direction in which a neighborhood spreads least, turned to where it was seen from.
#include "eigen.hpp"
#include "slots.hpp"
#include "sums.hpp"

namespace torchreg {
namespace {

// _covariance: of the neighbors of one row, put into place i; returns their number.
template <typename T>
int64_t covariance(const T* table, const Slots& slots, int64_t row, Matrices<double>& out, int64_t i) {
    const int64_t* indices = slots.index_of(row);
    const uint8_t* flags = slots.valid_of(row);
    const T* own = table + RECORD * row;
    const int64_t used = slots.used(row);
    alignas(64) double sums[9][NEIGHBOR_LANES] = {};  // x y z xx xy xz yy yz zz
    int64_t count = 0;
    for (int64_t first = 0; first < used; first += NEIGHBOR_LANES) {
        alignas(64) T others[RECORD * NEIGHBOR_LANES], weight[NEIGHBOR_LANES];
        const int64_t here = std::min(NEIGHBOR_LANES, used - first);
        for (int64_t k = 0; k < NEIGHBOR_LANES; ++k) {
            const int64_t slot = first + std::min(k, here - 1);
            std::memcpy(others + RECORD * k, table + RECORD * indices[slot], RECORD * sizeof(T));
            const bool counted = (k < here) & (flags[slot] != 0);
            weight[k] = static_cast<T>(counted);
            count += counted;
        }
        for (int64_t k = 0; k < NEIGHBOR_LANES; ++k) {
            const T* other = others + RECORD * k;
            const double w = weight[k];
            const double x = static_cast<double>(other[0] - own[0]) * w;
            const double y = static_cast<double>(other[1] - own[1]) * w;
            const double z = static_cast<double>(other[2] - own[2]) * w;
            sums[0][k] += x;
            sums[1][k] += y;
            sums[2][k] += z;
            sums[3][k] += x * x;
            sums[4][k] += x * y;
            sums[5][k] += x * z;
            sums[6][k] += y * y;
            sums[7][k] += y * z;
            sums[8][k] += z * z;
        }
    }
    const double share = 1.0 / static_cast<double>(std::max<int64_t>(count, 1));
    double total[9];
    for (int64_t sum = 0; sum < 9; ++sum) total[sum] = fold<NEIGHBOR_LANES>(sums[sum]);
    const double mx = total[0] * share, my = total[1] * share, mz = total[2] * share;
    out.xx[i] = total[3] * share - mx * mx;
    out.xy[i] = total[4] * share - mx * my;
    out.xz[i] = total[5] * share - mx * mz;
    out.yy[i] = total[6] * share - my * my;
    out.yz[i] = total[7] * share - my * mz;
    out.zz[i] = total[8] * share - mz * mz;
    return count;
}

}  // namespace

template <typename T>
int64_t normals(const T* points, const double* towards, Slots slots, int64_t count, T* out, int64_t threads) {
    const std::vector<T> table = records(points, count);
    parallel(threads, count, MATRICES, [&](int64_t begin, int64_t end, int64_t) {
        Matrices<double> a{};
        bool flat[MATRICES];
        for (int64_t row = begin; row < end; ++row) {
            const int64_t i = row - begin, neighbors = covariance(table.data(), slots, row, a, i);
            flat[i] = neighbors >= 3 && a.xx[i] + a.yy[i] + a.zz[i] > 0.0;
        }
        diagonalize(a);
        for (int64_t row = begin; row < end; ++row) {
            const int64_t i = row - begin;
            const double* to = towards + 3 * row;
            double normal[3] = {0.0, 0.0, 1.0};
            if (flat[i]) {
                const double found[3] = {a.xx[i], a.yy[i], a.zz[i]};
                int64_t order[3];
                ascending(found, order);
                for (int64_t k = 0; k < 3; ++k) normal[k] = a.vectors[3 * k + order[0]][i];
            } else {
                const double square = to[0] * to[0] + to[1] * to[1] + to[2] * to[2];
                if (square > 0.0)
                    for (int64_t k = 0; k < 3; ++k) normal[k] = to[k] * (1.0 / std::sqrt(square));
            }
            const double facing = normal[0] * to[0] + normal[1] * to[1] + normal[2] * to[2];
            for (int64_t k = 0; k < 3; ++k) out[3 * row + k] = static_cast<T>(facing < 0.0 ? -normal[k] : normal[k]);
        }
    });
    return 0;
}

// Equals `_oriented` of preprocess/normals.py.
//
// points (P, 3), meters; towards (P, 3) float64, from every point to where its normal is turned; neighborhoods (P, K) as
// `Slots`. Writes out (P, 3).
KERNELS(normals,
        (const Real* points, const double* towards, const int64_t* index, int64_t index_stride, const uint8_t* valid,
         int64_t valid_stride, int64_t count, int64_t width, Real* out, int64_t threads),
        (points, towards, Slots{index, index_stride, valid, valid_stride, width, count}, count, out, threads))

}  // namespace torchreg
