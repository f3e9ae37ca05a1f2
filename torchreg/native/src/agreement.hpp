// By how much the distances of two correspondences differ on the two sides (torchreg/solvers/compatibility/graph.py).
#pragma once

#include "common.hpp"

namespace torchreg {

// The distance of points i and j by the coordinates of their difference; basic operations in the order of torch's.
template <typename Real>
inline Real squared(Real x, Real y, Real z) {
    return x * x + y * y + z * z;
}

template <typename Real>
struct Sides {  // correspondences (3, count) twice, meters
    const Real* source;
    const Real* target;
    int64_t count;

    struct Point {
        Real p[3], q[3];

        // The difference of the two distances to correspondence j of others.
        Real gap(const Sides& others, int64_t j) const {
            return std::abs(std::sqrt(from_source(others, j)) - std::sqrt(from_target(others, j)));
        }
        Real from_source(const Sides& others, int64_t j) const { return from(p, others.source, others.count, j); }
        Real from_target(const Sides& others, int64_t j) const { return from(q, others.target, others.count, j); }

        static Real from(const Real* point, const Real* side, int64_t count, int64_t j) {
            return squared(point[0] - side[j], point[1] - side[count + j], point[2] - side[2 * count + j]);
        }
    };

    Point at(int64_t i) const {
        return {{source[i], source[count + i], source[2 * count + i]},
                {target[i], target[count + i], target[2 * count + i]}};
    }
};

}  // namespace torchreg
