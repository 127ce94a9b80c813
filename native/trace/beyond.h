// What lies beyond the volume: the far field and the sky, along rays of which a share that counts comes through.
#pragma once
#include "directed.h"
#include "summing.h"

namespace {

constexpr float MAX_LOG_DENSITY = 8.0f;

class Beyond {
  public:
    std::vector<int> rays;     // those that come so far
    int count = 0;             // samples of each
    std::vector<float> t, tau; // (rays, count): where these are, optical depths of their intervals
    float in_front[TILE];      // of each ray of the tile, what comes through the volume
    float depth[TILE];         // distances that stop it beyond, by weight

    Beyond(Tile &tile, Sums &sums) : tile_(tile), sums_(sums), directed_(tile) {}

    void add() {
        const unisim_sampling &sampling = tile_.task.sampling;
        rays.clear();
        for (int r = 0; r < tile_.rays.count; ++r) {
            depth[r] = 0;
            in_front[r] = sums_.behind[r];
            if (sampling.far && sums_.behind_own[r] > std::max(sampling.far_opaque, sampling.opaque)) rays.push_back(r);
        }
        if (rays.empty()) return;
        ask();
        begin_sums();
        weigh();
        if (sampling.sky) {
            ask_sky();
            for (size_t i = 0; i < rays.size(); ++i) give(i, behind_[i], &units_[0][i * field().wide]);
        }
        end_sums();
    }

  private:
    const Field &field() const { return tile_.task.fields[0].far; }
    const unisim_head *head() const { return tile_.scene.sample_head; }
    size_t proposals() const { return static_cast<size_t>(tile_.task.sampling.far_proposals); }
    size_t samples() const { return static_cast<size_t>(tile_.task.sampling.far_samples); }
    // Of a march the first answers count like the second ones: for as many questions the sum is closer to the integral.
    bool all() const { return tile_.task.sampling.stride_m > 0; }

    // The far field twice, the second time where the first answers say that something is.
    void ask() {
        const size_t n = rays.size();
        count = static_cast<int>(samples() + (all() ? proposals() : 0));
        for (auto *v : {&share_[0], &density_[0]}) v->resize(n * proposals());
        for (auto *v : {&share_[1], &density_[1], &width_}) v->resize(n * samples());
        for (size_t i = 0; i < n * proposals(); ++i)
            share_[0][i] = (static_cast<float>(i % proposals()) + 0.5f) / static_cast<float>(proposals());
        ask_at(share_[0], density_[0], all() ? &units_[0] : nullptr);
        for (size_t i = 0; i < n; ++i) find_places(&density_[0][i * proposals()], &share_[1][i * samples()], &width_[i * samples()]);
        ask_at(share_[1], density_[1], &units_[1]);
    }

    // Samples of both kinds in one order of depth, their weights and what they give.
    void weigh() {
        const bool both = all();
        const size_t n = rays.size(), of_each[2] = {proposals(), samples()}, counts[2] = {both ? proposals() : 0, samples()};
        const size_t wide = static_cast<size_t>(field().wide);
        t.resize(n * count);
        tau.resize(t.size());
        behind_.resize(n);
        for (size_t i = 0; i < n; ++i) {
            const float *shares[2] = {&share_[0][i * of_each[0]], &share_[1][i * of_each[1]]};
            size_t next[2] = {0, 0};
            float before = 0, edge = 0;
            for (int k = 0; k < count; ++k) {
                // both rise
                const int of = next[0] < counts[0] && (next[1] == counts[1] || shares[0][next[0]] <= shares[1][next[1]]) ? 0 : 1;
                const size_t j = next[of]++, from = i * of_each[of] + j, to = i * count + k;
                float width;
                if (both) {
                    float after = 1;
                    for (int side = 0; side < 2; ++side)
                        if (next[side] < counts[side]) after = std::min(after, 0.5f * (shares[of][j] + shares[side][next[side]]));
                    width = after - edge;
                    edge = after;
                } else
                    width = width_[from];
                t[to] = place(rays[i], shares[of][j]);
                tau[to] = density_[of][from] * width;
                const float weight = exp_of(-before) * stopped_by(tau[to]);
                give(i, weight, &units_[of][from * wide]);
                depth[rays[i]] += weight * t[to];
                before += tau[to];
            }
            behind_[i] = exp_of(-before);
        }
    }

    void begin_sums() {
        const size_t n = rays.size(), whole_blocks = (n + ROWS - 1) / ROWS * ROWS;
        summed_.assign(whole_blocks * field().wide, 0.0f);
        out_.assign(whole_blocks * field().wide_out, 0.0f);
        whole_.assign(n, 0.0f);
        directed_.begin();
    }

    // Hidden units h to ray i's sum.
    void give(size_t i, float weight, const float *h) {
        if (head()) {
            if (!(weight <= LEAST_WEIGHT)) directed_.add(field(), h, rays[i], nullptr, weight, i);
            return;
        }
        whole_[i] += weight;
        if (weight <= NO_WEIGHT) return;
        const int wide = field().wide;
        float *sum = &summed_[i * wide];
        for (int j = 0; j < wide; j += LANES) store(sum + j, load(sum + j) + weight * load(h + j));
    }

    void end_sums() {
        const Field &far = field();
        const size_t n = rays.size(), features = static_cast<size_t>(far.outputs - 1), wide = static_cast<size_t>(far.wide_out);
        if (head())
            directed_.sum(*head(), far, out_.data());
        else
            layer<false>(static_cast<int>(out_.size() / wide), far.wide_out, far.hidden, summed_.data(), far.wide, far.feature.data(),
                         out_.data());
        for (size_t i = 0; i < n; ++i) {
            const size_t r = static_cast<size_t>(rays[i]);
            for (size_t f = 0; f < features; ++f) {
                const float value = out_[i * wide + f] + whole_[i] * far.bias[f + 1];
                sums_.feature[r * features + f] += sums_.behind[r] * value;
                sums_.own_feature[r * features + f] += sums_.behind_own[r] * value;
            }
            sums_.behind[r] *= behind_[i];
        }
    }

    // How far a share of the disparities beyond the volume is along a ray.
    float place(int r, float share) const {
        return 1 / ((1 - share) / std::max(tile_.far[r], tile_.task.sampling.near_m) + share / tile_.scene.far_m);
    }

    // Densities at shares of disparity, as many of each ray; their hidden units too, where `units` is given.
    void ask_at(const std::vector<float> &share, std::vector<float> &density, std::vector<float> *units) {
        const Field &far = field();
        const int n = static_cast<int>(share.size()), of_each = n / static_cast<int>(rays.size());
        if (units) make_room(*units, n);
        tile_.samples += n;
        for (int first = 0; first < n; first += BLOCK) {
            const int block = std::min(BLOCK, n - first);
            for (int i = 0; i < filled(block); ++i) {
                const int at = first + std::min(i, block - 1), r = rays[at / of_each];
                const float at_m = place(r, share[at]);
                float y[3], norm = 0;
                for (int a = 0; a < 3; ++a) {
                    y[a] = (tile_.o[r][a] + tile_.d[r][a] * at_m - tile_.scene.size[a] / 2) / tile_.scene.far_radius;
                    norm += y[a] * y[a];
                }
                // mip-NeRF 360's contraction (Barron et al., 2022, eq. 10)
                norm = std::fmax(std::sqrt(norm), 1e-9f);
                const float scale = norm <= 1 ? 1.0f : (2 - 1 / norm) / norm;
                for (int a = 0; a < 3; ++a) tile_.x[a][i] = y[a] * scale / 4 + 0.5f;
            }
            float *h = units ? units->data() + static_cast<size_t>(first) * far.wide : tile_.block.data();
            far.units(tile_.x, nullptr, block, tile_.code.data(), h);
            for (int i = 0; i < block; ++i) density[first + i] = exp_of(least(far.first_output(h + i * far.wide), MAX_LOG_DENSITY));
        }
    }

    // Hidden units (rays, wide) at infinity, in the first answers' place.
    void ask_sky() {
        const int n = static_cast<int>(rays.size());
        make_room(units_[0], n);
        tile_.samples += n;
        for (int first = 0; first < n; first += BLOCK) {
            const int block = std::min(BLOCK, n - first);
            for (int i = 0; i < filled(block); ++i)
                for (int a = 0; a < 3; ++a) tile_.x[a][i] = tile_.d[rays[first + std::min(i, block - 1)]][a] / 2 + 0.5f;
            field().units(tile_.x, nullptr, block, tile_.code.data(), units_[0].data() + static_cast<size_t>(first) * field().wide);
        }
    }

    void make_room(std::vector<float> &units, int n) const {
        const size_t room = static_cast<size_t>((n + BLOCK - 1) / BLOCK * BLOCK) * field().wide;
        if (units.size() < room) units.resize(room);
    }

    // Where one ray is asked again, as shares of disparity, and the lengths of the intervals round these places.
    void find_places(const float *density, float *share, float *width) {
        const int first = static_cast<int>(proposals()), second = static_cast<int>(samples());
        sum_.assign(proposals() + 1, 0.0f);
        float before = 0, total = 0;
        for (int k = 0; k < first; ++k) {
            const float depth_of = density[k] / static_cast<float>(first);
            sum_[k + 1] = exp_of(-before) * stopped_by(depth_of) + 1e-3f;
            total += sum_[k + 1];
            before += depth_of;
        }
        for (int k = 1; k <= first; ++k) sum_[k] = sum_[k - 1] + 0.8f * sum_[k] / total + 0.2f / static_cast<float>(first);
        int j = 1;
        float edge = 0;
        for (int k = 0; k <= second; ++k) {
            const float target = static_cast<float>(k) / static_cast<float>(second) * sum_[first];
            while (j < first && sum_[j] <= target) ++j;
            const float at = (static_cast<float>(j - 1) + (target - sum_[j - 1]) / (sum_[j] - sum_[j - 1])) / static_cast<float>(first);
            if (k) {
                width[k - 1] = at - edge;
                share[k - 1] = edge + 0.5f * (at - edge);
            }
            edge = at;
        }
    }

    Tile &tile_;
    Sums &sums_;
    Directed directed_;
    std::vector<float> share_[2], density_[2], units_[2]; // of the first answers, of the second ones
    std::vector<float> width_;                            // of the second ones' intervals, in shares
    std::vector<float> behind_;                           // of each ray, what comes through all of it
    std::vector<float> summed_, whole_, out_, sum_;
};

} // namespace
