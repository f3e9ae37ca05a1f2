// Whether two correspondences keep their distance (torchreg/solvers/compatibility/graph.py).
#pragma once

#include "common.hpp"

namespace torchreg {

template <typename Real>
struct Sides {  // correspondences (3, count) twice, meters
    const Real* source;
    const Real* target;
    int64_t count;

    struct Point {
        Real p[3], q[3];

        // Whether the two distances to correspondence j of others differ by the threshold at most, per_square being
        // one over its square.
        bool agrees(const Sides& others, int64_t j, Real per_square) const {
            const Real a = square(p, others.source, others.count, j) * per_square;
            const Real b = square(q, others.target, others.count, j) * per_square;
            const Real u = (a - b) * (a - b) - (a + b);
            return u * std::abs(u) <= a * Real(4) * b;
        }

        static Real square(const Real* point, const Real* side, int64_t count, int64_t j) {
            const Real x = point[0] - side[j], y = point[1] - side[count + j], z = point[2] - side[2 * count + j];
            return x * x + y * y + z * z;
        }
    };

    Point at(int64_t i) const {
        return {{source[i], source[count + i], source[2 * count + i]},
                {target[i], target[count + i], target[2 * count + i]}};
    }
};

}  // namespace torchreg
