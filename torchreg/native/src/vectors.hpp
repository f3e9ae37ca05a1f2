// Vectors of the processor at hand, for bounds alone: products may be fused, which allows for either rounding.
#pragma once

#include "common.hpp"

#if defined(__GNUC__) && !defined(__clang__) && defined(__AVX2__) && !defined(__FMA__)
#pragma GCC target("fma")  // every processor with AVX2 that torch takes for such has it
#endif
#if defined(__AVX2__)
#include <immintrin.h>
#endif

namespace torchreg {
namespace {

// As many floats as fit; TALL such vectors side by side stay in registers.
#if defined(__AVX512F__)
constexpr int64_t WIDTH = 16, TALL = 12;
struct Floats {
    __m512 of;
    static Floats load(const float* from) { return {_mm512_loadu_ps(from)}; }
    static Floats all(float value) { return {_mm512_set1_ps(value)}; }
    void store(float* to) const { _mm512_storeu_ps(to, of); }
    Floats plus(Floats other) const { return {_mm512_add_ps(of, other.of)}; }
    Floats plus_product(Floats a, Floats b) const { return {_mm512_fmadd_ps(a.of, b.of, of)}; }
    Floats least(Floats other) const { return {_mm512_min_ps(of, other.of)}; }
    uint32_t within(Floats limit) const { return _mm512_cmp_ps_mask(of, limit.of, _CMP_LE_OQ); }
};
#elif defined(__AVX2__)
constexpr int64_t WIDTH = 8, TALL = 6;
struct Floats {
    __m256 of;
    static Floats load(const float* from) { return {_mm256_loadu_ps(from)}; }
    static Floats all(float value) { return {_mm256_set1_ps(value)}; }
    void store(float* to) const { _mm256_storeu_ps(to, of); }
    Floats plus(Floats other) const { return {_mm256_add_ps(of, other.of)}; }
#if defined(__FMA__) || defined(_MSC_VER)
    Floats plus_product(Floats a, Floats b) const { return {_mm256_fmadd_ps(a.of, b.of, of)}; }
#else
    Floats plus_product(Floats a, Floats b) const { return {_mm256_add_ps(_mm256_mul_ps(a.of, b.of), of)}; }
#endif
    Floats least(Floats other) const { return {_mm256_min_ps(of, other.of)}; }
    uint32_t within(Floats limit) const { return _mm256_movemask_ps(_mm256_cmp_ps(of, limit.of, _CMP_LE_OQ)); }
};
#else
constexpr int64_t WIDTH = 4, TALL = 4;
struct Floats {
    float of[WIDTH];
    template <typename Operation>
    static Floats each(Operation operation) {
        Floats result;
        for (int64_t lane = 0; lane < WIDTH; ++lane) result.of[lane] = operation(lane);
        return result;
    }
    static Floats load(const float* from) {
        return each([&](int64_t lane) { return from[lane]; });
    }
    static Floats all(float value) {
        return each([&](int64_t) { return value; });
    }
    void store(float* to) const { std::copy(of, of + WIDTH, to); }
    Floats plus(Floats other) const {
        return each([&](int64_t lane) { return of[lane] + other.of[lane]; });
    }
    Floats plus_product(Floats a, Floats b) const {
        return each([&](int64_t lane) { return of[lane] + a.of[lane] * b.of[lane]; });
    }
    Floats least(Floats other) const {
        return each([&](int64_t lane) { return of[lane] < other.of[lane] ? of[lane] : other.of[lane]; });
    }
    uint32_t within(Floats limit) const {
        uint32_t bits = 0;
        for (int64_t lane = 0; lane < WIDTH; ++lane) bits |= uint32_t(of[lane] <= limit.of[lane]) << lane;
        return bits;
    }
};
#endif

// Eight doubles.
#if defined(__AVX512F__)
struct Eight {
    __m512d of;
    static Eight zero() { return {_mm512_setzero_pd()}; }
    static Eight load(const double* from) { return {_mm512_loadu_pd(from)}; }
    static Eight load(const float* from) { return {_mm512_cvtps_pd(_mm256_loadu_ps(from))}; }
    Eight minus(Eight other) const { return {_mm512_sub_pd(of, other.of)}; }
    Eight plus(Eight other) const { return {_mm512_add_pd(of, other.of)}; }
    Eight plus_square(Eight a) const { return {_mm512_fmadd_pd(a.of, a.of, of)}; }
    Eight plus_product(double a, Eight b) const { return {_mm512_fmadd_pd(_mm512_set1_pd(a), b.of, of)}; }
    void store(double* to) const { _mm512_storeu_pd(to, of); }
};
#elif defined(__AVX2__)
struct Eight {
    __m256d low, high;
    static Eight zero() { return {_mm256_setzero_pd(), _mm256_setzero_pd()}; }
    static Eight load(const double* from) { return {_mm256_loadu_pd(from), _mm256_loadu_pd(from + 4)}; }
    static Eight load(const float* from) {
        return {_mm256_cvtps_pd(_mm_loadu_ps(from)), _mm256_cvtps_pd(_mm_loadu_ps(from + 4))};
    }
    Eight minus(Eight b) const { return {_mm256_sub_pd(low, b.low), _mm256_sub_pd(high, b.high)}; }
    Eight plus(Eight b) const { return {_mm256_add_pd(low, b.low), _mm256_add_pd(high, b.high)}; }
    Eight plus_square(Eight a) const {
        return plus({_mm256_mul_pd(a.low, a.low), _mm256_mul_pd(a.high, a.high)});
    }
    Eight plus_product(double a, Eight b) const {
        const __m256d factor = _mm256_set1_pd(a);
        return plus({_mm256_mul_pd(factor, b.low), _mm256_mul_pd(factor, b.high)});
    }
    void store(double* to) const {
        _mm256_storeu_pd(to, low);
        _mm256_storeu_pd(to + 4, high);
    }
};
#else
struct Eight {
    double of[8];
    template <typename Operation>
    static Eight each(Operation operation) {
        Eight result;
        for (int64_t lane = 0; lane < 8; ++lane) result.of[lane] = operation(lane);
        return result;
    }
    static Eight zero() {
        return each([](int64_t) { return 0.0; });
    }
    template <typename Real>
    static Eight load(const Real* from) {
        return each([&](int64_t lane) { return double(from[lane]); });
    }
    Eight minus(Eight other) const {
        return each([&](int64_t lane) { return of[lane] - other.of[lane]; });
    }
    Eight plus(Eight other) const {
        return each([&](int64_t lane) { return of[lane] + other.of[lane]; });
    }
    Eight plus_square(Eight a) const {
        return each([&](int64_t lane) { return of[lane] + a.of[lane] * a.of[lane]; });
    }
    Eight plus_product(double a, Eight b) const {
        return each([&](int64_t lane) { return of[lane] + a * b.of[lane]; });
    }
    void store(double* to) const { std::copy(of, of + 8, to); }
};
#endif

[[maybe_unused]] double total(Eight sums) {
    double of[8];
    sums.store(of);
    return ((of[0] + of[4]) + (of[1] + of[5])) + ((of[2] + of[6]) + (of[3] + of[7]));
}

}  // namespace
}  // namespace torchreg
