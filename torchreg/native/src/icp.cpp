// ICP of pairs of clouds whose targets have trees: the nearest points of moved source points, and the whole iteration of
// point-to-plane ICP.
#include "gauss_newton.hpp"
#include "tree.hpp"

namespace torchreg {
namespace {

constexpr double MARGIN = 1.5;       // times the largest distance, within which is searched: bounds what is beyond it
constexpr double SLACK = 1 - 1e-12;  // a bound that is closer than rounding is not relied on

// The target of a pair: its tree, and the columns of its points.
struct TargetPoints {
    Tree<double> tree;
    const double* values;  // (A, total), from the cloud's first point on
    int64_t total;

    // trees (4) are the addresses of planes, order and boxes, and the number of points
    TargetPoints(const int64_t* trees, const double* values, int64_t first, int64_t total)
        : tree(reinterpret_cast<const double*>(trees[0]), reinterpret_cast<const int32_t*>(trees[1]),
               reinterpret_cast<const double*>(trees[2]), trees[3]),
          values(values + first), total(total) {}

    double square(int32_t row, double x, double y, double z) const {
        const double dx = x - values[row], dy = y - values[total + row], dz = z - values[2 * total + row];
        return (dx * dx + dy * dy) + dz * dz;
    }
};

// What the last search of every row of a block knows: where it was made, the two nearest points, and how far all others
// than the first are at least. As in refinement/correspond.py, a row is searched only where its nearest may have changed.
struct Known {
    double at[3][BLOCK];
    double others[BLOCK];
    int32_t row[2][BLOCK];  // -1 for none

    Known() { forget(); }

    void forget() {
        std::fill_n(others, BLOCK, -std::numeric_limits<double>::infinity());
        std::fill_n(row[0], 2 * BLOCK, -1);
    }
};

// The nearest target point of every row of a block at p (3, 256), where it is nearer than `limit`, or -1, and the squared
// distance to it; 0 where there is none.
inline void match_block(const TargetPoints& target, const double (*p)[BLOCK], int64_t rows, double limit, Known& known,
                        int32_t* nearest, double* square) {
    const double limit_square = limit * limit, reach = MARGIN * limit, reach_square = reach * reach;
    for (int64_t r = 0; r < rows; ++r) {
        const double x = p[0][r], y = p[1][r], z = p[2][r];
        const double sx = x - known.at[0][r], sy = y - known.at[1][r], sz = z - known.at[2][r];
        const double others = (known.others[r] - std::sqrt((sx * sx + sy * sy) + sz * sz)) * SLACK;
        int32_t first = known.row[0][r], second = known.row[1][r];
        double apart = first >= 0 ? target.square(first, x, y, z) : std::numeric_limits<double>::infinity();
        const bool same = first >= 0 ? std::sqrt(apart) < others : others > limit;
        if (!same) {
            double within = reach_square;
            if (second >= 0) {  // two points that are nearer than this are known: look no farther, but for ties
                const double most = std::max(apart, target.square(second, x, y, z));
                within = std::min(within, std::nextafter(most, std::numeric_limits<double>::infinity()));
            }
            double squares[2];
            int32_t row[2];
            const int64_t found = nearest_few(target.tree, x, y, z, within, 2, squares, row);
            first = known.row[0][r] = found > 0 ? row[0] : -1;
            known.row[1][r] = found > 1 ? row[1] : -1;
            known.others[r] = found > 1 ? std::sqrt(squares[1]) : reach;
            known.at[0][r] = x;
            known.at[1][r] = y;
            known.at[2][r] = z;
            if (found > 0) apart = squares[0];
        }
        const bool inside = first >= 0 && apart < limit_square;
        nearest[r] = inside ? first : -1;
        square[r] = inside ? apart : 0.0;
    }
    std::fill(nearest + rows, nearest + BLOCK, -1);
    std::fill(square + rows, square + BLOCK, 0.0);
}

// Rows x (3 of 256, `stride` apart) under R and t.
inline void transform_block(const double* x, int64_t stride, const double* R, const double* t, double (*out)[BLOCK]) {
    const double *a = x, *b = x + stride, *c = x + 2 * stride;
    for (int i = 0; i < 3; ++i)
        for (int64_t r = 0; r < BLOCK; ++r)
            out[i][r] = ((t[i] + a[r] * R[3 * i]) + b[r] * R[3 * i + 1]) + c[r] * R[3 * i + 2];
}

// One pair of `icp_point_to_plane`.
struct Pair {
    const double* source;  // (3, blocks, 256), `stride` between the coordinates
    int64_t stride, blocks, length;
    TargetPoints target;
    double limit;
    const double* center;
    std::vector<Known> known;
    std::vector<double> partial;  // of every block, PRODUCTS sums, the number of correspondences and their squares

    static constexpr int64_t CHANNELS = PRODUCTS + 2;

    // The sums of terms at a pose, and fitness and inlier_rmse.
    void sum(const double* R, const double* t, int64_t threads, double* sums, double& fitness, double& rmse) {
        parallel(threads, blocks, 2, [&](int64_t begin, int64_t end, int64_t) {
            for (int64_t block = begin; block < end; ++block) sum_block(block, R, t);
        });
        fold_rows(partial.data(), blocks, CHANNELS);
        std::copy_n(partial.data(), CHANNELS, sums);
        fitness = sums[PRODUCTS] / double(length);
        rmse = square_root(sums[PRODUCTS + 1] / std::max(sums[PRODUCTS], 1.0));
    }

    void sum_block(int64_t block, const double* R, const double* t) {
        double p[3][BLOCK], n[3][BLOCK], residual[BLOCK], inside[BLOCK], square[BLOCK];
        int32_t nearest[BLOCK];
        transform_block(source + block * BLOCK, stride, R, t, p);
        match_block(target, p, std::min(BLOCK, length - block * BLOCK), limit, known[block], nearest, square);
        for (int64_t r = 0; r < BLOCK; ++r) {
            const int32_t row = std::max(nearest[r], 0);
            const double* q = target.values + row;
            inside[r] = nearest[r] >= 0 ? 1.0 : 0.0;
            double along[3];
            for (int i = 0; i < 3; ++i) {
                n[i][r] = q[(3 + i) * target.total];
                along[i] = (p[i][r] - q[i * target.total]) * n[i][r];
            }
            residual[r] = (along[0] + along[1]) + along[2];
        }
        double* out = partial.data() + block * CHANNELS;
        block_products(p, n, residual, inside, out);
        out[PRODUCTS] = fold<BLOCK>(inside);
        out[PRODUCTS + 1] = fold<BLOCK>(square);
    }
};

// Equals `iterate` of refinement/loop.py for one pair.
struct Progress {
    double* R;  // (3, 3)
    double* t;  // (3)
    double *fitness, *rmse;
    int64_t *updates, *outcome;
};

enum Outcome : int64_t { STOPPED = 0, CONVERGED = 1, UNMATCHED = 2, OPEN = 3 };

inline void iterate(Pair& pair, int64_t most, double least_fitness, double least_rmse, int64_t threads, Progress state) {
    double sums[Pair::CHANNELS];
    *state.updates = 0;
    pair.sum(state.R, state.t, threads, sums, *state.fitness, *state.rmse);
    if (!(*state.fitness > 0)) {
        *state.outcome = UNMATCHED;
        return;
    }
    while (true) {
        double turn[9], shift[3], R[9], t[3], fitness, rmse;
        bool usable = solve(sums, pair.center, turn, shift);
        for (int j = 0; j < 3; ++j) {
            const double column[3] = {state.R[j], state.R[3 + j], state.R[6 + j]};
            double moved[3];
            rotated(turn, column, moved);
            for (int i = 0; i < 3; ++i) R[3 * i + j] = moved[i];
        }
        rotated(turn, state.t, t);
        for (int i = 0; i < 3; ++i) {
            t[i] = t[i] + shift[i];
            usable = usable && std::isfinite(t[i]);
        }
        if (!usable) {
            *state.outcome = OPEN;
            return;
        }
        pair.sum(R, t, threads, sums, fitness, rmse);
        if (!(fitness > 0)) {
            *state.outcome = UNMATCHED;
            return;
        }
        const double fitness_change = std::abs(fitness - *state.fitness), rmse_change = std::abs(rmse - *state.rmse);
        std::copy_n(R, 9, state.R);
        std::copy_n(t, 3, state.t);
        *state.fitness = fitness;
        *state.rmse = rmse;
        ++*state.updates;
        const bool converged = fitness_change < least_fitness && rmse_change < least_rmse;
        if (converged || *state.updates >= most) {
            *state.outcome = converged ? CONVERGED : STOPPED;
            return;
        }
    }
}

}  // namespace

// Point-to-plane ICP of B pairs with weights of 1: `iterate` of refinement/loop.py with `point_to_plane(least_squares)`.
// source (3, n, 256) in blocks of pairs, first_block (B + 1), lengths (B) of the sources; trees (B, 4) are addresses of
// planes, order and boxes, and numbers of points; values (6, N): targets' points and normals, first (B) their first rows;
// center, limits, most updates, least changes (B). Writes rotation (B, 3, 3), translation (B, 3) from those it starts at,
// fitness, rmse, updates, outcome (B).
KERNEL(icp_point_to_plane, const double* source, int64_t n, const int64_t* first_block, const int64_t* lengths,
                          int64_t pairs, const int64_t* trees, const double* values, int64_t total,
                          const int64_t* first, const double* center, const double* limits, const int64_t* most,
                          const double* least_fitness, const double* least_rmse, double* rotation, double* translation,
                          double* fitness, double* rmse, int64_t* updates, int64_t* outcome, int64_t threads) {
    // whole pairs are shared out among threads, or where they are few and large, the blocks of each
    const bool together = pairs >= threads || first_block[pairs] < 80 * pairs;
    parallel(together ? threads : 1, pairs, 1, [&](int64_t b, int64_t, int64_t) {
        const int64_t blocks = first_block[b + 1] - first_block[b];
        Pair pair{source + first_block[b] * BLOCK,
                  n * BLOCK,
                  blocks,
                  lengths[b],
                  TargetPoints(trees + 4 * b, values, first[b], total),
                  limits[b],
                  center + 3 * b,
                  std::vector<Known>(blocks),
                  std::vector<double>(blocks * Pair::CHANNELS)};
        iterate(pair, most[b], least_fitness[b], least_rmse[b], together ? 1 : threads,
                {rotation + 9 * b, translation + 3 * b, fitness + b, rmse + b, updates + b, outcome + b});
    });
    return 0;
}

// The numbers of float64 that the state of a block's searches takes.
KERNEL(search_state_size, int64_t) { return sizeof(Known) / sizeof(double); }

// Equals `Correspondence.move`: the correspondences of n blocks under the poses of B pairs. source (3, n, 256), pair (n)
// and rows (n) of every block; trees, values (A, N), first and limits as in `icp_point_to_plane`; rotation (B, 3, 3),
// translation (B, 3); known (n, search_state_size) is the state of the searches, which is `fresh` at first. Writes moved
// (3, n, 256), inside and square (n, 256), and partner (A, n, 256) where a row has one.
KERNEL(move_blocks, const double* source, int64_t n, const int64_t* pair, const int64_t* rows, const int64_t* trees,
                const double* values, int64_t columns, int64_t total, const int64_t* first, const double* limits,
                const double* rotation, const double* translation, double* known, int64_t fresh, double* moved,
                double* partner, double* square, bool* inside, int64_t threads) {
    parallel(threads, n, 2, [&](int64_t begin, int64_t end, int64_t) {
        for (int64_t block = begin; block < end; ++block) {
            const int64_t b = pair[block], at = block * BLOCK;
            const TargetPoints target(trees + 4 * b, values, first[b], total);
            Known& state = reinterpret_cast<Known*>(known)[block];
            if (fresh) state.forget();
            double p[3][BLOCK];
            int32_t nearest[BLOCK];
            transform_block(source + at, n * BLOCK, rotation + 9 * b, translation + 3 * b, p);
            for (int i = 0; i < 3; ++i) std::copy_n(p[i], BLOCK, moved + i * n * BLOCK + at);
            match_block(target, p, rows[block], limits[b], state, nearest, square + at);
            for (int64_t r = 0; r < BLOCK; ++r) inside[at + r] = nearest[r] >= 0;
            for (int64_t c = 0; c < columns; ++c) {
                const double* column = target.values + c * total;
                double* out = partner + c * n * BLOCK + at;
                for (int64_t r = 0; r < BLOCK; ++r) out[r] = nearest[r] >= 0 ? column[nearest[r]] : out[r];
            }
        }
    });
    return 0;
}

}  // namespace torchreg
