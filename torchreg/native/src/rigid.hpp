// Rotations (3, 3) by rows, applied to vectors; terms are added in their order, as `apply_rotation` of geometry/se3.py does.
#pragma once

#include "common.hpp"

namespace torchreg {

// Coordinate i of R (x, y, z).
template <typename T>
inline T turned(const T* R, int i, T x, T y, T z) {
    return R[3 * i] * x + R[3 * i + 1] * y + R[3 * i + 2] * z;
}

// R x, all of it.
inline void rotated(const double* R, const double* x, double* out) {
    for (int i = 0; i < 3; ++i) out[i] = turned(R, i, x[0], x[1], x[2]);
}

}  // namespace torchreg
