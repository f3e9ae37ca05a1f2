// The update of a Gauss-Newton step.
#include "gauss_newton.hpp"

namespace torchreg {

// Equals `_solve` of refinement/gauss_newton.py: sums (B, 28), center (B, 3); writes rotation (B, 3, 3), translation
// (B, 3) and whether the motion is determined (B).
KERNEL(gauss_newton, const double* sums, const double* center, int64_t pairs, double* rotation, double* translation,
                     bool* usable, int64_t) {
    for (int64_t b = 0; b < pairs; ++b)
        usable[b] = solve(sums + PRODUCTS * b, center + 3 * b, rotation + 9 * b, translation + 3 * b);
    return 0;
}

}  // namespace torchreg
