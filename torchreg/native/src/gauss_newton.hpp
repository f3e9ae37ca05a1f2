// What kinds of ICP share: sums over blocks of 256 rows, the products of (J, r), and the update that follows from them.
#pragma once

#include "rigid.hpp"
#include "sums.hpp"

namespace torchreg {

constexpr int64_t BLOCK = 256;
constexpr int64_t PRODUCTS = 28;  // the upper triangle of 7 x 7

// Equals `products` of `jacobian`, summed over a block: rows p (3, 256) and d (3, 256), residuals and weights (256).
// Writes sums (28).
inline void block_products(const double (*p)[BLOCK], const double (*d)[BLOCK], const double* residual,
                           const double* weight, double* sums) {
    double J[7][BLOCK], weighted[BLOCK], product[BLOCK];
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        for (int64_t r = 0; r < BLOCK; ++r) J[i][r] = p[j][r] * d[k][r] - p[k][r] * d[j][r];
        std::copy_n(d[i], BLOCK, J[3 + i]);
    }
    std::copy_n(residual, BLOCK, J[6]);
    int64_t place = 0;
    for (int i = 0; i < 7; ++i) {
        for (int64_t r = 0; r < BLOCK; ++r) weighted[r] = J[i][r] * weight[r];
        for (int j = i; j < 7; ++j) {
            for (int64_t r = 0; r < BLOCK; ++r) product[r] = J[j][r] * weighted[r];
            sums[place++] = fold<BLOCK>(product);
        }
    }
}

// Equals `square_root` of geometry/numerics/roots.py.
inline double square_root(double x) { return x > 0 ? x * (1 / std::sqrt(x)) : 0.0; }

// Equals `rotation_zyx`, which calls the same sine and cosine.
inline void rotation_zyx(double a, double b, double c, double* R) {
    // read anew at every call, so that no compiler makes one call of the two, which might round otherwise
    double (*volatile sine)(double) = std::sin;
    double (*volatile cosine)(double) = std::cos;
    const double sa = sine(a), ca = cosine(a), sb = sine(b), cb = cosine(b), sc = sine(c), cc = cosine(c);
    const double made[9] = {cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa,
                            sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa,
                            -sb,     cb * sa,                cb * ca};
    std::copy_n(made, 9, R);
}

// Equals `_solve` in refinement/gauss_newton.py, of one pair: sums (28) and center (3) to R (3, 3) and t (3); whether the
// motion is determined.
inline bool solve(const double* sums, const double* center, double* R, double* t) {
    constexpr double RANK = 1e-10;
    bool determined = true;
    for (int64_t i = 0; i < PRODUCTS; ++i) determined = determined && std::isfinite(sums[i]);
    double M[7][7];
    int64_t place = 0;
    for (int i = 0; i < 7; ++i)
        for (int j = i; j < 7; ++j) M[i][j] = M[j][i] = determined ? sums[place++] : 0.0;
    double scale[7];
    for (int i = 0; i < 6; ++i) scale[i] = M[i][i] > 0 ? 1 / std::sqrt(M[i][i]) : 0.0;
    scale[6] = 1.0;
    for (int i = 0; i < 6; ++i)
        for (int j = 0; j < 7; ++j) M[i][j] = scale[i] * M[i][j] * scale[j];
    double pivot[6];
    for (int k = 0; k < 6; ++k) {
        const bool held = M[k][k] > RANK;
        determined = determined && held;
        pivot[k] = held ? M[k][k] : 1.0;
        for (int i = k + 1; i < 6; ++i) {
            const double factor = M[i][k] / pivot[k];
            for (int j = k + 1; j < 7; ++j) M[i][j] = M[i][j] - factor * M[k][j];
        }
    }
    for (int k = 5; k >= 0; --k) {
        M[k][6] = M[k][6] / pivot[k];
        for (int i = 0; i < k; ++i) M[i][6] = M[i][6] - M[i][k] * M[k][6];
    }
    double x[6];
    for (int i = 0; i < 6; ++i) x[i] = determined ? -scale[i] * M[i][6] : -scale[i] * 0.0;
    rotation_zyx(x[0], x[1], x[2], R);
    double turned[3];
    rotated(R, center, turned);
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        const double carried = (turned[i] - center[i]) - (x[j] * center[k] - x[k] * center[j]);
        t[i] = x[3 + i] + carried;
    }
    return determined;
}

}  // namespace torchreg
