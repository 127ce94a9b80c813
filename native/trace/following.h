// Samples of a batch's strands: where they are placed, and what the field says there.
#pragma once
#include "asking.h"
#include "gathering.h"

namespace {

// Samples are asked for in rounds, and rays that are stopped by then take no more.
constexpr int ROUND = 8, FINE_ROUND = 4;
constexpr float EVEN = 0.05f;

class Following {
  public:
    Following(Tile &tile, Asking &asking, Gathering &gathering) : tile_(tile), asking_(asking), gathering_(gathering) {}

    void follow(Batch &b) {
        const unisim_sampling &sampling = tile_.task.sampling;
        asking_.find_ways(b);
        if (b.medium == Medium::copy) {
            b.sample(2 * sampling.samples);
            for (int p = 0; p < b.count; ++p)
                for (int k = 0; k < b.samples; ++k)
                    b.t[static_cast<size_t>(k * b.stride + p)] =
                        b.t_near[p] + (static_cast<float>(k) + 0.5f) / static_cast<float>(b.samples) * (b.t_far[p] - b.t_near[p]);
            ask(b, true);
            return;
        }
        if (tile_.marches(*tile_.fields_of(b).scene)) return march(b);
        const bool still = b.medium == Medium::fixed;
        const int proposals = still ? sampling.proposals : sampling.actor_proposals;
        const int samples_of = still ? sampling.samples : sampling.actor_samples;
        b.sample(proposals);
        quantile_.resize(static_cast<size_t>(std::max(proposals, samples_of)) * b.stride);
        for (int k = 0; k < proposals; ++k)
            for (int p = 0; p < b.count; ++p)
                quantile_[static_cast<size_t>(k * b.stride + p)] = (static_cast<float>(k) + 0.5f) / static_cast<float>(proposals);
        place(b, proposals);
        ask(b, false);
        shares_.resize(static_cast<size_t>(proposals + 1) * b.stride);
        sum_shares(b.tau.data(), proposals, b.stride, EVEN, shares_.data());
        const int stride = b.stride;
        for (int p = 0; p < b.count; ++p) invert_shares(&shares_[p], proposals, stride, samples_of, &quantile_[p]);
        b.sample(samples_of);
        place(b, samples_of);
        ask(b, true);
    }

  private:
    void place(Batch &b, int count) {
        for (int p = 0; p < b.count; ++p) {
            if (b.medium == Medium::fixed)
                place_in(gathering_.occupied[static_cast<size_t>(p)], tile_.scene.voxel_m / 2, b.t_near[p], &quantile_[p], count, b.stride,
                         &b.t[p]);
            else
                for (int k = 0; k < count; ++k)
                    b.t[static_cast<size_t>(k * b.stride + p)] =
                        b.t_near[p] + quantile_[static_cast<size_t>(k * b.stride + p)] * (b.t_far[p] - b.t_near[p]);
        }
    }

    // The field at a batch's samples, in rounds: a strand takes none behind what stops it. `final`: hidden units are kept, and
    // depths are the density's; else they only say where samples shall be.
    void ask(Batch &b, bool final) {
        const unisim_scene &scene = *tile_.fields_of(b).scene;
        const float limit = -std::log(tile_.task.sampling.opaque);
        passed_.assign(static_cast<size_t>(b.count), 0.0f);
        if (b.medium == Medium::actor) behind_the_fixed(b);
        going_.clear();
        for (int p = 0; p < b.count; ++p)
            if (passed_[p] < limit) going_.push_back(p);
        const int round = final ? FINE_ROUND : ROUND;
        for (int from = 0; from < b.samples && !going_.empty(); from += round) {
            const int to = std::min(from + round, b.samples);
            wanted_.clear();
            for (int k = from; k < to; ++k)
                for (const int p : going_) wanted_.push_back(k * b.stride + p);
            evaluate(b, wanted_.data(), static_cast<int>(wanted_.size()), final);
            for (const int p : going_) b.last[p] = to;
            if (final && scene.paper_density)
                find_paper_depths(b, from, to, scene.beta, b.medium == Medium::actor ? scene.step_m / 4 : scene.step_m);
            else
                find_depths(b, from, to, scene.beta, !final);
            size_t kept = 0;
            for (const int p : going_) {
                for (int k = from; k < to; ++k) passed_[p] += b.tau[static_cast<size_t>(k * b.stride + p)];
                if (passed_[p] < limit) going_[kept++] = p;
            }
            going_.resize(kept);
        }
        // where nothing was asked nothing is
        for (int p = 0; p < b.count; ++p)
            for (int k = b.last[p]; k < b.samples; ++k) {
                const size_t i = static_cast<size_t>(k * b.stride + p);
                b.tau[i] = b.share[i] = 0;
            }
    }

    // Starts `passed_` of actors' strands with what stands before their boxes.
    void behind_the_fixed(const Batch &b) {
        const Batch &still = tile_.fixed();
        if (!still.count) return;
        int strand[TILE];
        std::fill(strand, strand + TILE, -1);
        for (int p = 0; p < still.count; ++p) strand[still.ray[p]] = p;
        for (int p = 0; p < b.count; ++p) {
            const int q = strand[b.ray[p]];
            for (int k = 0; q >= 0 && k < still.samples; ++k) {
                const size_t i = static_cast<size_t>(k * still.stride + q);
                if (still.t[i] >= b.t_near[p]) break;
                passed_[p] += still.tau[i];
            }
        }
    }

    // The field at samples of a batch, by their numbers.
    void evaluate(Batch &b, const int *ids, int count, bool keep) {
        Asked &asked = asking_.asked;
        asked.resize(count);
        for (int i = 0; i < count; ++i) {
            asked.strand[i] = ids[i] % b.stride;
            asked.t[i] = b.t[static_cast<size_t>(ids[i])];
        }
        asking_.ask_at(b, keep);
        for (int i = 0; i < count; ++i) {
            b.s[static_cast<size_t>(ids[i])] = asked.s[i];
            b.slot[static_cast<size_t>(ids[i])] = asked.slot[i];
        }
    }

    // Samples of a batch's strands from near to far, until each is stopped; the answers are the samples that are composited. Strands
    // are followed in the metres of their field, in which a distance bounds a step whatever the actor's scale.
    void march(Batch &b) {
        const unisim_scene &scene = *tile_.fields_of(b).scene;
        const size_t count = static_cast<size_t>(b.count);
        passed_.assign(count, 0.0f);
        march_.runs.resize(std::max({march_.runs.size(), count, gathering_.runs.size()}));
        if (b.medium == Medium::actor) {
            behind_the_fixed(b);
            const int32_t *rows = tile_.task.cast.troupes[b.troupe].rows;
            for (size_t p = 0; p < count; ++p) {
                find_box_runs(scene.box_cells + static_cast<int64_t>(rows[b.box[p]]) * BOX_CELLS * BOX_CELLS * BOX_CELLS, &b.o[3 * p],
                              &b.d[3 * p], &b.size[3 * p], b.t_near[p], b.t_far[p], march_.runs[p]);
                for (Run &run : march_.runs[p]) {
                    run.begin *= b.stretch[p];
                    run.end *= b.stretch[p];
                }
            }
        } else
            std::swap(march_.runs, gathering_.runs); // lent until the next tile: memory that has grown is kept
        b.slots = 0;
        const auto more = [&](size_t p, std::vector<Run> &runs) {
            if (b.medium == Medium::fixed) return gathering_.continue_runs(b, p, runs);
            runs.clear();
        };
        const auto face = [&](int p, int &at, float &t) {
            return b.medium == Medium::fixed && find_face(tile_.scene, &b.o[3 * p], &b.d[3 * p], b.t_near[p], &march_.t[p], &march_.stopped[p],
                                                          march_.counts[p], march_.stride, at, t);
        };
        const auto ask = [&] {
            Asked &asked = asking_.asked;
            asked.resize(static_cast<int>(march_.asked.size()));
            for (int i = 0; i < asked.count; ++i) {
                asked.strand[i] = march_.asked[i];
                asked.t[i] = march_.next[march_.asked[i]] / b.stretch[march_.asked[i]];
            }
            asking_.ask_at(b, true);
            for (int i = 0; i < asked.count; ++i) {
                march_.told[march_.asked[i]] = asked.s[i];
                march_.told_slot[march_.asked[i]] = asked.slot[i];
            }
        };
        march_.follow(b.count, passed_.data(), scene.beta, tile_.task.sampling, ask, more, face, tile_.scene.voxel_m);
        b.lay(std::max(1, march_.rows));
        if (march_.rows) {
            std::swap(b.t, march_.t);
            std::swap(b.s, march_.s);
            std::swap(b.slot, march_.slot);
            if (b.medium == Medium::actor)
                for (int k = 0; k < b.samples; ++k)
                    for (int p = 0; p < b.count; ++p) b.t[static_cast<size_t>(k * b.stride + p)] /= b.stretch[p];
        }
        // behind the last answer nothing is told, and nothing stops the ray
        for (int p = 0; p < b.stride; ++p) {
            const int told = p < b.count ? march_.counts[p] : 0;
            float t = p < b.count ? b.t_near[p] : 0.0f, s = EMPTY_M;
            if (told) {
                t = b.t[static_cast<size_t>((told - 1) * b.stride + p)];
                s = b.s[static_cast<size_t>((told - 1) * b.stride + p)];
            }
            for (int k = told; k < b.samples; ++k) {
                const size_t i = static_cast<size_t>(k * b.stride + p);
                b.t[i] = t;
                b.s[i] = s;
                b.slot[i] = -1;
            }
        }
        find_depths(b, 0, b.samples, scene.beta, false);
    }

    Tile &tile_;
    Asking &asking_;
    Gathering &gathering_;
    March march_;
    std::vector<float> quantile_, shares_, passed_;
    std::vector<int> going_, wanted_;
};

} // namespace
