// Neighborhoods as kernels see them: rows of slots, of which a view may use the first few.
#pragma once

#include "common.hpp"

namespace torchreg {

// Index int64 and valid bool, rows of `width` slots that begin `index_stride` and `valid_stride` entries apart; indices
// are rows of a table of `count`, of invalid slots, too.
struct Slots {
    const int64_t* index;
    int64_t index_stride;
    const uint8_t* valid;
    int64_t valid_stride;
    int64_t width;
    int64_t count;

    // The indices of a row, none of which is beyond the table.
    const int64_t* index_of(int64_t row) const {
        const int64_t* indices = index + row * index_stride;
        int64_t signs = 0;
        for (int64_t k = 0; k < width; ++k) signs |= indices[k] | (count - 1 - indices[k]);
        if (signs < 0) throw std::out_of_range("a neighbor that is no point");
        return indices;
    }
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
constexpr int64_t RECORD = 4;   // three numbers of a point and a zero: one load each
constexpr int64_t BLOCK = 128;  // slots that are worked on at a time, on the stack

// Rows of three numbers (P, 3) as records.
template <typename T>
std::vector<T> records(const T* values, int64_t count) {
    std::vector<T> out(RECORD * count);
    for (int64_t row = 0; row < count; ++row)
        for (int64_t axis = 0; axis < 3; ++axis) out[RECORD * row + axis] = values[3 * row + axis];
    return out;
}

}  // namespace torchreg
