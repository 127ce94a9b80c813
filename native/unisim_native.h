// The plain C interface of the kernels. Every array is contiguous and belongs to the caller; nothing here keeps a pointer.
#pragma once
#include <cstdint>

// A multiresolution grid: `levels` tables one behind the other, `grids` such grids `grid_stride` rows apart.
// Level l: vertex (i, j, k) is row offset[l] + (i + j * stride_y[l] + k * stride_z[l]) where stride_y[l] != 0,
// else row offset[l] + (hash(i, j, k) & (size[l] - 1)), the hash of Mueller et al., "Instant Neural Graphics Primitives", 2022.
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

// A box over triangles. `faces` > 0: a leaf that holds order[first .. first + faces); 0: its children are nodes first and first + 1.
struct unisim_bvh_node {
    float low[3];
    int32_t first;
    float high[3];
    int32_t faces;
};

// Strands of one medium: ray (n); samples t, optical depths tau of intervals and shares of where they stop (n, width).
struct unisim_strands {
    int64_t n;
    int32_t width;
    const int64_t *ray;
    const float *t;
    const float *tau;
    const float *share;
};

// A convolution with edges repeated, `kernel` odd; a linear layer is one of a single tap.
struct unisim_layer {
    int32_t inputs;
    int32_t outputs;
    int32_t kernel;
    const float *weight; // (outputs, inputs, kernel, kernel)
    const float *bias;   // (outputs), or null
};

// A perceptron of `features` inputs, the 16 spherical harmonics of a direction and `extras` further inputs.
struct unisim_head {
    int32_t features;
    int32_t extras;
    int32_t count; // of layers
    const unisim_layer *layers;
};

// A grid and the network behind it. The table is float32, or float16 where `half`.
struct unisim_field {
    unisim_grid grid;
    const void *table;
    int32_t half;
    unisim_mlp net;
};

// A trained scene: three fields, what can be occupied, the ground and the light.
struct unisim_scene {
    unisim_field fixed;         // what stands still, in the volume
    unisim_field far;           // what lies beyond it
    unisim_field actors;        // a grid an actor, one behind the other
    const double *volume_from_world; // (3, 4)
    float size[3];              // of the volume, metres
    float far_radius, far_m;
    float beta;                 // sharpness of the density, 1 / metres
    int32_t paper_density;      // 0: logistic; 1: the paper's
    float step_m;               // of the paper's density
    const uint8_t *voxels;      // (X, Y, Z) values, 0 is free
    const uint8_t *clearance;   // (X, Y, Z): voxels to the nearest with a cell that is not open, or fewer
    const uint16_t *cells;      // (X, Y, Z): two bits for each of a voxel's eight cells, see cells.h; null: not known
    const uint8_t *box_cells;   // (actors, 16, 16, 16): the same of the actors' boxes
    int32_t voxel_shape[3];
    float voxel_m;
    float decay_per_m;
    const float *ground;        // (X, Y) heights, cells of ground_m
    int32_t ground_shape[2];
    float ground_m, ground_clearance_m;
    const unisim_mlp *light;    // null: actors look alike everywhere
    const float *light_home;    // (actors, 3), volume coordinates
    float light_reach_m;
    const unisim_head *sample_head; // null: the view direction enters once a ray, in the decoders
};

// Boxes on their ways, with looks of one scene.
struct unisim_troupe {
    const unisim_scene *scene;
    int32_t count, keys;
    const double *times;        // (count, keys)
    const int32_t *lengths;     // (count)
    const double *positions;    // (count, keys, 3), world frame
    const double *quaternions;  // (count, keys, 4), wxyz
    const float *sizes;         // (count, 3): of the boxes without their scales, in the metres of the scene's fields
    const double *start, *end;  // (count)
    const int32_t *rows;        // (count): of the scene's actor grids
    const int32_t *among;       // (candidates): those that these rays can meet
    int32_t candidates;
    const float *scales;        // (count, 3): how many times larger the boxes are in the world, along their own axes
};

struct unisim_cast {
    const unisim_troupe *troupes; // the scene's own actors first, then guests
    int32_t troupe_count;
    const unisim_troupe *copies;  // copied boxes of space, null for none
    const double *world_from_source; // (copies, 3, 4): of the boxes that they are copies of
    int32_t removals;
    const double *removal_from_world; // (removals, 3, 4)
    const float *removal_sizes;   // (removals, 3)
};

// Rays in the world frame, finite, their directions of unit length; `order` (n) is the order in which they are computed,
// neighbours together.
struct unisim_rays {
    int64_t n;
    const double *origins, *directions, *times;
    const int64_t *order;
    const float *starts; // (n): metres before which nothing of the static field is met; null: everywhere it is
};

// Where rays meet meshes: ray (count) rising, distance, optical depth, and the mesh's number.
struct unisim_mesh_hits {
    int64_t count;
    const int64_t *ray;
    const float *t, *tau, *normals; // normals (count, 3), world frame
    const int32_t *number;
};

struct unisim_sampling {
    int32_t proposals, samples, actor_proposals, actor_samples, far_proposals, far_samples;
    float near_m;
    float opaque;     // transmittance behind which nothing is computed
    float far_opaque; // the same for what lies beyond the volume, where it is more
    int32_t far, sky;
    // Following surfaces from cell to cell; stride_m 0 places samples by quantiles instead.
    float stride_m;     // the longest step
    float widening;     // how much longer it may be a metre farther away
    float relaxation;   // steps may be this much longer than the distance, which then falls by 1 / relaxation a metre
    float least_slope, least_step_m;
    int32_t splits;     // so often the interval that stops most is split
    float split_weight; // where it stops at least this much
};

// One map of a picture: values (h w, channels) of `bytes` a number. kind: 0 colours, 1 depths, 2 unit vectors, 3 other numbers, all
// float; of any type, `bytes` a pixel: 4 labels, 5 flags of pixels that something thinner than a block may be beside, 6 what is alike
// at all corners.
struct unisim_plane {
    void *values;
    int32_t channels, bytes, kind;
};

// By how much a block's corners may differ: `core/render/lattice/blocks.py`.
struct unisim_likeness {
    float spread, contrast; // of colours: what the middle is to tell about, and what ends something
    float foretold;         // of colours, a middle from its corners' mean
    float range, twist;     // of disparities, shares of the largest
};

// The signed distance at `t` metres along a ray, by the ray's number.
typedef float (*unisim_distance)(int64_t ray, float t);

// What rays met, (n, ...) each. Null: not asked for.
struct unisim_found {
    float *feature;             // (n, features)
    float *depth, *opacity;     // (n)
    float *median;              // (n): 0 where nothing stops the ray
    int32_t *instance;          // (n)
    float *normal;              // (n, 3), world frame
    float *own_feature;         // (n, features): as if no guest and no mesh were there
    float *const *guest_feature; // a guest each, (n, its features)
    float *const *guest_opacity; // a guest each, (n)
    float *mesh_opacity;        // (n)
    int64_t *samples;           // (1): points at which a field was asked
};
