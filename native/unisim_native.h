// The C interface of the kernels. All arrays are contiguous and belong to the caller; no kernel keeps a pointer.
#pragma once
#include <cstdint>

// A multiresolution grid: `levels` tables, concatenated; several grids lie `grid_stride` rows apart.
// Vertex (i, j, k) of level l is row offset[l] + (i + j * stride_y[l] + k * stride_z[l]) where stride_y[l] != 0, else
// row offset[l] + (hash(i, j, k) & (size[l] - 1)), with the hash of Mueller et al., "Instant Neural Graphics
// Primitives", 2022.
struct unisim_grid {
    int32_t levels;
    int32_t features;
    int64_t grid_stride;
    const float *scale;        // (levels, 3): vertices along each axis of the unit cube, less one
    const int64_t *offset;     // (levels)
    const uint32_t *size;      // (levels)
    const uint32_t *stride_y;  // (levels)
    const uint32_t *stride_z;  // (levels)
};

// A perceptron of two layers: out = w2 relu(w1 x) + bias.
struct unisim_mlp {
    int32_t inputs;
    int32_t hidden;
    int32_t outputs;
    const float *w1;   // (hidden, inputs)
    const float *w2;   // (outputs, hidden)
    const float *bias; // (outputs)
};

// A box over triangles. `faces` > 0: a leaf that holds order[first .. first + faces); 0: its children are nodes first
// and first + 1.
struct unisim_bvh_node {
    float low[3];
    int32_t first;
    float high[3];
    int32_t faces;
};

// Ray segments of one field: ray (n); samples t, optical depths tau of the intervals, and stop fractions (n, width).
struct unisim_ray_segments {
    int64_t n;
    int32_t width;
    const int64_t *ray;
    const float *t;
    const float *tau;
    const float *stop_fraction;
};

// A convolution with replicated edges, `kernel` odd; a linear layer is one with a kernel of 1.
struct unisim_layer {
    int32_t inputs;
    int32_t outputs;
    int32_t kernel;
    const float *weight; // (outputs, inputs, kernel, kernel)
    const float *bias;   // (outputs), or null
};

// A perceptron whose inputs are `features` numbers, the 16 spherical harmonics of a direction and `extra_inputs` more
// numbers.
struct unisim_head {
    int32_t features;
    int32_t extra_inputs;
    int32_t count; // of layers
    const unisim_layer *layers;
};

// A hash grid and the network that decodes it. The table is float32, or float16 where `half` is set.
struct unisim_field {
    unisim_grid grid;
    const void *table;
    int32_t half;
    unisim_mlp net;
};

// A trained scene: three fields, occupancy, the ground, and the light on actors.
struct unisim_scene {
    unisim_field static_field;       // the static scene, inside the volume
    unisim_field background;         // the background model: everything outside the volume
    unisim_field actor_fields;       // one grid per actor, concatenated, and one network
    const double *volume_from_world; // (3, 4)
    float size[3];                   // of the volume, metres
    float background_radius_m;       // of the ball that the background's contraction leaves as it is
    float background_far_m;          // where the background's samples end
    float beta;                      // sharpness of the density, 1 / metres
    int32_t unisim_density;          // 0: logistic; 1: as in the paper
    float density_step_m;            // of the paper's density
    const uint8_t *voxels;           // (X, Y, Z) occupancy values, 0 is free
    const uint8_t *clearance;        // (X, Y, Z): distance in voxels to the nearest with a cell not open, or less
    const uint16_t *cells;           // (X, Y, Z): two bits for each of a voxel's eight cells (cells.h); null: unknown
    const uint8_t *box_cells;        // (rows of actor grids, 16, 16, 16): the cells of the actors' boxes
    int32_t voxel_shape[3];
    float voxel_m;
    float decay_per_m;
    const float *ground;             // (X, Y) heights, cells of ground_m
    int32_t ground_shape[2];
    float ground_m, ground_clearance_m;
    const unisim_mlp *light;         // null: an actor's appearance is the same everywhere
    const float *light_home;         // (rows of actor grids, 3): where actors were recorded, volume coordinates
    float light_reach_m;
    const unisim_head *sample_head;  // null: the view direction enters once per ray, in the decoders
};

// Boxes on trajectories, whose appearances come from one scene: actors, or copied boxes of static space.
struct unisim_actor_set {
    const unisim_scene *scene;
    int32_t count, keys;
    const double *times;             // (count, keys)
    const int32_t *lengths;          // (count): how many of the keys are in use
    const double *positions;         // (count, keys, 3), world frame
    const double *quaternions;       // (count, keys, 4), wxyz
    const float *sizes;              // (count, 3): of the boxes before scaling, in the metres of the scene's fields
    const double *start, *end;       // (count): when the box is there
    const int32_t *rows;             // (count): of the scene's actor grids, the first of an actor that has a gait
    const int32_t *candidates;       // (candidate_count): boxes that the rays of this call can hit
    int32_t candidate_count;
    const float *scales;             // (count, 3): factors of the boxes' sizes in the world, along their own axes
    const double *walked;            // (count, keys): metres of path up to each key
    const double *cycles;            // (count): metres of path in a cycle of the gait, 0 for an actor that has none
};

// The active actors of a state of the world, and its edits of static space.
struct unisim_active_actors {
    const unisim_actor_set *actor_sets;   // the scene's own actors first, then those of foreign scenes
    int32_t actor_set_count;
    const unisim_actor_set *copies;       // copied boxes of static space, null for none
    const double *world_from_source;      // (copies, 3, 4): the boxes that they are copies of
    int32_t removed_boxes;                // how many boxes of static space are removed
    const double *removed_box_from_world; // (removed_boxes, 3, 4)
    const float *removed_box_sizes;       // (removed_boxes, 3)
};

// Rays in the world frame, finite, with unit directions. `order` (n) is the order in which they are computed:
// neighbours together.
struct unisim_rays {
    int64_t n;
    const double *origins, *directions, *times;
    const int64_t *order;
    const float *starts; // (n): metres before which a ray does not hit the static field; null: no such bound
};

// Intersections of rays and meshes: ray (count) rising, distance, optical depth, unit normal, and the number of the
// mesh actor.
struct unisim_mesh_hits {
    int64_t count;
    const int64_t *ray;
    const float *t, *tau, *normals; // normals (count, 3), world frame
    const int32_t *actor;
};

struct unisim_sampling {
    int32_t proposals, samples, actor_proposals, actor_samples, background_proposals, background_samples;
    float near_m;
    float opaque;            // transmittance below which nothing is computed
    float background_opaque; // the same for the background, where it is larger
    int32_t background, sky; // whether these are rendered
    // The march along the signed distance; stride_m 0 places samples by quantiles instead.
    float stride_m;          // the longest step
    float step_growth_per_m; // growth of the longest step per metre of distance from the origin, relative
    float relaxation;        // how much longer than the distance a step may be, which falls by 1 / relaxation a metre
    float min_slope, min_step_m;
    int32_t splits;          // how often the interval that absorbs most is split
    float split_weight;      // only intervals of at least this weight are split
};

// One map of an image: values (h w, channels) of `bytes` per number. kind: 0 colours, 1 depths, 2 unit vectors, 3
// other numbers, all float; of any type, with `bytes` per pixel: 4 labels, 5 flags of pixels that may lie beside
// something thinner than a block, 6 values that are copied because all corners have the same one.
struct unisim_plane {
    void *values;
    int32_t channels, bytes, kind;
};

// How much the corners of a block may differ: `core/render/lattice.py`.
struct unisim_block_tolerance {
    float spread, contrast; // ranges of colours: above `spread` the middle is traced, above `contrast` the whole block
    float prediction;       // how far a middle's colour may be from the mean of its corners
    float range, twist;     // of disparities, relative to the largest
};

// A parameter of `n` numbers and what Adam knows of it: see `unisim_adam`.
struct unisim_adam_part {
    int64_t n;
    float *value, *gradient, *mean, *square;
    float rate, root, eps; // learning rate / (1 - beta1^t); sqrt(1 - beta2^t)
};

// The signed distance at `t` metres along a ray, by the ray's number.
typedef float (*unisim_distance)(int64_t ray, float t);

// Results of a trace, (n, ...) each. Null: not wanted.
struct unisim_trace_result {
    float *feature;                 // (n, features)
    float *depth, *opacity;         // (n)
    float *median;                  // (n): 0 where nothing stops the ray
    int32_t *instance;              // (n)
    float *normal;                  // (n, 3), world frame
    float *feature_without_foreign; // (n, features): as if there were no foreign actors and no meshes
    float *const *foreign_feature;  // one array per foreign actor set, (n, its features)
    float *const *foreign_opacity;  // one array per foreign actor set, (n)
    float *mesh_opacity;            // (n)
    int64_t *samples;               // (1): points at which a field was evaluated
};
