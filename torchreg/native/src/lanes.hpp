// Sums over the slots of a row as `interleaved_sum` of torchreg.geometry.numerics.interleaved adds.
#pragma once

#include "common.hpp"

namespace torchreg {

constexpr int64_t LANES = 16;  // entry k is added to lane k % LANES

// The lanes one after another, in double.
template <typename T>
inline T sum_of_lanes(const T* lanes) {
    double total = 0.0;
    for (int64_t lane = 0; lane < LANES; ++lane) total += static_cast<double>(lanes[lane]);
    return static_cast<T>(total);
}

}  // namespace torchreg
