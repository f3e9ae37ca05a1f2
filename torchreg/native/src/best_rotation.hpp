// The rotation that turns points to their partners best (torchreg/geometry/best_rotation.py).
#pragma once

#include "rigid.hpp"

namespace torchreg {

constexpr int ROUNDS = 7;     // of squarings; after each the trace is one again
constexpr int SQUARINGS = 4;  // a round

// Equals `best_rotation`: rotation (3, 3) by rows, from covariance[3 * i + j] = sum of p_i q_j.
inline void best_rotation(const double* covariance, double* rotation) {
    const double* S = covariance;
    double shift = std::abs(S[0]);
    for (int k = 1; k < 9; ++k) shift += std::abs(S[k]);
    double a[4][4];
    a[0][0] = S[0] + S[4] + S[8];
    a[1][1] = S[0] - S[4] - S[8];
    a[2][2] = S[4] - S[0] - S[8];
    a[3][3] = S[8] - S[0] - S[4];
    a[0][1] = a[1][0] = S[5] - S[7];
    a[0][2] = a[2][0] = S[6] - S[2];
    a[0][3] = a[3][0] = S[1] - S[3];
    a[1][2] = a[2][1] = S[1] + S[3];
    a[1][3] = a[3][1] = S[6] + S[2];
    a[2][3] = a[3][2] = S[5] + S[7];
    const bool some = shift > 0;
    const double divisor = some ? 4.0 * shift : 1.0;
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) {
            const double shifted = i == j ? a[i][j] + shift : a[i][j];
            a[i][j] = some ? shifted / divisor : (i == j ? 0.25 : 0.0);
        }
    for (int round = 0; round < ROUNDS; ++round) {
        for (int squaring = 0; squaring < SQUARINGS; ++squaring) {
            double b[4][4];
            for (int i = 0; i < 4; ++i)
                for (int j = 0; j < 4; ++j)
                    b[i][j] = a[i][0] * a[0][j] + a[i][1] * a[1][j] + a[i][2] * a[2][j] + a[i][3] * a[3][j];
            std::memcpy(a, b, sizeof(a));
        }
        const double trace = a[0][0] + a[1][1] + a[2][2] + a[3][3];
        for (int i = 0; i < 4; ++i)
            for (int j = 0; j < 4; ++j) a[i][j] = a[i][j] / trace;
    }
    int most = 0;
    for (int i = 1; i < 4; ++i)
        if (a[i][i] > a[most][most]) most = i;
    const double* q = a[most];
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    const double twice = 2.0 / (w * w + x * x + y * y + z * z);
    rotation[0] = 1.0 - twice * (y * y + z * z);
    rotation[1] = twice * (x * y - w * z);
    rotation[2] = twice * (x * z + w * y);
    rotation[3] = twice * (x * y + w * z);
    rotation[4] = 1.0 - twice * (x * x + z * z);
    rotation[5] = twice * (y * z - w * x);
    rotation[6] = twice * (x * z - w * y);
    rotation[7] = twice * (y * z + w * x);
    rotation[8] = 1.0 - twice * (x * x + y * y);
}

// Equals `best_translation`: target_mean - rotation source_mean.
inline void best_translation(const double* rotation, const double* source_mean, const double* target_mean, double* t) {
    for (int i = 0; i < 3; ++i)
        t[i] = target_mean[i] - turned(rotation, i, source_mean[0], source_mean[1], source_mean[2]);
}

}  // namespace torchreg
