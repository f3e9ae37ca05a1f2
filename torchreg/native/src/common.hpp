// What all kernels share. Every kernel is a C function that takes pointers to contiguous tensors, numbers as int64_t or
// double, and last the number of threads; it allocates its own working memory and returns an int64_t.
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
#include <limits>
#include <thread>
#include <vector>

#if defined(_WIN32)
#define KERNEL extern "C" __declspec(dllexport) int64_t
#else
#define KERNEL extern "C" __attribute__((visibility("default"))) int64_t
#endif

namespace torchreg {

// Call body(begin, end, worker) for pieces of `grain` of 0..count. Threads take the next piece when they have done one,
// so that a thread whose core is busy with another program delays nothing. Threads live as long as the call: nothing
// is left behind for a process that forks.
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
    auto work = [&](int64_t worker) {
        for (int64_t piece = next.fetch_add(1); piece < pieces; piece = next.fetch_add(1))
            body(piece * grain, std::min((piece + 1) * grain, count), worker);
    };
    std::vector<std::thread> others;
    others.reserve(workers - 1);
    for (int64_t worker = 1; worker < workers; ++worker) others.emplace_back(work, worker);
    work(0);
    for (auto& other : others) other.join();
}

}  // namespace torchreg
