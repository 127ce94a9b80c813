// The march of a ray through cells that can stop it: where the distance is evaluated next, given the samples so far.
//
// A step goes to where the last two samples predict the surface, and a little further, so that two samples enclose
// it. Steps are bounded by the thickness that an object must have to be found. `tests/reference/surface_march.py` is
// the specification, one ray at a time.
#pragma once
#include "cells.h"
#include "simd.h"

#include <cmath>

namespace {

// -log Phi(s): the optical depth in front of a place where the distance is s; 0 where that is too small to be visible.
inline simd_float optical_depth_at(const simd_float &s, float beta) {
    const simd_float a = -beta * s;
    return a < -12.0f ? simd_float{} : softplus(a);
}

// How many runs are found at a time: most rays are stopped in the first one.
constexpr size_t RUNS = 2;
// Finds the next RUNS runs through the volume's cells, or a few more, in steps of one cell from `next_step` on, which
// is advanced. Runs are complete; there are none where the ray has no more. cleared(t) says whether solid cells count
// at t, because a box that was emptied nearby may have exposed them.
template <class Cleared>
void find_runs(const unisim_scene &scene, const float *o, const float *d, float t_near, float t_far,
               const Cleared &cleared, int32_t &next_step, std::vector<Run> &out) {
    out.clear();
    const float inverse = 1.0f / scene.voxel_m;
    const float fastest = std::max(std::fabs(d[0]), std::max(std::fabs(d[1]), std::fabs(d[2])));
    // one cell along the axis of the largest direction component; steps per voxel are rounded down a little
    const float step = scene.voxel_m / (CELLS * std::max(fastest, 0.5f)), steps_a_voxel = CELLS * 0.999f;
    const int32_t steps = steps_between(t_near, t_far, step, MAX_STEPS);
    float ramp[LANES];
    for (int k = 0; k < LANES; ++k) ramp[k] = static_cast<float>(k);
    const simd_float index = load(ramp);
    int32_t at[LANES];
    uint8_t clear[LANES];
    // the voxels at places t, their clearance into `clear`; `inside`: whether they are in the volume; `part`: the
    // cell in the voxel
    const auto look_up = [&](const simd_float &t, simd_int &inside, simd_int &part) {
        simd_int cell{};
        inside = ~simd_int{};
        part = simd_int{};
        for (int a = 0; a < 3; ++a) {
            simd_float x = (o[a] + t * d[a]) * inverse;
            const simd_int in = (x >= 0.0f) & (x < static_cast<float>(scene.voxel_shape[a]));
            // truncation is the floor where the result is not negative
            x = in ? x : simd_float{};
            const simd_int c = __builtin_convertvector(x, simd_int);
            inside &= in;
            cell = cell * scene.voxel_shape[a] + c;
            part = part * CELLS +
                   __builtin_convertvector((x - __builtin_convertvector(c, simd_float)) * static_cast<float>(CELLS),
                                           simd_int);
        }
        store(at, cell & inside);
        for (int k = 0; k < LANES; ++k) clear[k] = scene.clearance[at[k]];
    };
    const auto min_clearance = [&] {
        uint8_t all = 255;
        for (int k = 0; k < LANES; ++k) all = std::min(all, clear[k]);
        return all;
    };
    // a run ends where the cell of its last step ends
    const auto finish_run = [&] {
        if (!out.empty()) out.back().end = cell_interval(scene, o, d, out.back().end).end;
    };
    simd_int inside, part;
    int32_t last = -2, i = next_step;
    bool open = true; // whether the last steps were all in open cells
    while (i < steps && (out.size() < RUNS || last == i - 1)) {
        if (open) {
            // every second step: where the voxel at it has a clearance above 1, the step before it is open too
            look_up(t_near + (static_cast<float>(i + 1) + 2.0f * index) * step, inside, part);
            const uint8_t all = min_clearance();
            if (all > 1 && !any(~inside)) {
                i +=
                    std::max(2 * LANES,
                             2 * LANES - 1 +
                                 static_cast<int32_t>(static_cast<float>(clear[LANES - 1] - 1) * steps_a_voxel - 0.5f));
                continue;
            }
            int32_t in[LANES];
            store(in, inside);
            for (int k = 0; k < LANES && clear[k] > 1 && in[k]; ++k) i += 2;
        }
        // one vector of steps at once
        look_up(t_near + (static_cast<float>(i) + (index + 0.5f)) * step, inside, part);
        open = min_clearance() > 0;
        if (open) {
            i += std::max(LANES,
                          LANES - 1 + static_cast<int32_t>(static_cast<float>(clear[LANES - 1] - 1) * steps_a_voxel));
            continue;
        }
        int32_t in[LANES], of[LANES];
        store(in, inside);
        store(of, part);
        for (int k = 0; k < std::min(LANES, steps - i); ++k) {
            if (!in[k] || clear[k]) continue;
            const int kind = scene.cells[at[k]] >> 2 * of[k] & 3;
            const float middle = t_near + (static_cast<float>(i + k) + 0.5f) * step;
            if (kind == OPEN || (kind == SOLID && !cleared(middle))) continue;
            if (i + k != last + 1) {
                finish_run();
                out.push_back({std::max(cell_interval(scene, o, d, middle).begin, t_near), 0.0f});
            }
            out.back().end = middle;
            last = i + k;
        }
        i += LANES;
    }
    next_step = i;
    finish_run();
    if (!out.empty()) out.back().end = std::min(out.back().end, t_far);
}

// Finds all runs through the cells of an actor's box; origin and direction in the box's axes, metres.
inline void find_box_runs(const uint8_t *kinds, const float *o, const float *d, const float *size, float t_near,
                          float t_far, std::vector<Run> &out) {
    out.clear();
    float from[3], along[3], fastest = 1e-9f;
    for (int a = 0; a < 3; ++a) {
        from[a] = (o[a] / size[a] + 0.5f) * BOX_CELLS;
        along[a] = d[a] / size[a] * BOX_CELLS;
        fastest = std::max(fastest, std::fabs(along[a]));
    }
    const float step = 0.5f / fastest;
    const int32_t steps = steps_between(t_near, t_far, step, MAX_BOX_STEPS);
    int32_t last = -2;
    for (int32_t i = 0; i < steps; ++i) {
        const float t = t_near + (static_cast<float>(i) + 0.5f) * step;
        int cell = 0;
        for (int a = 0; a < 3; ++a)
            // NaN and points outside the box are clamped to its nearest cells
            cell =
                cell * BOX_CELLS + static_cast<int>(std::min(BOX_CELLS - 1.0f, std::max(0.0f, from[a] + t * along[a])));
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

// Segments that are marched together, each with one sample per round. Sample k of segment p is number k * stride + p.
class SurfaceMarch {
  public:
    std::vector<std::vector<Run>> runs;    // of each segment: runs that were found and are not walked yet
    int stride = 0, rows = 0;              // rows: samples of the segment that has most
    std::vector<int32_t> counts;           // of samples
    std::vector<float> t, s, depth;        // the samples, rising in t; depth: `optical_depth_at` of s
    std::vector<int32_t> slot, after_free; // slots of hidden units; whether free space lies before the sample
    std::vector<int32_t> queries;          // segments to evaluate, at places query_t[segment]
    std::vector<float> query_t, query_s;   // query_s, query_slot: results, by segment
    std::vector<int32_t> query_slot;

    // Marches the first `count` segments, whose first runs are in `runs`, from near to far until each is opaque, and
    // then splits intervals. `depth_before`: optical depths before the segments. evaluate() answers `queries`;
    // more(p, runs) replaces a segment's runs by the next ones; face(p, before, t) is `find_face` of its samples.
    template <class Evaluate, class More, class Face>
    void march(int count, const float *depth_before, float beta, const unisim_sampling &how, const Evaluate &evaluate,
               const More &more, const Face &face, float voxel_m) {
        begin(count, depth_before, -std::log(how.opaque));
        while (!queries.empty()) {
            evaluate();
            append(beta);
            advance(beta, how, more);
        }
        queries.clear();
        for (int p = 0; p < count; ++p) {
            int before;
            if (!face(p, before, query_t[p])) continue;
            queries.push_back(p);
            insert_before_[p] = before;
        }
        if (!queries.empty()) {
            evaluate();
            insert(beta);
            for (const int p : queries) {
                const size_t i = static_cast<size_t>(insert_before_[p] * stride + p);
                after_free[i + stride] = t[i + stride] - t[i] > 0.75f * voxel_m ? -1 : 0;
            }
        }
        for (int round = 0; round < how.splits; ++round) {
            find_splits(beta, how.split_weight);
            if (queries.empty()) break;
            evaluate();
            insert(beta);
        }
    }

  private:
    void begin(int count, const float *depth_before, float max_depth) {
        stride = (count + LANES - 1) / LANES * LANES;
        rows = 0;
        for (auto *v : {&t, &s, &depth}) v->clear();
        for (auto *v : {&slot, &after_free, &queries}) v->clear();
        for (auto *v : {&query_t, &query_s, &total_, &last_depth_, &run_end_})
            v->assign(static_cast<size_t>(stride), 0.0f);
        for (auto *v : {&counts, &query_slot, &insert_before_, &active_, &run_begins_, &run_})
            v->assign(static_cast<size_t>(stride), 0);
        for (int p = 0; p < count; ++p) {
            if (runs[p].empty() || !(depth_before[p] < max_depth)) continue;
            query_t[p] = runs[p][0].begin;
            run_end_[p] = runs[p][0].end;
            total_[p] = depth_before[p];
            active_[p] = run_begins_[p] = -1;
            queries.push_back(p);
        }
    }

    void add_row() {
        ++rows;
        const size_t n = static_cast<size_t>(rows) * stride;
        for (auto *v : {&t, &s, &depth}) v->resize(n);
        for (auto *v : {&slot, &after_free}) v->resize(n);
    }

    // Appends the results of a round to their segments: all active ones have the same number of samples.
    void append(float beta) {
        const size_t row = static_cast<size_t>(rows) * stride;
        add_row();
        for (int p = 0; p < stride; p += LANES) {
            const simd_float here = load(&query_s[p]);
            store(&t[row + p], load(&query_t[p]));
            store(&s[row + p], here);
            store(&depth[row + p], optical_depth_at(here, beta));
            store(&slot[row + p], load(&query_slot[p]));
            store(&after_free[row + p], load(&run_begins_[p]));
            store(&counts[p], load(&counts[p]) - load(&active_[p]));
        }
    }

    // The next places of segments, from their last samples; segments that go on are in `queries`.
    template <class More> void advance(float beta, const unisim_sampling &how, const More &more) {
        const float max_depth = -std::log(how.opaque), shortest = std::max(how.min_step_m, 0.5f / beta);
        const float patience = 1 + static_cast<float>(rows / 24);
        const size_t row = static_cast<size_t>(rows - 1) * stride;
        queries.clear();
        for (int p = 0; p < stride; p += LANES) {
            simd_int active = load(&active_[p]);
            if (!any(active)) continue;
            const simd_float here_t = load(&t[row + p]), here_s = load(&s[row + p]), here_depth = load(&depth[row + p]);
            const simd_float end = load(&run_end_[p]);
            // NaN stays in the depth, and ends its segment
            simd_float closing = broadcast(1.0f), total = load(&total_[p]);
            const simd_int first = load(&run_begins_[p]);
            if (rows > 1) {
                const simd_float step_before = max_of(here_t - load(&t[row - stride + p]), broadcast(1e-4f));
                const simd_float slope_before = (load(&s[row - stride + p]) - here_s) / step_before;
                closing = first ? closing : slope_before;
                total += max_of(simd_float{}, here_depth - load(&last_depth_[p]));
            } else
                total += here_depth;
            store(&total_[p], total);
            store(&last_depth_[p], here_depth);
            active &= total < max_depth;
            const simd_float longest = how.stride_m * (1.0f + how.step_growth_per_m * here_t);
            // towards the surface and through it, or past a surface that the ray moves away from
            const simd_float slope = min_of(max_of(closing, broadcast(1 / how.relaxation)), broadcast(1.5f));
            simd_float ahead = closing > 0.0f ? here_s / slope + 1.5f / (beta * slope) : here_s;
            ahead = min_of(ahead, max_of(longest, how.relaxation * here_s));
            // behind a surface: deeper than it takes to be opaque, so that one step suffices
            const simd_float fall = min_of(max_of(closing, broadcast(how.min_slope)), broadcast(1.5f));
            const simd_float behind = min_of((1.5f * max_depth / beta + here_s) / fall, longest);
            simd_float step = max_of(here_s > 0.0f ? ahead : behind, broadcast(shortest)) * patience;
            // the distance at the first sample of a run may be that to a surface before the run
            step = first ? min_of(step, min_of(0.5f * (end - here_t), broadcast(how.stride_m))) : step;
            const simd_int within = (here_t + step < end) & (step > 0.0f);
            // the end of a run is evaluated where the surface could lie before it
            const simd_int to_end = (here_t + shortest < end) & (here_s < 1.5f * (end - here_t)) & ~within;
            store(&query_t[p], within ? here_t + step : end);
            const simd_int leaves = active & ~within & ~to_end;
            store(&active_[p], active);
            store(&run_begins_[p], leaves);
            if (any(leaves)) begin_runs(p, more);
            for (int k = p; k < p + LANES; ++k)
                if (active_[k]) queries.push_back(k);
        }
    }

    // The next runs of a vector of segments, of those that left their runs.
    template <class More> void begin_runs(int first, const More &more) {
        for (int p = first; p < first + LANES; ++p) {
            if (!run_begins_[p]) continue;
            if (static_cast<size_t>(++run_[p]) >= runs[p].size()) {
                run_[p] = 0;
                more(p, runs[p]);
                if (runs[p].empty()) {
                    active_[p] = 0;
                    continue;
                }
            }
            query_t[p] = runs[p][run_[p]].begin;
            run_end_[p] = runs[p][run_[p]].end;
        }
    }

    // Where one more sample of each segment is worth most: in the interval that absorbs most of the ray, at the place
    // that halves its opacity. There is none where no interval absorbs at least `min_weight` over more than a
    // centimetre.
    void find_splits(float beta, float min_weight) {
        queries.clear();
        for (int p = 0; p < stride; p += LANES) {
            const simd_int counts_of = load(&counts[p]);
            simd_float before{}, last{}, best = broadcast(min_weight), s0{}, s1{}, t0{}, t1{}, best_last{}, best_now{};
            simd_int split{};
            for (int k = 0; k < rows; ++k) {
                const size_t i = static_cast<size_t>(k * stride + p);
                const simd_int here = k < counts_of;
                const simd_float now = here ? load(&depth[i]) : last, increase = now - last;
                simd_int heavy = here & (increase > min_weight) & ~load(&after_free[i]);
                if (k && any(heavy)) {
                    heavy &= load(&t[i]) - load(&t[i - stride]) > 0.01f;
                    const simd_float weight = exp_of(-before) * (1.0f - exp_of(-increase));
                    heavy &= weight > best;
                    best = heavy ? weight : best;
                    split = heavy ? simd_int{} + k : split;
                    s0 = heavy ? load(&s[i - stride]) : s0;
                    s1 = heavy ? load(&s[i]) : s1;
                    t0 = heavy ? load(&t[i - stride]) : t0;
                    t1 = heavy ? load(&t[i]) : t1;
                    best_last = heavy ? last : best_last;
                    best_now = heavy ? now : best_now;
                }
                before += max_of(increase, simd_float{});
                last = now;
            }
            store(&insert_before_[p], split);
            if (!any(split)) continue;
            const simd_float middle = (exp_of(-best_last) + exp_of(-best_now)) * 0.5f;
            const simd_float at = log_of(middle / max_of(1.0f - middle, broadcast(1e-6f))) / beta;
            const simd_float fraction =
                min_of(max_of((s0 - at) / max_of(s0 - s1, broadcast(1e-6f)), broadcast(0.05f)), broadcast(0.95f));
            store(&query_t[p], t0 + fraction * (t1 - t0));
            for (int k = p; k < p + LANES; ++k)
                if (insert_before_[k]) queries.push_back(k);
        }
    }

    // Inserts the results of `queries` before the samples `insert_before_`.
    void insert(float beta) {
        add_row();
        active_.assign(static_cast<size_t>(stride), 0);
        for (const int p : queries) {
            active_[p] = -1;
            ++counts[p];
        }
        for (int p = 0; p < stride; p += LANES) {
            const simd_int active = load(&active_[p]), at = load(&insert_before_[p]);
            if (!any(active)) continue;
            const simd_float result = load(&query_s[p]);
            const auto insert_into = [&](auto *of, auto value) {
                for (int k = rows - 1; k >= 0; --k) {
                    const simd_int here = active & (k == at), behind = active & (k > at);
                    if (!any(here | behind)) break;
                    auto *row = of + static_cast<size_t>(k * stride + p);
                    auto kept = load(row);
                    if (k) kept = behind ? load(row - stride) : kept;
                    store(row, here ? value : kept);
                }
            };
            insert_into(t.data(), load(&query_t[p]));
            insert_into(s.data(), result);
            insert_into(depth.data(), optical_depth_at(result, beta));
            insert_into(slot.data(), load(&query_slot[p]));
            insert_into(after_free.data(), simd_int{});
        }
    }

    std::vector<float> total_, last_depth_, run_end_;              // optical depth so far; `depth` of the last sample
    std::vector<int32_t> insert_before_, active_, run_begins_, run_; // run_begins_: this run has no sample yet
};

} // namespace
