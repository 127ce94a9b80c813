// Chooses the widest instruction set that this processor and this build both have. UNISIM_NATIVE_VARIANT names another.
#include "unisim_native.h"

#include <cstdlib>
#include <cstring>

#define DECLARE(variant)                                                                                                       \
    extern "C" int unisim_encode_forward_##variant(const unisim_grid *, const float *, const int32_t *, int64_t, const float *, \
                                                   float *, int);                                                              \
    extern "C" int unisim_encode_backward_table_##variant(const unisim_grid *, const float *, const int32_t *, int64_t,        \
                                                          const float *, float *, int);                                        \
    extern "C" int unisim_encode_backward_input_##variant(const unisim_grid *, const float *, const int32_t *, int64_t,        \
                                                          const float *, const float *, float *, int);                         \
    extern "C" int unisim_propose_##variant(const float *, const float *, const float *, const float *, int64_t,               \
                                            const uint8_t *, const int32_t *, const float *, const float *, float, float,      \
                                            const float *, int, float *, float *, int);                                        \
    extern "C" int unisim_mlp_forward_##variant(const unisim_mlp *, const float *, int64_t, float *, int);                     \
    extern "C" int unisim_mlp_backward_##variant(const unisim_mlp *, const float *, int64_t, const float *, float *, float *,  \
                                                 float *, float *, int);                                                       \
    extern "C" int32_t unisim_bvh_build_##variant(const float *, const int32_t *, int32_t, unisim_bvh_node *, int32_t *);      \
    extern "C" int unisim_bvh_first_hits_##variant(const unisim_bvh_node *, const int32_t *, const float *, const int32_t *,   \
                                                   const double *, const double *, int64_t, double, double *, int32_t *,       \
                                                   float *, int);                                                              \
    extern "C" int unisim_field_forward_##variant(const unisim_grid *, const float *, const int32_t *, int64_t, const float *, \
                                                  const unisim_mlp *, float *, int);

DECLARE(portable)
#ifdef UNISIM_HAS_AVX2
DECLARE(avx2)
#endif
#ifdef UNISIM_HAS_AVX512
DECLARE(avx512)
#endif

namespace {

struct Variant {
    const char *name;
    decltype(&unisim_encode_forward_portable) encode_forward;
    decltype(&unisim_encode_backward_table_portable) encode_backward_table;
    decltype(&unisim_encode_backward_input_portable) encode_backward_input;
    decltype(&unisim_propose_portable) propose;
    decltype(&unisim_mlp_forward_portable) mlp_forward;
    decltype(&unisim_mlp_backward_portable) mlp_backward;
    decltype(&unisim_bvh_build_portable) bvh_build;
    decltype(&unisim_bvh_first_hits_portable) bvh_first_hits;
    decltype(&unisim_field_forward_portable) field_forward;
};

#define VARIANT(v)                                                                                                             \
    Variant {                                                                                                                  \
        #v, unisim_encode_forward_##v, unisim_encode_backward_table_##v, unisim_encode_backward_input_##v, unisim_propose_##v, \
            unisim_mlp_forward_##v, unisim_mlp_backward_##v, unisim_bvh_build_##v, unisim_bvh_first_hits_##v,                  \
            unisim_field_forward_##v                                                                                           \
    }

Variant choose() {
    const char *wanted = std::getenv("UNISIM_NATIVE_VARIANT");
    const auto admits = [&](const char *name) { return !wanted || std::strcmp(wanted, name) == 0; };
    (void)admits;
#ifdef UNISIM_HAS_AVX512
    if (admits("avx512") && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl"))
        return VARIANT(avx512);
#endif
#ifdef UNISIM_HAS_AVX2
    if (admits("avx2") && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return VARIANT(avx2);
#endif
    return VARIANT(portable);
}

const Variant chosen = choose();

} // namespace

#if defined(_WIN32)
#define EXPORT extern "C" __declspec(dllexport)
#else
#define EXPORT extern "C" __attribute__((visibility("default")))
#endif

EXPORT int unisim_abi_version() { return 4; }

EXPORT const char *unisim_variant() { return chosen.name; }

EXPORT int unisim_encode_forward(const unisim_grid *g, const float *x, const int32_t *grid, int64_t n, const float *table,
                                 float *out, int threads) {
    return chosen.encode_forward(g, x, grid, n, table, out, threads);
}

EXPORT int unisim_encode_backward_table(const unisim_grid *g, const float *x, const int32_t *grid, int64_t n,
                                        const float *grad_out, float *grad_table, int threads) {
    return chosen.encode_backward_table(g, x, grid, n, grad_out, grad_table, threads);
}

EXPORT int unisim_encode_backward_input(const unisim_grid *g, const float *x, const int32_t *grid, int64_t n, const float *table,
                                        const float *grad_out, float *grad_x, int threads) {
    return chosen.encode_backward_input(g, x, grid, n, table, grad_out, grad_x, threads);
}

EXPORT int unisim_propose(const float *origins, const float *directions, const float *t_near, const float *t_far, int64_t n,
                          const uint8_t *voxels, const int32_t *shape, const float *lower, const float *voxel_m, float step,
                          float decay, const float *u, int count, float *t, float *mass, int threads) {
    return chosen.propose(origins, directions, t_near, t_far, n, voxels, shape, lower, voxel_m, step, decay, u, count, t, mass,
                          threads);
}

EXPORT int unisim_mlp_forward(const unisim_mlp *net, const float *x, int64_t n, float *out, int threads) {
    return chosen.mlp_forward(net, x, n, out, threads);
}

EXPORT int unisim_mlp_backward(const unisim_mlp *net, const float *x, int64_t n, const float *grad_out, float *grad_x,
                               float *grad_w1, float *grad_w2, float *grad_bias, int threads) {
    return chosen.mlp_backward(net, x, n, grad_out, grad_x, grad_w1, grad_w2, grad_bias, threads);
}

EXPORT int32_t unisim_bvh_build(const float *vertices, const int32_t *faces, int32_t n, unisim_bvh_node *nodes, int32_t *order) {
    return chosen.bvh_build(vertices, faces, n, nodes, order);
}

EXPORT int unisim_bvh_first_hits(const unisim_bvh_node *nodes, const int32_t *order, const float *vertices, const int32_t *faces,
                                 const double *origins, const double *directions, int64_t n, double near, double *t,
                                 int32_t *face, float *uv, int threads) {
    return chosen.bvh_first_hits(nodes, order, vertices, faces, origins, directions, n, near, t, face, uv, threads);
}

EXPORT int unisim_field_forward(const unisim_grid *g, const float *x, const int32_t *grid, int64_t n, const float *table,
                                const unisim_mlp *net, float *out, int threads) {
    return chosen.field_forward(g, x, grid, n, table, net, out, threads);
}
