// Traces one ray by one thread: its segments, samples, compositing, background and passes.
//
// `../trace.cpp` traces tiles of rays on a CPU, and `core/render/tracers/torch/trace.py` is the specification of both.
// Compiled by CUDA's compiler, this runs on a GPU; compiled by the C++ compiler, tests run it.
#pragma once
#include "march.h"

namespace {

// The inputs of a trace; the pointers in its structures are the device's.
struct TraceInputs {
    unisim_scene scene;
    unisim_active_actors active;
    unisim_rays rays;
    unisim_mesh_hits meshes; // count 0: none
    unisim_sampling sampling;
    unisim_trace_result result;
};

// A ray inside a field, or at its intersection with a mesh.
struct Segment {
    enum Kind : int32_t { STATIC, ACTOR, COPY, MESH };
    int32_t kind, set, first, count; // number of the actor set or mesh actor; its samples among the ray's
    int32_t next;                    // the next sample in order of depth
    float stop;                      // where a ray that stops in that sample's interval is expected to stop
    BoxHit ray;                      // in the field's axes and metres; a mesh's normal is its `rotation`
};

// What a thread has room for beside its registers.
struct Workspace {
    Segment *segments;
    int32_t segment_capacity;
    SampleArrays samples;
};

class RayTracer {
  public:
    UNISIM_DEVICE RayTracer(const TraceInputs &in, const Workspace &work)
        : in_(in), work_(work), s_(work.samples), scene_(in.scene), how_(in.sampling) {}

    // Traces a ray and writes its results; returns false where the workspace has no room for it. `evaluations` is
    // increased by the points at which a field was evaluated.
    UNISIM_DEVICE bool trace(int64_t ray, int32_t &evaluations) {
        number_ = ray;
        time_ = in_.rays.times[ray];
        transform(scene_.volume_from_world, ray_origin(), o_);
        turn(scene_.volume_from_world, ray_direction(), d_);
        evaluations_ = 0;
        segments_ = samples_ = 0;
        hits_ = 0;
        if (!enter_actors() || !sample_static() || !sample_actors() || !sample_copies() || !add_meshes()) return false;
        composite();
        if (!add_background()) return false;
        write_passes();
        evaluations += evaluations_;
        return true;
    }

  private:
    // computed where they are read: a register less
    UNISIM_DEVICE const double *ray_origin() const { return in_.rays.origins + 3 * number_; }
    UNISIM_DEVICE const double *ray_direction() const { return in_.rays.directions + 3 * number_; }

    UNISIM_DEVICE Segment *new_segment(int32_t kind, int32_t set) {
        if (segments_ == work_.segment_capacity) return nullptr;
        Segment &s = work_.segments[segments_++];
        s.kind = kind;
        s.set = set;
        s.first = samples_;
        s.count = 0;
        return &s;
    }

    UNISIM_DEVICE const unisim_scene &scene_of(const Segment &s) const {
        return s.kind == Segment::ACTOR ? *in_.active.actor_sets[s.set].scene : scene_;
    }
    UNISIM_DEVICE const unisim_field &field_of(const Segment &s) const {
        return s.kind == Segment::ACTOR ? scene_of(s).actor_fields : scene_.static_field;
    }
    UNISIM_DEVICE int32_t grid_of(const Segment &s) const {
        return s.kind == Segment::ACTOR ? s.ray.row : 0;
    }
    UNISIM_DEVICE bool is_foreign(const Segment &s) const {
        return s.kind == Segment::MESH || (s.kind == Segment::ACTOR && s.set > 0);
    }
    // Whether a scene's segments are marched. The paper's density depends on the steps and needs even ones.
    UNISIM_DEVICE bool marches(const unisim_scene &of) const {
        return how_.stride_m > 0 && of.cells && !of.unisim_density;
    }

    // The place of a segment's point at t, displaced by `offset` in the field's axes, in the field's unit cube.
    UNISIM_DEVICE void place_in_field(const Segment &s, float t, const float *offset, float *x) const {
        const bool boxed = s.kind == Segment::ACTOR;
        const float *size = boxed ? in_.active.actor_sets[s.set].sizes + 3 * s.ray.box : scene_.size;
        for (int a = 0; a < 3; ++a)
            x[a] = (s.ray.o[a] + t * s.ray.d[a] + (offset ? offset[a] : 0.0f)) / size[a] + (boxed ? 0.5f : 0.0f);
    }

    // The signed distance of a segment's field at t, as the scenario's edits change it.
    UNISIM_DEVICE float distance_at(const Segment &s, float t) {
        float x[3];
        place_in_field(s, t, nullptr, x);
        const float value = evaluate_field(field_of(s), grid_of(s), x, 0.0f, nullptr);
        ++evaluations_;
        if (s.kind == Segment::ACTOR) return value;
        const float p[3] = {s.ray.o[0] + t * s.ray.d[0], s.ray.o[1] + t * s.ray.d[1], s.ray.o[2] + t * s.ray.d[2]};
        if (s.kind == Segment::STATIC) {
            if (!is_masked(t, 0.0f)) return value;
            // inside a masked box nothing is left but the ground, so its height bounds the distance
            const float height = p[2] - ground_at(scene_, p[0], p[1]);
            return height > scene_.ground_clearance_m ? (value < height ? height : value) : value;
        }
        // of a copied box, the ground stays where it is
        return p[2] > ground_at(scene_, p[0], p[1]) + scene_.ground_clearance_m ? value : EMPTY_M;
    }

    // Whether the ray at t is in a box in which the static scene is masked out, or at most `margin` from one: those of
    // active actors, and removed boxes.
    UNISIM_DEVICE bool is_masked(float t, float margin) const {
        for (int i = 0; i < hits_; ++i) {
            const BoxHit &hit = work_.segments[i].ray;
            if (t >= hit.t_near - margin && t <= hit.t_far + margin) return true;
        }
        for (int k = 0; k < in_.active.removed_boxes; ++k) {
            const double *m = in_.active.removed_box_from_world + 12 * k;
            const float *size = in_.active.removed_box_sizes + 3 * k;
            const float half[3] = {size[0] / 2, size[1] / 2, size[2] / 2}, minus[3] = {-half[0], -half[1], -half[2]};
            float o[3], d[3], near, far;
            transform(m, ray_origin(), o);
            turn(m, ray_direction(), d);
            if (intersect_box(o, d, minus, half, 0.0f, near, far) && t >= near - margin && t <= far + margin)
                return true;
        }
        return false;
    }

    // Segments of the boxes of a set that the ray hits.
    UNISIM_DEVICE bool enter_boxes(const unisim_actor_set &set, int32_t kind, int32_t number) {
        for (int c = 0; c < set.candidate_count; ++c) {
            const int actor = set.candidates[c];
            if (!(time_ >= set.start[actor] && time_ <= set.end[actor])) continue;
            double position[3], to[3];
            position_at(set, actor, time_, position);
            if (!reaches_sphere(position, ray_origin(), ray_direction(), sphere_radius(set, actor), to)) continue;
            BoxHit hit{0, actor, 0, 0, {}, {}, {}, 1.0f, 0};
            if (!enter_box(set, actor, pose_at(set, actor, time_), to, ray_direction(), how_.near_m, hit)) continue;
            Segment *s = new_segment(kind, number);
            if (!s) return false;
            s->ray = hit;
        }
        return true;
    }

    // The boxes of actors come first: they mask the static scene.
    UNISIM_DEVICE bool enter_actors() {
        for (int i = 0; i < in_.active.actor_set_count; ++i)
            if (!enter_boxes(in_.active.actor_sets[i], Segment::ACTOR, i)) return false;
        hits_ = segments_;
        return true;
    }

    UNISIM_DEVICE bool sample_static() {
        const float zero[3] = {};
        float near = 0, far = 0;
        if (!intersect_box(o_, d_, zero, scene_.size, how_.near_m, near, far)) far = near;
        far_ = far;
        const float start = in_.rays.starts ? greater_of(how_.near_m, in_.rays.starts[number_]) : how_.near_m;
        near = lesser_of(greater_of(near, start), far);
        Segment *s = new_segment(Segment::STATIC, 0);
        if (!s) return false;
        static_ = segments_ - 1;
        for (int a = 0; a < 3; ++a) {
            s->ray.o[a] = o_[a];
            s->ray.d[a] = d_[a];
        }
        s->ray.t_near = near;
        s->ray.t_far = far;
        s->ray.stretch = 1;
        if (!marches(scene_)) return place_by_quantiles(*s, how_.proposals, how_.samples);
        March march{s_, samples_, scene_.beta, how_};
        VolumeRuns runs(scene_, o_, d_, near, far);
        const auto distance = [&](float t) { return distance_at(*s, t); };
        const auto cleared = [&](float t) { return is_masked(t, scene_.voxel_m); };
        march.along(0.0f, distance, [&](Run &run) { return runs.next(cleared, run); });
        int before;
        float t;
        if (!march.full && find_face(scene_, o_, d_, near, s_.t + s_.at(samples_), s_.tau + s_.at(samples_),
                                     march.count, s_.stride, before, t)) {
            const float value = distance(t);
            if (march.insert(before, t, value, optical_depth_at(value, scene_.beta), false)) {
                const int64_t behind = s_.at(samples_ + before + 1);
                s_.stop_fraction[behind] = s_.t[behind] - t > 0.75f * scene_.voxel_m ? 1.0f : 0.0f;
            }
        }
        return end_march(*s, march, distance);
    }

    UNISIM_DEVICE bool sample_actors() {
        for (int i = 0; i < hits_; ++i) {
            Segment &s = work_.segments[i];
            s.first = samples_;
            const unisim_scene &scene = scene_of(s);
            if (!marches(scene)) {
                if (!place_by_quantiles(s, how_.actor_proposals, how_.actor_samples)) return false;
                continue;
            }
            const uint8_t *cells =
                scene.box_cells + static_cast<int64_t>(grid_of(s)) * BOX_CELLS * BOX_CELLS * BOX_CELLS;
            March march{s_, samples_, scene.beta, how_};
            BoxRuns runs(cells, s.ray, in_.active.actor_sets[s.set].sizes + 3 * s.ray.box);
            const auto distance = [&](float t) { return distance_at(s, t / s.ray.stretch); };
            march.along(depth_before(s), distance, [&](Run &run) { return runs.next(run); });
            if (!end_march(s, march, distance)) return false;
            for (int k = 0; k < s.count; ++k) s_.t[s_.at(s.first + k)] /= s.ray.stretch;
        }
        return true;
    }

    template <class Distance> UNISIM_DEVICE bool end_march(Segment &s, March &march, const Distance &distance) {
        if (!march.full) march.split(distance);
        if (march.full) return false;
        s.count = march.count;
        samples_ += s.count;
        find_intervals(s, 0, s.count, scene_of(s).beta, false);
        return true;
    }

    // The optical depth before an actor's box: that of the static field.
    UNISIM_DEVICE float depth_before(const Segment &s) const {
        if (s.kind != Segment::ACTOR) return 0;
        const Segment &front = work_.segments[static_];
        float depth = 0;
        for (int k = 0; k < front.count; ++k) {
            const int64_t i = s_.at(front.first + k);
            if (s_.t[i] >= s.ray.t_near) break;
            depth += s_.tau[i];
        }
        return depth;
    }

    // Copied boxes are evaluated at their sources. They are small: even samples, without proposals.
    UNISIM_DEVICE bool sample_copies() {
        if (!in_.active.copies) return true;
        const int begin = segments_;
        if (!enter_boxes(*in_.active.copies, Segment::COPY, 0)) return false;
        for (int i = begin; i < segments_; ++i) {
            Segment &s = work_.segments[i];
            move_to_source(scene_, in_.active.world_from_source + 12 * s.ray.box, s.ray);
            if (!take(s, 2 * how_.samples)) return false;
            for (int k = 0; k < s.count; ++k)
                s_.t[s_.at(s.first + k)] = s.ray.t_near + (static_cast<float>(k) + 0.5f) / static_cast<float>(s.count) *
                                                              (s.ray.t_far - s.ray.t_near);
            evaluate(s, s.count, true);
        }
        return true;
    }

    UNISIM_DEVICE bool add_meshes() {
        const unisim_mesh_hits &hits = in_.meshes;
        int64_t first = 0;
        for (int64_t end = hits.count; first < end;) {
            const int64_t middle = (first + end) / 2;
            if (hits.ray[middle] < number_)
                first = middle + 1;
            else
                end = middle;
        }
        for (int64_t i = first; i < hits.count && hits.ray[i] == number_; ++i) {
            Segment *s = new_segment(Segment::MESH, hits.actor[i]);
            if (!s || !take(*s, 1)) return false;
            for (int a = 0; a < 3; ++a) s->ray.rotation[a] = hits.normals[3 * i + a];
            const int64_t at = s_.at(s->first);
            s_.t[at] = hits.t[i];
            s_.tau[at] = hits.tau[i];
            s_.s[at] = s_.stop_fraction[at] = 0;
        }
        return true;
    }

    // Gives a segment the next `count` samples; false where there is no room.
    UNISIM_DEVICE bool take(Segment &s, int count) {
        if (samples_ + count > s_.capacity) return false;
        s.first = samples_;
        s.count = count;
        samples_ += count;
        return true;
    }

    // Samples by quantiles of the weights that `proposals` samples have.
    UNISIM_DEVICE bool place_by_quantiles(Segment &s, int proposals, int samples) {
        const int most = proposals + 1 > samples ? proposals + 1 : samples;
        if (!take(s, most)) return false;
        samples_ -= most - samples;
        s.count = samples;
        float total = 0;
        if (s.kind == Segment::STATIC) {
            total = occupied_mass(s);
            if (!(total > 0)) { // a ray through free space only has no samples
                samples_ -= samples;
                s.count = 0;
                return true;
            }
        }
        float *quantile = s_.before + s_.at(s.first), *cdf = s_.weight + s_.at(s.first);
        for (int k = 0; k < proposals; ++k)
            quantile[s_.at(k)] = (static_cast<float>(k) + 0.5f) / static_cast<float>(proposals);
        place(s, proposals, total);
        evaluate(s, proposals, false);
        cumulate_weights(s, proposals, cdf);
        invert_weights(cdf, proposals, samples, quantile);
        place(s, samples, total);
        evaluate(s, samples, true);
        return true;
    }

    // The occupancy of the step of half a voxel that begins at number i, 0 outside the volume.
    UNISIM_DEVICE float occupancy_of_step(const Segment &s, int32_t i) const {
        const float step = scene_.voxel_m / 2, inverse = 1.0f / scene_.voxel_m;
        const float t = s.ray.t_near + (static_cast<float>(i) + 0.5f) * step;
        int64_t cell = 0;
        for (int a = 0; a < 3; ++a) {
            const float x = std::floor((o_[a] + t * d_[a]) * inverse);
            if (!(x >= 0 && x < static_cast<float>(scene_.voxel_shape[a]))) return 0;
            cell = cell * scene_.voxel_shape[a] + static_cast<int64_t>(x);
        }
        return static_cast<float>(scene_.voxels[cell]) * (1.0f / 255.0f);
    }

    // A walk along the steps of a ray in voxels that are not free, and their cumulative mass.
    struct OccupiedWalk {
        int32_t step = -1; // the last one that was reached
        float mass = 0, mass_before = 0, depth = 0;
    };

    // Goes to the next occupied step; false where there is none, which leaves the walk where it is.
    UNISIM_DEVICE bool go_on(const Segment &s, OccupiedWalk &walk) const {
        const float step = scene_.voxel_m / 2;
        const int32_t steps = steps_between(s.ray.t_near, s.ray.t_far, step, MAX_STEPS);
        for (int32_t i = walk.step + 1; i < steps; ++i) {
            const float p = occupancy_of_step(s, i);
            if (!(p > 0)) continue;
            walk.step = i;
            walk.mass_before = walk.mass;
            walk.mass += p * std::exp(-scene_.decay_per_m * step * walk.depth);
            walk.depth += p;
            return true;
        }
        return false;
    }

    UNISIM_DEVICE float occupied_mass(const Segment &s) const {
        OccupiedWalk walk;
        while (go_on(s, walk)) {
        }
        return walk.mass;
    }

    // Places the first `count` samples by the rising quantiles in `before`: by occupied mass, of which there is
    // `total`, or evenly in an actor's box.
    UNISIM_DEVICE void place(const Segment &s, int count, float total) {
        const float *quantile = s_.before + s_.at(s.first);
        float *t = s_.t + s_.at(s.first);
        if (s.kind == Segment::ACTOR) {
            for (int k = 0; k < count; ++k)
                t[s_.at(k)] = s.ray.t_near + quantile[s_.at(k)] * (s.ray.t_far - s.ray.t_near);
            return;
        }
        const float step = scene_.voxel_m / 2;
        OccupiedWalk walk;
        go_on(s, walk);
        for (int k = 0; k < count; ++k) {
            const float target = quantile[s_.at(k)] * total;
            while (walk.mass <= target && go_on(s, walk)) {
            }
            const float fraction =
                std::fmin(std::fmax((target - walk.mass_before) / (walk.mass - walk.mass_before), 0.0f), 1.0f);
            t[s_.at(k)] = s.ray.t_near + (static_cast<float>(walk.step) + fraction) * step;
        }
    }

    // Cumulative weights (places + 1) of the intervals before, between and after samples; a small part of the weight is
    // distributed evenly.
    UNISIM_DEVICE void cumulate_weights(const Segment &s, int places, float *cdf) const {
        constexpr float LEAST = 1e-5f, UNIFORM = 0.05f;
        float before = 0, total = 0, sum = 0;
        for (int k = 0; k <= places; ++k) {
            float weight = LEAST;
            if (k < places) {
                const float depth = s_.tau[s_.at(s.first + k)];
                weight += exp_of(-before) * opacity_of(depth);
                before += depth;
            }
            total += weight;
            cdf[s_.at(k)] = weight;
        }
        const float scale = (1.0f - UNIFORM) / total;
        for (int k = 0; k <= places; ++k) {
            const float width = (k == 0 || k == places ? 0.5f : 1.0f) / static_cast<float>(places);
            sum += cdf[s_.at(k)] * scale + UNIFORM * width;
            cdf[s_.at(k)] = sum;
        }
    }

    // Quantiles u (count): the middles of `count` equal parts of cumulative weights.
    UNISIM_DEVICE void invert_weights(const float *cdf, int places, int count, float *u) const {
        const float total = cdf[s_.at(places)];
        int k = 0;
        for (int j = 0; j < count; ++j) {
            const float target = (static_cast<float>(j) + 0.5f) / static_cast<float>(count) * total;
            while (k < places && cdf[s_.at(k)] <= target) ++k;
            const float c0 = k ? cdf[s_.at(k - 1)] : 0.0f, c1 = cdf[s_.at(k)];
            const float e0 = k ? (static_cast<float>(k) - 0.5f) / static_cast<float>(places) : 0.0f;
            const float e1 = k == places ? 1.0f : (static_cast<float>(k) + 0.5f) / static_cast<float>(places);
            u[s_.at(j)] = e0 + (target - c0) / std::fmax(c1 - c0, 1e-12f) * (e1 - e0);
        }
    }

    // Evaluates the field at the first `count` samples, in rounds, until the segment is opaque. `final`: intervals are
    // those of the density; else they only decide where samples are placed.
    UNISIM_DEVICE void evaluate(Segment &s, int count, bool final) {
        const unisim_scene &scene = scene_of(s);
        const float max_depth = -std::log(how_.opaque);
        const int round = final ? 4 : 8;
        float depth = depth_before(s);
        int done = 0;
        while (done < count && depth < max_depth) {
            const int to = done + round < count ? done + round : count;
            for (int k = done; k < to; ++k) s_.s[s_.at(s.first + k)] = distance_at(s, s_.t[s_.at(s.first + k)]);
            if (final && scene.unisim_density)
                find_unisim_intervals(s, done, to, scene.beta,
                                      s.kind == Segment::ACTOR ? scene.density_step_m / 4 : scene.density_step_m);
            else
                find_intervals(s, done, to, scene.beta, !final);
            for (; done < to; ++done) depth += s_.tau[s_.at(s.first + done)];
        }
        // samples that were not evaluated absorb nothing
        for (int k = done; k < count; ++k) {
            const int64_t i = s_.at(s.first + k);
            s_.tau[i] = s_.stop_fraction[i] = s_.s[i] = 0;
        }
    }

    // Optical depths and stop fractions of intervals `from` to before `to`, see `core/ops/density.py`.
    // `limit_sharpness` bounds the sharpness by the interval's length, for samples that only decide where others are
    // placed; these get no stop fractions.
    UNISIM_DEVICE void find_intervals(const Segment &s, int from, int to, float beta, bool limit_sharpness) const {
        for (int k = from; k < to; ++k) {
            const int64_t i = s_.at(s.first + k);
            if (k == 0) {
                s_.tau[i] = softplus(-beta * s_.s[i]);
                s_.stop_fraction[i] = 0;
                continue;
            }
            const float s0 = s_.s[i - s_.stride], s1 = s_.s[i];
            float sharpness = beta;
            if (limit_sharpness) {
                const float length = (s_.t[i] - s_.t[i - s_.stride]) * s.ray.stretch;
                sharpness = lesser_of(beta, 4.0f / greater_of(length, 1e-4f));
            }
            const float outside = softplus(-sharpness * s0), rise = softplus(-sharpness * s1) - outside;
            const float tau = greater_of(rise, 0.0f);
            s_.tau[i] = tau;
            s_.stop_fraction[i] = 0;
            if (limit_sharpness) continue;
            const float slope = beta * (s0 - s1), steep = std::fabs(slope), alpha = opacity_of(tau);
            float mean; // transmittance over the interval; behind the surface the difference would cancel
            if (steep < 1e-2f)
                mean = 1.0f - alpha / 2.0f;
            else if (outside > 5.0f) {
                const float deep = greater_of(slope, 1e-2f);
                mean = opacity_of(deep) / deep;
            } else
                mean = (slope - rise) / slope * exp_of(outside);
            s_.stop_fraction[i] = lesser_of(greater_of(mean - exp_of(-tau), 0.0f), alpha);
        }
    }

    // The same for the paper's density, in steps of `step_m`.
    UNISIM_DEVICE void find_unisim_intervals(const Segment &s, int from, int to, float beta, float step_m) const {
        for (int k = from; k < to; ++k) {
            const int64_t i = s_.at(s.first + k);
            const float steps = k ? (s_.t[i] - s_.t[i - s_.stride]) * s.ray.stretch / step_m : 1.0f;
            s_.tau[i] = softplus(-beta * s_.s[i]) * steps;
            s_.stop_fraction[i] = k ? opacity_of(s_.tau[i]) : 0.0f;
        }
    }

    // Composites the ray's segments in order of depth.
    UNISIM_DEVICE void composite() {
        const unisim_trace_result &out = in_.result;
        const int width = scene_.static_field.net.outputs - 1;
        bool foreign = false;
        for (int i = 0; i < segments_; ++i) foreign |= work_.segments[i].count > 0 && is_foreign(work_.segments[i]);
        float *feature = out.feature + number_ * width;
        for (int f = 0; f < width; ++f) feature[f] = 0;
        for (int i = 0; i + 1 < in_.active.actor_set_count; ++i) {
            const int wide = in_.active.actor_sets[i + 1].scene->static_field.net.outputs - 1;
            for (int f = 0; f < wide; ++f) out.foreign_feature[i][number_ * wide + f] = 0;
            out.foreign_opacity[i][number_] = 0;
        }
        if (out.mesh_opacity) out.mesh_opacity[number_] = 0;
        weight_ = weighted_t_ = 0;
        // what the scene's own decoder sees: everything but foreign segments
        if (out.feature_without_foreign) {
            float *own = out.feature_without_foreign + number_ * width;
            for (int f = 0; f < width; ++f) own[f] = 0;
            transmittance_without_foreign_ = exp_of(-merge_by_depth(false));
            find_weights();
            for (int i = 0; i < segments_; ++i)
                if (!is_foreign(work_.segments[i])) add_features(work_.segments[i], own);
        }
        transmittance_ = exp_of(-merge_by_depth(true));
        if (!(out.feature_without_foreign && foreign)) transmittance_without_foreign_ = transmittance_;
        find_weights();
        for (int i = 0; i < segments_; ++i) {
            const Segment &s = work_.segments[i];
            const float weight = weight_of(s);
            weight_ += weight;
            for (int k = 0; k < s.count; ++k) {
                const int64_t j = s_.at(s.first + k);
                weighted_t_ += s_.weight[j] * s_.t[j];
            }
            if (s.kind == Segment::MESH)
                out.mesh_opacity[number_] += weight;
            else if (!is_foreign(s))
                add_features(s, feature);
            else { // features of a foreign scene are decoded by that scene's decoder
                add_features(s, out.foreign_feature[s.set - 1] + number_ * (field_of(s).net.outputs - 1));
                out.foreign_opacity[s.set - 1][number_] += weight;
            }
        }
    }

    UNISIM_DEVICE float weight_of(const Segment &s) const {
        float sum = 0;
        for (int k = 0; k < s.count; ++k) sum += s_.weight[s_.at(s.first + k)];
        return sum;
    }

    UNISIM_DEVICE float stop_of(const Segment &s, int k) const {
        if (k >= s.count) return END;
        const int64_t i = s_.at(s.first + k);
        const float t = s_.t[i], near = k ? s_.t[i - s_.stride] : t, alpha = opacity_of(s_.tau[i]);
        return near + (alpha > 1e-4f ? s_.stop_fraction[i] / alpha : 0.5f) * (t - near);
    }

    // Transmittances before the intervals of all segments, or of all that are not foreign, in one order of depth: by
    // where a ray that stops in an interval is expected to stop. Returns the optical depth of them all.
    UNISIM_DEVICE float merge_by_depth(bool with_foreign) const {
        for (int i = 0; i < segments_; ++i) {
            Segment &s = work_.segments[i];
            s.next = 0;
            s.stop = with_foreign || !is_foreign(s) ? stop_of(s, 0) : END;
        }
        double before = 0; // many thin intervals would be lost one by one in float32
        for (;;) {
            int first = 0;
            for (int i = 1; i < segments_; ++i)
                if (work_.segments[i].stop < work_.segments[first].stop) first = i;
            Segment &s = work_.segments[first];
            if (s.stop == END) return static_cast<float>(before);
            const int64_t i = s_.at(s.first + s.next++);
            s_.before[i] = exp_of(-static_cast<float>(before));
            before += s_.tau[i];
            s.stop = stop_of(s, s.next);
        }
    }

    // Weights of the samples: an interval's weight is divided between the samples at its two ends.
    UNISIM_DEVICE void find_weights() const {
        for (int n = 0; n < segments_; ++n) {
            const Segment &s = work_.segments[n];
            float near_part = 0;
            for (int k = s.count - 1; k >= 0; --k) {
                const int64_t i = s_.at(s.first + k);
                const float interval = s_.before[i] * opacity_of(s_.tau[i]);
                const float far_part = s_.before[i] * s_.stop_fraction[i];
                // interval 0 has no length: its whole weight belongs to its sample
                s_.weight[i] = (k ? far_part : interval) + near_part;
                near_part = interval - far_part;
            }
        }
    }

    // Adds a segment's features, summed by weight, as the light changes them.
    UNISIM_DEVICE void add_features(const Segment &s, float *sum) {
        if (s.kind == Segment::MESH || !s.count) return;
        const unisim_scene &scene = scene_of(s);
        const unisim_field &field = field_of(s);
        const unisim_mlp &net = field.net;
        const int features = net.outputs - 1;
        const float weight = weight_of(s);
        float light[2 * MAX_OUTPUTS], out[MAX_OUTPUTS], units[MAX_HIDDEN];
        const bool lit = s.kind == Segment::ACTOR && how_.sky && scene.light && weight > MIN_WEIGHT;
        if (lit) find_light(s, scene, light);
        for (int j = 0; j < net.hidden; ++j) units[j] = 0;
        for (int k = 0; k < s.count; ++k) {
            const int64_t i = s_.at(s.first + k);
            const float w = s_.weight[i];
            if (!(w > (scene.sample_head ? MIN_WEIGHT : NEGLIGIBLE_WEIGHT))) continue;
            float x[3];
            place_in_field(s, s_.t[i], nullptr, x);
            if (!scene.sample_head) {
                evaluate_field(field, grid_of(s), x, w, units);
                continue;
            }
            for (int j = 0; j < net.hidden; ++j) units[j] = 0;
            evaluate_field(field, grid_of(s), x, 1.0f, units);
            add_view_dependent(*scene.sample_head, net, units, lit ? light : nullptr, w, sum);
        }
        if (scene.sample_head) return;
        project(net, units, weight, out);
        for (int f = 0; f < features; ++f)
            sum[f] += lit ? out[f] * (1 + light[f]) + light[features + f] * weight : out[f];
    }

    // Adds the output of a head that takes the view direction at every sample.
    UNISIM_DEVICE void add_view_dependent(const unisim_head &head, const unisim_mlp &net, const float *units,
                                          const float *light, float weight, float *sum) const {
        const int features = net.outputs - 1;
        float a[MAX_WIDTH], b[MAX_WIDTH], direction[3];
        project(net, units, 1.0f, a);
        for (int f = 0; light && f < features; ++f) a[f] = a[f] * (1 + light[f]) + light[features + f];
        for (int i = 0; i < 3; ++i) direction[i] = static_cast<float>(ray_direction()[i]);
        spherical_harmonics(direction, a + features);
        for (int n = 0; n < head.count; ++n) {
            const unisim_layer &layer = head.layers[n];
            for (int j = 0; j < layer.outputs; ++j) {
                float value = layer.bias ? layer.bias[j] : 0.0f;
                for (int i = 0; i < layer.inputs; ++i) value += layer.weight[j * layer.inputs + i] * a[i];
                b[j] = n + 1 < head.count && !(value > 0) ? 0.0f : value;
            }
            for (int j = 0; j < layer.outputs; ++j) a[j] = b[j];
        }
        for (int f = 0; f < features; ++f) sum[f] += weight * a[f];
    }

    // The light on an actor's segment: scales and shifts (2, features) of its features, from the static field on the
    // ground around it. `core/model/scene.py` is the specification.
    UNISIM_DEVICE void find_light(const Segment &s, const unisim_scene &scene, float *light) {
        const unisim_mlp &net = *scene.light, &of = scene.static_field.net;
        float units[MAX_HIDDEN], appearance[MAX_OUTPUTS];
        for (int j = 0; j < of.hidden; ++j) units[j] = 0;
        const float t = s_.t[s_.at(s.first + median_sample(s))];
        // an actor of a foreign scene has the light of the place where it was recorded
        const float *home = scene.light_home + 3 * grid_of(s);
        for (int i = 0; i < 4; ++i) {
            float place[3];
            for (int a = 0; a < 3; ++a) place[a] = is_foreign(s) ? home[a] : o_[a] + t * d_[a];
            place[i & 2 ? 1 : 0] += i & 1 ? -scene.light_reach_m : scene.light_reach_m;
            place[2] = ground_at(scene, place[0], place[1]);
            for (int a = 0; a < 3; ++a) place[a] /= scene.size[a];
            evaluate_field(scene.static_field, 0, place, 0.25f, units);
        }
        evaluations_ += 4;
        project(of, units, 1.0f, appearance);
        for (int f = 0; f < net.outputs; ++f) light[f] = net.bias[f];
        for (int j = 0; j < net.hidden; ++j) {
            float unit = 0;
            for (int i = 0; i < net.inputs; ++i) unit += net.w1[j * net.inputs + i] * appearance[i];
            if (unit > 0)
                for (int f = 0; f < net.outputs; ++f) light[f] += net.w2[f * net.hidden + j] * unit;
        }
    }

    // The sample by which a segment, alone on its ray, has absorbed half of what it absorbs.
    UNISIM_DEVICE int median_sample(const Segment &s) const {
        float all = 0, depth = 0;
        for (int k = 0; k < s.count; ++k) all += s_.tau[s_.at(s.first + k)];
        const float half = 0.5f * opacity_of(all);
        for (int k = 0; k + 1 < s.count; ++k) {
            depth += s_.tau[s_.at(s.first + k)];
            if (opacity_of(depth) >= half) return k;
        }
        return s.count - 1;
    }

    // The background model and the sky, outside the volume; false where there is no room for its samples.
    UNISIM_DEVICE bool add_background() {
        constexpr float MAX_LOG_DENSITY = 8.0f;
        before_background_ = transmittance_;
        background_t_ = background_median_ = 0;
        if (!how_.background || !(transmittance_without_foreign_ > greater_of(how_.background_opaque, how_.opaque)))
            return true;
        const unisim_field &field = scene_.background;
        const unisim_mlp &net = field.net;
        const int proposals = how_.background_proposals, second = how_.background_samples;
        // where segments are marched, proposals are composited too
        const bool both = how_.stride_m > 0;
        // behind the ray's samples: densities and places of both evaluations, cumulative weights, widths
        if (samples_ + proposals + second + 1 > s_.capacity) return false;
        const int64_t base = s_.at(samples_), after = s_.at(samples_ + proposals);
        float *density[2] = {s_.tau + base, s_.tau + after}, *place[2] = {s_.t + base, s_.t + after};
        float *cdf = s_.before + base, *width = s_.weight + base;
        const auto density_at = [&](float fraction) {
            float x[3];
            contract(background_distance(fraction), x);
            ++evaluations_;
            return exp_of(lesser_of(evaluate_field(field, 0, x, 0.0f, nullptr), MAX_LOG_DENSITY));
        };
        for (int k = 0; k < proposals; ++k) {
            place[0][s_.at(k)] = (static_cast<float>(k) + 0.5f) / static_cast<float>(proposals);
            density[0][s_.at(k)] = density_at(place[0][s_.at(k)]);
        }
        place_background(density[0], proposals, second, cdf, place[1], width);
        for (int k = 0; k < second; ++k) density[1][s_.at(k)] = density_at(place[1][s_.at(k)]);
        float units[MAX_HIDDEN], sums[MAX_OUTPUTS], weight_sum = 0, before = 0, edge = 0;
        for (int j = 0; j < net.hidden; ++j) units[j] = 0;
        for (int f = 0; f + 1 < net.outputs; ++f) sums[f] = 0;
        const auto add = [&](float weight, const float *x) {
            if (scene_.sample_head && weight <= MIN_WEIGHT) return;
            weight_sum += weight;
            if (weight <= NEGLIGIBLE_WEIGHT) return;
            if (!scene_.sample_head) {
                evaluate_field(field, 0, x, weight, units);
                return;
            }
            for (int j = 0; j < net.hidden; ++j) units[j] = 0;
            evaluate_field(field, 0, x, 1.0f, units);
            add_view_dependent(*scene_.sample_head, net, units, nullptr, weight, sums);
        };
        // the samples of both evaluations, merged by depth: the median is known only behind the last
        int next[2] = {0, 0};
        const int counts[2] = {both ? proposals : 0, second}, count = counts[0] + counts[1];
        float *merged_t = s_.s + base, *merged_tau = s_.stop_fraction + base;
        for (int k = 0; k < count; ++k) {
            const int of =
                next[0] < counts[0] && (next[1] == counts[1] || place[0][s_.at(next[0])] <= place[1][s_.at(next[1])])
                    ? 0
                    : 1;
            const int j = next[of]++;
            const float here = place[of][s_.at(j)];
            float wide = width[s_.at(j)];
            if (both) {
                float end = 1;
                for (int side = 0; side < 2; ++side)
                    if (next[side] < counts[side]) end = lesser_of(end, 0.5f * (here + place[side][s_.at(next[side])]));
                wide = end - edge;
                edge = end;
            }
            const float t = background_distance(here), tau = density[of][s_.at(j)] * wide;
            const float weight = exp_of(-before) * opacity_of(tau);
            float x[3];
            contract(t, x);
            add(weight, x);
            background_t_ += weight * t;
            before += tau;
            merged_t[s_.at(k)] = t;
            merged_tau[s_.at(k)] = tau;
        }
        const float after_all = exp_of(-before);
        if (how_.sky) {
            const float x[3] = {d_[0] / 2 + 0.5f, d_[1] / 2 + 0.5f, d_[2] / 2 + 0.5f};
            add(after_all, x);
            ++evaluations_;
        }
        if (!scene_.sample_head) project(net, units, weight_sum, sums);
        const int features = net.outputs - 1;
        for (int f = 0; f < features; ++f) {
            in_.result.feature[number_ * features + f] += transmittance_ * sums[f];
            if (in_.result.feature_without_foreign)
                in_.result.feature_without_foreign[number_ * features + f] += transmittance_without_foreign_ * sums[f];
        }
        transmittance_ *= after_all;
        const float wanted = (1 + transmittance_) / 2;
        float passed = before_background_;
        for (int k = 0; k < count; ++k) {
            const float behind = passed * exp_of(-merged_tau[s_.at(k)]);
            if (passed > wanted && behind <= wanted) background_median_ = merged_t[s_.at(k)];
            passed = behind;
        }
        return true;
    }

    // The distance along the ray of a fraction, in disparity, of the way from the volume to the far end.
    UNISIM_DEVICE float background_distance(float fraction) const {
        return 1 / ((1 - fraction) / greater_of(far_, how_.near_m) + fraction / scene_.background_far_m);
    }

    // The ray's point at t in the background's unit cube: mip-NeRF 360's contraction (Barron et al., 2022, eq. 10).
    UNISIM_DEVICE void contract(float t, float *x) const {
        float norm = 0;
        for (int a = 0; a < 3; ++a) {
            x[a] = (o_[a] + d_[a] * t - scene_.size[a] / 2) / scene_.background_radius_m;
            norm += x[a] * x[a];
        }
        norm = std::fmax(std::sqrt(norm), 1e-9f);
        const float scale = norm <= 1 ? 1.0f : (2 - 1 / norm) / norm;
        for (int a = 0; a < 3; ++a) x[a] = x[a] * scale / 4 + 0.5f;
    }

    // Places of the background's second evaluation, and the widths of the intervals around them, from the densities of
    // the first.
    UNISIM_DEVICE void place_background(const float *density, int first, int second, float *cdf, float *place,
                                        float *width) const {
        float before = 0, total = 0;
        cdf[0] = 0;
        for (int k = 0; k < first; ++k) {
            const float depth = density[s_.at(k)] / static_cast<float>(first);
            cdf[s_.at(k + 1)] = exp_of(-before) * opacity_of(depth) + 1e-3f;
            total += cdf[s_.at(k + 1)];
            before += depth;
        }
        for (int k = 1; k <= first; ++k)
            cdf[s_.at(k)] = cdf[s_.at(k - 1)] + 0.8f * cdf[s_.at(k)] / total + 0.2f / static_cast<float>(first);
        int j = 1;
        float edge = 0;
        for (int k = 0; k <= second; ++k) {
            const float target = static_cast<float>(k) / static_cast<float>(second) * cdf[s_.at(first)];
            while (j < first && cdf[s_.at(j)] <= target) ++j;
            const float from = cdf[s_.at(j - 1)], to = cdf[s_.at(j)];
            const float at = (static_cast<float>(j - 1) + (target - from) / (to - from)) / static_cast<float>(first);
            if (k) {
                width[s_.at(k - 1)] = at - edge;
                place[s_.at(k - 1)] = edge + 0.5f * (at - edge);
            }
            edge = at;
        }
    }

    UNISIM_DEVICE void write_passes() {
        const unisim_trace_result &out = in_.result;
        const float opacity = 1 - transmittance_, inside = weighted_t_ / std::fmax(weight_, 1e-6f);
        out.opacity[number_] = opacity;
        out.depth[number_] =
            (inside * (1 - before_background_) + before_background_ * background_t_) / std::fmax(opacity, 1e-6f);
        if (out.median) out.median[number_] = median_distance();
        if (out.instance) out.instance[number_] = heaviest_instance();
        if (out.normal) write_normal(out.normal + 3 * number_);
    }

    // Where the ray has absorbed half of what it absorbs; `core/render/tracers/torch/ray_passes.py`.
    UNISIM_DEVICE float median_distance() const {
        if (background_median_ > 0) return background_median_;
        const float wanted = (1 + transmittance_) / 2;
        float depth = 0, last = 0, least = 2;
        for (int n = 0; n < segments_; ++n) {
            const Segment &s = work_.segments[n];
            for (int k = 0; k < s.count; ++k) {
                const int64_t i = s_.at(s.first + k);
                if (!(s_.before[i] > wanted)) continue;
                if (s_.before[i] * exp_of(-s_.tau[i]) <= wanted) depth = crossing(s, k, wanted);
                if (s_.before[i] > least || (s_.before[i] == least && s_.t[i] < last)) continue;
                least = s_.before[i];
                last = s_.t[i];
            }
        }
        // between two intervals the transmittance may fall to `wanted` by rounding alone: the crossing is their border
        return depth > 0 ? depth : last;
    }

    // Where in interval k the transmittance falls to `wanted`; the distance is linear there.
    UNISIM_DEVICE float crossing(const Segment &s, int k, float wanted) const {
        const int64_t i = s_.at(s.first + k);
        const unisim_scene &scene = scene_of(s);
        if (s.kind == Segment::MESH || k == 0 || scene.unisim_density) return s_.t[i];
        const float s1 = s_.s[i - s_.stride], s2 = s_.s[i];
        // -log Phi at the crossing, then its distance: the inverse of softplus(-beta s)
        const float y = softplus(-scene.beta * s1) + std::log(s_.before[i] / wanted);
        const float at = -(y + std::log(-std::expm1(-std::fmax(y, 1e-12f)))) / scene.beta;
        const float fraction = std::fmin(std::fmax((s1 - at) / std::fmax(s1 - s2, 1e-9f), 0.0f), 1.0f);
        return s_.t[i - s_.stride] + fraction * (s_.t[i] - s_.t[i - s_.stride]);
    }

    // 1 + the number of the actor with the largest weight, 0 where everything else has more.
    UNISIM_DEVICE int32_t heaviest_instance() const {
        float best = 0, rest = transmittance_;
        int32_t number = 0;
        for (int n = 0; n < segments_; ++n) {
            const Segment &s = work_.segments[n];
            const float weight = weight_of(s);
            if (s.kind == Segment::STATIC || s.kind == Segment::COPY)
                rest += weight;
            else if (weight > best) {
                best = weight;
                int first = 0;
                for (int i = 0; i < (s.kind == Segment::MESH ? in_.active.actor_set_count : s.set); ++i)
                    first += in_.active.actor_sets[i].count;
                number = first + (s.kind == Segment::MESH ? s.set : s.ray.box) + 1;
            }
        }
        return best > rest ? number : 0;
    }

    // The unit normal: the sum over the segments, by weight, of the gradients of the distance at their heaviest
    // samples, by differences on a tetrahedron.
    UNISIM_DEVICE void write_normal(float *out) {
        constexpr float STEP_M = 0.03f;
        float sum[3] = {};
        for (int n = 0; n < segments_; ++n) {
            const Segment &s = work_.segments[n];
            const float weight = weight_of(s);
            if (!(weight > MIN_WEIGHT)) continue;
            if (s.kind == Segment::MESH) {
                for (int a = 0; a < 3; ++a) sum[a] += weight * s.ray.rotation[a];
                continue;
            }
            int best = 0;
            for (int k = 1; k < s.count; ++k)
                if (s_.weight[s_.at(s.first + k)] > s_.weight[s_.at(s.first + best)]) best = k;
            const float t = s_.t[s_.at(s.first + best)];
            float gradient[3] = {}, world[3], length = 0;
            for (int c = 0; c < 4; ++c) {
                // the corners of a tetrahedron
                const float corner[3] = {c == 1 || c == 2 ? -1.0f : 1.0f, c == 2 || c == 3 ? 1.0f : -1.0f,
                                         c == 1 || c == 3 ? 1.0f : -1.0f};
                const float offset[3] = {STEP_M * corner[0], STEP_M * corner[1], STEP_M * corner[2]};
                float x[3];
                place_in_field(s, t, offset, x);
                const float value = evaluate_field(field_of(s), grid_of(s), x, 0.0f, nullptr);
                for (int a = 0; a < 3; ++a) gradient[a] += value * corner[a];
            }
            evaluations_ += 4;
            turn_to_world(s, gradient, world);
            for (const float x : world) length += x * x;
            length = std::fmax(std::sqrt(length), 1e-12f);
            for (int a = 0; a < 3; ++a) sum[a] += weight * world[a] / length;
        }
        const float length = std::fmax(std::sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]), 1e-12f);
        for (int a = 0; a < 3; ++a) out[a] = 1 - transmittance_ > 0.5f ? sum[a] / length : 0.0f;
    }

    // A gradient in the axes of a segment's field, along the world's axes.
    UNISIM_DEVICE void turn_to_world(const Segment &s, const float *gradient, float *world) const {
        float g[3] = {gradient[0], gradient[1], gradient[2]};
        if (s.kind != Segment::ACTOR) {
            const double *m = scene_.volume_from_world;
            for (int a = 0; a < 3; ++a)
                g[a] = static_cast<float>(m[a] * gradient[0] + m[4 + a] * gradient[1] + m[8 + a] * gradient[2]);
        }
        for (int a = 0; a < 3; ++a)
            world[a] = s.kind == Segment::STATIC ? g[a]
                                                 : s.ray.rotation[3 * a] * g[0] + s.ray.rotation[3 * a + 1] * g[1] +
                                                       s.ray.rotation[3 * a + 2] * g[2];
    }

    static constexpr float EMPTY_M = 10.0f, END = 3.4e38f;
    const TraceInputs &in_;
    const Workspace &work_;
    const SampleArrays &s_;
    const unisim_scene &scene_;
    const unisim_sampling &how_;
    int64_t number_;
    int32_t evaluations_;
    double time_;
    float o_[3], d_[3], far_; // in the volume's coordinates, metres; where the ray leaves the volume
    int segments_, samples_;  // how many are in use
    int hits_, static_;       // segments of actors, which come first; the number of the static one
    // after all segments, and after all but foreign ones; before the background
    float transmittance_, transmittance_without_foreign_, before_background_;
    float weight_, weighted_t_, background_t_; // sums of weights, and of distances by weight
    float background_median_;
};

} // namespace
