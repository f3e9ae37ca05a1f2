// SHOT: votes of neighbors in the volumes of a local reference frame, each shared with the next volumes and the next bin.
#include "slots.hpp"
#include "sums.hpp"

#include <limits>
#include <type_traits>

namespace torchreg {
namespace {

constexpr int64_t SECTORS = 8, VOLUMES = 4 * SECTORS;
constexpr int64_t SHAPE_BINS = 10, COLOR_BINS = 30;  // of descriptors/shot.py: a histogram has one more
constexpr int64_t SHAPE_SIZE = VOLUMES * (SHAPE_BINS + 1), COLOR_SIZE = VOLUMES * (COLOR_BINS + 1);
constexpr int64_t SHARES = 3;       // along distance, elevation and azimuth
constexpr int64_t POINT = 10;       // x y z, normal, color, and a zero

template <typename T>
struct Whole;
template <>
struct Whole<float> {
    using type = int32_t;
};
template <>
struct Whole<double> {
    using type = int64_t;
};

// What the votes of up to BLOCK neighbors need, slot by slot. Parts of a vote are floating, whole votes integers.
template <typename T>
struct Votes {
    using Count = typename Whole<T>::type;
    alignas(64) T x[BLOCK], y[BLOCK], z[BLOCK], own[BLOCK], cosine[BLOCK], difference[BLOCK];
    alignas(64) Count volume[BLOCK], next[SHARES][BLOCK], share[SHARES][BLOCK];
    alignas(64) Count step[BLOCK], next_step[BLOCK], whole[BLOCK], beside[BLOCK];
};

template <typename T>
inline T dot(T ax, T ay, T az, T bx, T by, T bz) {
    return ax * bx + ay * by + az * bz;
}

// _octant of descriptors/shot_votes.py.
template <int64_t N, typename T>
inline T octant(T shorter, T longer, const T* angles) {
    constexpr T tangent = static_cast<T>(0.41421356237309503);
    const T u = (shorter - tangent * longer) / (longer + tangent * shorter);
    const T square = u * u;
    T result = square * angles[N - 1] + angles[N - 2];
    for (int64_t i = N - 3; i >= 0; --i) result = result * square + angles[i];
    return result * u;
}

template <typename T>
inline T root(T square) {
    const T safe = square > T(0) ? square : T(1);
    const T result = safe * (T(1) / std::sqrt(safe));
    return square > T(0) ? result : T(0);
}

// places of descriptors/shot_votes.py, of `count` neighbors, all of which count but for those at no distance.
template <int64_t N, typename T>
void places(Votes<T>& v, int64_t count, T radius, const T* angles, T steps) {
    using Count = typename Whole<T>::type;
    constexpr Count one = 4, all = VOLUMES;  // volumes of a sector, and of all
    T fixed[N];
    std::copy(angles, angles + N, fixed);
#pragma GCC ivdep
    for (int64_t k = 0; k < count; ++k) {
        const T x = v.x[k], y = v.y[k], z = v.z[k];
        const T flat = x * x + y * y, square = flat + z * z;
        const T weight = square > T(0) ? T(1) : T(0);
        const T across = root(flat), length = root(square);
        T relative = length / radius;
        relative = relative > T(1) ? T(1) : relative;
        const bool outer = relative > T(0.5);
        const T twice = T(2) * relative;
        const T outward = outer ? T(1.5) - twice : twice - T(0.5);
        const T ax = std::fabs(x), ay = std::fabs(y), az = std::fabs(z);
        const T sum = length + az;
        const T downward = octant<N>(across, square > T(0) ? sum : T(1), fixed);
        const Count upper = (y > T(0)) | ((y == T(0)) & (x < T(0)));
        const Count right = (x > T(0)) | ((x == T(0)) & (y > T(0)));
        const Count same = ((x > T(0)) & (y > T(0))) | ((x < T(0)) & (y < T(0))) | (x == T(0));
        const Count steep = ax < ay, level = ax > ay, third = same ? steep : level;
        const Count sector = 4 * upper + 2 * (right ^ upper) + third;
        const T longer = ax > ay ? ax : ay, shorter = ax > ay ? ay : ax;
        const bool around = longer > T(0);
        const T rising = octant<N>(shorter, around ? longer : T(1), fixed);
        const T turn = third ? -rising : rising;  // third is the last bit of the sector
        const T weight_around = around ? weight : T(0);
        const Count above = z > T(0), beyond = outer;
        const Count volume = 4 * sector + 2 * beyond + above;
        const T out_of = std::fabs(outward), down_of = std::fabs(downward), turn_of = std::fabs(turn);
        v.volume[k] = volume;
        v.own[k] = ((T(1) - out_of) + (T(1) - down_of)) * weight + (T(1) - turn_of) * weight_around;
        v.next[0][k] = volume + 2 - 4 * beyond;
        v.next[1][k] = volume + 1 - 2 * above;
        v.next[2][k] = (volume + (turn > T(0) ? one : all - one)) & (all - 1);
        v.share[0][k] = static_cast<Count>((outward > T(0) ? outward : T(0)) * weight * steps);
        v.share[1][k] = static_cast<Count>((downward > T(0) ? downward : T(0)) * weight * steps);
        v.share[2][k] = static_cast<Count>(turn_of * weight_around * steps);
    }
}

// votes of descriptors/shot_votes.py, cast: of values[k] in histograms of `bins` + 1. No value leaves them.
template <typename T>
void vote(Votes<T>& v, const T* values, int64_t count, int64_t bins, T steps, int64_t* sums) {
    using Count = typename Whole<T>::type;
    const Count last = static_cast<Count>(bins);
#pragma GCC ivdep
    for (int64_t k = 0; k < count; ++k) {
        const T value = values[k];
        const Count nearest = static_cast<Count>(value + T(0.5));
        const Count step = nearest < 0 ? 0 : nearest > last ? last : nearest;
        const T beside = value - static_cast<T>(step);
        Count next = beside > T(0) ? step + 1 : step - 1;
        next = next >= last ? next - last : next;
        next = next < 0 ? last - 1 : next;
        const T weight = dot(v.x[k], v.y[k], v.z[k], v.x[k], v.y[k], v.z[k]) > T(0) ? T(1) : T(0);
        const T size = std::fabs(beside);
        v.step[k] = step;
        v.next_step[k] = next;
        v.whole[k] = static_cast<Count>((v.own[k] + (T(1) - size) * weight) * steps);
        v.beside[k] = static_cast<Count>(size * weight * steps);
    }
    const Count width = last + 1;
    for (int64_t k = 0; k < count; ++k) {
        int64_t* own = sums + v.volume[k] * width;
        own[v.step[k]] += v.whole[k];
        own[v.next_step[k]] += v.beside[k];
        for (int64_t s = 0; s < SHARES; ++s) sums[v.next[s][k] * width + v.step[k]] += v.share[s][k];
    }
}

// The sum of squares of `size` sums, a multiple of 16, in the order of lane_sums.
inline double squares(const int64_t* sums, int64_t size, double share) {
    alignas(64) double lanes[NEIGHBOR_LANES] = {};
    for (int64_t first = 0; first < size; first += NEIGHBOR_LANES)
        for (int64_t k = 0; k < NEIGHBOR_LANES; ++k) {
            const double value = static_cast<double>(sums[first + k]) * share;
            lanes[k] += value * value;
        }
    return fold<NEIGHBOR_LANES>(lanes);
}

template <int64_t N, typename T>
int64_t describe(const T* points, const T* normals, const T* frames, const T* radius, const T* colors,
                 const T* angles, double whole, Slots slots, int64_t count, T* out, int64_t threads) {
    std::vector<T> table(POINT * count);
    for (int64_t row = 0; row < count; ++row)
        for (int64_t axis = 0; axis < 3; ++axis) {
            table[POINT * row + axis] = points[3 * row + axis];
            table[POINT * row + 3 + axis] = normals[3 * row + axis];
            table[POINT * row + 6 + axis] = colors ? colors[3 * row + axis] : T(0);
        }
    const int64_t size = colors ? SHAPE_SIZE + COLOR_SIZE : SHAPE_SIZE;
    const T steps = static_cast<T>(whole);
    const double share = 1.0 / whole;
    constexpr T endless = std::numeric_limits<T>::infinity();
    parallel(threads, count, ROWS, [&](int64_t begin, int64_t end, int64_t) {
        std::vector<int64_t> sums(size);
        Votes<T> v;
        for (int64_t row = begin; row < end; ++row) {
            const int64_t* indices = slots.index_of(row);
            const uint8_t* flags = slots.valid_of(row);
            const T* f = frames + 9 * row;
            const T* own = table.data() + POINT * row;
            T* result = out + size * row;
            const int64_t used = slots.used(row);
            bool framed = false;
            for (int64_t i = 0; i < 9; ++i) framed |= f[i] != T(0);
            std::fill(sums.begin(), sums.end(), 0);
            for (int64_t first = 0; framed && first < used; first += BLOCK) {
                const int64_t last = std::min(first + BLOCK, used);
                int64_t taken = 0;
                for (int64_t k = first; k < last; ++k) {
                    const T* other = table.data() + POINT * indices[k];
                    const T dx = other[0] - own[0], dy = other[1] - own[1], dz = other[2] - own[2];
                    v.x[taken] = dot(f[0], f[1], f[2], dx, dy, dz);
                    v.y[taken] = dot(f[3], f[4], f[5], dx, dy, dz);
                    v.z[taken] = dot(f[6], f[7], f[8], dx, dy, dz);
                    T cosine = dot(f[6], f[7], f[8], other[3], other[4], other[5]);
                    cosine = cosine >= T(-1) ? cosine : T(-1);  // a number for NaN, too
                    cosine = cosine > T(1) ? T(1) : cosine;
                    v.cosine[taken] = (T(1) + cosine) * T(SHAPE_BINS / 2);
                    const T lightness = std::fabs(other[6] - own[6]);
                    const T a = std::fabs(other[7] - own[7]), b = std::fabs(other[8] - own[8]);
                    const T difference = (lightness + (a + b) * T(0.5)) / T(3);
                    v.difference[taken] = (difference > T(1) ? T(1) : difference) * T(COLOR_BINS);
                    const T square = dot(dx, dy, dz, dx, dy, dz);
                    const T turned = dot(v.x[taken], v.y[taken], v.z[taken], v.x[taken], v.y[taken], v.z[taken]);
                    taken += (flags[k] != 0) & (square > T(0)) & (square < endless) & (turned < endless);
                }
                places<N>(v, taken, radius[row], angles, steps);
                vote(v, v.cosine, taken, SHAPE_BINS, steps, sums.data());
                if (colors) vote(v, v.difference, taken, COLOR_BINS, steps, sums.data() + SHAPE_SIZE);
            }
            double square = squares(sums.data(), SHAPE_SIZE, share);
            if (colors) square = square + squares(sums.data() + SHAPE_SIZE, COLOR_SIZE, share);
            const double scale = square > 0.0 ? 1.0 / std::sqrt(square) : 0.0;
            for (int64_t i = 0; i < size; ++i)
                result[i] = static_cast<T>(static_cast<double>(sums[i]) * share * scale);
        }
    });
    return 0;
}

}  // namespace

template <typename T>
int64_t shot(const T* points, const T* normals, const T* frames, const T* radius, const T* colors, const T* angles,
             int64_t degree, double steps, Slots slots, int64_t count, T* out, int64_t threads) {
    constexpr int64_t N = std::is_same_v<T, double> ? 12 : 6;  // angle_coefficients of descriptors/shot_votes.py
    if (degree != N) throw std::invalid_argument("another number of coefficients");
    return describe<N>(points, normals, frames, radius, colors, angles, steps, slots, count, out, threads);
}

// Equals `_rows` of descriptors/shot.py, of all rows.
//
// points and normals (P, 3), frames (P, 3, 3), radius (P,) of the supports, colors (P, 3) or none, angles (degree,) of
// the polynomial for angles, the part of a vote that counts as one, reciprocal; neighborhoods (P, K) as `Slots`. Writes
// out (P, 352), with colors (P, 1344).
KERNELS(shot,
        (const Real* points, const Real* normals, const Real* frames, const Real* radius, const Real* colors,
         const Real* angles, int64_t degree, double steps, const int64_t* index, int64_t index_stride,
         const uint8_t* valid, int64_t valid_stride, int64_t count, int64_t width, Real* out, int64_t threads),
        (points, normals, frames, radius, colors, angles, degree, steps,
         Slots{index, index_stride, valid, valid_stride, width, count}, count, out, threads))

}  // namespace torchreg
