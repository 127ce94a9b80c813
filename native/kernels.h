// The list of all kernels: return type, name, parameters, arguments. `variant.h` declares them for the instruction
// set that a file is compiled for, `dispatch.cpp` for all instruction sets. Each kernel is documented where it is
// defined.
#pragma once
#include "unisim_native.h"

// clang-format off
#define UNISIM_KERNELS(KERNEL) \
    KERNEL(int, encode_forward, \
        (const unisim_grid *g, const float *x, const int32_t *grid, int64_t n, const float *table, float *out, \
         int threads), \
        (g, x, grid, n, table, out, threads)) \
    KERNEL(int, encode_backward_table, \
        (const unisim_grid *g, const float *x, const int32_t *grid, int64_t n, const float *grad_out, \
         float *grad_table, int threads), \
        (g, x, grid, n, grad_out, grad_table, threads)) \
    KERNEL(int, encode_backward_input, \
        (const unisim_grid *g, const float *x, const int32_t *grid, int64_t n, const float *table, \
         const float *grad_out, float *grad_x, int threads), \
        (g, x, grid, n, table, grad_out, grad_x, threads)) \
    KERNEL(int, propose, \
        (const float *origins, const float *directions, const float *t_near, const float *t_far, int64_t n, \
         const uint8_t *voxels, const int32_t *shape, const float *lower, const float *voxel_m, float step, \
         float decay, const float *u, int count, float *t, float *mass, int threads), \
        (origins, directions, t_near, t_far, n, voxels, shape, lower, voxel_m, step, decay, u, count, t, mass, \
         threads)) \
    KERNEL(int, refine, \
        (const float *u, const float *t, const float *s, int64_t n, int k, float beta, float uniform, \
         const float *jitter, int count, float *out, int threads), \
        (u, t, s, n, k, beta, uniform, jitter, count, out, threads)) \
    KERNEL(int, place_static, \
        (const unisim_scene *scene, const float *origins, const float *directions, const float *t_near, \
         const float *t_far, int64_t n, const int64_t *box_ray, const float *box_near, const float *box_far, \
         int64_t boxes, const float *u, int proposals, float uniform, const float *jitter, int count, float *t, \
         float *mass, int threads), \
        (scene, origins, directions, t_near, t_far, n, box_ray, box_near, box_far, boxes, u, proposals, uniform, \
         jitter, count, t, mass, threads)) \
    KERNEL(int, place_background, \
        (const unisim_scene *scene, const float *origins, const float *directions, const float *t0, int64_t n, \
         const float *u, int proposals, const float *within, int count, float *place, float *width, int threads), \
        (scene, origins, directions, t0, n, u, proposals, within, count, place, width, threads)) \
    KERNEL(int, mlp_forward, \
        (const unisim_mlp *net, const float *x, int64_t n, float *out, int threads), \
        (net, x, n, out, threads)) \
    KERNEL(int, mlp_backward, \
        (const unisim_mlp *net, const float *x, int64_t n, const float *grad_out, float *grad_x, float *grad_w1, \
         float *grad_w2, float *grad_bias, int threads), \
        (net, x, n, grad_out, grad_x, grad_w1, grad_w2, grad_bias, threads)) \
    KERNEL(int, field_forward, \
        (const unisim_grid *g, const float *x, const int32_t *grid, int64_t n, const float *table, \
         const unisim_mlp *net, float *out, int threads), \
        (g, x, grid, n, table, net, out, threads)) \
    KERNEL(int, adam, \
        (const unisim_adam_part *parts, int count, float beta1, float beta2, int threads), \
        (parts, count, beta1, beta2, threads)) \
    KERNEL(int, near_spheres, \
        (const float *origins, const float *directions, const int64_t *bin, int64_t n, const float *centres, \
         const float *radii, int64_t boxes, uint8_t *near, int threads), \
        (origins, directions, bin, n, centres, radii, boxes, near, threads)) \
    KERNEL(int, intervals_forward, \
        (const float *s, int64_t n, int k, float beta, float *tau, float *stop_fraction, \
         int threads), \
        (s, n, k, beta, tau, stop_fraction, threads)) \
    KERNEL(int, intervals_backward, \
        (const float *s, int64_t n, int k, float beta, const float *grad_tau, const float *grad_stop_fraction, \
         float *grad_s, float *grad_beta, int threads), \
        (s, n, k, beta, grad_tau, grad_stop_fraction, grad_s, grad_beta, threads)) \
    KERNEL(int, transmittances_forward, \
        (const unisim_ray_segments *groups, int count, int64_t rays, float *const *before, int threads), \
        (groups, count, rays, before, threads)) \
    KERNEL(int, transmittances_backward, \
        (const unisim_ray_segments *groups, int count, int64_t rays, const float *const *before, \
         const float *const *grad_before, float *const *grad_tau, int threads), \
        (groups, count, rays, before, grad_before, grad_tau, threads)) \
    KERNEL(int, gather_forward, \
        (const unisim_ray_segments *g, const float *before, const float *features, int64_t stride, int length, \
         float *interval, float *weight, float *sums, int threads), \
        (g, before, features, stride, length, interval, weight, sums, threads)) \
    KERNEL(int, gather_backward, \
        (const unisim_ray_segments *g, const float *before, const float *features, int64_t stride, int length, \
         const float *weight, const float *grad_interval, const float *grad_weight, const float *grad_sums, \
         float *grad_tau, float *grad_stop_fraction, float *grad_before, float *grad_features, int threads), \
        (g, before, features, stride, length, weight, grad_interval, grad_weight, grad_sums, grad_tau, \
         grad_stop_fraction, grad_before, grad_features, threads)) \
    KERNEL(int, trace, \
        (const unisim_scene *scene, const unisim_active_actors *active, const unisim_rays *rays, \
         const unisim_mesh_hits *meshes, const unisim_sampling *sampling, const unisim_trace_result *result, \
         int threads), \
        (scene, active, rays, meshes, sampling, result, threads)) \
    KERNEL(int, march, \
        (const unisim_scene *scene, int32_t in_box, const float *origins, const float *directions, const float *spans, \
         const float *cleared, const float *depth_before, int64_t n, const unisim_sampling *sampling, \
         unisim_distance distance, int32_t capacity, float *t, float *s, int32_t *counts), \
        (scene, in_box, origins, directions, spans, cleared, depth_before, n, sampling, distance, capacity, t, s, \
         counts)) \
    KERNEL(int, cells, \
        (const unisim_scene *scene, const int64_t *voxels, int64_t n, uint16_t *kinds, int threads), \
        (scene, voxels, n, kinds, threads)) \
    KERNEL(int, box_cells, \
        (const unisim_scene *scene, const float *sizes, int32_t actors, uint8_t *kinds, int threads), \
        (scene, sizes, actors, kinds, threads)) \
    KERNEL(int, clearance, (const uint8_t *voxels, const int32_t *shape, uint8_t *out), (voxels, shape, out)) \
    KERNEL(int, first_marked, \
        (const double *origins, const double *directions, int64_t n, double near, const double *size, \
         const uint8_t *clearance, const int32_t *shape, double voxel_m, float *out, int threads), \
        (origins, directions, n, near, size, clearance, shape, voxel_m, out, threads)) \
    KERNEL(int32_t, bvh_build, \
        (const float *vertices, const int32_t *faces, int32_t n, unisim_bvh_node *nodes, int32_t *order), \
        (vertices, faces, n, nodes, order)) \
    KERNEL(int, bvh_first_hits, \
        (const unisim_bvh_node *nodes, const int32_t *order, const float *vertices, const int32_t *faces, \
         const double *origins, const double *directions, int64_t n, double near, double *t, int32_t *face, float *uv, \
         int threads), \
        (nodes, order, vertices, faces, origins, directions, n, near, t, face, uv, threads)) \
    KERNEL(int, local_planes, \
        (const float *points, const int64_t *keys, const int64_t *starts, int64_t cells, const double *low, \
         const int64_t *dims, double radius, int32_t capacity, const float *queries, int64_t m, int32_t *count, \
         float *normal, float *height, float *rough, float *reach, int threads), \
        (points, keys, starts, cells, low, dims, radius, capacity, queries, m, count, normal, height, rough, reach, \
         threads)) \
    KERNEL(int, head_forward, \
        (const unisim_head *head, const float *feature, const float *directions, const float *extra, int64_t n, \
         float *out, int threads), \
        (head, feature, directions, extra, n, out, threads)) \
    KERNEL(int, blocks_differ, \
        (const unisim_plane *planes, int32_t count, const int64_t *blocks, int64_t n, int64_t width, int32_t size, \
         const unisim_block_tolerance *tolerance, uint8_t *verdict, int threads), \
        (planes, count, blocks, n, width, size, tolerance, verdict, threads)) \
    KERNEL(int, blocks_predicted, \
        (const unisim_plane *planes, int32_t count, const int64_t *blocks, int64_t n, int64_t width, int32_t size, \
         const unisim_block_tolerance *tolerance, uint8_t *alike, int threads), \
        (planes, count, blocks, n, width, size, tolerance, alike, threads)) \
    KERNEL(int, blocks_fill, \
        (const unisim_plane *planes, int32_t count, const int64_t *blocks, int64_t n, int64_t width, int32_t size, \
         const uint8_t *known, int threads), \
        (planes, count, blocks, n, width, size, known, threads)) \
    KERNEL(int, has_half, (), ()) \
    KERNEL(int, decode_image, \
        (const unisim_head *head, const unisim_layer *layers, int count, int up, const float *features, \
         const float *directions, int height, int width, float *rgb, int half, int threads), \
        (head, layers, count, up, features, directions, height, width, rgb, half, threads))
// clang-format on
