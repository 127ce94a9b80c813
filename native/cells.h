// Where a field can stop a ray: cells of a voxel, and of an actor's box, found by asking the trained distance once a scene.
//
// A voxel is CELLS x CELLS x CELLS cells. A cell is `surface` where the distance comes near zero, or where it is behind a surface
// beside what is open: a ray that comes from the open meets such a cell first. Elsewhere behind surfaces it is `solid`.
#pragma once
#include "field_tile.h"

namespace {

constexpr int CELLS = 2;
// Points that are asked along each edge of a cell.
constexpr int POINTS = 2;
constexpr int BOX_CELLS = 16;
enum : uint8_t { OPEN, SOLID, SURFACE };

// A cell by its least and largest distance, where points lie `gap` apart along an edge.
inline uint8_t kind_of(float least, float largest, float gap) {
    // the cube about a point ends between 0.5 and 0.87 of the gap from it: what crosses its corners alone shows beside it too
    const float reach = 0.67f * gap;
    return least > reach ? OPEN : largest < -reach ? SOLID : SURFACE;
}

// Solid cells of a grid beside open ones, or at its border where that is open, are surfaces too.
template <class At> uint8_t raised(const At &at, int i, int j, int k) {
    if (at(i, j, k) != SOLID) return at(i, j, k);
    for (int a = -1; a <= 1; ++a)
        for (int b = -1; b <= 1; ++b)
            for (int c = -1; c <= 1; ++c)
                if (at(i + a, j + b, k + c) == OPEN) return SURFACE;
    return SOLID;
}

} // namespace
