// Evaluates the fields of ray segments, a block of points at a time.
#pragma once
#include "static_mask.h"

namespace {

constexpr float EMPTY_M = 10.0f;

// Points on segments of one kind: distances t along the rays, and what was found there: signed distances s and slots
// of hidden units.
struct FieldQueries {
    int count = 0;
    std::vector<int32_t> segment, slot;
    std::vector<float> t, s;

    void resize(int n) {
        count = n;
        for (auto *v : {&segment, &slot}) v->resize(static_cast<size_t>(n));
        for (auto *v : {&t, &s}) v->resize(static_cast<size_t>(n));
    }
};

class FieldEvaluator {
  public:
    FieldQueries queries;

    FieldEvaluator(Tile &tile, const StaticMask &mask) : tile_(tile), mask_(mask) {}

    // Prepares the rays of segments in the unit cube of their field: origins, and directions per metre along the ray.
    template <class Segments> void start(const Segments &b) {
        const size_t count = static_cast<size_t>(b.count);
        for (size_t a = 0; a < 3; ++a) {
            origin_[a].resize(count);
            direction_[a].resize(count);
            for (size_t p = 0; p < count; ++p) {
                origin_[a][p] = b.o[3 * p + a] / tile_.size_of(b, p)[a] + Tile::offset_of(b);
                direction_[a][p] = b.d[3 * p + a] / tile_.size_of(b, p)[a];
            }
        }
        rows_.resize(count);
        for (size_t p = 0; p < count; ++p) rows_[p] = Tile::row_of(b, p);
    }

    // Evaluates `queries` on the segments that `start` prepared; hidden units go to slots of `b` where `keep` is set.
    template <class Segments> void evaluate(Segments &b, bool keep) {
        const Field &field = tile_.field_of(b);
        const int count = queries.count;
        tile_.samples += count;
        if (keep) {
            // the buffer only grows and is not cleared: units are written before they are read
            const size_t slots = b.slots + static_cast<size_t>((count + BLOCK - 1) / BLOCK * BLOCK);
            if (b.units.size() < slots * field.wide) b.units.resize(slots * field.wide);
        }
        for (int first = 0; first < count; first += BLOCK) {
            const int n = std::min(BLOCK, count - first);
            const int32_t *segment = &queries.segment[first];
            const float *t = &queries.t[first];
            for (int i = 0; i < filled(n); ++i) {
                const int j = std::min(i, n - 1), p = segment[j];
                for (int a = 0; a < 3; ++a) tile_.x[a][i] = origin_[a][p] + t[j] * direction_[a][p];
                tile_.row[i] = rows_[p];
            }
            float *h = keep ? &b.units[b.slots * field.wide] : tile_.block.data();
            field.units(tile_.x, tile_.rows_of(b), n, tile_.code.data(), h);
            for (int i = 0; i < n; ++i) {
                float &s = queries.s[first + i] = field.first_output(h + i * field.wide);
                queries.slot[first + i] = keep ? static_cast<int>(b.slots) + i : -1;
                edit(b, segment[i], t[i], s);
            }
            if (keep) b.slots += n;
        }
    }

  private:
    // Applies the scenario's edits to a distance.
    void edit(const StaticSegments &b, int p, float t, float &s) const { mask_.apply(b, p, t, s); }
    void edit(const ActorSegments &, int, float, float &) const {}

    // Of a copied box, the ground stays where it is.
    void edit(const CopySegments &b, int p, float t, float &s) const {
        const float z = b.o[3 * p + 2] + t * b.d[3 * p + 2];
        const float height = ground_at(tile_.scene, b.o[3 * p] + t * b.d[3 * p], b.o[3 * p + 1] + t * b.d[3 * p + 1]);
        if (!(z > height + tile_.scene.ground_clearance_m)) s = EMPTY_M;
    }

    Tile &tile_;
    const StaticMask &mask_;
    std::vector<float> origin_[3], direction_[3]; // of the segments
    std::vector<int32_t> rows_;                   // numbers of their actors' grids
};

} // namespace
