// A field asked at places on strands, a block of points at a time.
#pragma once
#include "clearing.h"

namespace {

constexpr float EMPTY_M = 10.0f;

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

class Asking {
  public:
    Asked asked;

    Asking(Tile &tile, const Clearing &clearing) : tile_(tile), clearing_(clearing) {}

    // Strands in the unit cube of their field: where they begin and how far they go a metre.
    void find_ways(const Batch &b) {
        const unisim_troupe *troupe = b.medium == Medium::actor ? &tile_.task.cast.troupes[b.troupe] : nullptr;
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

    // The distances at the places `asked` and, where units are to be kept, their slots; after `find_ways`.
    void ask_at(Batch &b, bool keep) {
        const Field &field = tile_.field_of(b);
        const int count = asked.count;
        tile_.samples += count;
        if (keep) {
            // grown, and never cleared: what is kept is written before it is read
            const size_t slots = b.slots + static_cast<size_t>((count + BLOCK - 1) / BLOCK * BLOCK);
            if (b.units.size() < slots * field.wide) b.units.resize(slots * field.wide);
        }
        for (int first = 0; first < count; first += BLOCK) {
            const int n = std::min(BLOCK, count - first);
            const int32_t *strand = &asked.strand[first];
            const float *t = &asked.t[first];
            for (int i = 0; i < filled(n); ++i) {
                const int j = std::min(i, n - 1), p = strand[j];
                for (int a = 0; a < 3; ++a) tile_.x[a][i] = begin_[a][p] + t[j] * way_[a][p];
                tile_.row[i] = rows_[p];
            }
            float *h = keep ? &b.units[b.slots * field.wide] : tile_.block.data();
            field.units(tile_.x, b.medium == Medium::actor ? tile_.row : nullptr, n, tile_.code.data(), h);
            for (int i = 0; i < n; ++i) {
                float &s = asked.s[first + i] = field.first_output(h + i * field.wide);
                asked.slot[first + i] = keep ? static_cast<int>(b.slots) + i : -1;
                if (b.medium == Medium::fixed) clearing_.empty(b, strand[i], t[i], s);
                if (b.medium == Medium::copy) lift(b, strand[i], t[i], s);
            }
            if (keep) b.slots += n;
        }
    }

  private:
    // The ground of a copied box stays where it is.
    void lift(const Batch &b, int p, float t, float &s) const {
        const float z = b.o[3 * p + 2] + t * b.d[3 * p + 2];
        const float height = ground_at(tile_.scene, b.o[3 * p] + t * b.d[3 * p], b.o[3 * p + 1] + t * b.d[3 * p + 1]);
        if (!(z > height + tile_.scene.ground_clearance_m)) s = EMPTY_M;
    }

    Tile &tile_;
    const Clearing &clearing_;
    std::vector<float> begin_[3], way_[3]; // of a batch's strands
    std::vector<int32_t> rows_;            // their actors' grids
};

} // namespace
