// Included by every kernel file: function names with the instruction set's suffix, and blocks of work distributed
// over threads.
#pragma once
#include "kernels.h"

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <thread>
#include <vector>

#ifndef UNISIM_VARIANT
#define UNISIM_VARIANT portable
#endif
#define UNISIM_JOIN_(a, b) a##_##b
#define UNISIM_JOIN(a, b) UNISIM_JOIN_(a, b)
#define UNISIM_NAME(name) UNISIM_JOIN(name, UNISIM_VARIANT)

#define UNISIM_DECLARED(type, name, parameters, arguments) extern "C" type UNISIM_NAME(unisim_##name) parameters;
UNISIM_KERNELS(UNISIM_DECLARED)

namespace {

// Runs body(begin, end) over [0, n) in blocks. make() returns one body for each thread, with its own memory. Results
// do not depend on which thread takes which block.
template <class Make> void parallel_bodies(int64_t n, int64_t block, int threads, const Make &make) {
    const int64_t blocks = (n + block - 1) / block;
    const int workers = static_cast<int>(std::min<int64_t>(threads, blocks));
    std::atomic<int64_t> next{0};
    const auto work = [&] {
        auto body = make();
        for (int64_t b = next++; b < blocks; b = next++) body(b * block, std::min(n, (b + 1) * block));
    };
    std::vector<std::thread> pool;
    for (int i = 1; i < workers; ++i) pool.emplace_back(work);
    work();
    for (auto &thread : pool) thread.join();
}

// The same with one body shared by all threads.
template <class Body> void parallel_blocks(int64_t n, int64_t block, int threads, const Body &body) {
    parallel_bodies(n, block, threads, [&] { return [&](int64_t begin, int64_t end) { body(begin, end); }; });
}

} // namespace
