// Sums over the slots of a row as `interleaved_sum` of torchreg.geometry.numerics.interleaved adds.
#pragma once

#include "common.hpp"

namespace torchreg {

constexpr int64_t LANES = 16;  // entry k is added to lane k % LANES

// The lanes of `SUMS` sums one after another, in double: side by side, so that no sum waits for another.
template <int64_t SUMS, typename T>
inline void add_lanes(const T (*lanes)[LANES], T* out) {
    double total[SUMS] = {};
    for (int64_t lane = 0; lane < LANES; ++lane)
        for (int64_t sum = 0; sum < SUMS; ++sum) total[sum] += static_cast<double>(lanes[sum][lane]);
    for (int64_t sum = 0; sum < SUMS; ++sum) out[sum] = static_cast<T>(total[sum]);
}

}  // namespace torchreg
