// A ray's way through the cells that can stop it: where it asks for the distance next, given what it was told so far.
//
// Steps follow the distance: as far as the last two answers say that the surface is, and a little beyond, so that two answers
// hold it between them; never longer than what a thin thing could hide in. `tests/reference/surface_march.py` is the same, a ray at a time.
#pragma once
#include "cells.h"
#include "lanes.h"

#include <cmath>

namespace {

// A stretch of a ray, metres, through cells that can stop it.
struct Run {
    float begin, end;
};

// -log Phi(s): what a surface has stopped of a ray where the distance is s; 0 where that is less than anybody sees.
inline lanes stopped_at(const lanes &s, float beta) {
    const lanes a = -beta * s;
    return a < -12.0f ? lanes{} : softplus(a);
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
    for (int k = 0; k < LANES; ++k) ramp[k] = static_cast<float>(k);
    const lanes index = load(ramp);
    int32_t at[LANES];
    uint8_t clear[LANES];
    // the voxels at places, their clearance into `clear`, 0 outside; `part`: the cells in them
    const auto look = [&](const lanes &t, int_lanes &inside, int_lanes &part) {
        int_lanes cell{};
        inside = ~int_lanes{};
        part = int_lanes{};
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
        store(at, cell & inside);
        for (int k = 0; k < LANES; ++k) clear[k] = scene.clearance[at[k]];
    };
    const auto least_clear = [&] {
        uint8_t all = 255;
        for (int k = 0; k < LANES; ++k) all = std::min(all, clear[k]);
        return all;
    };
    // a run ends with the cell about the last middle in it
    const auto finish_run = [&] {
        if (!out.empty()) out.back().end = cell_about(scene, o, d, out.back().end).end;
    };
    int_lanes inside, part;
    int32_t last = -2, i = next_step;
    bool open = true; // nothing was met of late
    while (i < steps && (out.size() < RUNS || last == i - 1)) {
        if (open) {
            // two steps at once: where the voxel between them has none beside it either, both are in the open
            look(t_near + (static_cast<float>(i + 1) + 2.0f * index) * step, inside, part);
            const uint8_t all = least_clear();
            if (all > 1 && !any(~inside)) {
                i += std::max(2 * LANES, 2 * LANES - 1 + static_cast<int32_t>(static_cast<float>(clear[LANES - 1] - 1) * steps_a_voxel - 0.5f));
                continue;
            }
            int32_t in[LANES];
            store(in, inside);
            for (int k = 0; k < LANES && clear[k] > 1 && in[k]; ++k) i += 2;
        }
        // one vector of steps: they do not wait for each other
        look(t_near + (static_cast<float>(i) + (index + 0.5f)) * step, inside, part);
        open = least_clear() > 0;
        if (open) {
            i += std::max(LANES, LANES - 1 + static_cast<int32_t>(static_cast<float>(clear[LANES - 1] - 1) * steps_a_voxel));
            continue;
        }
        int32_t in[LANES], of[LANES];
        store(in, inside);
        store(of, part);
        for (int k = 0; k < std::min(LANES, steps - i); ++k) {
            if (!in[k] || clear[k]) continue;
            const int kind = scene.cells[at[k]] >> 2 * of[k] & 3;
            const float middle = t_near + (static_cast<float>(i + k) + 0.5f) * step;
            if (kind == OPEN || (kind == SOLID && !behind(middle))) continue;
            if (i + k != last + 1) {
                finish_run();
                out.push_back({std::max(cell_about(scene, o, d, middle).begin, t_near), 0.0f});
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

// Where a ray comes out of free space into what is solid, the surface lies in between: it was learnt from samples on both sides.
// Of `count` answers at places `probes`, `stride` apart: the one before which the space lies, and the nearest occupied place before it; false where there is none.
inline bool find_face(const unisim_scene &scene, const float *o, const float *d, float t_near, const float *probes,
                      const float *stopped, int count, int stride, int &at, float &t) {
    const float step = scene.voxel_m / 2;
    for (int k = 0; k < count; ++k) {
        if (stopped[k * stride] < 0.05f) continue;
        const float least = k ? probes[(k - 1) * stride] + step : t_near;
        for (t = probes[k * stride] - step; t > least; t -= step) {
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

// Strands that are marched together, each taking one answer a round. Answer k of strand p is number k * stride + p.
class March {
  public:
    std::vector<std::vector<Run>> runs; // of each strand: those that were found and are not walked yet
    int stride = 0, rows = 0;           // rows: answers of the strand that has most
    std::vector<int32_t> counts;        // of answers
    std::vector<float> t, s, stopped;   // the answers, rising in t; `stopped_at` of s, worked out once
    std::vector<int32_t> slot, beyond;  // slots of hidden units; whether free space lies between the answer before and this one
    std::vector<int32_t> asked;         // strands that ask, at places next[strand]
    std::vector<float> next, told;      // told, told_slot: answers by strand
    std::vector<int32_t> told_slot;

    // The first `count` strands, whose first runs are in `runs`, from near to far until each is stopped; then the splits. `passed`
    // are the optical depths before them. ask() answers `asked`; more(p, runs) gives strand p its next runs; face(p, at, t)
    // is `find_face` of its answers.
    template <class Ask, class More, class Face>
    void follow(int count, const float *passed, float beta, const unisim_sampling &how, const Ask &ask, const More &more, const Face &face,
                float voxel_m) {
        begin(count, passed, -std::log(how.opaque));
        while (!asked.empty()) {
            ask();
            append(beta);
            take(beta, how, more);
        }
        asked.clear();
        for (int p = 0; p < count; ++p) {
            int at;
            if (!face(p, at, next[p])) continue;
            asked.push_back(p);
            after_[p] = at;
        }
        if (!asked.empty()) {
            ask();
            insert(beta);
            for (const int p : asked) {
                const size_t i = static_cast<size_t>(after_[p] * stride + p);
                beyond[i + stride] = t[i + stride] - t[i] > 0.75f * voxel_m ? -1 : 0;
            }
        }
        for (int round = 0; round < how.splits; ++round) {
            find_splits(beta, how.split_weight);
            if (asked.empty()) break;
            ask();
            insert(beta);
        }
    }

  private:
    void begin(int count, const float *passed, float limit) {
        stride = (count + LANES - 1) / LANES * LANES;
        rows = 0;
        for (auto *v : {&t, &s, &stopped}) v->clear();
        for (auto *v : {&slot, &beyond, &asked}) v->clear();
        for (auto *v : {&next, &told, &passed_, &outside_, &end_}) v->assign(static_cast<size_t>(stride), 0.0f);
        for (auto *v : {&counts, &told_slot, &after_, &going_, &fresh_, &run_}) v->assign(static_cast<size_t>(stride), 0);
        for (int p = 0; p < count; ++p) {
            if (runs[p].empty() || !(passed[p] < limit)) continue;
            next[p] = runs[p][0].begin;
            end_[p] = runs[p][0].end;
            passed_[p] = passed[p];
            going_[p] = fresh_[p] = -1;
            asked.push_back(p);
        }
    }

    void grow() {
        ++rows;
        const size_t n = static_cast<size_t>(rows) * stride;
        for (auto *v : {&t, &s, &stopped}) v->resize(n);
        for (auto *v : {&slot, &beyond}) v->resize(n);
    }

    // Adds the answers of a round to their strands: all have taken the same number before.
    void append(float beta) {
        const size_t row = static_cast<size_t>(rows) * stride;
        grow();
        for (int p = 0; p < stride; p += LANES) {
            const lanes here = load(&told[p]);
            store(&t[row + p], load(&next[p]));
            store(&s[row + p], here);
            store(&stopped[row + p], stopped_at(here, beta));
            store(&slot[row + p], load(&told_slot[p]));
            store(&beyond[row + p], load(&fresh_[p]));
            store(&counts[p], load(&counts[p]) - load(&going_[p]));
        }
    }

    // Where strands go from their last answers; those that go on are `asked`.
    template <class More> void take(float beta, const unisim_sampling &how, const More &more) {
        const float limit = -std::log(how.opaque), shortest = std::max(how.least_step_m, 0.5f / beta);
        const float patience = 1 + static_cast<float>(rows / 24);
        const size_t row = static_cast<size_t>(rows - 1) * stride;
        asked.clear();
        for (int p = 0; p < stride; p += LANES) {
            int_lanes going = load(&going_[p]);
            if (!any(going)) continue;
            const lanes here_t = load(&t[row + p]), here_s = load(&s[row + p]), out = load(&stopped[row + p]), end = load(&end_[p]);
            // what is not a number stays so in the depth, and such a strand ends
            lanes closing = spread(1.0f), passed = load(&passed_[p]);
            const int_lanes fresh = load(&fresh_[p]);
            if (rows > 1) {
                const lanes before = (load(&s[row - stride + p]) - here_s) / most(here_t - load(&t[row - stride + p]), spread(1e-4f));
                closing = fresh ? closing : before;
                passed += most(lanes{}, out - load(&outside_[p]));
            } else
                passed += out;
            store(&passed_[p], passed);
            store(&outside_[p], out);
            going &= passed < limit;
            const lanes longest = how.stride_m * (1.0f + how.widening * here_t);
            // on towards the surface and through it, or past what the ray leaves
            const lanes slope = least(most(closing, spread(1 / how.relaxation)), spread(1.5f));
            lanes ahead = closing > 0.0f ? here_s / slope + 1.5f / (beta * slope) : here_s;
            ahead = least(ahead, most(longest, how.relaxation * here_s));
            // deeper than it takes to be opaque, or a second one would be needed
            const lanes fall = least(most(closing, spread(how.least_slope)), spread(1.5f));
            const lanes behind = least((1.5f * limit / beta + here_s) / fall, longest);
            lanes step = most(here_s > 0.0f ? ahead : behind, spread(shortest)) * patience;
            // what the first answer in a run says may be of what lies before it
            step = fresh ? least(step, least(0.5f * (end - here_t), spread(how.stride_m))) : step;
            const int_lanes within = (here_t + step < end) & (step > 0.0f);
            // a run is not left unasked where the surface could be before its end
            const int_lanes to_end = (here_t + shortest < end) & (here_s < 1.5f * (end - here_t)) & ~within;
            store(&next[p], within ? here_t + step : end);
            int_lanes leaves = going & ~within & ~to_end;
            store(&going_[p], going);
            store(&fresh_[p], leaves);
            if (any(leaves)) begin_runs(p, more);
            for (int k = p; k < p + LANES; ++k)
                if (going_[k]) asked.push_back(k);
        }
    }

    // The next runs of the strands from `first` on that left theirs.
    template <class More> void begin_runs(int first, const More &more) {
        for (int p = first; p < first + LANES; ++p) {
            if (!fresh_[p]) continue;
            if (static_cast<size_t>(++run_[p]) >= runs[p].size()) {
                run_[p] = 0;
                more(p, runs[p]);
                if (runs[p].empty()) {
                    going_[p] = 0;
                    continue;
                }
            }
            next[p] = runs[p][run_[p]].begin;
            end_[p] = runs[p][run_[p]].end;
        }
    }

    // Where one more answer tells most, of each strand: in the interval that stops most of the ray, at the place that halves what
    // it stops. None where none stops much, or over no length that matters.
    void find_splits(float beta, float least_weight) {
        asked.clear();
        for (int p = 0; p < stride; p += LANES) {
            const int_lanes counts_of = load(&counts[p]);
            lanes before{}, last{}, best = spread(least_weight), s0{}, s1{}, t0{}, t1{}, last_of{}, now_of{};
            int_lanes after{};
            for (int k = 0; k < rows; ++k) {
                const size_t i = static_cast<size_t>(k * stride + p);
                const int_lanes here = k < counts_of;
                const lanes now = here ? load(&stopped[i]) : last, depth = now - last;
                int_lanes heavy = here & (depth > least_weight) & ~load(&beyond[i]);
                if (k && any(heavy)) {
                    heavy &= load(&t[i]) - load(&t[i - stride]) > 0.01f;
                    const lanes weight = exp_of(-before) * (1.0f - exp_of(-depth));
                    heavy &= weight > best;
                    best = heavy ? weight : best;
                    after = heavy ? int_lanes{} + k : after;
                    s0 = heavy ? load(&s[i - stride]) : s0;
                    s1 = heavy ? load(&s[i]) : s1;
                    t0 = heavy ? load(&t[i - stride]) : t0;
                    t1 = heavy ? load(&t[i]) : t1;
                    last_of = heavy ? last : last_of;
                    now_of = heavy ? now : now_of;
                }
                before += most(depth, lanes{});
                last = now;
            }
            store(&after_[p], after);
            if (!any(after)) continue;
            const lanes middle = (exp_of(-last_of) + exp_of(-now_of)) * 0.5f;
            const lanes at = log_of(middle / most(1.0f - middle, spread(1e-6f))) / beta;
            const lanes share = least(most((s0 - at) / most(s0 - s1, spread(1e-6f)), spread(0.05f)), spread(0.95f));
            store(&next[p], t0 + share * (t1 - t0));
            for (int k = p; k < p + LANES; ++k)
                if (after_[k]) asked.push_back(k);
        }
    }

    // Puts the answers of those that asked before their answers `after_`.
    void insert(float beta) {
        grow();
        going_.assign(static_cast<size_t>(stride), 0);
        for (const int p : asked) {
            going_[p] = -1;
            ++counts[p];
        }
        for (int p = 0; p < stride; p += LANES) {
            const int_lanes going = load(&going_[p]), after = load(&after_[p]);
            if (!any(going)) continue;
            const lanes told_here = load(&told[p]);
            const auto place = [&](auto *of, auto value) {
                for (int k = rows - 1; k >= 0; --k) {
                    const int_lanes here = going & (k == after), behind = going & (k > after);
                    if (!any(here | behind)) break;
                    auto *row = of + static_cast<size_t>(k * stride + p);
                    auto kept = load(row);
                    if (k) kept = behind ? load(row - stride) : kept;
                    store(row, here ? value : kept);
                }
            };
            place(t.data(), load(&next[p]));
            place(s.data(), told_here);
            place(stopped.data(), stopped_at(told_here, beta));
            place(slot.data(), load(&told_slot[p]));
            place(beyond.data(), int_lanes{});
        }
    }

    std::vector<float> passed_, outside_, end_;             // optical depth so far; -log Phi of the last answer; of the run
    std::vector<int32_t> after_, going_, fresh_, run_;      // fresh_: no answer yet in this run
};

} // namespace
