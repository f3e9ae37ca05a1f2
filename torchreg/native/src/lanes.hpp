// Sums of K rows at once in 64 lanes, in the order of torchreg/geometry/numerics/lanes.py.
#pragma once

#include "common.hpp"

namespace torchreg {

// Only lanes that something was added to are cleared and folded: few of them where few places count.
class Lanes {
   public:
    explicit Lanes(int64_t rows) : rows_(rows), sums_(COUNT * rows) {}

    void clear() { used_ = 0; }

    // The K sums of the lane of a place, to be added to.
    double* at(int64_t place) {
        const int64_t lane = place % COUNT;
        double* sums = sums_.data() + lane * rows_;
        if (!(used_ >> lane & 1)) {
            used_ |= uint64_t(1) << lane;
            std::fill(sums, sums + rows_, 0.0);
        }
        return sums;
    }

    // Fold the lanes; the K totals stay until the next `clear`.
    const double* fold() {
        if (used_ == 0) std::fill(sums_.begin(), sums_.begin() + rows_, 0.0);
        for (int64_t width = COUNT / 2; width > 0; width /= 2) {
            for (int64_t lane = 0; lane < width; ++lane) {
                if (!(used_ >> (lane + width) & 1)) continue;
                double* lower = sums_.data() + lane * rows_;
                const double* upper = lower + width * rows_;
                if (used_ >> lane & 1)
                    for (int64_t i = 0; i < rows_; ++i) lower[i] += upper[i];
                else
                    std::copy(upper, upper + rows_, lower);
                used_ |= uint64_t(1) << lane;
            }
        }
        return sums_.data();
    }

   private:
    static constexpr int64_t COUNT = 64;
    int64_t rows_;
    uint64_t used_ = 0;
    std::vector<double> sums_;
};

}  // namespace torchreg
