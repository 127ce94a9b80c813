// Distances of voxels to the nearest one that can stop a ray, by which free space is skipped.
#include "variant.h"

#include <cmath>
#include <limits>

// Chessboard distances (X, Y, Z), in voxels and at most 255, to the nearest voxel that is not free.
extern "C" int UNISIM_NAME(unisim_clearance)(const uint8_t *voxels, const int32_t *shape, uint8_t *out) {
    const int64_t nx = shape[0], ny = shape[1], nz = shape[2];
    for (int64_t i = 0; i < nx * ny * nz; ++i) out[i] = voxels[i] ? 0 : 255;
    std::vector<uint8_t> nearest(static_cast<size_t>(nz) + 2), wide(static_cast<size_t>(nz));
    const auto sweep = [&](int sign) {
        for (int64_t ii = 0; ii < nx; ++ii)
            for (int64_t jj = 0; jj < ny; ++jj) {
                const int64_t i = sign > 0 ? ii : nx - 1 - ii, j = sign > 0 ? jj : ny - 1 - jj;
                // the minimum over the four rows of neighbours before this one, with a voxel of padding at both ends
                std::fill(nearest.begin(), nearest.end(), 255);
                const auto join = [&](int64_t a, int64_t b) {
                    if (a < 0 || a >= nx || b < 0 || b >= ny) return;
                    const uint8_t *row = out + (a * ny + b) * nz;
                    for (int64_t k = 0; k < nz; ++k) nearest[k + 1] = std::min(nearest[k + 1], row[k]);
                };
                for (int dj = -1; dj <= 1; ++dj) join(i - sign, j + dj);
                join(i, j - sign);
                for (int64_t k = 0; k < nz; ++k)
                    wide[k] = std::min(std::min(nearest[k], nearest[k + 1]), nearest[k + 2]);
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

// Metres (n) along rays to the first voxel whose clearance is 0, infinity where there is none; rays (n, 3) in the
// voxels' coordinates, from `near` on, inside a box of `size` (3). `ObservedSpace.first_reference` is the same in
// numpy.
extern "C" int UNISIM_NAME(unisim_first_marked)(const double *origins, const double *directions, int64_t n, double near,
                                                const double *size, const uint8_t *clearance, const int32_t *shape,
                                                double voxel_m, float *out, int threads) {
    parallel_blocks(n, 4096, threads, [&](int64_t begin, int64_t end) {
        for (int64_t r = begin; r < end; ++r) {
            const double *o = origins + 3 * r, *d = directions + 3 * r;
            double t = near, far = std::numeric_limits<double>::infinity(), fastest = 0;
            for (int a = 0; a < 3; ++a) {
                const double along = std::fabs(d[a]) < 1e-9 ? 1e-9 : d[a];
                const double first = -o[a] / along, second = (size[a] - o[a]) / along;
                t = std::max(t, std::min(first, second));
                far = std::min(far, std::max(first, second));
                fastest = std::max(fastest, std::fabs(d[a]));
            }
            out[r] = std::numeric_limits<float>::infinity();
            while (t < far) {
                int64_t cell = 0;
                for (int a = 0; a < 3; ++a) {
                    const double x = std::max((o[a] + t * d[a]) / voxel_m, 0.0);
                    cell = cell * shape[a] + std::min<int64_t>(static_cast<int64_t>(x), shape[a] - 1);
                }
                if (!clearance[cell]) {
                    out[r] = static_cast<float>(t);
                    break;
                }
                // no marked voxel is nearer than the clearance less one voxel; next to one, steps are half a voxel
                t += std::max((clearance[cell] - 1.0) / fastest, 0.5) * voxel_m;
            }
        }
    });
    return 0;
}
