// Places the samples of ray segments and evaluates the field there.
#pragma once
#include "field_evaluator.h"
#include "segment_builder.h"

namespace {

// Samples are evaluated in rounds of so many per segment; segments that are opaque by then take no more.
constexpr int PROPOSAL_ROUND = 8, FINAL_ROUND = 4;
// The fraction of the samples that is distributed evenly, whatever the proposals find.
constexpr float UNIFORM = 0.05f;

class RayMarcher {
  public:
    RayMarcher(Tile &tile, FieldEvaluator &evaluator, SegmentBuilder &builder)
        : tile_(tile), evaluator_(evaluator), builder_(builder) {}

    void sample(StaticSegments &b) {
        const unisim_sampling &sampling = tile_.task.sampling;
        if (tile_.marches(tile_.scene)) return march(b);
        place_by_quantiles(b, sampling.proposals, sampling.samples);
    }

    void sample(ActorSegments &b) {
        const unisim_sampling &sampling = tile_.task.sampling;
        if (tile_.marches(*tile_.scene_fields_of(b).scene)) return march(b);
        place_by_quantiles(b, sampling.actor_proposals, sampling.actor_samples);
    }

    // Copied boxes are small: even samples, without proposals.
    void sample(CopySegments &b) {
        evaluator_.start(b);
        b.slots = 0;
        b.allocate(2 * tile_.task.sampling.samples);
        for (int p = 0; p < b.count; ++p)
            for (int k = 0; k < b.samples; ++k)
                b.t[b.number(k, p)] = b.t_near[p] + (static_cast<float>(k) + 0.5f) / static_cast<float>(b.samples) *
                                                        (b.t_far[p] - b.t_near[p]);
        evaluate(b, true);
    }

  private:
    // Samples by quantiles of the weights that `proposals` samples have.
    template <class Segments> void place_by_quantiles(Segments &b, int proposals, int samples) {
        evaluator_.start(b);
        b.slots = 0;
        b.allocate(proposals);
        quantile_.resize(static_cast<size_t>(std::max(proposals, samples)) * b.stride);
        for (int k = 0; k < proposals; ++k)
            for (int p = 0; p < b.count; ++p)
                quantile_[b.number(k, p)] = (static_cast<float>(k) + 0.5f) / static_cast<float>(proposals);
        place(b, proposals);
        evaluate(b, false);
        cdf_.resize(static_cast<size_t>(proposals + 1) * b.stride);
        cumulate_weights(b.tau.data(), proposals, b.stride, UNIFORM, cdf_.data());
        const int stride = b.stride;
        for (int p = 0; p < b.count; ++p) invert_weights(&cdf_[p], proposals, stride, samples, &quantile_[p]);
        b.allocate(samples);
        place(b, samples);
        evaluate(b, true);
    }

    void place(StaticSegments &b, int count) {
        for (int p = 0; p < b.count; ++p)
            place_quantiles(builder_.occupied[static_cast<size_t>(p)], tile_.scene.voxel_m / 2, b.t_near[p],
                            &quantile_[p], count, b.stride, &b.t[p]);
    }

    void place(ActorSegments &b, int count) {
        for (int p = 0; p < b.count; ++p)
            for (int k = 0; k < count; ++k)
                b.t[b.number(k, p)] = b.t_near[p] + quantile_[b.number(k, p)] * (b.t_far[p] - b.t_near[p]);
    }

    // Evaluates the field at placed samples, in rounds: a segment takes none behind where it is opaque. `final`:
    // hidden units are kept, and intervals are those of the density; else they only decide where samples are placed.
    template <class Segments> void evaluate(Segments &b, bool final) {
        const unisim_scene &scene = *tile_.scene_fields_of(b).scene;
        const float max_depth = -std::log(tile_.task.sampling.opaque);
        find_depth_before(b);
        active_.clear();
        for (int p = 0; p < b.count; ++p)
            if (depth_[p] < max_depth) active_.push_back(p);
        const int round = final ? FINAL_ROUND : PROPOSAL_ROUND;
        for (int from = 0; from < b.samples && !active_.empty(); from += round) {
            const int to = std::min(from + round, b.samples);
            numbers_.clear();
            for (int k = from; k < to; ++k)
                for (const int p : active_) numbers_.push_back(k * b.stride + p);
            evaluate_samples(b, final);
            for (const int p : active_) b.evaluated[p] = to;
            if (final && scene.unisim_density)
                find_unisim_intervals(b, from, to, scene.beta, density_step_m(b, scene));
            else
                find_intervals(b, from, to, scene.beta, !final);
            size_t kept = 0;
            for (const int p : active_) {
                for (int k = from; k < to; ++k) depth_[p] += b.tau[b.number(k, p)];
                if (depth_[p] < max_depth) active_[kept++] = p;
            }
            active_.resize(kept);
        }
        // samples that were not evaluated absorb nothing
        for (int p = 0; p < b.count; ++p)
            for (int k = b.evaluated[p]; k < b.samples; ++k)
                b.tau[b.number(k, p)] = b.stop_fraction[b.number(k, p)] = 0;
    }

    static float density_step_m(const FieldSegments &, const unisim_scene &scene) { return scene.density_step_m; }
    static float density_step_m(const ActorSegments &, const unisim_scene &scene) { return scene.density_step_m / 4; }

    // Optical depths before segments, into `depth_`.
    void find_depth_before(const FieldSegments &b) { depth_.assign(static_cast<size_t>(b.count), 0.0f); }

    // Before an actor's box: that of the static field.
    void find_depth_before(const ActorSegments &b) {
        depth_.assign(static_cast<size_t>(b.count), 0.0f);
        const StaticSegments &in_front = tile_.static_segments;
        if (!in_front.count) return;
        int segment[TILE];
        std::fill(segment, segment + TILE, -1);
        for (int p = 0; p < in_front.count; ++p) segment[in_front.ray[p]] = p;
        for (int p = 0; p < b.count; ++p) {
            const int q = segment[b.ray[p]];
            for (int k = 0; q >= 0 && k < in_front.samples; ++k) {
                const size_t i = in_front.number(k, q);
                if (in_front.t[i] >= b.t_near[p]) break;
                depth_[p] += in_front.tau[i];
            }
        }
    }

    // Evaluates the field at the samples `numbers_`.
    template <class Segments> void evaluate_samples(Segments &b, bool keep) {
        FieldQueries &queries = evaluator_.queries;
        const int count = static_cast<int>(numbers_.size());
        queries.resize(count);
        for (int i = 0; i < count; ++i) {
            queries.segment[i] = numbers_[i] % b.stride;
            queries.t[i] = b.t[static_cast<size_t>(numbers_[i])];
        }
        evaluator_.evaluate(b, keep);
        for (int i = 0; i < count; ++i) {
            b.s[static_cast<size_t>(numbers_[i])] = queries.s[i];
            b.slot[static_cast<size_t>(numbers_[i])] = queries.slot[i];
        }
    }

    // Marches segments from near to far until each is opaque; the evaluated samples are the ones that are composited.
    // The march is in the metres of the field, where the distance bounds a step whatever an actor's scale.
    template <class Segments> void march(Segments &b) {
        const unisim_scene &scene = *tile_.scene_fields_of(b).scene;
        const size_t count = static_cast<size_t>(b.count);
        evaluator_.start(b);
        find_depth_before(b);
        march_.runs.resize(std::max({march_.runs.size(), count, builder_.runs.size()}));
        find_first_runs(b);
        b.slots = 0;
        const auto more = [&](size_t p, std::vector<Run> &runs) { continue_runs(b, p, runs); };
        const auto face = [&](int p, int &before, float &t) { return find_face_of(b, p, before, t); };
        const auto evaluate_queries = [&] {
            FieldQueries &queries = evaluator_.queries;
            queries.resize(static_cast<int>(march_.queries.size()));
            for (int i = 0; i < queries.count; ++i) {
                const int p = march_.queries[i];
                queries.segment[i] = p;
                queries.t[i] = march_.query_t[p] / stretch_of(b, p);
            }
            evaluator_.evaluate(b, true);
            for (int i = 0; i < queries.count; ++i) {
                march_.query_s[march_.queries[i]] = queries.s[i];
                march_.query_slot[march_.queries[i]] = queries.slot[i];
            }
        };
        march_.march(b.count, depth_.data(), scene.beta, tile_.task.sampling, evaluate_queries, more, face,
                     tile_.scene.voxel_m);
        b.allocate(std::max(1, march_.rows));
        if (march_.rows) {
            std::swap(b.t, march_.t);
            std::swap(b.s, march_.s);
            std::swap(b.slot, march_.slot);
            convert_to_ray(b);
        }
        // segments with fewer samples than others: the rest has no length and absorbs nothing
        for (int p = 0; p < b.stride; ++p) {
            const int samples = p < b.count ? march_.counts[p] : 0;
            float t = p < b.count ? b.t_near[p] : 0.0f, s = EMPTY_M;
            if (samples) {
                t = b.t[b.number(samples - 1, p)];
                s = b.s[b.number(samples - 1, p)];
            }
            for (int k = samples; k < b.samples; ++k) {
                const size_t i = b.number(k, p);
                b.t[i] = t;
                b.s[i] = s;
                b.slot[i] = -1;
            }
        }
        find_intervals(b, 0, b.samples, scene.beta, false);
    }

    // The first runs of segments, in field metres along the ray.
    void find_first_runs(const StaticSegments &) {
        std::swap(march_.runs, builder_.runs);
    } // swapped, to keep allocated memory

    void find_first_runs(const ActorSegments &b) {
        const uint8_t *cells = tile_.scene_fields_of(b).scene->box_cells;
        for (size_t p = 0; p < static_cast<size_t>(b.count); ++p) {
            const int64_t row = Tile::row_of(b, p);
            find_box_runs(cells + row * BOX_CELLS * BOX_CELLS * BOX_CELLS, &b.o[3 * p], &b.d[3 * p], &b.size[3 * p],
                          b.t_near[p], b.t_far[p], march_.runs[p]);
            for (Run &run : march_.runs[p]) {
                run.begin *= b.stretch[p];
                run.end *= b.stretch[p];
            }
        }
    }

    void continue_runs(const StaticSegments &b, size_t p, std::vector<Run> &runs) {
        builder_.continue_runs(b, p, runs);
    }
    void continue_runs(const ActorSegments &, size_t, std::vector<Run> &runs) { runs.clear(); }

    bool find_face_of(const StaticSegments &b, int p, int &before, float &t) const {
        return find_face(tile_.scene, &b.o[3 * p], &b.d[3 * p], b.t_near[p], &march_.t[p], &march_.depth[p],
                         march_.counts[p], march_.stride, before, t);
    }
    bool find_face_of(const ActorSegments &, int, int &, float &) const { return false; }

    // Distances t of marched samples, from field metres to metres along the ray.
    static void convert_to_ray(StaticSegments &) {}
    static void convert_to_ray(ActorSegments &b) {
        for (int k = 0; k < b.samples; ++k)
            for (int p = 0; p < b.count; ++p) b.t[b.number(k, p)] /= b.stretch[p];
    }

    Tile &tile_;
    FieldEvaluator &evaluator_;
    SegmentBuilder &builder_;
    SurfaceMarch march_;
    std::vector<float> quantile_, cdf_, depth_;
    std::vector<int> active_, numbers_;
};

} // namespace
