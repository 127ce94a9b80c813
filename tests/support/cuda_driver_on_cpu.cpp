// CUDA's driver with a GPU of one thread at a time, for tests: its memory is not the process's own, and a launch runs
// the kernels of native/cuda/kernels.cu, compiled by the C++ compiler.
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <sys/mman.h>
#include <tuple>
#include <vector>

#define __global__
#define __launch_bounds__(...)
#define __grid_constant__
struct Dimensions {
    unsigned x = 0, y = 0, z = 0;
};
static thread_local Dimensions gridDim, blockIdx, blockDim, threadIdx;
template <class T> T atomicAdd(T *to, T value) {
    const T before = *to;
    *to += value;
    return before;
}
#include "../../native/cuda/kernels.cu"

namespace {

constexpr size_t SIZE = size_t(1) << 32;
char *const arena = static_cast<char *>(
    mmap(nullptr, SIZE, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0));
std::map<char *, size_t> allocated;
std::mutex mutex;
size_t used = 0, limit = SIZE;

// Memory of the GPU can be read and written only meanwhile: elsewhere its pointers are another machine's.
struct Opened {
    std::lock_guard<std::mutex> lock{mutex};
    Opened() { mprotect(arena, SIZE, PROT_READ | PROT_WRITE); }
    ~Opened() { mprotect(arena, SIZE, PROT_NONE); }
};

bool is_allocated(const void *at, size_t size) {
    const char *p = static_cast<const char *>(at);
    auto next = allocated.upper_bound(const_cast<char *>(p));
    if (next == allocated.begin()) return false;
    --next;
    return p + size <= next->first + next->second;
}

// Whether eight bytes are a pointer to the process's own memory.
bool is_foreign(const char *at) {
    uint64_t value;
    std::memcpy(&value, at, sizeof value);
    char *p = reinterpret_cast<char *>(value);
    if (value < 0x550000000000 || value >= 0x800000000000 || (p >= arena && p < arena + SIZE)) return false;
    return msync(p - value % 4096, 4096, MS_ASYNC) == 0; // not numbers that look like one
}

// What was launched and copied: done as late as a driver may, when the host waits. The one stream's work is first, and copies
// of the other, which must have waited for the launches, are last.
std::vector<std::function<int()>> launched, copied;
size_t launch_count = 0, launches_before_event = 0, launches_waited_for = 0;

int wait() {
    int fault = 0;
    for (auto *queue : {&launched, &copied}) {
        for (const auto &work : *queue)
            if (const int code = work(); code && !fault) fault = code;
        queue->clear();
    }
    return fault;
}

// A kernel with copies of the arguments that a launch points to. Those of training have torch's tensors, which are the CPU's
// here, and run at once.
using Call = std::function<std::function<void()>(void **)>;
struct Kernel {
    Call call;
    size_t first_size; // of the first argument, which has the longest structure
    bool of_torch = false;
};
template <class... Arguments, size_t... At>
Call call_of(void (*function)(Arguments...), std::index_sequence<At...>) {
    return [function](void **of) {
        const auto copies = std::make_tuple(*static_cast<std::decay_t<Arguments> *>(of[At])...);
        return [function, copies] { std::apply(function, copies); };
    };
}
template <class... Arguments> Kernel kernel_of(void (*function)(Arguments...), bool of_torch = false) {
    using First = std::tuple_element_t<0, std::tuple<std::decay_t<Arguments>...>>;
    return {call_of(function, std::index_sequence_for<Arguments...>()), sizeof(First), of_torch};
}
std::map<std::string, Kernel> kernels = {
    {"unisim_trace_rays", kernel_of(unisim_trace_rays)},       {"unisim_decode_beams", kernel_of(unisim_decode_beams)},
    {"unisim_begin_image", kernel_of(unisim_begin_image)},     {"unisim_begin_sweep", kernel_of(unisim_begin_sweep)},
    {"unisim_collect_pixels", kernel_of(unisim_collect_pixels)}, {"unisim_finish_pixels", kernel_of(unisim_finish_pixels)},
    {"unisim_judge_blocks", kernel_of(unisim_judge_blocks)},   {"unisim_fill_pixels", kernel_of(unisim_fill_pixels)},
#define OF_TORCH(name) {#name, kernel_of(name, true)}
    OF_TORCH(unisim_encode), OF_TORCH(unisim_encode_table_gradient), OF_TORCH(unisim_encode_point_gradient),
    OF_TORCH(unisim_field), OF_TORCH(unisim_intervals), OF_TORCH(unisim_interval_gradients), OF_TORCH(unisim_weigh),
    OF_TORCH(unisim_sum_features), OF_TORCH(unisim_weight_gradients), OF_TORCH(unisim_gather_gradients),
    OF_TORCH(unisim_feature_gradients), OF_TORCH(unisim_propose_places),
};

} // namespace

#define EXPORT extern "C" __attribute__((visibility("default")))

EXPORT void limit_memory(size_t bytes) { limit = bytes; }
EXPORT size_t memory_in_use() { return used; }
std::map<std::string, int> launches;
EXPORT int launches_of(const char *kernel) { return launches[kernel]; }
EXPORT size_t size_of_encoded_points() { return sizeof(EncodedPoints); }
EXPORT size_t size_of_gathered_segments() { return sizeof(GatheredSegments); }
EXPORT size_t size_of_voxel_rays() { return sizeof(VoxelRays); }
EXPORT size_t size_of_inputs() { return sizeof(TraceInputs); }
EXPORT size_t size_of_image() { return sizeof(ImageInputs); }
EXPORT size_t size_of_sweep() { return sizeof(SweepInputs); }
EXPORT int cuInit(unsigned) { return 0; }
int devices = 1;
EXPORT void have_devices(int count) { devices = count; }
EXPORT int cuDeviceGetCount(int *count) { return *count = devices, 0; }
EXPORT int cuDeviceGet(int *device, int number) { return *device = number, number < devices ? 0 : 101; }
EXPORT int cuDeviceGetName(char *name, int size, int) { return std::snprintf(name, size, "a CPU"), 0; }
EXPORT int cuDevicePrimaryCtxRetain(void **context, int) { return *context = &allocated, 0; }
EXPORT int cuCtxSetCurrent(void *context) { return context == &allocated ? 0 : 201; }
EXPORT int cuStreamCreate(void **stream, unsigned) { return *stream = &copied, 0; }
EXPORT int cuEventCreate(void **event, unsigned) { return *event = new char, 0; }
EXPORT int cuEventRecord(void *, void *stream) {
    if (!stream) launches_before_event = launch_count;
    return 0;
}
EXPORT int cuStreamWaitEvent(void *, void *, unsigned) { return launches_waited_for = launches_before_event, 0; }
EXPORT int cuEventSynchronize(void *) { return wait(); }
// Machine code of another GPU, of which the driver says so: data that begins with "of another GPU".
EXPORT int cuModuleLoadData(void **module, const void *data) {
    *module = &mutex;
    return std::strncmp(static_cast<const char *>(data), "of another GPU", 14) ? 0 : 209;
}
EXPORT int cuDeviceGetAttribute(int *value, int attribute, int) { return *value = attribute == 75 ? 9 : 0, 0; }
EXPORT int cuModuleGetFunction(void **function, void *, const char *name) {
    const auto kernel = kernels.find(name);
    if (kernel == kernels.end()) return 500;
    *function = &*kernel;
    return 0;
}
EXPORT int cuGetErrorString(int code, const char **text) {
    *text = code == 2 ? "out of memory" : code == 209   ? "no kernel image is available"
            : code == 700 ? "an illegal memory access"
                          : "another error";
    return 0;
}
EXPORT int cuMemGetInfo_v2(size_t *free, size_t *total) { return *free = limit - used, *total = limit, 0; }
EXPORT int cuMemAlloc_v2(void **address, size_t size) {
    const Opened opened;
    if (used + size > limit) return 2;
    char *at = arena;
    for (const auto &[begin, length] : allocated) {
        if (static_cast<size_t>(begin - at) >= size + 256) break;
        at = begin + (length + 255) / 256 * 256;
    }
    if (at + size > arena + SIZE) return 2;
    allocated[at] = size;
    std::memset(at, 0xff, size); // nothing that a kernel may use
    used += size;
    *address = at;
    return 0;
}
EXPORT int cuMemFree_v2(void *address) {
    wait();
    const std::lock_guard<std::mutex> lock(mutex);
    const auto at = allocated.find(static_cast<char *>(address));
    if (at == allocated.end()) return 1;
    used -= at->second;
    allocated.erase(at);
    return 0;
}
static int copy(void *to, const void *from, size_t size, const void *on_gpu) {
    const Opened opened;
    if (!is_allocated(on_gpu, size)) return 700;
    std::memcpy(to, from, size);
    return 0;
}
// Pointers of the process's own memory in what is uploaded would be the GPU's fault.
static int upload(void *to, const void *from, size_t size) {
    for (size_t i = 0; i + 8 <= size; i += 8)
        if (is_foreign(static_cast<const char *>(from) + i)) return 700;
    return copy(to, from, size, to);
}
EXPORT int cuMemcpyHtoD_v2(void *to, const void *from, size_t size) {
    const int fault = wait();
    return fault ? fault : upload(to, from, size);
}
EXPORT int cuMemcpyDtoH_v2(void *to, const void *from, size_t size) {
    const int fault = wait();
    return fault ? fault : copy(to, from, size, from);
}
EXPORT int cuMemcpyHtoDAsync_v2(void *to, const void *from, size_t size, void *) {
    launched.push_back([=] { return upload(to, from, size); });
    return 0;
}
EXPORT int cuMemcpyDtoHAsync_v2(void *to, const void *from, size_t size, void *stream) {
    if (stream != &copied || launches_waited_for < launch_count) return 700;
    copied.push_back([=] { return copy(to, from, size, from); });
    return 0;
}
EXPORT int cuMemAllocHost_v2(void **address, size_t size) { return *address = std::malloc(size), 0; }
EXPORT int cuMemsetD8_v2(void *to, unsigned char value, size_t size) {
    launched.push_back([=] {
        const Opened opened;
        if (!is_allocated(to, size)) return 700;
        std::memset(to, value, size);
        return 0;
    });
    return 0;
}
EXPORT int cuLaunchKernel(void *function, unsigned blocks, unsigned, unsigned, unsigned threads, unsigned, unsigned,
                          unsigned, void *, void **arguments, void **) {
    const auto &[name, kernel] = *static_cast<decltype(kernels)::value_type *>(function);
    ++launches[name];
    ++launch_count;
    const bool of_torch = kernel.of_torch;
    launched.push_back([=, run = kernel.call(arguments),
                        inputs = std::vector<char>(static_cast<char *>(arguments[0]),
                                                   static_cast<char *>(arguments[0]) +
                                                       (of_torch ? 0 : kernel.first_size))] {
        const Opened opened;
        // pointers of the process's own memory would be the GPU's fault
        for (size_t i = 0; i + 8 <= inputs.size(); i += 8)
            if (is_foreign(inputs.data() + i)) return 700;
        gridDim.x = blocks;
        blockDim.x = threads;
        for (blockIdx.x = 0; blockIdx.x < blocks; ++blockIdx.x)
            for (threadIdx.x = 0; threadIdx.x < threads; ++threadIdx.x) run();
        return 0;
    });
    if (of_torch) return wait();
    return 0;
}
