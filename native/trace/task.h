// The inputs of a trace: scenes with their fields ready for evaluation.
#pragma once
#include "../field_tile.h"
#include "../one_ray.h"

namespace {

struct SceneFields {
    const unisim_scene *scene;
    Field static_field, background, actors;
    // The light network's layers, transposed: (features, wide), (hidden, wide).
    std::vector<float> light_first, light_last;

    explicit SceneFields(const unisim_scene *s)
        : scene(s), static_field(s->static_field), background(s->background), actors(s->actor_fields) {
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
    const unisim_active_actors &active;
    const unisim_rays &rays;
    const unisim_mesh_hits *meshes;
    const unisim_sampling &sampling;
    const unisim_trace_result &result;
    std::vector<SceneFields> fields;   // one per actor set, the scene's own first
    std::vector<int> first_instance;   // one per actor set: the number of its first actor; then of the first mesh actor
};

} // namespace
