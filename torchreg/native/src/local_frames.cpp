// Local reference frames: the axes of most and least spread, weighed by distance, turned to where most neighbors lie.
#include "eigen.hpp"
#include "slots.hpp"
#include "sums.hpp"

namespace torchreg {
namespace {

constexpr int64_t LEAST_NEIGHBORS = 5;  // of descriptors/local_frames.py, as the next
constexpr int64_t MIDDLE = 2;

// Offsets of the neighbors apart from a point, axis by axis, in the order of their slots.
struct Offsets {
    std::vector<double> axes;
    int64_t pitch, count = 0;

    explicit Offsets(int64_t width)
        : axes(3 * ((width + NEIGHBOR_LANES - 1) / NEIGHBOR_LANES * NEIGHBOR_LANES)), pitch(int64_t(axes.size()) / 3) {}
    double* axis(int64_t a) { return axes.data() + a * pitch; }
};

// Gathers all slots of a row as offsets, zero where they do not count.
template <typename T>
void gather(const T* table, const Slots& slots, int64_t row, Offsets& out) {
    const int64_t* indices = slots.index_of(row);
    const uint8_t* flags = slots.valid_of(row);
    const T* own = table + RECORD * row;
    const int64_t used = slots.used(row);
    double *x = out.axis(0), *y = out.axis(1), *z = out.axis(2);
    for (int64_t k = 0; k < used; ++k) {
        const T* other = table + RECORD * indices[k];
        const double counted = flags[k] != 0 ? 1.0 : 0.0;
        x[k] = static_cast<double>(other[0] - own[0]) * counted;
        y[k] = static_cast<double>(other[1] - own[1]) * counted;
        z[k] = static_cast<double>(other[2] - own[2]) * counted;
    }
    out.count = (used + NEIGHBOR_LANES - 1) / NEIGHBOR_LANES * NEIGHBOR_LANES;
    for (int64_t k = used; k < out.count; ++k) x[k] = y[k] = z[k] = 0.0;
}

// _covariance: of one row, put into place i.
void covariance(Offsets& near, double radius, Matrices<double>& out, int64_t i) {
    alignas(64) double sums[6][NEIGHBOR_LANES] = {};  // xx xy xz yy yz zz
    const double *xs = near.axis(0), *ys = near.axis(1), *zs = near.axis(2);
    for (int64_t first = 0; first < near.count; first += NEIGHBOR_LANES) {
#pragma GCC ivdep
        for (int64_t k = 0; k < NEIGHBOR_LANES; ++k) {
            const double x = xs[first + k], y = ys[first + k], z = zs[first + k];
            const double square = x * x + y * y + z * z;
            const bool apart = square > 0.0;
            const double safe = apart ? square : 1.0;
            const double w = (radius - safe * (1.0 / std::sqrt(safe))) * (apart ? 1.0 : 0.0);
            const double wx = w * x, wy = w * y, wz = w * z;
            sums[0][k] += wx * x;
            sums[1][k] += wx * y;
            sums[2][k] += wx * z;
            sums[3][k] += wy * y;
            sums[4][k] += wy * z;
            sums[5][k] += wz * z;
        }
    }
    double* entries[6] = {out.xx, out.xy, out.xz, out.yy, out.yz, out.zz};
    for (int64_t sum = 0; sum < 6; ++sum) entries[sum][i] = fold<NEIGHBOR_LANES>(sums[sum]);
}

// Keeps the neighbors apart from the point alone.
void compact(Offsets& near) {
    double *x = near.axis(0), *y = near.axis(1), *z = near.axis(2);
    int64_t kept = 0;
    for (int64_t k = 0; k < near.count; ++k) {
        x[kept] = x[k], y[kept] = y[k], z[kept] = z[k];
        kept += x[k] * x[k] + y[k] * y[k] + z[k] * z[k] > 0.0;
    }
    near.count = kept;
}

// _sign: 1 or -1.
double sign(Offsets& near, const double* axis) {
    const double *x = near.axis(0), *y = near.axis(1), *z = near.axis(2);
    const double ax = axis[0], ay = axis[1], az = axis[2];
    int64_t forward = 0, inner = 0;
    for (int64_t k = 0; k < near.count; ++k) forward += ax * x[k] + ay * y[k] + az * z[k] >= 0.0;
    const int64_t ahead = 2 * forward - near.count;
    if (ahead != 0) return ahead < 0 ? -1.0 : 1.0;
    const int64_t median = near.count / 2;
    for (int64_t k = std::max<int64_t>(0, median - MIDDLE); k < std::min(near.count, median + MIDDLE + 1); ++k)
        inner += ax * x[k] + ay * y[k] + az * z[k] > 0.0;
    return inner <= MIDDLE ? -1.0 : 1.0;
}

}  // namespace

template <typename T>
int64_t local_frames(const T* points, const double* radius, Slots slots, int64_t count, T* out, int64_t threads) {
    const std::vector<T> table = records(points, count);
    parallel(threads, count, MATRICES, [&](int64_t begin, int64_t end, int64_t) {
        Matrices<double> a{};
        Offsets near(slots.width);
        for (int64_t row = begin; row < end; ++row) {
            gather(table.data(), slots, row, near);
            covariance(near, radius[row], a, row - begin);
        }
        diagonalize(a);
        for (int64_t row = begin; row < end; ++row) {
            const int64_t i = row - begin;
            T* frame = out + 9 * row;
            gather(table.data(), slots, row, near);
            compact(near);
            if (near.count < LEAST_NEIGHBORS) {
                std::fill(frame, frame + 9, T(0));
                continue;
            }
            const double found[3] = {a.xx[i], a.yy[i], a.zz[i]};
            int64_t order[3];
            ascending(found, order);
            double x[3], z[3];
            for (int64_t k = 0; k < 3; ++k) {
                x[k] = a.vectors[3 * k + order[2]][i];
                z[k] = a.vectors[3 * k + order[0]][i];
            }
            const double of_x = sign(near, x), of_z = sign(near, z);
            for (int64_t k = 0; k < 3; ++k) {
                x[k] *= of_x;
                z[k] *= of_z;
            }
            for (int64_t k = 0; k < 3; ++k) {
                const int64_t i1 = (k + 1) % 3, i2 = (k + 2) % 3;
                frame[k] = static_cast<T>(x[k]);
                frame[3 + k] = static_cast<T>(z[i1] * x[i2] - z[i2] * x[i1]);
                frame[6 + k] = static_cast<T>(z[k]);
            }
        }
    });
    return 0;
}

// Equals `local_frames` of descriptors/local_frames.py.
//
// points (P, 3), meters; radius (P,) float64, of the supports; neighborhoods (P, K) as `Slots`. Writes out (P, 3, 3).
KERNELS(local_frames,
        (const Real* points, const double* radius, const int64_t* index, int64_t index_stride, const uint8_t* valid,
         int64_t valid_stride, int64_t count, int64_t width, Real* out, int64_t threads),
        (points, radius, Slots{index, index_stride, valid, valid_stride, width, count}, count, out, threads))

}  // namespace torchreg
