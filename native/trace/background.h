// The background model and the sky, outside the volume, along rays whose transmittance through the volume is not
// negligible.
#pragma once
#include "../sample_placement.h"
#include "compositor.h"
#include "view_dependence.h"

namespace {

class Background {
  public:
    std::vector<int> rays;            // those that reach the background
    int count = 0;                    // samples per ray
    std::vector<float> t, tau;        // (rays, count): places of the samples, optical depths of their intervals
    float transmittance_before[TILE]; // of each ray of the tile: after the volume
    float weighted_t[TILE];           // of each ray of the tile: distances by weight, over `transmittance_before`

    Background(Tile &tile, RaySums &sums) : tile_(tile), sums_(sums), view_dependent_(tile) {}

    // Adds the background to the sums of the tile's rays.
    void composite() {
        const unisim_sampling &sampling = tile_.task.sampling;
        const float negligible = std::max(sampling.background_opaque, sampling.opaque);
        rays.clear();
        for (int r = 0; r < tile_.rays.count; ++r) {
            weighted_t[r] = 0;
            transmittance_before[r] = sums_.transmittance[r];
            if (sampling.background && sums_.transmittance_without_foreign[r] > negligible) rays.push_back(r);
        }
        if (rays.empty()) return;
        evaluate_twice();
        begin_sums();
        add_samples();
        if (sampling.sky) {
            evaluate_sky();
            for (size_t i = 0; i < rays.size(); ++i) add(i, transmittance_after_[i], &units_[0][i * field().wide]);
        }
        end_sums();
    }

  private:
    const Field &field() const { return tile_.task.fields[0].background; }
    const unisim_head *head() const { return tile_.scene.sample_head; }
    size_t proposals() const { return static_cast<size_t>(tile_.task.sampling.background_proposals); }
    size_t samples() const { return static_cast<size_t>(tile_.task.sampling.background_samples); }
    // Where segments are marched, proposals are composited too: for as many evaluations the sum is closer to the
    // integral.
    bool proposals_count() const { return tile_.task.sampling.stride_m > 0; }

    // Evaluates the background at even places, and again where the first evaluation found something.
    void evaluate_twice() {
        const size_t n = rays.size();
        count = static_cast<int>(samples() + (proposals_count() ? proposals() : 0));
        for (auto *v : {&place_[0], &density_[0]}) v->resize(n * proposals());
        for (auto *v : {&place_[1], &density_[1], &width_}) v->resize(n * samples());
        for (size_t i = 0; i < n * proposals(); ++i)
            place_[0][i] = (static_cast<float>(i % proposals()) + 0.5f) / static_cast<float>(proposals());
        evaluate(place_[0], density_[0], proposals_count() ? &units_[0] : nullptr);
        for (size_t i = 0; i < n; ++i)
            find_places(&density_[0][i * proposals()], &place_[1][i * samples()], &width_[i * samples()]);
        evaluate(place_[1], density_[1], &units_[1]);
    }

    // Merges the samples of both evaluations by depth, and adds them by weight.
    void add_samples() {
        const bool both = proposals_count();
        const size_t n = rays.size(), per_ray[2] = {proposals(), samples()},
                     counts[2] = {both ? proposals() : 0, samples()};
        const size_t wide = static_cast<size_t>(field().wide);
        t.resize(n * count);
        tau.resize(t.size());
        transmittance_after_.resize(n);
        for (size_t i = 0; i < n; ++i) {
            const float *places[2] = {&place_[0][i * per_ray[0]], &place_[1][i * per_ray[1]]};
            size_t next[2] = {0, 0};
            float before = 0, edge = 0;
            for (int k = 0; k < count; ++k) {
                // both rise
                const int of =
                    next[0] < counts[0] && (next[1] == counts[1] || places[0][next[0]] <= places[1][next[1]]) ? 0 : 1;
                const size_t j = next[of]++, from = i * per_ray[of] + j, to = i * count + k;
                float width;
                if (both) {
                    float after = 1;
                    for (int side = 0; side < 2; ++side)
                        if (next[side] < counts[side])
                            after = std::min(after, 0.5f * (places[of][j] + places[side][next[side]]));
                    width = after - edge;
                    edge = after;
                } else
                    width = width_[from];
                t[to] = distance_of(rays[i], places[of][j]);
                tau[to] = density_[of][from] * width;
                const float weight = exp_of(-before) * opacity_of(tau[to]);
                add(i, weight, &units_[of][from * wide]);
                weighted_t[rays[i]] += weight * t[to];
                before += tau[to];
            }
            transmittance_after_[i] = exp_of(-before);
        }
    }

    void begin_sums() {
        const size_t n = rays.size(), whole_blocks = (n + ROWS - 1) / ROWS * ROWS;
        summed_.assign(whole_blocks * field().wide, 0.0f);
        out_.assign(whole_blocks * field().wide_out, 0.0f);
        weight_.assign(n, 0.0f);
        view_dependent_.clear();
    }

    // Adds hidden units h to ray i's sum.
    void add(size_t i, float weight, const float *h) {
        if (head()) {
            if (!(weight <= MIN_WEIGHT)) view_dependent_.add(field(), h, rays[i], nullptr, weight, i);
            return;
        }
        weight_[i] += weight;
        if (weight <= NEGLIGIBLE_WEIGHT) return;
        const int wide = field().wide;
        float *sum = &summed_[i * wide];
        for (int j = 0; j < wide; j += LANES) store(sum + j, load(sum + j) + weight * load(h + j));
    }

    void end_sums() {
        const Field &far = field();
        const size_t n = rays.size(), features = static_cast<size_t>(far.outputs - 1),
                     wide = static_cast<size_t>(far.wide_out);
        if (head())
            view_dependent_.sum(*head(), far, out_.data());
        else
            layer<false>(static_cast<int>(out_.size() / wide), far.wide_out, far.hidden, summed_.data(), far.wide,
                         far.feature.data(), out_.data());
        for (size_t i = 0; i < n; ++i) {
            const size_t r = static_cast<size_t>(rays[i]);
            for (size_t f = 0; f < features; ++f) {
                const float value = out_[i * wide + f] + weight_[i] * far.bias[f + 1];
                sums_.feature[r * features + f] += sums_.transmittance[r] * value;
                sums_.feature_without_foreign[r * features + f] += sums_.transmittance_without_foreign[r] * value;
            }
            sums_.transmittance[r] *= transmittance_after_[i];
        }
    }

    // The distance along ray r of a place: a fraction, in disparity, of the way from the volume to the far end.
    float distance_of(int r, float place) const {
        return 1 / ((1 - place) / std::max(tile_.far[r], tile_.task.sampling.near_m) +
                    place / tile_.scene.background_far_m);
    }

    // Densities at places, as many for each ray, and hidden units where `units` is not null.
    void evaluate(const std::vector<float> &place, std::vector<float> &density, std::vector<float> *units) {
        const Field &far = field();
        const int n = static_cast<int>(place.size()), per_ray = n / static_cast<int>(rays.size());
        if (units) reserve(*units, n);
        tile_.samples += n;
        for (int first = 0; first < n; first += BLOCK) {
            const int block = std::min(BLOCK, n - first);
            for (int i = 0; i < filled(block); ++i) {
                const int at = first + std::min(i, block - 1), r = rays[at / per_ray];
                const float at_m = distance_of(r, place[at]);
                float x[3], y[3];
                for (int a = 0; a < 3; ++a) x[a] = tile_.o[r][a] + tile_.d[r][a] * at_m;
                contract(tile_.scene, x, y);
                for (int a = 0; a < 3; ++a) tile_.x[a][i] = y[a];
            }
            float *h = units ? units->data() + static_cast<size_t>(first) * far.wide : tile_.block.data();
            far.units(tile_.x, nullptr, block, tile_.code.data(), h);
            for (int i = 0; i < block; ++i)
                density[first + i] = exp_of(min_of(far.first_output(h + i * far.wide), MAX_LOG_DENSITY));
        }
    }

    // Hidden units (rays, wide) at infinity, into the buffer of the proposals.
    void evaluate_sky() {
        const int n = static_cast<int>(rays.size());
        reserve(units_[0], n);
        tile_.samples += n;
        for (int first = 0; first < n; first += BLOCK) {
            const int block = std::min(BLOCK, n - first);
            for (int i = 0; i < filled(block); ++i)
                for (int a = 0; a < 3; ++a) tile_.x[a][i] = tile_.d[rays[first + std::min(i, block - 1)]][a] / 2 + 0.5f;
            field().units(tile_.x, nullptr, block, tile_.code.data(),
                          units_[0].data() + static_cast<size_t>(first) * field().wide);
        }
    }

    void reserve(std::vector<float> &units, int n) const {
        const size_t size = static_cast<size_t>((n + BLOCK - 1) / BLOCK * BLOCK) * field().wide;
        if (units.size() < size) units.resize(size);
    }

    // Places of the second evaluation along one ray, and the widths of the intervals around them, from the densities
    // of the first.
    void find_places(const float *density, float *place, float *width) {
        const int first = static_cast<int>(proposals()), second = static_cast<int>(samples());
        cdf_.resize(proposals() + 1);
        edges_.resize(samples() + 1);
        find_background_edges(density, first, second, cdf_.data(), edges_.data());
        for (int k = 0; k < second; ++k) {
            width[k] = edges_[k + 1] - edges_[k];
            place[k] = edges_[k] + 0.5f * width[k];
        }
    }

    Tile &tile_;
    RaySums &sums_;
    ViewDependentFeatures view_dependent_;
    // Of the first and of the second evaluation; places as in `distance_of`.
    std::vector<float> place_[2], density_[2], units_[2];
    std::vector<float> width_;                            // of the intervals around the places of the second
    std::vector<float> transmittance_after_;              // of each ray, through the background alone
    std::vector<float> summed_, weight_, out_, cdf_, edges_;
};

} // namespace
