// Planes fitted to the points around a place: the normal is the direction in which its nearest neighbours vary
// smallest (Hoppe et al., "Surface reconstruction from unorganized points", 1992).
#include "variant.h"

#include <cmath>
#include <limits>
#include <utility>

namespace {

// Eigenvectors (the columns of v) of a symmetric 3x3 matrix by Jacobi rotations; the diagonal of a becomes the
// eigenvalues.
void jacobi(double a[3][3], double v[3][3]) {
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) v[i][k] = i == k;
    for (int sweep = 0; sweep < 12; ++sweep) {
        const double off = a[0][1] * a[0][1] + a[0][2] * a[0][2] + a[1][2] * a[1][2];
        const double on = a[0][0] * a[0][0] + a[1][1] * a[1][1] + a[2][2] * a[2][2];
        if (off <= 1e-30 * on || off == 0.0) return;
        for (int p = 0; p < 2; ++p)
            for (int q = p + 1; q < 3; ++q) {
                if (a[p][q] == 0.0) continue;
                const double theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
                const double t = (theta >= 0 ? 1.0 : -1.0) / (std::abs(theta) + std::sqrt(theta * theta + 1));
                const double c = 1 / std::sqrt(t * t + 1), s = t * c;
                for (int k = 0; k < 3; ++k) {
                    const double x = a[k][p], y = a[k][q];
                    a[k][p] = c * x - s * y, a[k][q] = s * x + c * y;
                }
                for (int k = 0; k < 3; ++k) {
                    const double x = a[p][k], y = a[q][k];
                    a[p][k] = c * x - s * y, a[q][k] = s * x + c * y;
                }
                for (int k = 0; k < 3; ++k) {
                    const double x = v[k][p], y = v[k][q];
                    v[k][p] = c * x - s * y, v[k][q] = s * x + c * y;
                }
            }
    }
}

} // namespace

// points (n, 3), sorted by cell: those of cell keys[i] are starts[i] to before starts[i + 1]. A cell is a cube with
// edges of `radius`; cell (x, y, z) of a grid of dims cells from `low` on has the key (x * dims[1] + y) * dims[2] + z.
// The outermost cells are empty.
// For each query (m, 3), of its nearest points within `radius`, at most `capacity`: count (m); normal (m, 3), 0 for
// fewer than three points; height (m) of their mean above the query along the normal; rough (m), their standard
// deviation along the normal; reach (m), the distance to the farthest of them.
extern "C" int UNISIM_NAME(unisim_local_planes)(const float *points, const int64_t *keys, const int64_t *starts,
                                                int64_t cells, const double *low, const int64_t *dims, double radius,
                                                int32_t capacity, const float *queries, int64_t m, int32_t *count,
                                                float *normal, float *height, float *rough, float *reach, int threads) {
    parallel_bodies(m, 512, threads, [&] {
        return [&, near = std::vector<std::pair<float, int64_t>>()](int64_t begin, int64_t end) mutable {
            for (int64_t i = begin; i < end; ++i) {
                const float *q = queries + 3 * i;
                int64_t cell[3];
                for (int k = 0; k < 3; ++k) cell[k] = static_cast<int64_t>(std::floor((q[k] - low[k]) / radius));
                near.clear();
                const float limit = static_cast<float>(radius * radius);
                for (int64_t x = std::max<int64_t>(cell[0] - 1, 0); x <= std::min(cell[0] + 1, dims[0] - 1); ++x)
                    for (int64_t y = std::max<int64_t>(cell[1] - 1, 0); y <= std::min(cell[1] + 1, dims[1] - 1); ++y) {
                        const int64_t z0 = std::max<int64_t>(cell[2] - 1, 0), z1 = std::min(cell[2] + 1, dims[2] - 1);
                        if (z0 > z1) continue;
                        const int64_t column = (x * dims[1] + y) * dims[2];
                        const int64_t *from = std::lower_bound(keys, keys + cells, column + z0);
                        const int64_t *to = std::upper_bound(from, keys + cells, column + z1);
                        if (from == to) continue;
                        for (int64_t j = starts[from - keys]; j < starts[to - keys]; ++j) {
                            const float dx = points[3 * j] - q[0], dy = points[3 * j + 1] - q[1],
                                        dz = points[3 * j + 2] - q[2];
                            const float squared = dx * dx + dy * dy + dz * dz;
                            if (squared <= limit) near.emplace_back(squared, j);
                        }
                    }
                if (static_cast<int64_t>(near.size()) > capacity) {
                    std::nth_element(near.begin(), near.begin() + capacity, near.end());
                    near.resize(capacity);
                }
                float farthest = 0;
                double mean[3] = {}, covariance[3][3] = {}, axes[3][3];
                for (const auto &[squared, j] : near) {
                    farthest = std::max(farthest, squared);
                    for (int k = 0; k < 3; ++k) mean[k] += double(points[3 * j + k]) - q[k];
                }
                const double n = static_cast<double>(near.size());
                for (int k = 0; k < 3; ++k) mean[k] /= std::max(n, 1.0);
                for (const auto &[squared, j] : near) {
                    double d[3];
                    for (int k = 0; k < 3; ++k) d[k] = double(points[3 * j + k]) - q[k] - mean[k];
                    for (int k = 0; k < 3; ++k)
                        for (int l = 0; l < 3; ++l) covariance[k][l] += d[k] * d[l];
                }
                count[i] = static_cast<int32_t>(near.size());
                reach[i] = std::sqrt(farthest);
                height[i] = rough[i] = 0;
                for (int k = 0; k < 3; ++k) normal[3 * i + k] = 0;
                if (near.size() < 3) continue;
                jacobi(covariance, axes);
                int smallest = 0;
                for (int k = 1; k < 3; ++k)
                    if (covariance[k][k] < covariance[smallest][smallest]) smallest = k;
                double along = 0;
                for (int k = 0; k < 3; ++k)
                    normal[3 * i + k] = static_cast<float>(axes[k][smallest]), along += axes[k][smallest] * mean[k];
                height[i] = static_cast<float>(along);
                rough[i] = static_cast<float>(std::sqrt(std::max(covariance[smallest][smallest], 0.0) / n));
            }
        };
    });
    return 0;
}
