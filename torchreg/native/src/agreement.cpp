// Poses weighed on matches: torchreg/verification/agreement.py.
#include "rigid.hpp"

namespace torchreg {
namespace {

constexpr int64_t TILE = 512;   // matches whose targets stay in the cache for all poses of a block
constexpr int64_t BLOCK = 8;    // poses

}  // namespace

// Equals `_counted` of agreement.py, of H poses on M matches with K pairings each.
//
// source (3, M), targets (3, K, M) float64, meters; last (C) and size (C) int64, of C cells; rotation (H, 3, 3) and
// translation (H, 3) float64. Writes support (H) int64 and agreeing (2, H) float64: the sums over cells of the shares
// of their matches that agree, first of the true pairing, then of all others together.
KERNEL(agreement, const double* source, const double* targets, const int64_t* last, const int64_t* size,
                  const double* rotation, const double* translation, int64_t* support, double* agreeing, int64_t count,
                  int64_t pairings, int64_t cells, int64_t poses, double square_limit, int64_t threads) {
    parallel(threads, poses, BLOCK, [&](int64_t begin, int64_t end, int64_t) {
        std::vector<int32_t> counts(2 * count * (end - begin));  // true pairings, then others, pose by pose
        double x[TILE], y[TILE], z[TILE];
        int64_t near[TILE];
        for (int64_t first = 0; first < count; first += TILE) {
            const int64_t n = std::min(TILE, count - first);
            for (int64_t h = begin; h < end; ++h) {
                const double *R = rotation + 9 * h, *t = translation + 3 * h;
                const double *px = source + first, *py = px + count, *pz = py + count;
                for (int64_t m = 0; m < n; ++m) {
                    x[m] = turned(R, 0, px[m], py[m], pz[m]) + t[0];
                    y[m] = turned(R, 1, px[m], py[m], pz[m]) + t[1];
                    z[m] = turned(R, 2, px[m], py[m], pz[m]) + t[2];
                    near[m] = 0;
                }
                int32_t* of_pose = counts.data() + 2 * count * (h - begin) + first;
                for (int64_t k = 0; k < pairings; ++k) {
                    const double *qx = targets + k * count + first, *qy = qx + pairings * count, *qz = qy + pairings * count;
                    for (int64_t m = 0; m < n; ++m) {
                        const double dx = x[m] - qx[m], dy = y[m] - qy[m], dz = z[m] - qz[m];
                        near[m] += dx * dx + dy * dy + dz * dz < square_limit ? 1 : 0;
                    }
                    if (k == 0) {
                        for (int64_t m = 0; m < n; ++m) {
                            of_pose[m] = int32_t(near[m]);
                            near[m] = 0;
                        }
                    }
                }
                for (int64_t m = 0; m < n; ++m) of_pose[count + m] = int32_t(near[m]);
            }
        }
        for (int64_t h = begin; h < end; ++h) {
            const int32_t *here = counts.data() + 2 * count * (h - begin), *chance = here + count;
            double share = 0, expected = 0;
            int64_t total = 0, m = 0;
            for (int64_t c = 0; c < cells; ++c) {
                int64_t one = 0, other = 0;
                for (; m <= last[c]; ++m) {
                    one += here[m];
                    other += chance[m];
                }
                share += double(one) / double(size[c]);
                expected += double(other) / double(size[c]);
                total += one;
            }
            support[h] = total;
            agreeing[h] = share;
            agreeing[poses + h] = expected;
        }
    });
    return 0;
}

}  // namespace torchreg
