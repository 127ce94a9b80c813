// A ray's way through the cells that can stop it: where it asks for the distance next, given what it was told so far.
//
// Steps follow the distance: as far as the last two answers say that the surface is, and a little beyond, so that two answers
// hold it between them; never longer than what a thin thing could hide in. `core/surface_march.py` is the same, a ray at a time.
#pragma once
#include "cells.h"
#include "lanes.h"

#include <cmath>

namespace {

// A stretch of a ray, metres, through cells that can stop it.
struct Run {
    float begin, end;
};

struct Probe {
    float t, s;
    int slot; // of its hidden units
    bool beyond = false; // free space lies between the answer before and this one
    float stopped = 0;   // `stopped_at` of s, worked out once
};

// Where a strand asks next.
struct Place {
    int strand;
    float t;
};

// -log Phi(s): what a surface has stopped of a ray where the distance is s; 0 where that is less than anybody sees.
inline float stopped_at(float s, float beta) {
    const float a = -beta * s;
    return a < -12.0f ? 0.0f : a > 20.0f ? a : std::log1p(std::exp(a));
}

// Where a ray is in the cell about its place t. Runs begin and end there to the bit: outside a cell nobody taught the distance.
inline Run cell_about(const unisim_scene &scene, const float *o, const float *d, float t) {
    const float size = scene.voxel_m / CELLS;
    Run run{0, 3e38f};
    for (int a = 0; a < 3; ++a) {
        if (std::fabs(d[a]) < 1e-9f) continue;
        const float low = std::floor((o[a] + t * d[a]) / size) * size;
        const float first = (low - o[a]) / d[a], second = (low + size - o[a]) / d[a];
        run.begin = std::max(run.begin, std::min(first, second));
        run.end = std::min(run.end, std::max(first, second));
    }
    return run.begin < run.end ? run : Run{t, t};
}

// How many runs are looked for at a time: most rays are stopped in the first.
constexpr size_t RUNS = 2;
// No ray takes more steps, whatever its numbers are: NaN, or a direction of no length.
constexpr float MOST_STEPS = 1e6f, MOST_BOX_STEPS = 1e4f;

// Steps of `step` from t_near to t_far; NaN counts as most.
inline int32_t steps_between(float t_near, float t_far, float step, float most) {
    return t_far > t_near ? static_cast<int32_t>(std::min(most, std::ceil((t_far - t_near) / step))) : 0;
}

// Steps of a cell through the volume's cells: the next RUNS runs or a few more, each whole, from step `next` on, which is moved;
// none where there are no more. `behind` says whether solid cells count at a place, where an emptied box may have opened them.
template <class Behind>
void find_runs(const unisim_scene &scene, const float *o, const float *d, float t_near, float t_far, const Behind &behind, int32_t &next_step,
               std::vector<Run> &out) {
    out.clear();
    const float inverse = 1.0f / scene.voxel_m;
    const float fastest = std::max(std::fabs(d[0]), std::max(std::fabs(d[1]), std::fabs(d[2])));
    // a cell along the axis that the ray follows most; a little short of a voxel's steps, for rounding
    const float step = scene.voxel_m / (CELLS * std::max(fastest, 0.5f)), steps_a_voxel = CELLS * 0.999f;
    const int32_t steps = steps_between(t_near, t_far, step, MOST_STEPS);
    float ramp[LANES];
    for (int k = 0; k < LANES; ++k) ramp[k] = static_cast<float>(k) + 0.5f;
    int32_t last = -2, i = next_step;
    while (i < steps && (out.size() < RUNS || last == i - 1)) {
        // one vector of steps: they do not wait for each other
        const lanes t = t_near + (static_cast<float>(i) + load(ramp)) * step;
        int_lanes cell{}, inside = ~int_lanes{}, part{};
        for (int a = 0; a < 3; ++a) {
            lanes x = (o[a] + t * d[a]) * inverse;
            const int_lanes in = (x >= 0.0f) & (x < static_cast<float>(scene.voxel_shape[a]));
            // truncation is the floor where the result is not negative
            x = in ? x : lanes{};
            const int_lanes c = __builtin_convertvector(x, int_lanes);
            inside &= in;
            cell = cell * scene.voxel_shape[a] + c;
            part = part * CELLS + __builtin_convertvector((x - __builtin_convertvector(c, lanes)) * static_cast<float>(CELLS), int_lanes);
        }
        cell &= inside;
        int32_t at[LANES], of[LANES];
        std::memcpy(at, &cell, sizeof at);
        uint8_t clear[LANES], all = 255;
        for (int k = 0; k < LANES; ++k) all = std::min(all, clear[k] = scene.clearance[at[k]]);
        if (all) {
            i += std::max(LANES, LANES - 1 + static_cast<int32_t>(static_cast<float>(clear[LANES - 1] - 1) * steps_a_voxel));
            continue;
        }
        int32_t in[LANES];
        std::memcpy(in, &inside, sizeof in);
        std::memcpy(of, &part, sizeof of);
        for (int k = 0; k < std::min(LANES, steps - i); ++k) {
            if (!in[k] || clear[k]) continue;
            const int kind = scene.cells[at[k]] >> 2 * of[k] & 3;
            const float middle = t_near + (static_cast<float>(i + k) + 0.5f) * step;
            if (kind == OPEN || (kind == SOLID && !behind(middle))) continue;
            const Run within = cell_about(scene, o, d, middle);
            if (i + k == last + 1)
                out.back().end = within.end;
            else
                out.push_back({std::max(within.begin, t_near), within.end});
            last = i + k;
        }
        i += LANES;
    }
    next_step = i;
    if (!out.empty()) out.back().end = std::min(out.back().end, t_far);
}

// The same through the cells of an actor's box; origin and direction in the box's axes, metres.
inline void find_box_runs(const uint8_t *kinds, const float *o, const float *d, const float *size, float t_near, float t_far, std::vector<Run> &out) {
    out.clear();
    float from[3], along[3], fastest = 1e-9f;
    for (int a = 0; a < 3; ++a) {
        from[a] = (o[a] / size[a] + 0.5f) * BOX_CELLS;
        along[a] = d[a] / size[a] * BOX_CELLS;
        fastest = std::max(fastest, std::fabs(along[a]));
    }
    const float step = 0.5f / fastest;
    const int32_t steps = steps_between(t_near, t_far, step, MOST_BOX_STEPS);
    int32_t last = -2;
    for (int32_t i = 0; i < steps; ++i) {
        const float t = t_near + (static_cast<float>(i) + 0.5f) * step;
        int cell = 0;
        for (int a = 0; a < 3; ++a)
            // NaN and anything outside the box go to its nearest cells
            cell = cell * BOX_CELLS + static_cast<int>(std::min(BOX_CELLS - 1.0f, std::max(0.0f, from[a] + t * along[a])));
        if (kinds[cell] != SURFACE) continue;
        const float begin = t_near + static_cast<float>(i) * step;
        if (i == last + 1)
            out.back().end = begin + step;
        else
            out.push_back({begin, begin + step});
        last = i;
    }
    if (!out.empty()) out.back().end = std::min(out.back().end, t_far);
}

// The walk of one strand.
struct Walk {
    size_t run = 0;
    float next = 0;
    float passed = 0;  // optical depth so far
    float outside = 0; // of the last answer: -log Phi
    bool fresh = true; // no answer yet in this run

    // Takes the answer at `next`; false where the walk ends. `more` puts the next runs in the place of those that were walked.
    template <class More>
    bool take(std::vector<Run> &runs, const std::vector<Probe> &probes, float beta, float limit, const unisim_sampling &how, const More &more) {
        const Probe &here = probes.back();
        const float out = here.stopped;
        passed += probes.size() == 1 ? out : std::max(out - outside, 0.0f);
        outside = out;
        if (!(passed < limit)) return false;
        float closing = 1;
        if (!fresh) {
            const Probe &before = probes[probes.size() - 2];
            closing = (before.s - here.s) / std::max(here.t - before.t, 1e-4f);
        }
        const bool first = fresh;
        fresh = false;
        const float longest = how.stride_m * (1 + how.widening * here.t), least = std::max(how.least_step_m, 0.5f / beta);
        float step;
        if (here.s > 0) {
            // on towards the surface and through it, or past what the ray leaves
            const float slope = std::min(std::max(closing, 1 / how.relaxation), 1.5f);
            step = closing > 0 ? here.s / slope + 1.5f / (beta * slope) : here.s;
            step = std::min(step, std::max(longest, how.relaxation * here.s));
        } else {
            // deeper than it takes to be opaque, or a second one would be needed
            const float slope = std::min(std::max(closing, how.least_slope), 1.5f);
            step = std::min((1.5f * limit / beta + here.s) / slope, longest);
        }
        step = std::max(step, least) * (1 + static_cast<float>(probes.size() / 24));
        const float end = runs[run].end;
        // what the first answer in a run says may be of what lies before it
        if (first) step = std::min(step, std::min(0.5f * (end - here.t), how.stride_m));
        if (here.t + step < end && step > 0) {
            next = here.t + step;
            return true;
        }
        // a run is not left unasked where the surface could be before its end
        if (here.t + least < end && here.s < 1.5f * (end - here.t)) {
            next = end;
            return true;
        }
        if (++run >= runs.size()) {
            run = 0;
            more(runs);
            if (runs.empty()) return false;
        }
        next = runs[run].begin;
        fresh = true;
        return true;
    }
};

// Where one more answer tells most: in the interval that stops most of the ray, at the place that halves what it stops. False
// where none stops much, or over no length that matters.
inline bool find_split(const std::vector<Probe> &probes, float beta, float least_weight, size_t &after, float &t) {
    float before = 0, best = least_weight, last = 0;
    bool found = false;
    for (size_t k = 0; k < probes.size(); ++k) {
        const float now = probes[k].stopped, depth = now - last;
        if (k && depth > least_weight && !probes[k].beyond && probes[k].t - probes[k - 1].t > 0.01f) {
            const float weight = std::exp(-before) * (1 - std::exp(-depth));
            if (weight > best) {
                const float s0 = probes[k - 1].s, s1 = probes[k].s, middle = (std::exp(-last) + std::exp(-now)) / 2;
                const float s = std::log(middle / std::max(1 - middle, 1e-6f)) / beta;
                const float share = std::min(std::max((s0 - s) / std::max(s0 - s1, 1e-6f), 0.05f), 0.95f);
                best = weight;
                after = k;
                t = probes[k - 1].t + share * (probes[k].t - probes[k - 1].t);
                found = true;
            }
        }
        before += std::max(depth, 0.0f);
        last = now;
    }
    return found;
}

// Where a ray comes out of free space into what is solid, the surface lies in between: it was learnt from samples on both sides.
// The answer before which the space lies, and the nearest occupied place before it; false where there is none.
inline bool find_face(const unisim_scene &scene, const float *o, const float *d, float t_near, const std::vector<Probe> &probes, size_t &at, float &t) {
    const float step = scene.voxel_m / 2;
    for (size_t k = 0; k < probes.size(); ++k) {
        if (probes[k].stopped < 0.05f) continue;
        const float least = k ? probes[k - 1].t + step : t_near;
        for (t = probes[k].t - step; t > least; t -= step) {
            int64_t cell = 0;
            for (int a = 0; a < 3; ++a) {
                const float x = std::min(std::max((o[a] + t * d[a]) / scene.voxel_m, 0.0f), static_cast<float>(scene.voxel_shape[a] - 1));
                cell = cell * scene.voxel_shape[a] + static_cast<int64_t>(x);
            }
            if (!scene.voxels[cell]) continue;
            at = k;
            return true;
        }
        return false;
    }
    return false;
}

// Strands that are marched together: each takes one answer a round.
struct March {
    std::vector<std::vector<Run>> runs;
    std::vector<std::vector<Probe>> probes; // the answers, rising in t
    std::vector<Place> at;
    std::vector<Probe> told; // at `at`

    // The first `count` strands, whose first runs are in `runs`, from near to far until each is stopped; then the splits. `passed`
    // are the optical depths before them. ask() answers `at` with `told`; more(p, runs) gives strand p its next runs; face(p, at, t)
    // is `find_face` of its answers.
    template <class Ask, class More, class Face>
    void follow(size_t count, const float *passed, float beta, const unisim_sampling &how, const Ask &ask, const More &more, const Face &face,
                float voxel_m) {
        const float limit = -std::log(how.opaque);
        walks_.assign(count, {});
        probes.resize(std::max(probes.size(), count));
        going_.clear();
        for (size_t p = 0; p < count; ++p) {
            probes[p].clear();
            if (runs[p].empty() || !(passed[p] < limit)) continue;
            walks_[p].next = runs[p][0].begin;
            walks_[p].passed = passed[p];
            going_.push_back(p);
        }
        while (!going_.empty()) {
            at.clear();
            for (const size_t p : going_) at.push_back({static_cast<int>(p), walks_[p].next});
            ask();
            weigh(beta);
            size_t kept = 0;
            for (size_t i = 0; i < going_.size(); ++i) {
                const size_t p = going_[i];
                probes[p].push_back(told[i]);
                probes[p].back().beyond = walks_[p].fresh;
                if (walks_[p].take(runs[p], probes[p], beta, limit, how, [&](std::vector<Run> &of) { more(p, of); })) going_[kept++] = p;
            }
            going_.resize(kept);
        }
        if (insert(count, beta, ask, face))
            for (size_t i = 0; i < at.size(); ++i) {
                Probe *faced = &probes[static_cast<size_t>(at[i].strand)][after_[i]];
                faced[1].beyond = faced[1].t - faced[0].t > 0.75f * voxel_m;
            }
        const auto split = [&](size_t p, size_t &after, float &t) { return find_split(probes[p], beta, how.split_weight, after, t); };
        for (int round = 0; round < how.splits && insert(count, beta, ask, split); ++round) {}
    }

  private:
    // One more answer for each strand for which find(p, at, t) names a place and where it belongs; whether there were any.
    template <class Ask, class Find> bool insert(size_t count, float beta, const Ask &ask, const Find &find) {
        at.clear();
        after_.clear();
        for (size_t p = 0; p < count; ++p) {
            size_t after = 0;
            float t = 0;
            if (!find(p, after, t)) continue;
            at.push_back({static_cast<int>(p), t});
            after_.push_back(after);
        }
        if (at.empty()) return false;
        ask();
        weigh(beta);
        for (size_t i = 0; i < at.size(); ++i) {
            std::vector<Probe> &of = probes[static_cast<size_t>(at[i].strand)];
            of.insert(of.begin() + static_cast<int64_t>(after_[i]), told[i]);
        }
        return true;
    }

    void weigh(float beta) {
        for (Probe &probe : told) probe.stopped = stopped_at(probe.s, beta);
    }

    std::vector<Walk> walks_;
    std::vector<size_t> going_, after_;
};

} // namespace
