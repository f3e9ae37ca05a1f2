// Neighborhoods as kernels see them: rows of slots, of which a view may use the first few.
#pragma once

#include "common.hpp"

namespace torchreg {

// Index int64 and valid bool, rows of `width` slots that begin `index_stride` and `valid_stride` entries apart.
struct Slots {
    const int64_t* index;
    int64_t index_stride;
    const uint8_t* valid;
    int64_t valid_stride;
    int64_t width;

    const int64_t* index_of(int64_t row) const { return index + row * index_stride; }
    const uint8_t* valid_of(int64_t row) const { return valid + row * valid_stride; }
    // The slots of a row up to its last valid one.
    int64_t used(int64_t row) const {
        const uint8_t* flags = valid_of(row);
        int64_t count = width;
        while (count > 0 && !flags[count - 1]) --count;
        return count;
    }
};

constexpr int64_t ROWS = 64;    // a piece of work: some 50 microseconds of 100 slots each
constexpr int64_t BLOCK = 128;  // slots that are worked on at a time, on the stack

}  // namespace torchreg
