// Rows of bits, such as those of a graph: 64 to a word.
#pragma once

#include "common.hpp"

namespace torchreg {

using Word = uint64_t;

struct Bits {
    int64_t words;
    std::vector<Word> rows;

    Bits(int64_t count, int64_t width) : words((width + 63) / 64), rows(count * words) {}
    Word* row(int64_t i) { return rows.data() + i * words; }
    const Word* row(int64_t i) const { return rows.data() + i * words; }
};

inline bool holds(const Word* row, int64_t j) { return (row[j >> 6] >> (j & 63)) & 1; }

inline void set(Word* row, int64_t j) { row[j >> 6] |= Word(1) << (j & 63); }

#if defined(_MSC_VER)
inline int64_t ones(Word word) {
    word -= (word >> 1) & 0x5555555555555555ull;
    word = (word & 0x3333333333333333ull) + ((word >> 2) & 0x3333333333333333ull);
    return int64_t((((word + (word >> 4)) & 0x0f0f0f0f0f0f0f0full) * 0x0101010101010101ull) >> 56);
}
inline int64_t lowest(Word word) { return ones((word & (0 - word)) - 1); }
#else
inline int64_t ones(Word word) { return __builtin_popcountll(word); }
inline int64_t lowest(Word word) { return __builtin_ctzll(word); }
#endif

inline int64_t common(const Word* one, const Word* other, int64_t words) {
    int64_t count = 0;
    for (int64_t w = 0; w < words; ++w) count += ones(one[w] & other[w]);
    return count;
}

// Call visit(j) for the bits that are set in a row, ascending.
template <typename Visit>
inline void each(const Word* row, int64_t words, Visit visit) {
    for (int64_t w = 0; w < words; ++w)
        for (Word left = row[w]; left != 0; left &= left - 1) visit(w * 64 + lowest(left));
}

}  // namespace torchreg
