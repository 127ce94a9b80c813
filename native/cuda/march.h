// One ray's march through cells that can stop it. `../surface_march.h` marches many rays a vector at a time;
// `tests/reference/surface_march.py` is the specification of both.
#pragma once
#include "field.h"

namespace {

// A ray's samples: arrays of `capacity` numbers, `stride` apart, so that neighbouring threads lie beside each other.
// distance, signed distance, optical depth and stop fraction of the interval that ends at the sample, transmittance
// before that interval, weight of the sample
struct SampleArrays {
    float *t, *s, *tau, *stop_fraction, *before, *weight;
    int32_t stride, capacity;

    UNISIM_DEVICE int64_t at(int k) const { return static_cast<int64_t>(k) * stride; }
};

// Finds the runs of a ray through the volume's cells, one after the other.
class VolumeRuns {
  public:
    UNISIM_DEVICE VolumeRuns(const unisim_scene &scene, const float *o, const float *d, float near, float far)
        : scene_(scene), o_(o), d_(d), near_(near), far_(far) {
        const float fastest = greater_of(std::fabs(d[0]), greater_of(std::fabs(d[1]), std::fabs(d[2])));
        step_ = scene.voxel_m / (CELLS * greater_of(fastest, 0.5f));
        steps_ = steps_between(near, far, step_, MAX_STEPS);
    }

    // Sets the next run; false where there is none. cleared(t): whether solid cells count at t, because a box that was
    // emptied nearby may have exposed them.
    template <class Cleared> UNISIM_DEVICE bool next(const Cleared &cleared, Run &run) {
        // steps per voxel are rounded down a little
        constexpr float STEPS_A_VOXEL = CELLS * 0.999f;
        bool begun = false;
        float last = 0;
        for (; next_ < steps_; ++next_) {
            const float middle = near_ + (static_cast<float>(next_) + 0.5f) * step_;
            int64_t voxel;
            int part;
            uint8_t clear = 0;
            bool stops = look_up(middle, voxel, part);
            if (stops) {
                clear = scene_.clearance[voxel];
                if (!clear) {
                    const int kind = scene_.cells[voxel] >> 2 * part & 3;
                    stops = kind == SURFACE || (kind == SOLID && cleared(middle));
                } else
                    stops = false;
            }
            if (stops) {
                if (!begun) run.begin = greater_of(cell_interval(scene_, o_, d_, middle).begin, near_);
                begun = true;
                last = middle;
            } else if (begun)
                break;
            else if (clear > 1)
                next_ += static_cast<int32_t>(static_cast<float>(clear - 1) * STEPS_A_VOXEL) - 1;
        }
        if (!begun) return false;
        run.end = cell_interval(scene_, o_, d_, last).end;
        if (next_ >= steps_) run.end = lesser_of(run.end, far_);
        return true;
    }

  private:
    // The voxel and the cell in it at t; false outside the volume.
    UNISIM_DEVICE bool look_up(float t, int64_t &voxel, int &part) const {
        const float inverse = 1.0f / scene_.voxel_m;
        voxel = part = 0;
        for (int a = 0; a < 3; ++a) {
            const float x = (o_[a] + t * d_[a]) * inverse;
            if (!(x >= 0.0f && x < static_cast<float>(scene_.voxel_shape[a]))) return false;
            const int32_t c = static_cast<int32_t>(x);
            voxel = voxel * scene_.voxel_shape[a] + c;
            part = part * CELLS + static_cast<int>((x - static_cast<float>(c)) * static_cast<float>(CELLS));
        }
        return true;
    }

    const unisim_scene &scene_;
    const float *o_, *d_;
    float near_, far_, step_;
    int32_t steps_, next_ = 0;
};

// Finds the runs of a ray through the cells of an actor's box, in the field's metres along the ray.
class BoxRuns {
  public:
    UNISIM_DEVICE BoxRuns(const uint8_t *kinds, const BoxHit &hit, const float *size) : kinds_(kinds), hit_(hit) {
        float fastest = 1e-9f;
        for (int a = 0; a < 3; ++a) {
            from_[a] = (hit.o[a] / size[a] + 0.5f) * BOX_CELLS;
            along_[a] = hit.d[a] / size[a] * BOX_CELLS;
            fastest = greater_of(fastest, std::fabs(along_[a]));
        }
        step_ = 0.5f / fastest;
        steps_ = steps_between(hit.t_near, hit.t_far, step_, MAX_BOX_STEPS);
    }

    UNISIM_DEVICE bool next(Run &run) {
        bool begun = false;
        for (; next_ < steps_; ++next_) {
            if (!stops(hit_.t_near + (static_cast<float>(next_) + 0.5f) * step_)) {
                if (begun) break;
                continue;
            }
            const float begin = hit_.t_near + static_cast<float>(next_) * step_;
            if (!begun) run.begin = begin;
            run.end = begin + step_;
            begun = true;
        }
        if (!begun) return false;
        if (next_ >= steps_) run.end = lesser_of(run.end, hit_.t_far);
        run.begin *= hit_.stretch;
        run.end *= hit_.stretch;
        return true;
    }

  private:
    UNISIM_DEVICE bool stops(float t) const {
        int cell = 0;
        for (int a = 0; a < 3; ++a) {
            // NaN and points outside the box are clamped to its nearest cells
            const float x = from_[a] + t * along_[a], above = x > 0.0f ? x : 0.0f;
            cell = cell * BOX_CELLS + static_cast<int>(above < BOX_CELLS - 1.0f ? above : BOX_CELLS - 1.0f);
        }
        return kinds_[cell] == SURFACE;
    }

    const uint8_t *kinds_;
    const BoxHit &hit_;
    float from_[3], along_[3], step_;
    int32_t steps_, next_ = 0;
};

// One segment's march: its samples are numbers `first` to before `first` + `count` of the ray's.
struct March {
    const SampleArrays &samples;
    int first;
    float beta;
    const unisim_sampling &how;
    int count = 0;
    bool full = false; // whether there was no room for a sample

    // Samples along the runs of next_run(run), until the transmittance is below `opaque`. distance(t) evaluates the
    // field, t in the field's metres; `total` is the optical depth before the segment. While it is marched, `tau` has
    // `optical_depth_at` and `stop_fraction` whether free space lies before a sample: such intervals are not split.
    template <class Distance, class NextRun>
    UNISIM_DEVICE void along(float total, const Distance &distance, NextRun &&next_run) {
        const float max_depth = -std::log(how.opaque), shortest = greater_of(how.min_step_m, 0.5f / beta);
        Run run;
        if (!(total < max_depth) || !next_run(run)) return;
        float t = run.begin, last_depth = 0;
        for (bool begins = true;;) {
            const float s = distance(t), depth = optical_depth_at(s, beta);
            if (!insert(count, t, s, depth, begins)) return;
            float closing = 1;
            if (count > 1) {
                const int64_t before = samples.at(first + count - 2);
                if (!begins) closing = (samples.s[before] - s) / greater_of(t - samples.t[before], 1e-4f);
                // NaN stays in the depth, and ends the march
                const float rise = depth - last_depth;
                total += 0.0f > rise ? 0.0f : rise;
            } else
                total += depth;
            last_depth = depth;
            if (!(total < max_depth)) return;
            const float step = step_from(t, s, closing, max_depth, shortest, begins, run.end);
            if (t + step < run.end && step > 0.0f) {
                t += step;
                begins = false;
            } else if (t + shortest < run.end && s < 1.5f * (run.end - t)) {
                t = run.end; // the end of a run is evaluated where the surface could lie before it
                begins = false;
            } else {
                if (!next_run(run)) return;
                t = run.begin;
                begins = true;
            }
        }
    }

    // Places one more sample in the interval that absorbs most of the ray, `splits` times.
    template <class Distance> UNISIM_DEVICE void split(const Distance &distance) {
        for (int round = 0; round < how.splits; ++round) {
            int before;
            float t;
            if (!place_of_split(before, t)) return;
            const float s = distance(t);
            if (!insert(before, t, s, optical_depth_at(s, beta), false)) return;
        }
    }

    // Inserts a sample before number k of the segment's.
    UNISIM_DEVICE bool insert(int k, float t, float s, float depth, bool after_free) {
        if (first + count >= samples.capacity) {
            full = true;
            return false;
        }
        for (int i = count; i > k; --i) {
            const int64_t to = samples.at(first + i), from = samples.at(first + i - 1);
            samples.t[to] = samples.t[from];
            samples.s[to] = samples.s[from];
            samples.tau[to] = samples.tau[from];
            samples.stop_fraction[to] = samples.stop_fraction[from];
        }
        const int64_t here = samples.at(first + k);
        samples.t[here] = t;
        samples.s[here] = s;
        samples.tau[here] = depth;
        samples.stop_fraction[here] = after_free ? 1.0f : 0.0f;
        ++count;
        return true;
    }

  private:
    UNISIM_DEVICE float step_from(float t, float s, float closing, float max_depth, float shortest, bool begins,
                                  float end) const {
        const float longest = how.stride_m * (1.0f + how.step_growth_per_m * t);
        float step;
        if (s > 0.0f) {
            // towards the surface and through it, or past a surface that the ray moves away from
            const float slope = lesser_of(greater_of(closing, 1 / how.relaxation), 1.5f);
            step = closing > 0.0f ? s / slope + 1.5f / (beta * slope) : s;
            step = lesser_of(step, greater_of(longest, how.relaxation * s));
        } else {
            // behind a surface: deeper than it takes to be opaque, so that one step suffices
            const float fall = lesser_of(greater_of(closing, how.min_slope), 1.5f);
            step = lesser_of((1.5f * max_depth / beta + s) / fall, longest);
        }
        step = greater_of(step, shortest) * static_cast<float>(1 + count / 24);
        // the distance at the first sample of a run may be that to a surface before the run
        return begins ? lesser_of(step, lesser_of(0.5f * (end - t), how.stride_m)) : step;
    }

    // Where one more sample is worth most: in the interval of the largest weight, at the place that halves its
    // opacity. False where no interval has at least `split_weight` over more than a centimetre.
    UNISIM_DEVICE bool place_of_split(int &before, float &place) const {
        const float min_weight = how.split_weight;
        float passed = 0, last = 0, best = min_weight, best_last = 0, best_now = 0;
        int split = 0;
        for (int k = 0; k < count; ++k) {
            const int64_t i = samples.at(first + k);
            const float now = samples.tau[i], increase = now - last;
            if (k && increase > min_weight && samples.stop_fraction[i] == 0 &&
                samples.t[i] - samples.t[i - samples.stride] > 0.01f) {
                const float weight = exp_of(-passed) * (1.0f - exp_of(-increase));
                if (weight > best) {
                    best = weight;
                    split = k;
                    best_last = last;
                    best_now = now;
                }
            }
            passed += increase > 0.0f ? increase : 0.0f;
            last = now;
        }
        if (!split) return false;
        const int64_t i = samples.at(first + split);
        const float s0 = samples.s[i - samples.stride], s1 = samples.s[i], t0 = samples.t[i - samples.stride],
                    t1 = samples.t[i];
        const float middle = (exp_of(-best_last) + exp_of(-best_now)) * 0.5f;
        const float at = std::log(middle / greater_of(1.0f - middle, 1e-6f)) / beta;
        const float fraction = lesser_of(greater_of((s0 - at) / greater_of(s0 - s1, 1e-6f), 0.05f), 0.95f);
        before = split;
        place = t0 + fraction * (t1 - t0);
        return true;
    }
};

} // namespace
