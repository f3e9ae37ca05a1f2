// Sums of K rows at once in 64 lanes, in the order of torchreg/geometry/numerics/lanes.py.
#pragma once

#include "common.hpp"

namespace torchreg {

class Lanes {
   public:
    explicit Lanes(int64_t rows) : rows_(rows), sums_(COUNT * rows) {}

    void clear() { std::fill(sums_.begin(), sums_.end(), 0.0); }

    // The K sums of the lane of a place, to be added to.
    double* at(int64_t place) { return sums_.data() + (place % COUNT) * rows_; }

    // Fold the lanes; the K totals stay until the next `clear`.
    const double* fold() {
        for (int64_t width = COUNT / 2; width > 0; width /= 2) {
            double* lower = sums_.data();
            const double* upper = lower + width * rows_;
            for (int64_t i = 0; i < width * rows_; ++i) lower[i] += upper[i];
        }
        return sums_.data();
    }

   private:
    static constexpr int64_t COUNT = 64;
    int64_t rows_;
    std::vector<double> sums_;
};

}  // namespace torchreg
