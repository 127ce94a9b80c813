// What a trace is given: the scenes' fields as tiles ask them, and how places and directions come into a scene's coordinates.
#pragma once
#include "../field_tile.h"

namespace {

// What weighs less is not looked at.
constexpr float LEAST_WEIGHT = 1e-4f;
// What weighs less is left out of sums: a millionth of a feature shows in none of its digits.
constexpr float NO_WEIGHT = 1e-6f;

struct Fields {
    const unisim_scene *scene;
    Field fixed, far, actors;
    std::vector<float> light_first, light_last; // the light's layers, transposed: (features, wide), (hidden, wide)

    explicit Fields(const unisim_scene *s) : scene(s), fixed(s->fixed), far(s->far), actors(s->actors) {
        if (!s->light) return;
        light_first = transposed(s->light->w1, s->light->hidden, s->light->inputs);
        light_last = transposed(s->light->w2, s->light->outputs, s->light->hidden);
    }

    // (inputs, padded(outputs)) of a matrix (outputs, inputs).
    static std::vector<float> transposed(const float *w, int outputs, int inputs) {
        std::vector<float> out(static_cast<size_t>(inputs) * padded(outputs), 0.0f);
        for (int o = 0; o < outputs; ++o)
            for (int i = 0; i < inputs; ++i) out[static_cast<size_t>(i * padded(outputs) + o)] = w[o * inputs + i];
        return out;
    }
};

struct Task {
    const unisim_scene &scene;
    const unisim_cast &cast;
    const unisim_rays &rays;
    const unisim_mesh_hits *meshes;
    const unisim_sampling &sampling;
    const unisim_found &found;
    std::vector<Fields> fields; // a troupe each, the scene's own first
    std::vector<int> first;     // a troupe each: the number of its first actor; then that of the first mesh
};

inline void transform(const double *m, const double *x, float *out) {
    for (int a = 0; a < 3; ++a)
        out[a] = static_cast<float>(m[4 * a] * x[0] + m[4 * a + 1] * x[1] + m[4 * a + 2] * x[2] + m[4 * a + 3]);
}

inline void turn(const double *m, const double *x, float *out) {
    for (int a = 0; a < 3; ++a) out[a] = static_cast<float>(m[4 * a] * x[0] + m[4 * a + 1] * x[1] + m[4 * a + 2] * x[2]);
}

// Heights of the ground under (x, y), volume coordinates: bilinear between cells' middles.
inline float ground_at(const unisim_scene &s, float x, float y) {
    const float u = std::fmin(std::fmax(x / s.ground_m - 0.5f, 0.0f), static_cast<float>(s.ground_shape[0] - 1));
    const float v = std::fmin(std::fmax(y / s.ground_m - 0.5f, 0.0f), static_cast<float>(s.ground_shape[1] - 1));
    const int i = static_cast<int>(u), j = static_cast<int>(v), wide = s.ground_shape[1];
    const int ii = std::min(i + 1, s.ground_shape[0] - 1), jj = std::min(j + 1, wide - 1);
    const float fu = u - static_cast<float>(i), fv = v - static_cast<float>(j);
    return (1 - fu) * ((1 - fv) * s.ground[i * wide + j] + fv * s.ground[i * wide + jj]) +
           fu * ((1 - fv) * s.ground[ii * wide + j] + fv * s.ground[ii * wide + jj]);
}

} // namespace
