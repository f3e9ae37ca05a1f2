// Eigenvalues and eigenvectors of symmetric 3x3 matrices.
#include "eigen.hpp"

namespace torchreg {

template <typename T>
int64_t symmetric_eigen(const T* matrix, int64_t count, T* values, T* vectors, int64_t threads) {
    parallel(threads, count, MATRICES, [&](int64_t begin, int64_t end, int64_t) {
        Matrices<T> a{};
        for (int64_t row = begin; row < end; ++row) {
            const T* m = matrix + 9 * row;
            const int64_t i = row - begin;
            a.xx[i] = m[0], a.xy[i] = m[1], a.xz[i] = m[2], a.yy[i] = m[4], a.yz[i] = m[5], a.zz[i] = m[8];
        }
        diagonalize(a);
        for (int64_t row = begin; row < end; ++row) {
            const int64_t i = row - begin;
            const T found[3] = {a.xx[i], a.yy[i], a.zz[i]};
            int64_t order[3];
            ascending(found, order);
            for (int64_t j = 0; j < 3; ++j) {
                values[3 * row + j] = found[order[j]];
                for (int64_t k = 0; k < 3; ++k) vectors[9 * row + 3 * k + j] = a.vectors[3 * k + order[j]][i];
            }
        }
    });
    return 0;
}

// Equals `symmetric_eigen` of geometry/eigen.py: matrices (N, 3, 3), of which the upper triangles are read.
//
// Writes values (N, 3), ascending, and vectors (N, 3, 3), as columns.
KERNELS(symmetric_eigen, (const Real* matrix, int64_t count, Real* values, Real* vectors, int64_t threads),
        (matrix, count, values, vectors, threads))

}  // namespace torchreg
