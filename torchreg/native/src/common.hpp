// What all kernels share. Every kernel is a function of C that takes pointers to contiguous tensors, numbers as int64_t or
// double, and last the number of threads; it allocates its own working memory and returns an int64_t, not negative. What
// is thrown in it, by any thread, comes back as one of the `Refusal`s, as nothing may be thrown through C. It is named for
// what it writes, or for what it does as verb and noun, and beside it stands what it takes (shapes, units, dtypes) and
// which function in torch it equals.
//
//     KERNEL(name, const float* x, float* out, int64_t count, int64_t threads) { ...; return 0; }
//
// gives the library a variable `name` that points to the function.
//
// Bits: the library is compiled without contraction to fused multiply-adds and without reordering, so that + - * and /
// give what torch's elementwise operations give, in any lane and any thread. torch.sqrt does not everywhere: where torch
// takes roots from a vector library, about one in 150 is off by the last bit, and its addcmul fuses. So what both
// compute avoids roots, or takes them as x times rsqrt(x). A kernel adds in the order that the function in torch adds
// in, and a result never depends on which thread computed it.
#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <exception>
#include <limits>
#include <new>
#include <stdexcept>
#include <thread>
#include <vector>

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif

#define KERNEL(name, ...)                                                \
    static int64_t name##_body(__VA_ARGS__);                             \
    extern "C" {                                                         \
    EXPORTED auto* name = &::torchreg::Guarded<&name##_body>::call; \
    }                                                                    \
    static int64_t name##_body(__VA_ARGS__)

// A kernel for float and one for double, name_f32 and name_f64, from a template `name` over the type of its numbers, which
// the list of parameters calls Real: KERNELS(name, (const Real* x, int64_t n, int64_t threads), (x, n, threads)).
#define UNWRAPPED(...) __VA_ARGS__
#define KERNEL_OF(type, suffix, name, parameters, arguments)                                                          \
    namespace name##suffix##_types {                                                                                  \
    using Real = type;                                                                                                \
    KERNEL(name##suffix, UNWRAPPED parameters) { return torchreg::name<Real> arguments; }                             \
    }
#define KERNELS(name, parameters, arguments)                                                                          \
    KERNEL_OF(float, _f32, name, parameters, arguments)                                                               \
    KERNEL_OF(double, _f64, name, parameters, arguments)

namespace torchreg {

// What a kernel returns where it gave up; what it writes is then undefined. As in torchreg/native/library.py.
enum Refusal : int64_t {
    NO_MEMORY = std::numeric_limits<int64_t>::min(),
    OUT_OF_RANGE,  // an index beyond what it points into
    FAILED,
};

template <auto body>
struct Guarded;

template <typename... Arguments, int64_t (*body)(Arguments...)>
struct Guarded<body> {
    static int64_t call(Arguments... arguments) noexcept {
        try {
            return body(arguments...);
        } catch (const std::bad_alloc&) {
            return NO_MEMORY;
        } catch (const std::length_error&) {
            return NO_MEMORY;
        } catch (const std::out_of_range&) {
            return OUT_OF_RANGE;
        } catch (...) {
            return FAILED;
        }
    }
};

// Call body(begin, end, worker) for pieces of `grain` of 0..count. Threads take the next piece when they have done one,
// so that a thread whose core is busy with another program delays nothing. Threads live as long as the call: nothing
// is left behind for a process that forks. Where the system gives fewer threads, these do the work. What a body throws
// is thrown here, when no thread works any more.
template <typename Body>
void parallel(int64_t threads, int64_t count, int64_t grain, Body body) {
    grain = std::max<int64_t>(1, grain);
    const int64_t pieces = (count + grain - 1) / grain;
    const int64_t workers = std::max<int64_t>(1, std::min<int64_t>(threads, pieces));
    if (workers == 1) {
        for (int64_t begin = 0; begin < count; begin += grain) body(begin, std::min(begin + grain, count), int64_t(0));
        return;
    }
    std::atomic<int64_t> next{0};
    std::atomic_flag failed = ATOMIC_FLAG_INIT;
    std::exception_ptr failure;
    auto work = [&](int64_t worker) noexcept {
        try {
            for (int64_t piece = next.fetch_add(1); piece < pieces; piece = next.fetch_add(1))
                body(piece * grain, std::min((piece + 1) * grain, count), worker);
        } catch (...) {
            if (!failed.test_and_set()) failure = std::current_exception();
            next.store(pieces);  // the others stop, too
        }
    };
    std::vector<std::thread> others;
    others.reserve(workers - 1);
    try {
        for (int64_t worker = 1; worker < workers; ++worker) others.emplace_back(work, worker);
    } catch (const std::exception&) {  // no more threads, or no memory for one
    }
    work(0);
    for (auto& other : others) other.join();
    if (failure) std::rethrow_exception(failure);
}

}  // namespace torchreg
