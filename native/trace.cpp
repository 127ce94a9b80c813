// Rays through a scene, a tile at a time: samples placed, fields asked, everything on a ray put in depth order, features summed.
//
// `core/trace.py` is the same in plain torch, and the specification. What is left out here cannot be seen: samples behind what
// lets less than `opaque` through, strands that lie wholly behind it. A ray's results do not depend on the others of its tile.
#include "marching.h"
#include "placing.h"
#include "strands.h"

#include <memory>

namespace {

constexpr int TILE = 64;
// Samples are asked for in rounds, and rays that are stopped by then take no more.
constexpr int ROUND = 8, FINE_ROUND = 4;
constexpr float EVEN = 0.05f;
constexpr float EMPTY_M = 10.0f, NORMAL_STEP_M = 0.03f;
constexpr float MAX_LOG_DENSITY = 8.0f;
constexpr float LEAST_WEIGHT = 1e-4f;
// What weighs less is left out of sums: a millionth of a feature shows in none of its digits.
constexpr float NO_WEIGHT = 1e-6f;

// Points of a block that are filled: those that are asked for, up to the end of a vector.
constexpr int filled(int count) { return (count + LANES - 1) / LANES * LANES; }

struct Fields {
    const unisim_scene *scene;
    Field fixed, far, actors;
    std::vector<float> light_first, light_last; // the light's layers, transposed: (features, wide), (hidden, wide)

    explicit Fields(const unisim_scene *s) : scene(s), fixed(s->fixed), far(s->far), actors(s->actors) {
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
    const unisim_cast &cast;
    const unisim_rays &rays;
    const unisim_mesh_hits *meshes;
    const unisim_sampling &sampling;
    const unisim_found &found;
    std::vector<Fields> fields; // a troupe each, the scene's own first
    std::vector<int> first;     // a troupe each: the number of its first actor; then that of the first mesh
};

inline void transform(const double *m, const double *x, float *out) {
    for (int a = 0; a < 3; ++a)
        out[a] = static_cast<float>(m[4 * a] * x[0] + m[4 * a + 1] * x[1] + m[4 * a + 2] * x[2] + m[4 * a + 3]);
}

inline void turn(const double *m, const double *x, float *out) {
    for (int a = 0; a < 3; ++a) out[a] = static_cast<float>(m[4 * a] * x[0] + m[4 * a + 1] * x[1] + m[4 * a + 2] * x[2]);
}

// Heights of the ground under (x, y), volume coordinates: bilinear between cells' middles.
inline float ground_at(const unisim_scene &s, float x, float y) {
    const float u = std::fmin(std::fmax(x / s.ground_m - 0.5f, 0.0f), static_cast<float>(s.ground_shape[0] - 1));
    const float v = std::fmin(std::fmax(y / s.ground_m - 0.5f, 0.0f), static_cast<float>(s.ground_shape[1] - 1));
    const int i = static_cast<int>(u), j = static_cast<int>(v), wide = s.ground_shape[1];
    const int ii = std::min(i + 1, s.ground_shape[0] - 1), jj = std::min(j + 1, wide - 1);
    const float fu = u - static_cast<float>(i), fv = v - static_cast<float>(j);
    return (1 - fu) * ((1 - fv) * s.ground[i * wide + j] + fv * s.ground[i * wide + jj]) +
           fu * ((1 - fv) * s.ground[ii * wide + j] + fv * s.ground[ii * wide + jj]);
}

// Places t on strands where a field is asked, and what it says.
struct Asked {
    int count = 0;
    std::vector<int32_t> strand, slot;
    std::vector<float> t, s;

    void resize(int n) {
        count = n;
        for (auto *v : {&strand, &slot}) v->resize(static_cast<size_t>(n));
        for (auto *v : {&t, &s}) v->resize(static_cast<size_t>(n));
    }
};

class Tile {
  public:
    explicit Tile(const Task &task) : task_(task), scene_(task.scene), batches_(task.cast.troupe_count + 3) {
        int inputs = 0, wide = 0;
        for (const Fields &fields : task.fields)
            for (const Field *field : {&fields.fixed, &fields.far, &fields.actors}) {
                inputs = std::max(inputs, field->inputs);
                wide = std::max(wide, field->wide);
            }
        code_.resize(static_cast<size_t>(BLOCK) * inputs);
        block_.resize(static_cast<size_t>(BLOCK) * wide);
    }

    int64_t samples = 0;

    void trace(int64_t begin, int64_t end) {
        start(begin, end);
        gather_strands();
        for (Batch &b : batches_)
            if (b.count && b.medium != Medium::mesh) follow(b);
        composite();
        beyond();
        finish();
    }

  private:
    const Fields &fields_of(const Batch &b) const { return task_.fields[b.medium == Medium::actor ? b.troupe : 0]; }
    const Field &field_of(const Batch &b) const { return b.medium == Medium::actor ? fields_of(b).actors : fields_of(b).fixed; }
    Batch &fixed() { return batches_[0]; }

    void start(int64_t begin, int64_t end) {
        const unisim_rays &rays = task_.rays;
        rays_.count = static_cast<int>(end - begin);
        for (int r = 0; r < rays_.count; ++r) {
            const int64_t i = number_[r] = rays.order ? rays.order[begin + r] : begin + r;
            rays_.origin[r] = rays.origins + 3 * i;
            rays_.direction[r] = rays.directions + 3 * i;
            rays_.time[r] = rays.times[i];
            transform(scene_.volume_from_world, rays_.origin[r], o_[r]);
            turn(scene_.volume_from_world, rays_.direction[r], d_[r]);
        }
    }

    // Which media each ray runs through.
    void gather_strands() {
        for (int i = 0; i < task_.cast.troupe_count; ++i) {
            const unisim_troupe &troupe = task_.cast.troupes[i];
            Batch &b = batches_[static_cast<size_t>(1 + i)];
            b.begin(Medium::actor, i);
            hits_.clear();
            meet_boxes(troupe, rays_, task_.sampling.near_m, hits_);
            for (const Hit &hit : hits_) b.add(hit.ray, hit.box, hit.o, hit.d, hit.t_near, hit.t_far, troupe.sizes + 3 * hit.box, hit.rotation);
        }
        find_cleared();
        const float zero[3] = {}, none[9] = {};
        Batch &still = fixed();
        still.begin(Medium::fixed, 0);
        occupied_.resize(TILE);
        march_.runs.resize(std::max<size_t>(march_.runs.size(), TILE));
        for (int r = 0; r < rays_.count; ++r) {
            float near = 0, far = 0;
            if (!span_of_box(o_[r], d_[r], zero, scene_.size, task_.sampling.near_m, near, far)) far = near;
            far_[r] = far;
            if (marches(scene_)) {
                // added first, to be looked for like what follows
                const size_t p = static_cast<size_t>(still.count);
                steps_[p] = 0;
                still.add(r, 0, o_[r], d_[r], near, far, scene_.size, none);
                continue_runs(still, p, march_.runs[p]);
                if (march_.runs[p].empty()) still.drop();
                continue;
            }
            Occupied &in = occupied_[static_cast<size_t>(still.count)];
            find_occupied(scene_, o_[r], d_[r], near, far, in);
            // free space: a ray that meets nothing that could stop it takes no sample
            if (in.total() > 0) still.add(r, 0, o_[r], d_[r], near, far, scene_.size, none);
        }
        Batch &copies = batches_[batches_.size() - 2];
        copies.begin(Medium::copy, 0);
        if (task_.cast.copies) {
            hits_.clear();
            meet_boxes(*task_.cast.copies, rays_, task_.sampling.near_m, hits_);
            for (const Hit &hit : hits_) add_copy(copies, hit);
        }
        add_meshes(batches_.back());
    }

    // A copied box is the place it was copied from, seen where the copy stands.
    void add_copy(Batch &b, const Hit &hit) {
        const double *source = task_.cast.world_from_source + 12 * hit.box;
        double world[3], along[3];
        for (int a = 0; a < 3; ++a) {
            world[a] = source[4 * a + 3];
            along[a] = 0;
            for (int c = 0; c < 3; ++c) {
                world[a] += source[4 * a + c] * hit.o[c];
                along[a] += source[4 * a + c] * hit.d[c];
            }
        }
        float o[3], d[3], rotation[9] = {};
        transform(scene_.volume_from_world, world, o);
        turn(scene_.volume_from_world, along, d);
        // the world's axes at the source, to the copy's box, to the world's there
        for (int a = 0; a < 3; ++a)
            for (int c = 0; c < 3; ++c)
                for (int e = 0; e < 3; ++e) rotation[3 * a + c] += hit.rotation[3 * a + e] * static_cast<float>(source[4 * c + e]);
        b.add(hit.ray, hit.box, o, d, hit.t_near, hit.t_far, scene_.size, rotation);
    }

    void add_meshes(Batch &b) {
        b.begin(Medium::mesh, task_.cast.troupe_count);
        const unisim_mesh_hits *met = task_.meshes;
        if (!met) return;
        const float none[9] = {};
        std::vector<int64_t> at;
        for (int r = 0; r < rays_.count; ++r)
            for (int64_t i = std::lower_bound(met->ray, met->ray + met->count, number_[r]) - met->ray;
                 i < met->count && met->ray[i] == number_[r]; ++i) {
                b.add(r, met->number[i], o_[r], d_[r], met->t[i], met->t[i], met->normals + 3 * i, none);
                at.push_back(i);
            }
        b.sample(1);
        for (int p = 0; p < b.count; ++p) {
            b.t[p] = met->t[at[static_cast<size_t>(p)]];
            b.tau[p] = met->tau[at[static_cast<size_t>(p)]];
        }
    }

    // Samples of a batch's strands placed, and what they say.
    void follow(Batch &b) {
        const unisim_sampling &sampling = task_.sampling;
        find_ways(b);
        if (b.medium == Medium::copy) {
            b.sample(2 * sampling.samples);
            for (int p = 0; p < b.count; ++p)
                for (int k = 0; k < b.samples; ++k)
                    b.t[static_cast<size_t>(k * b.stride + p)] =
                        b.t_near[p] + (static_cast<float>(k) + 0.5f) / static_cast<float>(b.samples) * (b.t_far[p] - b.t_near[p]);
            ask(b, true);
            return;
        }
        if (marches(*fields_of(b).scene)) return march(b);
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

    void place(Batch &b, int count) {
        for (int p = 0; p < b.count; ++p) {
            if (b.medium == Medium::fixed)
                place_in(occupied_[static_cast<size_t>(p)], scene_.voxel_m / 2, b.t_near[p], &quantile_[p], count, b.stride, &b.t[p]);
            else
                for (int k = 0; k < count; ++k)
                    b.t[static_cast<size_t>(k * b.stride + p)] =
                        b.t_near[p] + quantile_[static_cast<size_t>(k * b.stride + p)] * (b.t_far[p] - b.t_near[p]);
        }
    }

    // The field at a batch's samples, in rounds: a strand takes none behind what stops it. `final`: hidden units are kept, and
    // depths are the density's; else they only say where samples shall be.
    void ask(Batch &b, bool final) {
        const unisim_scene &scene = *fields_of(b).scene;
        const float limit = -std::log(task_.sampling.opaque);
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
        const Batch &still = fixed();
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
        asked_.resize(count);
        for (int i = 0; i < count; ++i) {
            asked_.strand[i] = ids[i] % b.stride;
            asked_.t[i] = b.t[static_cast<size_t>(ids[i])];
        }
        ask_at(b, keep);
        for (int i = 0; i < count; ++i) {
            b.s[static_cast<size_t>(ids[i])] = asked_.s[i];
            b.slot[static_cast<size_t>(ids[i])] = asked_.slot[i];
        }
    }

    // Strands in the unit cube of their field: where they begin and how far they go a metre.
    void find_ways(const Batch &b) {
        const unisim_troupe *troupe = b.medium == Medium::actor ? &task_.cast.troupes[b.troupe] : nullptr;
        const size_t count = static_cast<size_t>(b.count);
        for (size_t a = 0; a < 3; ++a) {
            begin_[a].resize(count);
            way_[a].resize(count);
            for (size_t p = 0; p < count; ++p) {
                begin_[a][p] = b.o[3 * p + a] / b.size[3 * p + a] + (troupe ? 0.5f : 0.0f);
                way_[a][p] = b.d[3 * p + a] / b.size[3 * p + a];
            }
        }
        rows_.assign(count, 0);
        for (size_t p = 0; troupe && p < count; ++p) rows_[p] = troupe->rows[b.box[p]];
    }

    // The distances at the places `asked_` and, where units are to be kept, their slots; after `find_ways`.
    void ask_at(Batch &b, bool keep) {
        const Field &field = field_of(b);
        const int count = asked_.count;
        samples += count;
        if (keep) {
            // grown, and never cleared: what is kept is written before it is read
            const size_t slots = b.slots + static_cast<size_t>((count + BLOCK - 1) / BLOCK * BLOCK);
            if (b.units.size() < slots * field.wide) b.units.resize(slots * field.wide);
        }
        for (int first = 0; first < count; first += BLOCK) {
            const int n = std::min(BLOCK, count - first);
            const int32_t *strand = &asked_.strand[first];
            const float *t = &asked_.t[first];
            for (int i = 0; i < filled(n); ++i) {
                const int j = std::min(i, n - 1), p = strand[j];
                for (int a = 0; a < 3; ++a) x_[a][i] = begin_[a][p] + t[j] * way_[a][p];
                row_[i] = rows_[p];
            }
            float *h = keep ? &b.units[b.slots * field.wide] : block_.data();
            field.units(x_, b.medium == Medium::actor ? row_ : nullptr, n, code_.data(), h);
            for (int i = 0; i < n; ++i) {
                float &s = asked_.s[first + i] = field.first_output(h + i * field.wide);
                asked_.slot[first + i] = keep ? static_cast<int>(b.slots) + i : -1;
                if (b.medium == Medium::fixed) clear(b, strand[i], t[i], s);
                if (b.medium == Medium::copy) lift(b, strand[i], t[i], s);
            }
            if (keep) b.slots += n;
        }
    }

    void continue_runs(const Batch &b, size_t p, std::vector<Run> &runs) {
        const int r = b.ray[p];
        find_runs(scene_, o_[r], d_[r], b.t_near[p], b.t_far[p], [&](float t) { return cleared(r, t, scene_.voxel_m); }, steps_[p], runs);
    }

    // Whether a scene's strands are followed from cell to cell; the paper's density depends on the steps, and takes even ones.
    bool marches(const unisim_scene &scene) const { return task_.sampling.stride_m > 0 && scene.cells && !scene.paper_density; }

    // Samples of a batch's strands from near to far, until each is stopped; the answers are the samples that are composited.
    void march(Batch &b) {
        const unisim_scene &scene = *fields_of(b).scene;
        const size_t count = static_cast<size_t>(b.count);
        passed_.assign(count, 0.0f);
        march_.runs.resize(std::max(march_.runs.size(), count));
        if (b.medium == Medium::actor) {
            behind_the_fixed(b);
            for (size_t p = 0; p < count; ++p)
                find_box_runs(scene.box_cells + static_cast<int64_t>(task_.cast.troupes[b.troupe].rows[b.box[p]]) * BOX_CELLS * BOX_CELLS * BOX_CELLS,
                              &b.o[3 * p], &b.d[3 * p], &b.size[3 * p], b.t_near[p], b.t_far[p], march_.runs[p]);
        }
        b.slots = 0;
        const auto more = [&](size_t p, std::vector<Run> &runs) {
            if (b.medium == Medium::fixed) return continue_runs(b, p, runs);
            runs.clear();
        };
        const auto face = [&](int p, int &at, float &t) {
            return b.medium == Medium::fixed && find_face(scene_, &b.o[3 * p], &b.d[3 * p], b.t_near[p], &march_.t[p], &march_.stopped[p],
                                                          march_.counts[p], march_.stride, at, t);
        };
        const auto ask = [&] {
            asked_.resize(static_cast<int>(march_.asked.size()));
            for (int i = 0; i < asked_.count; ++i) {
                asked_.strand[i] = march_.asked[i];
                asked_.t[i] = march_.next[march_.asked[i]];
            }
            ask_at(b, true);
            for (int i = 0; i < asked_.count; ++i) {
                march_.told[march_.asked[i]] = asked_.s[i];
                march_.told_slot[march_.asked[i]] = asked_.slot[i];
            }
        };
        march_.follow(b.count, passed_.data(), scene.beta, task_.sampling, ask, more, face, scene_.voxel_m);
        b.lay(std::max(1, march_.rows));
        if (march_.rows) {
            std::swap(b.t, march_.t);
            std::swap(b.s, march_.s);
            std::swap(b.slot, march_.slot);
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

    // Where rays are in a present actor's box, or in a removed one.
    void find_cleared() {
        for (int r = 0; r < rays_.count; ++r) span_[r].clear();
        for (const Batch &boxes : batches_)
            if (boxes.medium == Medium::actor)
                for (int p = 0; p < boxes.count; ++p) span_[boxes.ray[p]].push_back({boxes.t_near[p], boxes.t_far[p]});
        for (int k = 0; k < task_.cast.removals; ++k) {
            const double *m = task_.cast.removal_from_world + 12 * k;
            const float *size = task_.cast.removal_sizes + 3 * k;
            const float half[3] = {size[0] / 2, size[1] / 2, size[2] / 2}, minus[3] = {-half[0], -half[1], -half[2]};
            for (int r = 0; r < rays_.count; ++r) {
                float o[3], d[3], near, far;
                transform(m, rays_.origin[r], o);
                turn(m, rays_.direction[r], d);
                if (span_of_box(o, d, minus, half, 0.0f, near, far)) span_[r].push_back({near, far});
            }
        }
    }

    bool cleared(int r, float t, float margin) const {
        for (const Run &span : span_[r])
            if (t >= span.begin - margin && t <= span.end + margin) return true;
        return false;
    }

    // In such a box nothing stands above the ground: the ground is then all that is near.
    void clear(const Batch &b, int p, float t, float &s) const {
        if (!cleared(b.ray[p], t, 0.0f)) return;
        const float x = b.o[3 * p] + t * b.d[3 * p], y = b.o[3 * p + 1] + t * b.d[3 * p + 1], z = b.o[3 * p + 2] + t * b.d[3 * p + 2];
        const float height = z - ground_at(scene_, x, y);
        if (height > scene_.ground_clearance_m) s = std::max(s, height);
    }

    // The ground of a copied box stays where it is.
    void lift(const Batch &b, int p, float t, float &s) const {
        const float z = b.o[3 * p + 2] + t * b.d[3 * p + 2];
        const float height = ground_at(scene_, b.o[3 * p] + t * b.d[3 * p], b.o[3 * p + 1] + t * b.d[3 * p + 1]);
        if (!(z > height + scene_.ground_clearance_m)) s = EMPTY_M;
    }

    bool guest(const Batch &b) const { return b.medium == Medium::mesh || (b.medium == Medium::actor && b.troupe > 0); }

    void composite() {
        for (int r = 0; r < rays_.count; ++r) {
            strands_[r].clear();
            guests_[r] = false;
            behind_[r] = behind_own_[r] = 1;
        }
        for (Batch &b : batches_) {
            if (!b.count) continue;
            find_fronts(b);
            for (int p = 0; p < b.count; ++p) {
                strands_[b.ray[p]].push_back({&b, p});
                guests_[b.ray[p]] |= guest(b);
            }
        }
        const bool apart = task_.found.own_feature != nullptr;
        bool some = false;
        for (int r = 0; r < rays_.count; ++r) {
            std::vector<Strand> &all = strands_[r];
            if (all.empty()) continue;
            if (guests_[r] && apart) {
                own_.clear();
                for (const Strand &s : all)
                    if (!guest(*s.batch)) own_.push_back(s);
                behind_own_[r] = own_.empty() ? 1.0f : std::exp(-merge_fronts(own_, next_, stops_));
                some = true;
                continue;
            }
            float depth = 0;
            if (all.size() > 1)
                depth = merge_fronts(all, next_, stops_);
            else
                for (int k = 0; k < all[0].batch->samples; ++k) depth += all[0].batch->tau[static_cast<size_t>(k * all[0].batch->stride + all[0].p)];
            behind_[r] = behind_own_[r] = std::exp(-depth);
        }
        clear_sums();
        for (Batch &b : batches_)
            if (b.count) find_weights(b);
        // what the scene's own decoder is to see: everything but the guests
        if (apart) sum_features(true);
        if (some) {
            for (int r = 0; r < rays_.count; ++r)
                if (guests_[r]) behind_[r] = std::exp(-merge_fronts(strands_[r], next_, stops_));
            for (Batch &b : batches_)
                if (b.count) find_weights(b);
        }
        sum_features(false);
    }

    void clear_sums() {
        const size_t width = static_cast<size_t>(task_.fields[0].fixed.outputs - 1);
        feature_.assign(TILE * width, 0.0f);
        own_feature_.assign(TILE * width, 0.0f);
        for (int r = 0; r < TILE; ++r) total_[r] = stopped_[r] = 0;
        for (int i = 0; i < task_.cast.troupe_count - 1; ++i) {
            const int wide = task_.fields[static_cast<size_t>(i + 1)].fixed.outputs - 1;
            for (int r = 0; r < rays_.count; ++r) {
                std::fill_n(task_.found.guest_feature[i] + number_[r] * wide, wide, 0.0f);
                task_.found.guest_opacity[i][number_[r]] = 0;
            }
        }
        if (task_.found.mesh_opacity)
            for (int r = 0; r < rays_.count; ++r) task_.found.mesh_opacity[number_[r]] = 0;
    }

    // Sums of what strands give to their rays. `own`: as if there were no guests, and features alone.
    void sum_features(bool own) {
        const int width = task_.fields[0].fixed.outputs - 1;
        for (Batch &b : batches_) {
            if (!b.count || (own && guest(b))) continue;
            strand_weight_.assign(static_cast<size_t>(b.count), 0.0f);
            for (int k = 0; k < b.samples; ++k)
                for (int p = 0; p < b.count; ++p) strand_weight_[p] += b.weight[static_cast<size_t>(k * b.stride + p)];
            if (b.medium == Medium::mesh) {
                for (int p = 0; p < b.count; ++p) {
                    task_.found.mesh_opacity[number_[b.ray[p]]] += strand_weight_[p];
                    add_depth(b, p);
                }
                continue;
            }
            project(b);
            const int wide_out = field_of(b).wide_out;
            for (int p = 0; p < b.count; ++p) {
                const int r = b.ray[p];
                if (!own) add_depth(b, p);
                const float *feature = &projected_[static_cast<size_t>(p) * wide_out];
                if (!own && guest(b)) {
                    const int i = b.troupe - 1, wide = field_of(b).outputs - 1;
                    float *out = task_.found.guest_feature[i] + number_[r] * wide;
                    for (int f = 0; f < wide; ++f) out[f] += feature[f];
                    task_.found.guest_opacity[i][number_[r]] += strand_weight_[p];
                } else {
                    float *out = (own ? own_feature_.data() : feature_.data()) + static_cast<int64_t>(r) * width;
                    for (int f = 0; f < width; ++f) out[f] += feature[f];
                }
            }
        }
    }

    void add_depth(const Batch &b, int p) {
        const int r = b.ray[p];
        total_[r] += strand_weight_[p];
        for (int k = 0; k < b.samples; ++k) {
            const size_t i = static_cast<size_t>(k * b.stride + p);
            stopped_[r] += b.weight[i] * b.t[i];
        }
    }

    // projected_ (count, wide_out): the strands' features, by weight, as the light has them.
    void project(Batch &b) {
        const Field &field = field_of(b);
        const bool lit = b.medium == Medium::actor && task_.sampling.sky && fields_of(b).scene->light;
        if (lit) find_light(b);
        if (const unisim_head *head = fields_of(b).scene->sample_head) return project_directed(b, *head, lit);
        const int rows = (b.count + ROWS - 1) / ROWS * ROWS;
        summed_.assign(static_cast<size_t>(rows) * field.wide, 0.0f);
        for (int p = 0; p < b.count; ++p) {
            float *sum = &summed_[static_cast<size_t>(p) * field.wide];
            for (int k = 0; k < b.samples; ++k) {
                const size_t i = static_cast<size_t>(k * b.stride + p);
                if (b.slot[i] < 0 || b.weight[i] <= NO_WEIGHT) continue;
                const float *h = &b.units[static_cast<size_t>(b.slot[i]) * field.wide];
                const lanes w = spread(b.weight[i]);
                for (int j = 0; j < field.wide; j += LANES) store(sum + j, load(sum + j) + w * load(h + j));
            }
        }
        projected_.resize(static_cast<size_t>(rows) * field.wide_out);
        layer<false>(rows, field.wide_out, field.hidden, summed_.data(), field.wide, field.feature.data(), projected_.data());
        for (int p = 0; p < b.count; ++p) {
            float *out = &projected_[static_cast<size_t>(p * field.wide_out)];
            for (int f = 0; f + 1 < field.outputs; ++f) out[f] += strand_weight_[p] * field.bias[static_cast<size_t>(f + 1)];
            if (!lit) continue;
            const float *scale = &light_[static_cast<size_t>(2 * p * (field.outputs - 1))], *shift = scale + field.outputs - 1;
            for (int f = 0; f + 1 < field.outputs; ++f) out[f] = out[f] * (1 + scale[f]) + shift[f] * strand_weight_[p];
        }
    }

    // The same where the direction enters at every sample.
    void project_directed(Batch &b, const unisim_head &head, bool lit) {
        const Field &field = field_of(b);
        const int features = field.outputs - 1;
        projected_.assign(static_cast<size_t>(b.count) * field.wide_out, 0.0f);
        heavy_.clear();
        for (int i = 0; i < b.samples * b.stride; ++i)
            if (b.slot[static_cast<size_t>(i)] >= 0 && b.weight[static_cast<size_t>(i)] > LEAST_WEIGHT) heavy_.push_back(i);
        begin_directed(static_cast<int>(heavy_.size()), features);
        for (size_t i = 0; i < heavy_.size(); ++i) {
            const int p = heavy_[i] % b.stride;
            const float *scale = lit ? &light_[static_cast<size_t>(2 * p * features)] : nullptr;
            add_directed(field, &b.units[static_cast<size_t>(b.slot[static_cast<size_t>(heavy_[i])]) * field.wide], b.ray[p], scale);
        }
        run_directed(head);
        for (size_t i = 0; i < heavy_.size(); ++i) {
            float *out = &projected_[static_cast<size_t>(heavy_[i] % b.stride) * field.wide_out];
            const float weight = b.weight[static_cast<size_t>(heavy_[i])];
            for (int f = 0; f < features; ++f) out[f] += weight * directed_[i * static_cast<size_t>(features) + f];
        }
    }

    void begin_directed(int count, int features) {
        undirected_.clear();
        along_.clear();
        directed_.resize(static_cast<size_t>(count) * features);
    }

    void add_directed(const Field &field, const float *h, int r, const float *light) {
        const int features = field.outputs - 1;
        for (int f = 0; f < features; ++f) {
            float value = field.bias[static_cast<size_t>(f + 1)];
            for (int j = 0; j < field.hidden; ++j) value += h[j] * field.feature[static_cast<size_t>(j * field.wide_out + f)];
            undirected_.push_back(light ? value * (1 + light[f]) + light[features + f] : value);
        }
        for (int a = 0; a < 3; ++a) along_.push_back(static_cast<float>(rays_.direction[r][a]));
    }

    void run_directed(const unisim_head &head) {
        UNISIM_NAME(unisim_head_forward)(&head, undirected_.data(), along_.data(), nullptr, static_cast<int64_t>(along_.size() / 3), directed_.data(), 1);
    }

    // light_ (count, 2, features): scales and shifts of actors' features, by the ground round their places;
    // `core/fields/light.py`.
    void find_light(Batch &b) {
        const Fields &fields = fields_of(b);
        const unisim_scene &scene = *fields.scene;
        const Field &field = fields.fixed;
        const unisim_mlp &net = *scene.light;
        const int features = field.outputs - 1;
        light_.assign(static_cast<size_t>(b.count) * 2 * features, 0.0f);
        heavy_.clear();
        for (int p = 0; p < b.count; ++p)
            if (strand_weight_[p] > LEAST_WEIGHT) heavy_.push_back(p);
        constexpr int PLACES = BLOCK / 4;
        const std::vector<float> &first_layer = fields.light_first, &last_layer = fields.light_last;
        const int wide = padded(net.hidden), wide_out = padded(2 * features);
        light_units_.resize(static_cast<size_t>(PLACES) * std::max(field.wide, wide));
        looks_.resize(static_cast<size_t>(PLACES) * std::max(field.wide_out, wide_out));
        for (size_t first = 0; first < heavy_.size(); first += PLACES) {
            const int n = static_cast<int>(std::min<size_t>(PLACES, heavy_.size() - first));
            for (int i = 0; i < filled(4 * n); ++i) {
                const int p = heavy_[first + std::min(i / 4, n - 1)], r = b.ray[p];
                const float t = b.t[static_cast<size_t>((marches(*fields_of(b).scene) ? heaviest(b, p) : b.samples / 2) * b.stride + p)];
                const float *home = scene.light_home + 3 * task_.cast.troupes[b.troupe].rows[b.box[p]];
                const float reach = i & 1 ? -scene.light_reach_m : scene.light_reach_m;
                float place[3];
                for (int a = 0; a < 3; ++a) place[a] = b.troupe == 0 ? o_[r][a] + t * d_[r][a] : home[a];
                place[i & 2 ? 1 : 0] += reach;
                place[2] = ground_at(scene, place[0], place[1]);
                for (int a = 0; a < 3; ++a) x_[a][i] = place[a] / scene.size[a];
            }
            field.units(x_, nullptr, 4 * n, code_.data(), block_.data());
            samples += 4 * n;
            // what is linear may be averaged before: the hidden units in place of the features
            float *mean = light_units_.data();
            for (int i = 0; i < n; ++i)
                for (int j = 0; j < field.wide; j += LANES) {
                    const float *h = &block_[static_cast<size_t>(4 * i * field.wide + j)];
                    store(mean + i * field.wide + j, (load(h) + load(h + field.wide) + load(h + 2 * field.wide) + load(h + 3 * field.wide)) * 0.25f);
                }
            layer<false>(PLACES, field.wide_out, field.hidden, mean, field.wide, field.feature.data(), looks_.data());
            for (int i = 0; i < n; ++i)
                for (int f = 0; f < features; ++f) looks_[static_cast<size_t>(i * field.wide_out + f)] += field.bias[static_cast<size_t>(f + 1)];
            layer<true>(PLACES, wide, features, looks_.data(), field.wide_out, first_layer.data(), light_units_.data());
            layer<false>(PLACES, wide_out, net.hidden, light_units_.data(), wide, last_layer.data(), looks_.data());
            for (int i = 0; i < n; ++i) {
                float *out = &light_[static_cast<size_t>(2 * heavy_[first + i] * features)];
                for (int f = 0; f < 2 * features; ++f) out[f] = looks_[static_cast<size_t>(i * wide_out + f)] + net.bias[f];
            }
        }
    }

    // The far field and the sky, along rays of which a share that counts comes through.
    void beyond() {
        const unisim_sampling &sampling = task_.sampling;
        for (int r = 0; r < rays_.count; ++r) {
            far_depth_[r] = 0;
            far_behind_[r] = 1;
            near_behind_[r] = behind_[r];
        }
        beyond_.clear();
        if (!sampling.far) return;
        for (int r = 0; r < rays_.count; ++r)
            if (behind_own_[r] > std::max(sampling.far_opaque, sampling.opaque)) beyond_.push_back(r);
        if (beyond_.empty()) return;
        const Field &field = task_.fields[0].far;
        const int n = static_cast<int>(beyond_.size()), proposals = sampling.far_proposals, count = sampling.far_samples;
        // of a march the first answers count like the second ones: for as many questions the sum is closer to the integral
        const bool all = sampling.stride_m > 0;
        const int first = all ? proposals : 0;
        far_count_ = first + count;
        far_share_.resize(static_cast<size_t>(n) * (proposals + count));
        far_density_.resize(far_share_.size());
        far_width_.resize(static_cast<size_t>(n) * count);
        float *share = &far_share_[static_cast<size_t>(n) * proposals], *density = &far_density_[static_cast<size_t>(n) * proposals];
        for (int i = 0; i < n * proposals; ++i)
            far_share_[static_cast<size_t>(i)] = (static_cast<float>(i % proposals) + 0.5f) / static_cast<float>(proposals);
        ask_far(far_share_.data(), proposals, far_density_.data(), all ? &far_units_[0] : nullptr);
        for (int i = 0; i < n; ++i) find_far_places(&far_density_[static_cast<size_t>(i * proposals)], share + i * count, &far_width_[static_cast<size_t>(i * count)]);
        ask_far(share, count, density, &far_units_[1]);
        const int rows = (n + ROWS - 1) / ROWS * ROWS;
        std::vector<float> summed(static_cast<size_t>(rows) * field.wide, 0.0f), whole(n, 0.0f), out(static_cast<size_t>(rows) * field.wide_out);
        std::vector<float> behind(n);
        std::vector<float> weights;
        std::vector<int> places;
        if (scene_.sample_head) begin_directed(n * (far_count_ + 1), field.outputs - 1);
        const auto add = [&](int i, float weight, const float *h) {
            if (scene_.sample_head) {
                if (weight <= LEAST_WEIGHT) return;
                add_directed(field, h, beyond_[i], nullptr);
                weights.push_back(weight);
                places.push_back(i);
                return;
            }
            whole[i] += weight;
            if (weight <= NO_WEIGHT) return;
            float *sum = &summed[static_cast<size_t>(i * field.wide)];
            for (int j = 0; j < field.wide; j += LANES) store(sum + j, load(sum + j) + weight * load(h + j));
        };
        far_t_.resize(static_cast<size_t>(n) * far_count_);
        far_tau_.resize(far_t_.size());
        for (int i = 0; i < n; ++i) {
            const float *shares[2] = {&far_share_[static_cast<size_t>(i * proposals)], share + i * count};
            const int counts[2] = {first, count};
            int next[2] = {0, 0};
            float before = 0, edge = 0;
            for (int k = 0; k < far_count_; ++k) {
                // both rise
                const int of = next[0] < counts[0] && (next[1] == counts[1] || shares[0][next[0]] <= shares[1][next[1]]) ? 0 : 1;
                const int j = next[of]++, at = i * (of ? count : proposals) + j;
                const float u = shares[of][j];
                float width;
                if (all) {
                    float after = 1;
                    for (int side = 0; side < 2; ++side)
                        if (next[side] < counts[side]) after = std::min(after, 0.5f * (u + shares[side][next[side]]));
                    width = after - edge;
                    edge = after;
                } else
                    width = far_width_[static_cast<size_t>(at)];
                const size_t place = static_cast<size_t>(i * far_count_ + k);
                far_t_[place] = far_place(beyond_[i], u);
                far_tau_[place] = (of ? density : far_density_.data())[at] * width;
                const float weight = exp_of(-before) * stopped_by(far_tau_[place]);
                add(i, weight, &far_units_[of][static_cast<size_t>(at) * field.wide]);
                far_depth_[beyond_[i]] += weight * far_t_[place];
                before += far_tau_[place];
            }
            behind[i] = exp_of(-before);
        }
        if (sampling.sky) {
            sky(far_units_[0]);
            for (int i = 0; i < n; ++i) add(i, behind[i], &far_units_[0][static_cast<size_t>(i) * field.wide]);
        }
        const int features = field.outputs - 1;
        if (scene_.sample_head)
            direct_far(*scene_.sample_head, weights, places, out);
        else
            layer<false>(rows, field.wide_out, field.hidden, summed.data(), field.wide, field.feature.data(), out.data());
        for (int i = 0; i < n; ++i) {
            const int r = beyond_[i];
            for (int f = 0; f < features; ++f) {
                const float value = out[static_cast<size_t>(i * field.wide_out + f)] + whole[i] * field.bias[static_cast<size_t>(f + 1)];
                feature_[static_cast<size_t>(r * features + f)] += behind_[r] * value;
                own_feature_[static_cast<size_t>(r * features + f)] += behind_own_[r] * value;
            }
            far_behind_[r] = behind[i];
            behind_[r] *= behind[i];
        }
    }

    // Adds what the head makes of the far features noted with `add_directed`, by weight, to out (rays beyond, wide_out).
    void direct_far(const unisim_head &head, const std::vector<float> &weights, const std::vector<int> &places, std::vector<float> &out) {
        const Field &field = task_.fields[0].far;
        const size_t features = static_cast<size_t>(field.outputs - 1);
        run_directed(head);
        std::fill(out.begin(), out.end(), 0.0f);
        for (size_t i = 0; i < weights.size(); ++i)
            for (size_t f = 0; f < features; ++f) out[static_cast<size_t>(places[i] * field.wide_out) + f] += weights[i] * directed_[i * features + f];
    }

    // How far a share of the disparities beyond the volume is along a ray.
    float far_place(int r, float u) const {
        return 1 / ((1 - u) / std::max(far_[r], task_.sampling.near_m) + u / scene_.far_m);
    }

    // Densities at shares of disparity (rays beyond, count); their hidden units too, where `units` is given.
    void ask_far(const float *share, int count, float *density, std::vector<float> *units) {
        const Field &field = task_.fields[0].far;
        const int n = static_cast<int>(beyond_.size()) * count;
        const size_t room = static_cast<size_t>((n + BLOCK - 1) / BLOCK * BLOCK) * field.wide;
        if (units && units->size() < room) units->resize(room);
        samples += n;
        for (int first = 0; first < n; first += BLOCK) {
            const int block = std::min(BLOCK, n - first);
            for (int i = 0; i < filled(block); ++i) {
                const int at = first + std::min(i, block - 1), r = beyond_[at / count];
                const float t = far_place(r, share[at]);
                float y[3], norm = 0;
                for (int a = 0; a < 3; ++a) {
                    y[a] = (o_[r][a] + d_[r][a] * t - scene_.size[a] / 2) / scene_.far_radius;
                    norm += y[a] * y[a];
                }
                // mip-NeRF 360's contraction (Barron et al., 2022, eq. 10)
                norm = std::fmax(std::sqrt(norm), 1e-9f);
                const float scale = norm <= 1 ? 1.0f : (2 - 1 / norm) / norm;
                for (int a = 0; a < 3; ++a) x_[a][i] = y[a] * scale / 4 + 0.5f;
            }
            float *h = units ? units->data() + static_cast<size_t>(first) * field.wide : block_.data();
            field.units(x_, nullptr, block, code_.data(), h);
            for (int i = 0; i < block; ++i) density[first + i] = exp_of(least(field.first_output(h + i * field.wide), MAX_LOG_DENSITY));
        }
    }

    // Hidden units (rays beyond, wide) at infinity.
    void sky(std::vector<float> &units) {
        const Field &field = task_.fields[0].far;
        const int n = static_cast<int>(beyond_.size());
        const size_t room = static_cast<size_t>((n + BLOCK - 1) / BLOCK * BLOCK) * field.wide;
        if (units.size() < room) units.resize(room);
        samples += n;
        for (int first = 0; first < n; first += BLOCK) {
            const int block = std::min(BLOCK, n - first);
            for (int i = 0; i < filled(block); ++i)
                for (int a = 0; a < 3; ++a) x_[a][i] = d_[beyond_[first + std::min(i, block - 1)]][a] / 2 + 0.5f;
            field.units(x_, nullptr, block, code_.data(), units.data() + static_cast<size_t>(first) * field.wide);
        }
    }

    // Where one ray asks the far field again, as shares of disparity, and the lengths of the intervals round these places.
    void find_far_places(const float *density, float *share, float *width) {
        const int proposals = task_.sampling.far_proposals, count = task_.sampling.far_samples;
        std::vector<float> &sum = far_sum_;
        sum.assign(static_cast<size_t>(proposals) + 1, 0.0f);
        float before = 0, total = 0;
        for (int k = 0; k < proposals; ++k) {
            const float tau = density[k] / static_cast<float>(proposals);
            sum[static_cast<size_t>(k + 1)] = exp_of(-before) * stopped_by(tau) + 1e-3f;
            total += sum[static_cast<size_t>(k + 1)];
            before += tau;
        }
        for (int k = 1; k <= proposals; ++k) sum[k] = sum[k - 1] + 0.8f * sum[k] / total + 0.2f / static_cast<float>(proposals);
        int j = 1;
        float edge = 0;
        for (int k = 0; k <= count; ++k) {
            const float target = static_cast<float>(k) / static_cast<float>(count) * sum[proposals];
            while (j < proposals && sum[j] <= target) ++j;
            const float at = (static_cast<float>(j - 1) + (target - sum[j - 1]) / (sum[j] - sum[j - 1])) / static_cast<float>(proposals);
            if (k) {
                width[k - 1] = at - edge;
                share[k - 1] = edge + 0.5f * (at - edge);
            }
            edge = at;
        }
    }

    void finish() {
        const unisim_found &found = task_.found;
        const int width = task_.fields[0].fixed.outputs - 1;
        for (int r = 0; r < rays_.count; ++r) {
            const int64_t i = number_[r];
            const float opacity = 1 - behind_[r];
            const float mean = stopped_[r] / std::fmax(total_[r], 1e-6f) * (1 - near_behind_[r]) + near_behind_[r] * far_depth_[r];
            std::copy_n(&feature_[static_cast<size_t>(r) * width], width, found.feature + i * width);
            if (found.own_feature) std::copy_n(&own_feature_[static_cast<size_t>(r) * width], width, found.own_feature + i * width);
            found.opacity[i] = opacity;
            found.depth[i] = mean / std::fmax(opacity, 1e-6f);
        }
        if (found.median) find_medians();
        if (found.instance) find_instances();
        if (found.normal) find_normals();
    }

    // Median distances; `core/median.py`.
    void find_medians() {
        for (int r = 0; r < rays_.count; ++r) {
            const float wanted = (1 + behind_[r]) / 2;
            float depth = 0;
            for (const Strand &s : strands_[r]) {
                const Batch &b = *s.batch;
                const unisim_scene &scene = *fields_of(b).scene;
                for (int k = 0; k < b.samples; ++k) {
                    const size_t i = static_cast<size_t>(k * b.stride + s.p);
                    if (b.front[i] > wanted && b.front[i] * std::exp(-b.tau[i]) <= wanted)
                        depth = b.medium == Medium::mesh ? b.t[i] : place_of(b, s.p, k, wanted, scene.beta, scene.paper_density != 0);
                }
            }
            task_.found.median[number_[r]] = depth;
        }
        const int count = far_count_;
        for (size_t i = 0; i < beyond_.size(); ++i) {
            const int r = beyond_[i];
            const float wanted = (1 + behind_[r]) / 2;
            float front = near_behind_[r];
            for (int k = 0; k < count; ++k) {
                const float after = front * std::exp(-far_tau_[i * count + k]);
                if (front > wanted && after <= wanted) task_.found.median[number_[r]] = far_t_[i * count + k];
                front = after;
            }
        }
    }

    static int heaviest(const Batch &b, int p) {
        int best = 0;
        for (int k = 1; k < b.samples; ++k)
            if (b.weight[static_cast<size_t>(k * b.stride + p)] > b.weight[static_cast<size_t>(best * b.stride + p)]) best = k;
        return best;
    }

    static float weight_of(const Strand &s) {
        float sum = 0;
        for (int k = 0; k < s.batch->samples; ++k) sum += s.batch->weight[static_cast<size_t>(k * s.batch->stride + s.p)];
        return sum;
    }

    // 1 + the number of the actor with the largest weight on a ray, 0 where the rest outweighs it.
    void find_instances() {
        for (int r = 0; r < rays_.count; ++r) {
            float best = 0, rest = behind_[r];
            int32_t number = 0;
            for (const Strand &s : strands_[r]) {
                const float weight = weight_of(s);
                if (s.batch->medium == Medium::fixed || s.batch->medium == Medium::copy)
                    rest += weight;
                else if (weight > best) {
                    best = weight;
                    number = task_.first[static_cast<size_t>(s.batch->troupe)] + s.batch->box[s.p] + 1;
                }
            }
            task_.found.instance[number_[r]] = best > rest ? number : 0;
        }
    }

    // Unit normals: each strand's gradient of the distance at its heaviest sample, by differences on a tetrahedron, by weight.
    void find_normals() {
        constexpr float CORNER[4][3] = {{1, -1, -1}, {-1, -1, 1}, {-1, 1, -1}, {1, 1, 1}};
        std::vector<float> sum(3 * TILE, 0.0f);
        for (Batch &b : batches_) {
            if (!b.count) continue;
            std::vector<Strand> heavy;
            for (int p = 0; p < b.count; ++p)
                if (weight_of({&b, p}) > LEAST_WEIGHT) heavy.push_back({&b, p});
            if (b.medium == Medium::mesh) {
                for (const Strand &s : heavy)
                    for (int a = 0; a < 3; ++a) sum[3 * b.ray[s.p] + a] += weight_of(s) * b.size[3 * s.p + a];
                continue;
            }
            const Field &field = field_of(b);
            const unisim_troupe *troupe = b.medium == Medium::actor ? &task_.cast.troupes[b.troupe] : nullptr;
            constexpr int PLACES = BLOCK / 4;
            for (size_t first = 0; first < heavy.size(); first += PLACES) {
                const int n = static_cast<int>(std::min<size_t>(PLACES, heavy.size() - first));
                for (int i = 0; i < filled(4 * n); ++i) {
                    const int p = heavy[first + std::min(i / 4, n - 1)].p;
                    const float t = b.t[static_cast<size_t>(heaviest(b, p) * b.stride + p)];
                    for (int a = 0; a < 3; ++a)
                        x_[a][i] = (b.o[3 * p + a] + t * b.d[3 * p + a] + NORMAL_STEP_M * CORNER[i % 4][a]) / b.size[3 * p + a] + (troupe ? 0.5f : 0.0f);
                    row_[i] = troupe ? troupe->rows[b.box[p]] : 0;
                }
                field.units(x_, troupe ? row_ : nullptr, 4 * n, code_.data(), block_.data());
                samples += 4 * n;
                for (int i = 0; i < n; ++i) {
                    const Strand &s = heavy[first + i];
                    float gradient[3] = {}, world[3] = {}, length = 0;
                    for (int c = 0; c < 4; ++c) {
                        const float value = field.first_output(&block_[static_cast<size_t>((4 * i + c) * field.wide)]);
                        for (int a = 0; a < 3; ++a) gradient[a] += value * CORNER[c][a];
                    }
                    turn_normal(b, s.p, gradient, world);
                    for (const float x : world) length += x * x;
                    length = std::fmax(std::sqrt(length), 1e-12f);
                    for (int a = 0; a < 3; ++a) sum[3 * b.ray[s.p] + a] += weight_of(s) * world[a] / length;
                }
            }
        }
        for (int r = 0; r < rays_.count; ++r) {
            const float *v = &sum[3 * r];
            const float length = std::fmax(std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]), 1e-12f);
            for (int a = 0; a < 3; ++a) task_.found.normal[3 * number_[r] + a] = 1 - behind_[r] > 0.5f ? v[a] / length : 0.0f;
        }
    }

    // A gradient in a strand's own axes along the world's.
    void turn_normal(const Batch &b, int p, const float *g, float *world) const {
        const double *m = scene_.volume_from_world;
        float local[3] = {g[0], g[1], g[2]};
        if (b.medium != Medium::actor)
            for (int a = 0; a < 3; ++a) local[a] = static_cast<float>(m[a] * g[0] + m[4 + a] * g[1] + m[8 + a] * g[2]);
        if (b.medium == Medium::fixed) {
            std::copy_n(local, 3, world);
            return;
        }
        const float *rotation = &b.rotation[static_cast<size_t>(9 * p)];
        for (int a = 0; a < 3; ++a) world[a] = rotation[3 * a] * local[0] + rotation[3 * a + 1] * local[1] + rotation[3 * a + 2] * local[2];
    }

    const Task &task_;
    const unisim_scene &scene_;
    TileRays rays_;
    int64_t number_[TILE];
    float o_[TILE][3], d_[TILE][3], far_[TILE];
    std::vector<Occupied> occupied_;
    std::vector<Hit> hits_;
    std::vector<Batch> batches_; // what stands still, the troupes, copies, meshes
    std::vector<float> quantile_, shares_, passed_, code_, block_, light_, light_units_, looks_, undirected_, along_, directed_;
    std::vector<int> going_, wanted_, heavy_;
    March march_;
    Asked asked_;
    std::vector<float> begin_[3], way_[3]; // of a batch's strands
    std::vector<int32_t> rows_;            // their actors' grids
    int32_t steps_[TILE]; // through the cells, of the strands of what stands still
    std::vector<Run> span_[TILE];
    float x_[3][BLOCK];
    int32_t row_[BLOCK];
    std::vector<Strand> strands_[TILE], own_;
    bool guests_[TILE];
    std::vector<int> next_;
    std::vector<float> stops_, strand_weight_, summed_, projected_, feature_, own_feature_;
    float behind_[TILE], behind_own_[TILE], total_[TILE], stopped_[TILE];
    std::vector<int> beyond_;
    int far_count_ = 0;
    std::vector<float> far_t_, far_tau_, far_share_, far_density_, far_width_, far_sum_;
    std::vector<float> far_units_[2]; // of the first answers, of the second ones
    float far_depth_[TILE], far_behind_[TILE], near_behind_[TILE];
};

} // namespace

extern "C" int UNISIM_NAME(unisim_trace)(const unisim_scene *scene, const unisim_cast *cast, const unisim_rays *rays,
                                         const unisim_mesh_hits *meshes, const unisim_sampling *sampling,
                                         const unisim_found *found, int threads) {
    Task task{*scene, *cast, *rays, meshes, *sampling, *found, {}, {}};
    int first = 0;
    for (int i = 0; i < cast->troupe_count; ++i) {
        task.fields.emplace_back(cast->troupes[i].scene);
        task.first.push_back(first);
        first += cast->troupes[i].count;
    }
    task.first.push_back(first);
    std::atomic<int64_t> samples{0};
    parallel_bodies(rays->n, 4 * TILE, threads, [&] {
        return [&, tile = std::make_unique<Tile>(task)](int64_t begin, int64_t end) {
            tile->samples = 0;
            for (int64_t at = begin; at < end; at += TILE) tile->trace(at, std::min(at + TILE, end));
            samples += tile->samples;
        };
    });
    *found->samples = samples;
    return 0;
}

// Chessboard distances (X, Y, Z), in voxels and at most 255, to the nearest voxel that is not free.
extern "C" int UNISIM_NAME(unisim_clearance)(const uint8_t *voxels, const int32_t *shape, uint8_t *out) {
    const int64_t nx = shape[0], ny = shape[1], nz = shape[2];
    for (int64_t i = 0; i < nx * ny * nz; ++i) out[i] = voxels[i] ? 0 : 255;
    std::vector<uint8_t> least(static_cast<size_t>(nz) + 2), wide(static_cast<size_t>(nz));
    const auto sweep = [&](int sign) {
        for (int64_t ii = 0; ii < nx; ++ii)
            for (int64_t jj = 0; jj < ny; ++jj) {
                const int64_t i = sign > 0 ? ii : nx - 1 - ii, j = sign > 0 ? jj : ny - 1 - jj;
                // the four rows of neighbours that were swept before, and a voxel at both their ends
                std::fill(least.begin(), least.end(), 255);
                const auto join = [&](int64_t a, int64_t b) {
                    if (a < 0 || a >= nx || b < 0 || b >= ny) return;
                    const uint8_t *row = out + (a * ny + b) * nz;
                    for (int64_t k = 0; k < nz; ++k) least[k + 1] = std::min(least[k + 1], row[k]);
                };
                for (int dj = -1; dj <= 1; ++dj) join(i - sign, j + dj);
                join(i, j - sign);
                for (int64_t k = 0; k < nz; ++k) wide[k] = std::min(std::min(least[k], least[k + 1]), least[k + 2]);
                uint8_t *row = out + (i * ny + j) * nz, before = 255;
                for (int64_t kk = 0; kk < nz; ++kk) {
                    const int64_t k = sign > 0 ? kk : nz - 1 - kk;
                    before = row[k] = static_cast<uint8_t>(std::min<int>(row[k], std::min(wide[k], before) + 1));
                }
            }
    };
    sweep(1);
    sweep(-1);
    return 0;
}
