// The nearest points of scans within a limit, and cells that tell where none is: torchreg/verification/partner_grid.py and
// partners.py.
//
// A scan lies in a grid of cells somewhat wider than the limit, with two empty ones around it, so that all points within
// the limit of a query lie in the 27 cells around its own. Cells along z follow each other, and so do their points:
// nine ranges of points are compared at most. Cells that no point lies in or beside are marked, most queries end there.
#include "common.hpp"

namespace torchreg {
namespace {

constexpr int64_t FEW = 8;      // poses that a thread takes at a time
constexpr float MARGIN = 2;     // empty cells around a scan
constexpr float SLACK = 4e-3f;  // of a cell: more than rounding moves a point in a grid of 4,096 cells

struct Entry {
    float x, y, z;
    int32_t row;
};

struct Grid {
    const float *low, *width, *last;  // (3) meters, (1) meters, (3) cells
    int64_t first, stride_x, stride_y;

    Grid(const float* lows, const float* widths, const float* lasts, const int64_t* firsts, int64_t scan)
        : low(lows + 3 * scan), width(widths + scan), last(lasts + 3 * scan), first(firsts[scan]) {
        stride_y = int64_t(last[2]) + 1;
        stride_x = stride_y * (int64_t(last[1]) + 1);
    }
    float place(float coordinate, int axis, float inverse) const {
        const float cell = (coordinate - low[axis]) * inverse + MARGIN;
        return std::min(cell > 0 ? cell : 0, last[axis]);  // the first cell also for what is no number
    }
    int64_t cell(float x, float y, float z) const {
        return first + int64_t(x) * stride_x + int64_t(y) * stride_y + int64_t(z);
    }
};

// Mark a cell and the 26 around it; those along z follow each other.
inline void mark_around(uint8_t* cell, int64_t stride_x, int64_t stride_y) {
    for (int64_t x = -1; x <= 1; ++x)
        for (int64_t y = -1; y <= 1; ++y) std::memset(cell + x * stride_x + y * stride_y - 1, 1, 3);
}

struct Column {
    float away;  // squared meters at least to what it holds
    int32_t begin, end;
};

struct Best {
    float square;
    int32_t row;
};

inline void compare(const Entry* entry, const Entry* end, float x, float y, float z, Best& best) {
    for (; entry < end; ++entry) {
        const float dx = x - entry->x, dy = y - entry->y, dz = z - entry->z;
        const float square = dx * dx + dy * dy + dz * dz;
        if (square < best.square || (square == best.square && entry->row < best.row)) best = {square, entry->row};
    }
}

}  // namespace

// Sort the points of G scans into cells.
//
// points (3, P) float32, meters, scan by scan; offsets (G + 1) int64. low (G, 3), width (G) and last (G, 3) float32 and
// first (G) int64 are the grids. Writes entries (P, 4) int32, x, y, z and row of every point, cell by cell; starts
// (V + 1) int32, where the entries of each of all V cells begin; reached (V) bool. Both have to be zero before.
KERNEL(sort_into_cells, const float* points, const int64_t* offsets, const float* low, const float* width,
                        const float* last, const int64_t* first, int32_t* entries, int32_t* starts, uint8_t* reached,
                        int64_t count, int64_t scans, int64_t cells, int64_t) {
    std::vector<int64_t> own(count);
    for (int64_t g = 0; g < scans; ++g) {
        const Grid grid(low, width, last, first, g);
        const float inverse = 1 / grid.width[0];
        for (int64_t i = offsets[g]; i < offsets[g + 1]; ++i) {
            const int64_t cell = grid.cell(grid.place(points[i], 0, inverse), grid.place(points[count + i], 1, inverse),
                                           grid.place(points[2 * count + i], 2, inverse));
            own[i] = cell;
            if (starts[cell + 1]++ > 0) continue;  // a cell that is marked already
            mark_around(reached + cell, grid.stride_x, grid.stride_y);
        }
    }
    for (int64_t c = 0; c < cells; ++c) starts[c + 1] += starts[c];
    std::vector<int32_t> next(starts, starts + cells);
    Entry* out = reinterpret_cast<Entry*>(entries);
    for (int64_t i = 0; i < count; ++i)
        out[next[own[i]]++] = {points[i], points[count + i], points[2 * count + i], int32_t(i)};
    return 0;
}

// Equals `partners` of partners.py where ties go to the lower row.
//
// moved (3, R, L) float32, meters; pair (R) int64; valid (R, L) bool; limit (R) float32, squared meters; the grid as
// above. Writes row (R, L) int64, 0 where there is no point within the limit, and square (R, L), infinite there.
KERNEL(nearest_in_cells, const float* moved, const int64_t* pair, const uint8_t* valid, const float* limit,
                         const float* low, const float* width, const float* last, const int64_t* first,
                         const int32_t* entries, const int32_t* starts, const uint8_t* reached, int64_t* row,
                         float* square, int64_t rows, int64_t length, int64_t threads) {
    const Entry* all = reinterpret_cast<const Entry*>(entries);
    const int64_t grain = std::max<int64_t>(1, 2048 / std::max<int64_t>(1, length));
    parallel(threads, rows, grain, [&](int64_t begin, int64_t end, int64_t) {
        std::vector<int32_t> cells(length);
        for (int64_t r = begin; r < end; ++r) {
            const Grid grid(low, width, last, first, pair[r]);
            const float w = grid.width[0], inverse = 1 / w;
            const float *px = moved + r * length, *py = px + rows * length, *pz = py + rows * length;
            const int32_t stride_x = int32_t(grid.stride_x), stride_y = int32_t(grid.stride_y);
            for (int64_t i = 0; i < length; ++i) {
                const float cx = grid.place(px[i], 0, inverse), cy = grid.place(py[i], 1, inverse);
                cells[i] = int32_t(cx) * stride_x + int32_t(cy) * stride_y + int32_t(grid.place(pz[i], 2, inverse));
            }
            const uint8_t *here = reached + grid.first, *asked = valid + r * length;
            const int32_t* from = starts + grid.first;
            int64_t* to = row + r * length;
            float* squares = square + r * length;
            for (int64_t i = 0; i < length; ++i) {
                to[i] = 0;
                squares[i] = std::numeric_limits<float>::infinity();
                if (!(here[cells[i]] & asked[i])) continue;
                const float x = px[i], y = py[i], z = pz[i];
                const float cx = grid.place(x, 0, inverse), cy = grid.place(y, 1, inverse);
                const float fx = cx - float(int32_t(cx)), fy = cy - float(int32_t(cy));
                const float away_x[3] = {std::max(0.0f, fx - SLACK) * w, 0, std::max(0.0f, 1 - fx - SLACK) * w};
                const float away_y[3] = {std::max(0.0f, fy - SLACK) * w, 0, std::max(0.0f, 1 - fy - SLACK) * w};
                static constexpr int ORDER[9][2] = {{1, 1}, {0, 1}, {2, 1}, {1, 0}, {1, 2}, {0, 0}, {0, 2}, {2, 0}, {2, 2}};
                Column columns[9];
                int used = 0;  // columns that have points and may have one within the limit
                for (const auto& step : ORDER) {
                    const int32_t* middle = from + cells[i] + (step[0] - 1) * stride_x + (step[1] - 1) * stride_y;
                    const float ax = away_x[step[0]], ay = away_y[step[1]], away = (ax * ax + ay * ay) * 0.999f;
                    columns[used] = {away, middle[-1], middle[2]};
                    used += int(middle[-1] < middle[2]) & int(away <= limit[r]);
                }
                Best best{limit[r], -1};
                for (int k = 0; k < used; ++k)
                    if (columns[k].away <= best.square)
                        compare(all + columns[k].begin, all + columns[k].end, x, y, z, best);
                if (best.row < 0) continue;
                to[i] = best.row;
                squares[i] = best.square;
            }
        }
    });
    return 0;
}

// Equals the loop of `occupancy` of partners.py: marks the cells that the points (3, P) float32 of G scans reach.
//
// offsets (G + 1) int64, where the points of each scan begin; low (3, G), width (G), last (3, G) float32, stride (3, G)
// and first (G) int64. Writes true into reached (V) bool, which is false before.
KERNEL(mark_reached, const float* points, const int64_t* offsets, const float* low, const float* width,
                    const float* last, const int64_t* stride, const int64_t* first, uint8_t* reached, int64_t count,
                    int64_t scans, int64_t cells, int64_t) {
    std::vector<uint8_t> done(cells);
    for (int64_t g = 0; g < scans; ++g) {
        for (int64_t i = offsets[g]; i < offsets[g + 1]; ++i) {
            int64_t cell = first[g];
            for (int axis = 0; axis < 3; ++axis) {
                const float place = std::floor((points[axis * count + i] - low[axis * scans + g]) / width[g]) + 2;
                cell += int64_t(std::min(place > 0 ? place : 0, last[axis * scans + g])) * stride[axis * scans + g];
            }
            if (done[cell]) continue;
            done[cell] = 1;
            mark_around(reached + cell, stride[g], stride[scans + g]);
        }
    }
    return 0;
}

// Equals `near_counts` of partners.py: how many of the points moved (3, R, L) float32, where valid (R, L) bool, lie in
// reached cells of their scans, pair (R) int64. Cells as above. Writes counts (R) int64.
KERNEL(near_counts, const float* moved, const int64_t* pair, const uint8_t* valid, const float* low, const float* width,
                   const float* last, const int64_t* stride, const int64_t* first, const uint8_t* reached,
                   int64_t* counts, int64_t scans, int64_t rows, int64_t length, int64_t threads) {
    parallel(threads, rows, FEW, [&](int64_t begin, int64_t end, int64_t) {
        std::vector<int32_t> cell(length);
        for (int64_t r = begin; r < end; ++r) {
            const int64_t g = pair[r];
            std::fill(cell.begin(), cell.end(), 0);
            for (int axis = 0; axis < 3; ++axis) {
                const float* x = moved + (axis * rows + r) * length;
                const float from = low[axis * scans + g], w = width[g], most = last[axis * scans + g];
                const int32_t step = int32_t(stride[axis * scans + g]);
                for (int64_t i = 0; i < length; ++i) {
                    const float place = std::floor((x[i] - from) / w) + 2;
                    cell[i] += int32_t(std::min(place > 0 ? place : 0, most)) * step;
                }
            }
            int64_t total = 0;
            const uint8_t *here = reached + first[g], *counted = valid + r * length;
            for (int64_t i = 0; i < length; ++i) total += here[cell[i]] & counted[i];
            counts[r] = total;
        }
    });
    return 0;
}

}  // namespace torchreg
