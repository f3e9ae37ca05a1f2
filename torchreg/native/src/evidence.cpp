// What poses show on clouds, pose by pose: torchreg/verification/evidence.py and the files that it takes terms from.
//
// R poses, of G pairs whose samples of at most L points stand side by side; sums over points are in 64 lanes.
#include "rigid.hpp"
#include "sums.hpp"

namespace torchreg {
namespace {

constexpr int64_t FEW = 8;  // poses that a thread takes at a time

// Places of a row with a partner: `square` below the limit.
inline void gather_close(const float* square, float limit, int64_t length, std::vector<int32_t>& close) {
    close.clear();
    for (int64_t i = 0; i < length; ++i)
        if (square[i] < limit) close.push_back(int32_t(i));
}

}  // namespace

// Equals `moved_points` of scans.py: points (3, G, L) of the pairs (R) int64, turned by rotation (R, 3, 3), shifted by
// translation (R, 3), all float32. Writes moved (3, R, L).
KERNEL(moved_points, const float* points, const int64_t* pair, const float* rotation, const float* translation,
                    float* moved, int64_t pairs, int64_t rows, int64_t length, int64_t threads) {
    parallel(threads, rows, 4 * FEW, [&](int64_t begin, int64_t end, int64_t) {
        for (int64_t r = begin; r < end; ++r) {
            const float *x = points + pair[r] * length, *y = x + pairs * length, *z = y + pairs * length;
            for (int i = 0; i < 3; ++i) {
                const float *R = rotation + 9 * r, shift = translation[3 * r + i];
                float* out = moved + (i * rows + r) * length;
                for (int64_t j = 0; j < length; ++j) out[j] = turned(R, i, x[j], y[j], z[j]) + shift;
            }
        }
    });
    return 0;
}

// Equals `visible_counts` of free_space.py, of points moved (3, R, L) float32, meters, where valid (R, L) bool.
//
// which (R) int64, the image of each row, -1 for none; slack (R) float32, meters; viewpoint (3, I), ranges and near (I)
// float32, seen bool, first and side (I) int64 of the images. Writes counts (2, R) int64: before a surface, and on one.
KERNEL(visible_counts, const float* moved, const uint8_t* valid, const int64_t* which, const float* slack,
                      const float* viewpoint, const float* ranges, const uint8_t* seen, const int64_t* first,
                      const int64_t* side, const float* near, int64_t* counts, int64_t images, int64_t rows,
                      int64_t length, int64_t threads) {
    parallel(threads, rows, FEW, [&](int64_t begin, int64_t end, int64_t) {
        std::vector<float> squares(length);
        std::vector<int32_t> cells(length);
        for (int64_t r = begin; r < end; ++r) {
            const int64_t image = which[r];
            counts[r] = counts[rows + r] = 0;
            if (image < 0) continue;
            const float *px = moved + r * length, *py = px + rows * length, *pz = py + rows * length;
            const float vx = viewpoint[image], vy = viewpoint[images + image], vz = viewpoint[2 * images + image];
            const int32_t width = int32_t(side[image]);
            const float half = float(width) / 2;
            for (int64_t i = 0; i < length; ++i) {
                const float rx = px[i] - vx, ry = py[i] - vy, rz = pz[i] - vz;
                squares[i] = rx * rx + ry * ry + rz * rz;
                const float sum = std::abs(rx) + std::abs(ry) + std::abs(rz), size = sum > 0 ? sum : 1;
                const float x = rx / size, y = ry / size, z = rz / size;
                const float folded_x = std::copysign(1 - std::abs(y), x + 0.0f);
                const float folded_y = std::copysign(1 - std::abs(x), y + 0.0f);
                const float u = (z >= 0 ? x : folded_x) + 1, v = (z >= 0 ? y : folded_y) + 1;
                // the comparisons first: what is no number lies in the first cell
                const float across = u > 0 ? u * half : 0, down = v > 0 ? v * half : 0;
                const int32_t column = std::min(int32_t(std::min(across, 1e6f)), width - 1);
                const int32_t line = std::min(int32_t(std::min(down, 1e6f)), width - 1);
                cells[i] = line * width + column;
            }
            const float *surfaces = ranges + first[image];
            const uint8_t *known = seen + first[image], *counted = valid + r * length;
            int64_t before = 0, on = 0;
            for (int64_t i = 0; i < length; ++i) {
                const float square = squares[i], surface = surfaces[cells[i]];
                const bool counts_here = counted[i] && known[cells[i]] && square >= near[image] * near[image];
                const float margin = slack[r] + 0.02f * surface;
                const float first_on = surface - margin, last_on = surface + 2 * margin;
                const bool is_before = first_on > 0 && square < first_on * first_on;
                before += counts_here && is_before;
                on += counts_here && !is_before && square <= last_on * last_on;
            }
            counts[r] = before;
            counts[rows + r] = on;
        }
    });
    return 0;
}

// Equals `_summed` of partner_terms.py.
//
// row (R, L) int64 and square (R, L) float32 as `Partners`, limit (R) float32, pair (R) int64, rotation (R, 3, 3)
// float32. Of the samples: normals (3, G, L) float32 and colors (3, G, L) float64, of all points of the other scans:
// (3, P) likewise; faced (G, L) and (P) bool. Normals or colors are null on both sides where they are not compared.
// Writes counts (R) int64 and sums (11, R) float64: closeness, cosines, and of every channel of color the products of
// both sides, the squares of the one and of the other, each about its mean.
KERNEL(partner_sums, const int64_t* row, const float* square, const float* limit, const int64_t* pair,
                    const float* rotation, const float* normals, const float* other_normals, const uint8_t* faced,
                    const uint8_t* other_faced, const double* colors, const double* other_colors, int64_t* counts,
                    double* sums, int64_t pairs, int64_t points, int64_t rows, int64_t length, int64_t threads) {
    parallel(threads, rows, FEW, [&](int64_t begin, int64_t end, int64_t) {
        std::vector<int32_t> close;
        close.reserve(length);
        SparseLanes first(8), second(9);
        for (int64_t r = begin; r < end; ++r) {
            const int64_t g = pair[r], *partner = row + r * length;
            gather_close(square + r * length, limit[r], length, close);
            counts[r] = int64_t(close.size());
            first.clear();
            for (const int32_t i : close) {
                double* sum = first.at(i);
                const int64_t k = partner[i];
                sum[0] += double(1 - square[r * length + i] / limit[r]);
                if (normals != nullptr) {
                    const float *R = rotation + 9 * r, *n = normals + g * length + i, *f = other_normals + k;
                    const float x = n[0], y = n[pairs * length], z = n[2 * pairs * length];
                    const float cosine = turned(R, 0, x, y, z) * f[0] + turned(R, 1, x, y, z) * f[points] +
                                         turned(R, 2, x, y, z) * f[2 * points];
                    sum[1] += double(faced[g * length + i] && other_faced[k] ? cosine : std::abs(cosine));
                }
                if (colors != nullptr) {
                    for (int c = 0; c < 3; ++c) {
                        sum[2 + c] += colors[(c * pairs + g) * length + i];
                        sum[5 + c] += other_colors[c * points + k];
                    }
                }
            }
            const double* totals = first.fold();
            sums[r] = totals[0];
            sums[rows + r] = totals[1];
            if (colors == nullptr) continue;
            const double count = std::max<double>(1, double(close.size()));
            double means[6];
            for (int c = 0; c < 6; ++c) means[c] = totals[2 + c] / count;
            second.clear();
            for (const int32_t i : close) {
                double* sum = second.at(i);
                for (int c = 0; c < 3; ++c) {
                    const double a = colors[(c * pairs + g) * length + i] - means[c];
                    const double b = other_colors[c * points + partner[i]] - means[3 + c];
                    sum[c] += a * b;
                    sum[3 + c] += a * a;
                    sum[6 + c] += b * b;
                }
            }
            totals = second.fold();
            for (int c = 0; c < 9; ++c) sums[(2 + c) * rows + r] = totals[c];
        }
    });
    return 0;
}

template <typename T>
int64_t moment_sums(const T* points, const float* normals, const uint8_t* valid, double* products, double* centers,
                      double* squares, int64_t rows, int64_t length, int64_t threads) {
    parallel(threads, rows, FEW, [&](int64_t begin, int64_t end, int64_t) {
        std::vector<int32_t> close;
        close.reserve(length);
        SparseLanes means(3), sums(22);
        const int64_t plane = rows * length;
        for (int64_t r = begin; r < end; ++r) {
            const T* p = points + r * length;
            const float* n = normals + r * length;
            close.clear();
            for (int64_t i = 0; i < length; ++i)
                if (valid[r * length + i]) close.push_back(int32_t(i));
            const double count = std::max<double>(1, double(close.size()));
            means.clear();
            for (const int32_t i : close)
                for (int axis = 0; axis < 3; ++axis) means.at(i)[axis] += double(p[axis * plane + i]);
            double center[3];
            const double* totals = means.fold();
            for (int axis = 0; axis < 3; ++axis) centers[axis * rows + r] = center[axis] = totals[axis] / count;
            sums.clear();
            for (const int32_t i : close) {
                const double x = double(p[i]) - center[0], y = double(p[plane + i]) - center[1];
                const double z = double(p[2 * plane + i]) - center[2];
                const double a = double(n[i]), b = double(n[plane + i]), c = double(n[2 * plane + i]);
                const double motion[6] = {y * c - z * b, z * a - x * c, x * b - y * a, a, b, c};
                double* sum = sums.at(i);
                for (int k = 0, at = 0; k < 6; ++k)
                    for (int l = k; l < 6; ++l, ++at) sum[at] += motion[l] * motion[k];
                sum[21] += x * x + y * y + z * z;
            }
            totals = sums.fold();
            for (int k = 0; k < 21; ++k) products[k * rows + r] = totals[k];
            squares[r] = totals[21];
        }
    });
    return 0;
}

// Equals `_moment_sums` of information.py, of points (3, R, L), meters, with normals (3, R, L) float32, where valid (R, L)
// bool. Writes products (21, R), centers (3, R) and squares (R), all float64.
KERNELS(moment_sums,
        (const Real* points, const float* normals, const uint8_t* valid, double* products, double* centers,
         double* squares, int64_t rows, int64_t length, int64_t threads),
        (points, normals, valid, products, centers, squares, rows, length, threads))

// Equals `_summed` of concordance.py.
//
// own (G, S, D) float32, features of every third point of the samples; other (P, D), of all points of the other scans;
// row (R, L), square (R, L), limit (R), pair (R) as in `partner_sums`. Writes counts (R) int64 and sums (4, R, D)
// float64: squared differences, squares of both, own and other, over the partners of every third point.
KERNEL(feature_sums, const float* own, const float* other, const int64_t* row, const float* square, const float* limit,
                    const int64_t* pair, int64_t* counts, double* sums, int64_t thin, int64_t stride, int64_t width,
                    int64_t rows, int64_t length, int64_t threads) {
    parallel(threads, rows, FEW, [&](int64_t begin, int64_t end, int64_t) {
        SparseLanes lanes(4 * width);
        for (int64_t r = begin; r < end; ++r) {
            lanes.clear();
            int64_t count = 0;
            for (int64_t j = 0, i = 0; i < length; ++j, i += stride) {
                if (!(square[r * length + i] < limit[r])) continue;
                ++count;
                const float *a = own + (pair[r] * thin + j) * width, *b = other + row[r * length + i] * width;
                double *apart = lanes.at(j), *both = apart + width, *one = both + width, *two = one + width;
                for (int64_t d = 0; d < width; ++d) {
                    const float difference = a[d] - b[d];
                    apart[d] += double(difference * difference);
                    both[d] += double(a[d] * a[d] + b[d] * b[d]);
                    one[d] += double(a[d]);
                    two[d] += double(b[d]);
                }
            }
            counts[r] = count;
            const double* totals = lanes.fold();
            for (int64_t k = 0; k < 4; ++k)
                std::copy(totals + k * width, totals + (k + 1) * width, sums + (k * rows + r) * width);
        }
    });
    return 0;
}

}  // namespace torchreg
