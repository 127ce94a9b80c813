// Perceptrons of two layers, out = W2 relu(W1 x) + b, forward and backward. Compiled once for each instruction set.
//
// The specification is plain torch, in core/ops/mlp.py. Points are processed in tiles that stay in the first-level
// cache together with both layers' weights, so that the hidden layer is never written to memory; the backward pass
// computes it again.
#include "simd.h"
#include "variant.h"

namespace {

#if defined(__AVX512F__)
constexpr int ROWS = 8;
#else
constexpr int ROWS = 4;
#endif
// Matrices are padded to a multiple of this many columns: two registers, with ROWS pairs of registers for the sums.
constexpr int PANEL = 2 * LANES;
constexpr int TILE = 128, CHUNK = 16 * TILE;

constexpr int padded(int n) { return (n + PANEL - 1) / PANEL * PANEL; }

// c (R, PANEL) = or += a (R, k) b (k, PANEL); an element of a is a[r * row + i * step].
template <int R>
inline void multiply_panel(int64_t k, const float *a, int64_t row, int64_t step, const float *b, int64_t b_row,
                           float *c, int64_t c_row, bool add) {
    simd_float sum[R][2];
    for (int r = 0; r < R; ++r)
        for (int j = 0; j < 2; ++j) sum[r][j] = add ? load(c + r * c_row + j * LANES) : simd_float{};
    for (int64_t i = 0; i < k; ++i) {
        const simd_float b0 = load(b + i * b_row), b1 = load(b + i * b_row + LANES);
        for (int r = 0; r < R; ++r) {
            const simd_float x = broadcast(a[r * row + i * step]);
            sum[r][0] += x * b0;
            sum[r][1] += x * b1;
        }
    }
    for (int r = 0; r < R; ++r)
        for (int j = 0; j < 2; ++j) store(c + r * c_row + j * LANES, sum[r][j]);
}

// c (m, n) = or += a (m, k) b (k, n), n a multiple of PANEL.
void multiply(int64_t m, int64_t n, int64_t k, const float *a, int64_t row, int64_t step, const float *b, float *c,
              bool add) {
    for (int64_t j = 0; j < n; j += PANEL) {
        int64_t i = 0;
        for (; i + ROWS <= m; i += ROWS)
            multiply_panel<ROWS>(k, a + i * row, row, step, b + j, n, c + i * n + j, n, add);
        for (; i < m; ++i) multiply_panel<1>(k, a + i * row, row, step, b + j, n, c + i * n + j, n, add);
    }
}

// Copies (rows, columns) into (rows, padded(columns)), or its transpose into (columns, padded(rows)), padded with
// zeros.
std::vector<float> pack(const float *w, int rows, int columns, bool transposed) {
    const int m = transposed ? columns : rows, n = transposed ? rows : columns, wide = padded(n);
    std::vector<float> out(static_cast<size_t>(m) * wide, 0.0f);
    for (int i = 0; i < m; ++i)
        for (int j = 0; j < n; ++j)
            out[static_cast<size_t>(i) * wide + j] = transposed ? w[j * columns + i] : w[i * columns + j];
    return out;
}

void hidden_layer(const unisim_mlp &net, const float *x, int row, int count, const float *w1_transposed,
                  float *hidden) {
    const int wide = padded(net.hidden);
    multiply(count, wide, net.inputs, x, row, 1, w1_transposed, hidden, false);
    for (int64_t i = 0; i < static_cast<int64_t>(count) * wide; ++i) hidden[i] = hidden[i] > 0.0f ? hidden[i] : 0.0f;
}

} // namespace

extern "C" int UNISIM_NAME(unisim_mlp_forward)(const unisim_mlp *net, const float *x, int64_t n, float *out,
                                               int threads) {
    const int inputs = net->inputs, hidden = net->hidden, outputs = net->outputs;
    const int wide = padded(hidden), wide_out = padded(outputs);
    const std::vector<float> w1 = pack(net->w1, hidden, inputs, true), w2 = pack(net->w2, outputs, hidden, true);
    parallel_blocks(n, CHUNK, threads, [&](int64_t begin, int64_t end) {
        std::vector<float> h(static_cast<size_t>(TILE) * wide), o(static_cast<size_t>(TILE) * wide_out);
        for (int64_t first = begin; first < end; first += TILE) {
            const int count = static_cast<int>(std::min<int64_t>(TILE, end - first));
            hidden_layer(*net, x + first * inputs, inputs, count, w1.data(), h.data());
            if (outputs == 1) {
                for (int s = 0; s < count; ++s) {
                    float lane[LANES];
                    simd_float sum{};
                    for (int j = 0; j + LANES <= hidden; j += LANES)
                        sum += load(&h[static_cast<size_t>(s) * wide + j]) * load(net->w2 + j);
                    store(lane, sum);
                    float total = net->bias[0];
                    for (int j = 0; j < LANES; ++j) total += lane[j];
                    for (int j = hidden / LANES * LANES; j < hidden; ++j)
                        total += h[static_cast<size_t>(s) * wide + j] * net->w2[j];
                    out[first + s] = total;
                }
                continue;
            }
            multiply(count, wide_out, hidden, h.data(), wide, 1, w2.data(), o.data(), false);
            for (int s = 0; s < count; ++s)
                for (int j = 0; j < outputs; ++j)
                    out[(first + s) * outputs + j] = o[static_cast<size_t>(s) * wide_out + j] + net->bias[j];
        }
    });
    return 0;
}

// Gradients with respect to x (n, inputs), w1, w2 and bias, from the gradient grad_out (n, outputs) of `out`. grad_x
// is overwritten; the other three are added to, all or none of them (null).
extern "C" int UNISIM_NAME(unisim_mlp_backward)(const unisim_mlp *net, const float *x, int64_t n, const float *grad_out,
                                                float *grad_x, float *grad_w1, float *grad_w2, float *grad_bias,
                                                int threads) {
    const int inputs = net->inputs, hidden = net->hidden, outputs = net->outputs;
    const int wide = padded(hidden), wide_in = padded(inputs);
    const std::vector<float> w1_transposed = pack(net->w1, hidden, inputs, true);
    const std::vector<float> w1 = pack(net->w1, hidden, inputs, false), w2 = pack(net->w2, outputs, hidden, false);
    const bool learn = grad_w1 != nullptr;
    // each chunk has its own sums, and these are added in order: the bits do not depend on the number of threads
    const size_t size = static_cast<size_t>(hidden) * wide_in + static_cast<size_t>(outputs) * wide + outputs;
    std::vector<float> sums(learn ? size * static_cast<size_t>((n + CHUNK - 1) / CHUNK) : 0, 0.0f);
    parallel_blocks(n, CHUNK, threads, [&](int64_t begin, int64_t end) {
        std::vector<float> in(static_cast<size_t>(TILE) * wide_in, 0.0f), g_in(in.size());
        std::vector<float> h(static_cast<size_t>(TILE) * wide), g_h(h.size()), g(static_cast<size_t>(TILE) * outputs);
        float *sum_w1 = learn ? &sums[size * static_cast<size_t>(begin / CHUNK)] : nullptr;
        float *sum_w2 = learn ? sum_w1 + static_cast<size_t>(hidden) * wide_in : nullptr;
        float *sum_bias = learn ? sum_w2 + static_cast<size_t>(outputs) * wide : nullptr;
        for (int64_t first = begin; first < end; first += TILE) {
            // points whose gradient is zero, which are many behind surfaces, are left out: they add nothing to any sum
            int64_t points[TILE];
            int count = 0;
            for (int64_t s = first; s < std::min(first + TILE, end); ++s) {
                const float *row = grad_out + s * outputs;
                if (std::all_of(row, row + outputs, [](float v) { return v == 0.0f; })) {
                    std::memset(grad_x + s * inputs, 0, sizeof(float) * inputs);
                    continue;
                }
                std::memcpy(&g[static_cast<size_t>(count) * outputs], row, sizeof(float) * outputs);
                std::memcpy(&in[static_cast<size_t>(count) * wide_in], x + s * inputs, sizeof(float) * inputs);
                points[count++] = s;
            }
            hidden_layer(*net, in.data(), wide_in, count, w1_transposed.data(), h.data());
            multiply(count, wide, outputs, g.data(), outputs, 1, w2.data(), g_h.data(), false);
            for (size_t i = 0; i < static_cast<size_t>(count) * wide; ++i) g_h[i] = h[i] > 0.0f ? g_h[i] : 0.0f;
            multiply(count, wide_in, hidden, g_h.data(), wide, 1, w1.data(), g_in.data(), false);
            for (int s = 0; s < count; ++s)
                std::memcpy(grad_x + points[s] * inputs, &g_in[static_cast<size_t>(s) * wide_in],
                            sizeof(float) * inputs);
            if (!learn) continue;
            for (int s = 0; s < count; ++s)
                for (int j = 0; j < outputs; ++j) sum_bias[j] += g[static_cast<size_t>(s) * outputs + j];
            multiply(hidden, wide_in, count, g_h.data(), 1, wide, in.data(), sum_w1, true);
            multiply(outputs, wide, count, g.data(), 1, outputs, h.data(), sum_w2, true);
        }
    });
    for (size_t first = 0; first < sums.size(); first += size) {
        const float *sum_w1 = &sums[first], *sum_w2 = sum_w1 + static_cast<size_t>(hidden) * wide_in;
        const float *sum_bias = sum_w2 + static_cast<size_t>(outputs) * wide;
        for (int i = 0; i < hidden; ++i)
            for (int j = 0; j < inputs; ++j) grad_w1[i * inputs + j] += sum_w1[static_cast<size_t>(i) * wide_in + j];
        for (int i = 0; i < outputs; ++i)
            for (int j = 0; j < hidden; ++j) grad_w2[i * hidden + j] += sum_w2[static_cast<size_t>(i) * wide + j];
        for (int j = 0; j < outputs; ++j) grad_bias[j] += sum_bias[j];
    }
    return 0;
}
