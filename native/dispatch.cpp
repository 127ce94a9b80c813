// Chooses the widest instruction set that both this processor and this build support. UNISIM_NATIVE_VARIANT selects
// another one.
#include "kernels.h"

#include <cstdlib>
#include <cstring>

#define DECLARE_portable(type, name, parameters, arguments) extern "C" type unisim_##name##_portable parameters;
#define DECLARE_avx2(type, name, parameters, arguments) extern "C" type unisim_##name##_avx2 parameters;
#define DECLARE_avx512(type, name, parameters, arguments) extern "C" type unisim_##name##_avx512 parameters;
#define ENTRY_portable(type, name, parameters, arguments) unisim_##name##_portable,
#define ENTRY_avx2(type, name, parameters, arguments) unisim_##name##_avx2,
#define ENTRY_avx512(type, name, parameters, arguments) unisim_##name##_avx512,
#define MEMBER(type, name, parameters, arguments) type(*name) parameters;

UNISIM_KERNELS(DECLARE_portable)
#ifdef UNISIM_HAS_CUDA_ON_CPU
extern "C" decltype(unisim_trace_portable) unisim_trace_cuda_on_cpu;
#endif
#ifdef UNISIM_HAS_AVX2
UNISIM_KERNELS(DECLARE_avx2)
#endif
#ifdef UNISIM_HAS_AVX512
UNISIM_KERNELS(DECLARE_avx512)
#endif

namespace {

struct Variant {
    UNISIM_KERNELS(MEMBER)
    const char *variant;
};

Variant choose() {
    const char *wanted = std::getenv("UNISIM_NATIVE_VARIANT");
    const auto admits = [&](const char *name) { return !wanted || std::strcmp(wanted, name) == 0; };
    (void)admits;
#if defined(UNISIM_HAS_AVX2) || defined(UNISIM_HAS_AVX512)
    __builtin_cpu_init(); // this runs while the library is loaded, possibly before clang's runtime has called it
#endif
#ifdef UNISIM_HAS_CUDA_ON_CPU
    if (wanted && std::strcmp(wanted, "cuda_on_cpu") == 0) {
        Variant variant = {UNISIM_KERNELS(ENTRY_portable) "cuda_on_cpu"};
        variant.trace = unisim_trace_cuda_on_cpu;
        return variant;
    }
#endif
#ifdef UNISIM_HAS_AVX512
    if (admits("avx512") && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl"))
        return {UNISIM_KERNELS(ENTRY_avx512) "avx512"};
#endif
#ifdef UNISIM_HAS_AVX2
    if (admits("avx2") && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
        __builtin_cpu_supports("f16c"))
        return {UNISIM_KERNELS(ENTRY_avx2) "avx2"};
#endif
    return {UNISIM_KERNELS(ENTRY_portable) "portable"};
}

const Variant chosen = choose();

} // namespace

#if defined(_WIN32)
#define EXPORT extern "C" __declspec(dllexport)
#else
#define EXPORT extern "C" __attribute__((visibility("default")))
#endif
#define EXPORTED(type, name, parameters, arguments) \
    EXPORT type unisim_##name parameters { return chosen.name arguments; }

EXPORT int unisim_abi_version() { return 16; }

EXPORT const char *unisim_variant() { return chosen.variant; }

UNISIM_KERNELS(EXPORTED)
