// The neighborhoods of all points of clouds, and the nearest points of another set; by k-d trees.
#include "tree.hpp"

namespace torchreg {
namespace {

template <typename T>
struct Candidate {
    T square;
    int32_t row;
    bool operator<(const Candidate& other) const {
        return square < other.square || (square == other.square && row < other.row);
    }
};

constexpr int64_t BUCKETS = 128;

// Sorts the `count` least of candidates by (d^2, row). Distances squared spread evenly over a disk, so that buckets of
// equal width hold about one of them each.
template <typename T>
struct Sorter {
    std::vector<Candidate<T>> sorted;
    std::vector<int32_t> bucket;

    // candidates (size), all below `limit`; returns how many stand at the front of `sorted`
    int64_t operator()(const T* square, const int32_t* row, int64_t size, T limit, int64_t count) {
        if (int64_t(bucket.size()) < size) bucket.resize(size);
        int32_t first[BUCKETS + 1] = {0};
        const T scale = T(BUCKETS) / limit;
        const bool spread = std::isfinite(scale);
        for (int64_t i = 0; i < size; ++i) {
            int32_t place = spread ? int32_t(square[i] * scale) : 0;
            bucket[i] = place < int32_t(BUCKETS) ? place : int32_t(BUCKETS - 1);
        }
        for (int64_t i = 0; i < size; ++i) ++first[bucket[i] + 1];
        int64_t used = 0;  // buckets that can hold one of the least
        while (used < BUCKETS) {
            first[used + 1] += first[used];
            if (first[++used] >= count) break;
        }
        const int64_t kept = first[used];
        if (int64_t(sorted.size()) < kept) sorted.resize(kept);
        int32_t next[BUCKETS];
        std::copy(first, first + used, next);
        for (int64_t i = 0; i < size; ++i)
            if (bucket[i] < used) sorted[next[bucket[i]]++] = {square[i], row[i]};
        for (int64_t b = 0; b < used; ++b) {
            Candidate<T>* begin = sorted.data() + first[b];
            const int64_t many = first[b + 1] - first[b];
            if (many > 24) {
                std::sort(begin, begin + many);
                continue;
            }
            for (int64_t i = 1; i < many; ++i) {
                const Candidate<T> moved = begin[i];
                int64_t place = i;
                for (; place > 0 && moved < begin[place - 1]; --place) begin[place] = begin[place - 1];
                begin[place] = moved;
            }
        }
        return std::min(kept, count);
    }
};

template <typename T>
struct Around {  // the points near a leaf
    std::vector<T> axes[3];
    std::vector<int32_t> row;
    std::vector<T> square, within;
    std::vector<int32_t> within_row;
    int64_t size = 0;

    // all points of leaves whose box is nearer than `limit` to the box of a leaf
    void gather(const Tree<T>& tree, const Box<T>& box, T limit) {
        size = 0;
        struct Entry {
            int64_t level, run;
        };
        Entry stack[64];
        int64_t top = 0;
        stack[top++] = {0, 0};
        while (top > 0) {
            const Entry entry = stack[--top];
            if (!(square_between(box, tree.box(entry.level, entry.run)) < limit)) continue;
            if (entry.level < tree.depth) {
                stack[top++] = {entry.level + 1, 2 * entry.run + 1};
                stack[top++] = {entry.level + 1, 2 * entry.run};
                continue;
            }
            const int64_t begin = tree.begin(entry.level, entry.run);
            const int64_t many = tree.begin(entry.level, entry.run + 1) - begin;
            if (int64_t(row.size()) < size + many) {
                const int64_t room = 2 * (size + many) + 1024;
                for (auto& axis : axes) axis.resize(room);
                row.resize(room);
                square.resize(room);
                within.resize(room);
                within_row.resize(room);
            }
            for (int axis = 0; axis < 3; ++axis)
                std::copy(tree.axes[axis] + begin, tree.axes[axis] + begin + many, axes[axis].data() + size);
            std::copy(tree.order + begin, tree.order + begin + many, row.data() + size);
            size += many;
        }
    }

    // those with d^2 < limit to one point, into within and within_row; returns how many
    int64_t measure(T x, T y, T z, T limit) {
        const T *px = axes[0].data(), *py = axes[1].data(), *pz = axes[2].data();
        T* out = square.data();
        for (int64_t i = 0; i < size; ++i) {
            const T dx = px[i] - x, dy = py[i] - y, dz = pz[i] - z;
            out[i] = (dx * dx + dy * dy) + dz * dz;
        }
        int64_t count = 0;
        T* kept = within.data();
        int32_t* kept_row = within_row.data();
        const int32_t* number = row.data();
        for (int64_t i = 0; i < size; ++i) {
            kept[count] = out[i];
            kept_row[count] = number[i];
            count += out[i] < limit;
        }
        return count;
    }
};

template <typename T>
inline T diagonal(const Box<T>& box) {
    T square = 0;
    for (int axis = 0; axis < 3; ++axis) {
        const T side = box.high[axis] - box.low[axis];
        square += side * side;
    }
    return square;
}

// The neighborhoods of one cloud: points (n, 3), whose first row is `begin` among all; outputs are the rows of the cloud.
template <typename T>
void search_cloud(const T* points, int64_t n, int64_t begin, T limit, int64_t slots, int64_t* index, bool* valid,
                  T* squares, int64_t threads) {
    std::vector<T> planes(3 * n), boxes(6 * ((int64_t(2) << tree_depth(n)) - 1));
    std::vector<int32_t> order(n);
    build_tree(points, n, planes.data(), order.data(), boxes.data(), threads);
    const Tree<T> tree(planes.data(), order.data(), boxes.data(), n);
    const T whole = diagonal(tree.box(0, 0));
    const int64_t workers = std::max<int64_t>(1, threads);
    std::vector<Around<T>> near(workers);
    std::vector<Sorter<T>> sorters(workers);
    parallel(threads, tree.leaves(), 16, [&](int64_t first, int64_t last, int64_t worker) {
        Around<T>& around = near[worker];
        Sorter<T>& sorter = sorters[worker];
        for (int64_t leaf = first; leaf < last; ++leaf) {
            const Box<T>& box = tree.box(tree.depth, leaf);
            const int64_t from = tree.begin(tree.depth, leaf), to = tree.begin(tree.depth, leaf + 1);
            int64_t pending[LEAF], left = 0;
            for (int64_t i = from; i < to; ++i) pending[left++] = i;
            // Where many more points than slots lie within the radius, a smaller one finds the nearest too: the first is
            // that of a disk which holds somewhat more than the slots at the density of the leaf.
            T reach = std::min(limit, std::max(diagonal(box) * T(0.02) * T(slots), std::min(limit, whole) * T(1e-10)));
            if (!(reach > 0)) reach = limit;  // copies of one point, or a radius whose square is hardly a number
            while (left > 0) {
                around.gather(tree, box, reach);
                int64_t most = 0, open = 0;
                for (int64_t j = 0; j < left; ++j) {
                    const int64_t i = pending[j];
                    const int64_t count = around.measure(planes[i], planes[n + i], planes[2 * n + i], reach);
                    most = std::max(most, count);
                    if (count < slots && reach < limit) {
                        pending[open++] = i;
                        continue;
                    }
                    const int64_t kept =
                        sorter(around.within.data(), around.within_row.data(), count, reach, slots);
                    const int64_t query = order[i];
                    int64_t* out = index + query * slots;
                    bool* held = valid + query * slots;
                    T* distance = squares + query * slots;
                    const Candidate<T>* sorted = sorter.sorted.data();
                    for (int64_t k = 0; k < kept; ++k) {
                        out[k] = sorted[k].row + begin;
                        distance[k] = sorted[k].square;
                    }
                    std::fill(out + kept, out + slots, query + begin);
                    std::fill(distance + kept, distance + slots, T(0));
                    std::memset(held, 1, kept);
                    std::memset(held + kept, 0, slots - kept);
                }
                left = open;
                const T growth = std::min(T(16), std::max(T(2), T(1.5) * T(slots) / T(std::max<int64_t>(1, most))));
                reach = std::min(limit, reach * growth);
            }
        }
    });
}

}  // namespace

template <typename T>
int64_t search_clouds(const T* points, const int64_t* offsets, const T* limits, int64_t clouds, int64_t slots, int64_t* index,
            bool* valid, T* squares, int64_t threads) {
    const int64_t total = offsets[clouds];
    const bool together = clouds >= threads && total / std::max<int64_t>(1, clouds) < 20000;
    parallel(together ? threads : 1, clouds, 1, [&](int64_t cloud, int64_t, int64_t) {
        const int64_t begin = offsets[cloud], n = offsets[cloud + 1] - begin;
        if (n == 0) return;
        search_cloud(points + 3 * begin, n, begin, limits[cloud], slots, index + begin * slots, valid + begin * slots,
                     squares + begin * slots, together ? 1 : threads);
    });
    return 0;
}

// Equals `search_cells` of neighborhoods/cells.py.
//
// points (P, 3), meters, of B clouds at offsets (B + 1) int64; limits (B), squared radii; K slots. Writes index (P, K)
// int64, valid (P, K) bool and squares (P, K).
KERNELS(search_clouds,
        (const Real* points, const int64_t* offsets, const Real* limits, int64_t clouds, int64_t slots, int64_t* index,
         bool* valid, Real* squares, int64_t threads),
        (points, offsets, limits, clouds, slots, index, valid, squares, threads))

// The number of boxes of a tree over n points.
KERNEL(tree_boxes, int64_t n, int64_t) { return (int64_t(2) << tree_depth(n)) - 1; }

// A tree over points (N, 3), meters. Writes planes (3, N), order (N) int32 and boxes (tree_boxes(N), 6).
KERNELS(build_tree, (const Real* points, int64_t n, Real* planes, int32_t* order, Real* boxes, int64_t threads),
        (points, n, planes, order, boxes, threads))

template <typename T>
int64_t nearest_in_tree(const T* planes, const int32_t* order, const T* boxes, int64_t n, const T* query, int64_t queries,
             int64_t count, double limit, int64_t* rows, T* squares, int64_t threads) {
    const Tree<T> tree(planes, order, boxes, n);
    parallel(threads, queries, 256, [&](int64_t first, int64_t last, int64_t) {
        T near[64];
        int32_t row[64];
        for (int64_t i = first; i < last; ++i) {
            const T* point = query + 3 * i;
            const int64_t found = nearest_few(tree, point[0], point[1], point[2], T(limit), count, near, row);
            for (int64_t k = 0; k < count; ++k) {
                rows[i * count + k] = k < found ? row[k] : -1;
                squares[i * count + k] = k < found ? near[k] : std::numeric_limits<T>::infinity();
            }
        }
    });
    return 0;
}

// The nearest points of a tree, as `build_tree` writes it, with d^2 < limit: at most 64 of every query (Q, 3).
//
// Writes rows (Q, count) int64, -1 where there are none, and squares (Q, count), infinite there.
KERNELS(nearest_in_tree,
        (const Real* planes, const int32_t* order, const Real* boxes, int64_t n, const Real* query, int64_t queries,
         int64_t count, double limit, int64_t* rows, Real* squares, int64_t threads),
        (planes, order, boxes, n, query, queries, count, limit, rows, squares, threads))

}  // namespace torchreg
