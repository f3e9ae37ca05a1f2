// Eigenvectors of symmetric 3x3 matrices, many at once: symmetric_eigen of torchreg/geometry/eigen.py.
#pragma once

#include "common.hpp"

namespace torchreg {

constexpr int64_t MATRICES = 64;  // worked on at a time
constexpr int64_t SWEEPS = 6;

// The upper triangles of as many matrices, and their eigenvectors as columns, entry by entry.
template <typename T>
struct Matrices {
    alignas(64) T xx[MATRICES], xy[MATRICES], xz[MATRICES], yy[MATRICES], yz[MATRICES], zz[MATRICES];
    alignas(64) T vectors[9][MATRICES];
};

// _rotate: zero the entry pq; rp and rq are the entries of the third row r.
template <typename T>
inline void rotate(T* pp, T* qq, T* pq, T* rp, T* rq, T (*vectors)[MATRICES], int64_t p, int64_t q) {
    T *v0p = vectors[p], *v1p = vectors[3 + p], *v2p = vectors[6 + p];
    constexpr T largest = std::numeric_limits<T>::max();
    T *v0q = vectors[q], *v1q = vectors[3 + q], *v2q = vectors[6 + q];
#pragma GCC ivdep
    for (int64_t i = 0; i < MATRICES; ++i) {
        const T app = pp[i], aqq = qq[i], apq = pq[i];
        const bool zero = apq == T(0);
        T theta = (aqq - app) / (zero ? T(1) : apq + apq);
        theta = theta > largest ? largest : theta;
        theta = theta < -largest ? -largest : theta;
        const T per_root = T(1) / std::sqrt(theta * theta + T(1));
        const T size = per_root / (std::fabs(theta) * per_root + T(1));
        const T t = zero ? T(0) : std::copysign(size, theta);
        const T c = T(1) / std::sqrt(t * t + T(1)), s = t * c;
        pp[i] = app - t * apq;
        qq[i] = aqq + t * apq;
        pq[i] = T(0);
        const T arp = rp[i], arq = rq[i];
        rp[i] = c * arp - s * arq;
        rq[i] = s * arp + c * arq;
        const T a0 = v0p[i], b0 = v0q[i], a1 = v1p[i], b1 = v1q[i], a2 = v2p[i], b2 = v2q[i];
        v0p[i] = c * a0 - s * b0;
        v0q[i] = s * a0 + c * b0;
        v1p[i] = c * a1 - s * b1;
        v1q[i] = s * a1 + c * b1;
        v2p[i] = c * a2 - s * b2;
        v2q[i] = s * a2 + c * b2;
    }
}

template <typename T>
void diagonalize(Matrices<T>& a) {
    for (int64_t entry = 0; entry < 9; ++entry)
        std::fill(a.vectors[entry], a.vectors[entry] + MATRICES, entry % 4 == 0 ? T(1) : T(0));
    for (int64_t sweep = 0; sweep < SWEEPS; ++sweep) {
        rotate(a.xx, a.yy, a.xy, a.xz, a.yz, a.vectors, 0, 1);
        rotate(a.xx, a.zz, a.xz, a.xy, a.yz, a.vectors, 0, 2);
        rotate(a.yy, a.zz, a.yz, a.xy, a.xz, a.vectors, 1, 2);
    }
}

// The order of a stable ascending sort of three values, NaN behind all others.
template <typename T>
inline void ascending(const T* values, int64_t* order) {
    auto before = [&](int64_t i, int64_t j) {
        return values[i] < values[j] || (std::isnan(values[j]) && !std::isnan(values[i]));
    };
    order[0] = 0, order[1] = 1, order[2] = 2;
    if (before(order[1], order[0])) std::swap(order[0], order[1]);
    if (before(order[2], order[1])) std::swap(order[1], order[2]);
    if (before(order[1], order[0])) std::swap(order[0], order[1]);
}

}  // namespace torchreg
