// A k-d tree over points as plain arrays, which the caller owns: nothing to free, nothing that a fork would break.
//
// Level d cuts the points into 2^d runs; run k of level d is begin(d, k) .. begin(d, k + 1), so that all runs of a level
// differ by one point at most. Every run has the box around its points. Distances are those of torch, (dx dx + dy dy) +
// dz dz, each operation rounded; as rounding keeps the order of numbers, the distance to a box computed in this way is
// never above that to a point in it, and the search is exact. Of equally near points the lower row comes first.
#pragma once

#include "common.hpp"

namespace torchreg {

constexpr int64_t LEAF = 20;  // points of a leaf at most

inline int64_t tree_depth(int64_t n) {
    int64_t depth = 0;
    while ((n >> depth) + 1 > LEAF) ++depth;
    return depth;
}

template <typename T>
struct Box {
    T low[3], high[3];
};

template <typename T>
struct Tree {
    int64_t n;             // points, at least one
    int64_t depth;         // level of the leaves
    const T* axes[3];      // coordinates in the order of the tree
    const int32_t* order;  // the row of every point
    const Box<T>* boxes;   // of all runs, level by level: 2^d - 1 + k

    // planes (3, n), order (n) and boxes (2^(depth + 1) - 1, 6) as `build_tree` has written them
    Tree(const T* planes, const int32_t* order, const T* boxes, int64_t n)
        : n(n), depth(tree_depth(n)), axes{planes, planes + n, planes + 2 * n}, order(order),
          boxes(reinterpret_cast<const Box<T>*>(boxes)) {}

    int64_t begin(int64_t level, int64_t run) const { return (n * run) >> level; }
    const Box<T>& box(int64_t level, int64_t run) const { return boxes[(int64_t(1) << level) - 1 + run]; }
    int64_t leaves() const { return int64_t(1) << depth; }
};

template <typename T>
inline T square_to_box(const Box<T>& box, T x, T y, T z) {
    const T dx = std::max(std::max(box.low[0] - x, x - box.high[0]), T(0));
    const T dy = std::max(std::max(box.low[1] - y, y - box.high[1]), T(0));
    const T dz = std::max(std::max(box.low[2] - z, z - box.high[2]), T(0));
    return (dx * dx + dy * dy) + dz * dz;
}

template <typename T>
inline T square_between(const Box<T>& one, const Box<T>& other) {
    T d[3];
    for (int i = 0; i < 3; ++i)
        d[i] = std::max(std::max(other.low[i] - one.high[i], one.low[i] - other.high[i]), T(0));
    return (d[0] * d[0] + d[1] * d[1]) + d[2] * d[2];
}

// The `count` nearest of one point among those with d^2 < limit, ascending by (d^2, row). `square` and `row` have room
// for `count` (at most 64); returns how many there are.
template <typename T>
inline int64_t nearest_few(const Tree<T>& tree, T x, T y, T z, T limit, int64_t count, T* square, int32_t* row) {
    struct Entry {
        T square;
        int32_t level;
        int32_t run;
    };
    Entry stack[64];
    int64_t top = 0, found = 0;
    T worst = limit;  // what a point has to stay below, or equal with a lower row
    stack[top++] = {square_to_box(tree.box(0, 0), x, y, z), 0, 0};
    T near[LEAF];
    while (top > 0) {
        const Entry entry = stack[--top];
        if (entry.square > worst || (found < count && entry.square >= limit)) continue;
        int64_t level = entry.level, run = entry.run;
        bool alive = true;
        while (level < tree.depth) {
            ++level;
            run *= 2;
            T one = square_to_box(tree.box(level, run), x, y, z);
            T other = square_to_box(tree.box(level, run + 1), x, y, z);
            int64_t later = run + 1;
            if (other < one) {
                std::swap(one, other);
                std::swap(run, later);
            }
            if (other <= worst) stack[top++] = {other, int32_t(level), int32_t(later)};
            if (one > worst) {
                alive = false;
                break;
            }
        }
        if (!alive) continue;
        const int64_t begin = tree.begin(level, run), size = tree.begin(level, run + 1) - begin;
        for (int64_t j = 0; j < size; ++j) {
            const T dx = tree.axes[0][begin + j] - x, dy = tree.axes[1][begin + j] - y, dz = tree.axes[2][begin + j] - z;
            near[j] = (dx * dx + dy * dy) + dz * dz;
        }
        for (int64_t j = 0; j < size; ++j) {
            if (near[j] > worst || near[j] >= limit) continue;
            const int32_t number = tree.order[begin + j];
            if (found == count && near[j] == worst && number > row[count - 1]) continue;
            int64_t place = found < count ? found : count - 1;
            while (place > 0 && (near[j] < square[place - 1] || (near[j] == square[place - 1] && number < row[place - 1]))) {
                square[place] = square[place - 1];
                row[place] = row[place - 1];
                --place;
            }
            square[place] = near[j];
            row[place] = number;
            if (found < count) ++found;
            if (found == count) worst = square[count - 1];
        }
    }
    return found;
}

// The nearest point with d^2 < limit: its row, or -1.
template <typename T>
inline int32_t nearest_one(const Tree<T>& tree, T x, T y, T z, T limit, T& square) {
    int32_t row = -1;
    return nearest_few<T>(tree, x, y, z, limit, 1, &square, &row) > 0 ? row : -1;
}

// Build the tree of points (n, 3): writes planes (3, n), order (n) and boxes (2^(depth + 1) - 1, 6).
template <typename T>
int64_t build_tree(const T* points, int64_t n, T* planes, int32_t* order, T* boxes, int64_t threads) {
    const int64_t depth = tree_depth(n);
    Box<T>* box = reinterpret_cast<Box<T>*>(boxes);
    for (int64_t i = 0; i < n; ++i) order[i] = int32_t(i);
    auto bound = [&](int64_t level, int64_t run) {
        Box<T>& own = box[(int64_t(1) << level) - 1 + run];
        const int64_t begin = (n * run) >> level, end = (n * (run + 1)) >> level;
        for (int axis = 0; axis < 3; ++axis) {
            T low = points[3 * int64_t(order[begin]) + axis], high = low;
            for (int64_t i = begin + 1; i < end; ++i) {
                const T value = points[3 * int64_t(order[i]) + axis];
                low = std::min(low, value);
                high = std::max(high, value);
            }
            own.low[axis] = low;
            own.high[axis] = high;
        }
    };
    auto halve = [&](int64_t level, int64_t run) {  // cut a run across its longest side
        const Box<T>& own = box[(int64_t(1) << level) - 1 + run];
        int axis = 0;
        for (int other = 1; other < 3; ++other)
            if (own.high[other] - own.low[other] > own.high[axis] - own.low[axis]) axis = other;
        const int64_t begin = (n * run) >> level, end = (n * (run + 1)) >> level;
        const int64_t middle = (n * (2 * run + 1)) >> (level + 1);
        std::nth_element(order + begin, order + middle, order + end, [&](int32_t a, int32_t b) {
            return points[3 * int64_t(a) + axis] < points[3 * int64_t(b) + axis];
        });
    };
    auto grow = [&](auto&& self, int64_t level, int64_t run) -> void {
        bound(level, run);
        if (level == depth) {
            const int64_t begin = (n * run) >> level, end = (n * (run + 1)) >> level;
            for (int64_t i = begin; i < end; ++i)
                for (int axis = 0; axis < 3; ++axis) planes[axis * n + i] = points[3 * int64_t(order[i]) + axis];
            return;
        }
        halve(level, run);
        self(self, level + 1, 2 * run);
        self(self, level + 1, 2 * run + 1);
    };
    int64_t apart = 0;  // the level from which runs are built side by side
    while (threads > 1 && apart < depth && (int64_t(1) << apart) < 4 * threads && (n >> apart) > 4096) ++apart;
    for (int64_t level = 0; level < apart; ++level)
        parallel(threads, int64_t(1) << level, 1, [&](int64_t run, int64_t, int64_t) {
            bound(level, run);
            halve(level, run);
        });
    parallel(threads, int64_t(1) << apart, 1, [&](int64_t run, int64_t, int64_t) { grow(grow, apart, run); });
    return 0;
}

}  // namespace torchreg
