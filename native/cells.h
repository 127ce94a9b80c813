// Where a field can stop a ray: cells of voxels and of actors' boxes, found by evaluating the trained distance once
// per scene.
//
// A voxel has CELLS x CELLS x CELLS cells. A cell is `surface` where the distance comes near zero, and where it lies
// behind a surface but next to an open cell: a ray that comes through open cells enters such a cell first. Other
// cells behind surfaces are `solid`.
#pragma once
#include "field_tile.h"
#include "one_ray.h"

namespace {

// The kind of a cell by the minimum and maximum of the distance at its points, which lie `gap` apart along an edge.
inline uint8_t kind_of(float minimum, float maximum, float gap) {
    // the cube around a point ends between 0.5 and 0.87 gaps from it; a surface that only cuts its corners shows in
    // neighbours too
    const float reach = 0.67f * gap;
    return minimum > reach ? OPEN : maximum < -reach ? SOLID : SURFACE;
}

// The kind of a cell in a grid: solid cells next to open ones are surface cells too. at(i, j, k) is OPEN outside the
// grid.
template <class At> uint8_t kind_in_grid(const At &at, int i, int j, int k) {
    if (at(i, j, k) != SOLID) return at(i, j, k);
    for (int a = -1; a <= 1; ++a)
        for (int b = -1; b <= 1; ++b)
            for (int c = -1; c <= 1; ++c)
                if (at(i + a, j + b, k + c) == OPEN) return SURFACE;
    return SOLID;
}

} // namespace
