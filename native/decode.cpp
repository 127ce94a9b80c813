// Decodes composited features to sensor values: perceptrons of a feature and a direction, and the camera decoder.
//
// The specification is plain torch, in core/model/decode.py. Every output is one sum in a fixed order (taps by row,
// column and channel), so its bits depend neither on threads nor on tiles nor on what else is decoded.
//
// An image is decoded in strips of columns and bands of rows. Each convolution has a ring buffer of the few input
// rows in its kernel, and a row is computed when the next convolution needs it: intermediate maps never leave the
// caches. Where a strip or band ends inside the image, the margin that the kernels cover is computed twice.
#include "one_ray.h"
#include "simd.h"
#include "variant.h"

#if defined(__AVX512BF16__)
#include <immintrin.h>
#endif

namespace {

// Pixels whose sums are in registers at the same time, two registers each.
#if defined(__AVX512F__)
constexpr int ROWS = 12;
#elif defined(__AVX2__)
constexpr int ROWS = 6;
#else
constexpr int ROWS = 4;
#endif
// Points that go through a perceptron together; minimum width of a strip.
constexpr int TILE = 8 * ROWS;
// Bytes of all ring buffers of one strip.
constexpr int64_t RINGS = 1 << 20;
constexpr int SH_WIDTH = 16;

// Channels per element of a map: a float is one channel, a uint32_t two of them in bfloat16.
template <class E> constexpr int CHANNELS = 1;
#if defined(__AVX512BF16__)
template <> constexpr int CHANNELS<uint32_t> = 2;
using Active = uint32_t;
#else
using Active = float;
#endif

inline simd_float operands(const float *p) { return load(p); }
inline simd_float repeated(float x) { return broadcast(x); }
inline void accumulate(simd_float &sum, const simd_float &a, const simd_float &b) { sum += a * b; }
inline void store_relu(float *p, const simd_float &a) { store(p, relu(a)); }

#if defined(__AVX512BF16__)
inline __m512i operands(const uint32_t *p) { return _mm512_loadu_si512(p); }
inline __m512i repeated(uint32_t x) { return _mm512_set1_epi32(static_cast<int>(x)); }
inline void accumulate(simd_float &sum, __m512i a, __m512i b) {
    sum = (simd_float)_mm512_dpbf16_ps((__m512)sum, (__m512bh)a, (__m512bh)b);
}
inline void store_relu(uint32_t *p, const simd_float &a) {
    const __m256bh narrow = _mm512_cvtneps_pbh((__m512)relu(a));
    std::memcpy(p, &narrow, sizeof narrow);
}
#endif

inline void put(float *p, int, float x) { *p = x; }

#if defined(__AVX512BF16__)
// Rounds to the nearest bfloat16, ties to even.
inline uint32_t bfloat16(float x) {
    uint32_t bits;
    std::memcpy(&bits, &x, sizeof bits);
    return (bits + 0x7fff + (bits >> 16 & 1)) >> 16;
}

inline void put(uint32_t *p, int channel, float x) { *p |= bfloat16(x) << (channel % 2 ? 16 : 0); }
#endif

// A zeroed buffer that starts at a cache line.
template <class T> struct Buffer {
    explicit Buffer(size_t size) : held(size + 64 / sizeof(T)) {
        data = held.data() + (64 - reinterpret_cast<uintptr_t>(held.data()) % 64) % 64 / sizeof(T);
    }
    Buffer(Buffer &&) = default;
    Buffer &operator=(Buffer &&) = default;
    std::vector<T> held;
    T *data;
};

// A layer's weights in the order in which the loops read them: pairs of registers of outputs, then taps, then inputs.
template <class E> struct Layer {
    explicit Layer(const unisim_layer &from)
        : kernel(from.kernel), inputs((from.inputs + CHANNELS<E> - 1) / CHANNELS<E>),
          registers((from.outputs + LANES - 1) / LANES), wide(registers * LANES),
          weight(static_cast<size_t>(wide) * kernel * kernel * inputs), bias(wide) {
        const int taps = kernel * kernel;
        for (int o = 0; o < from.outputs; ++o) {
            const int first = o / LANES / 2 * 2, held = std::min(2, registers - first);
            for (int c = 0; c < from.inputs; ++c)
                for (int t = 0; t < taps; ++t) {
                    const int64_t row = static_cast<int64_t>(first) * taps * inputs +
                                        (t * inputs + c / CHANNELS<E>)*held + (o / LANES - first);
                    put(weight.data + row * LANES + o % LANES, c,
                        from.weight[(static_cast<int64_t>(o) * from.inputs + c) * taps + t]);
                }
            bias.data[o] = from.bias ? from.bias[o] : 0.0f;
        }
    }
    int kernel, inputs, registers, wide;
    Buffer<E> weight;
    Buffer<float> bias;
};

// Computes V registers of outputs at ROWS pixels. `rows`: the input rows in the kernel, from `shift` on, `stride`
// elements per pixel.
template <int V, class E, class A>
inline void convolve_tile(int kernel, int inputs, const E *const *rows, int64_t shift, int64_t stride, const E *weight,
                          const float *bias, const float *add, float *raw, A *active, int wide) {
    simd_float sum[ROWS][V];
    for (int r = 0; r < ROWS; ++r)
        for (int v = 0; v < V; ++v) sum[r][v] = load(bias + v * LANES);
    for (int i = 0; i < kernel; ++i) {
        const E *x = rows[i] + shift;
        for (int j = 0; j < kernel; ++j, x += stride)
            for (int c = 0; c < inputs; ++c, weight += V * LANES) {
                decltype(operands(weight)) w[V];
                for (int v = 0; v < V; ++v) w[v] = operands(weight + v * LANES);
                for (int r = 0; r < ROWS; ++r) {
                    const auto a = repeated(x[r * stride + c]);
                    for (int v = 0; v < V; ++v) accumulate(sum[r][v], a, w[v]);
                }
            }
    }
    for (int r = 0; r < ROWS; ++r)
        for (int v = 0; v < V; ++v) {
            const int64_t at = static_cast<int64_t>(r) * wide + v * LANES;
            if (add) sum[r][v] += load(add + at);
            if (raw) store(raw + at, sum[r][v]);
            if (active) store_relu(active + at / CHANNELS<A>, sum[r][v]);
        }
}

// Computes a row of `count` pixels, and up to ROWS - 1 more. `add` is added to the outputs, `raw` receives them, and
// `active` their ReLU; each may be null.
template <class E, class A>
void convolve(const Layer<E> &layer, const E *const *rows, int64_t stride, int count, const float *add, float *raw,
              A *active) {
    for (int first = 0; first < layer.registers; first += 2) {
        const E *weight =
            layer.weight.data + static_cast<int64_t>(first) * LANES * layer.kernel * layer.kernel * layer.inputs;
        for (int x = 0; x < count; x += ROWS) {
            const int64_t at = static_cast<int64_t>(x) * layer.wide + first * LANES;
            const auto tile = layer.registers - first > 1 ? convolve_tile<2, E, A> : convolve_tile<1, E, A>;
            tile(layer.kernel, layer.inputs, rows, x * stride, stride, weight, layer.bias.data + first * LANES,
                 add ? add + at : nullptr, raw ? raw + at : nullptr, active ? active + at / CHANNELS<A> : nullptr,
                 layer.wide);
        }
    }
}

// A perceptron of [feature, spherical harmonics of the direction, extra inputs], with ReLU between its layers.
struct Head {
    Head(const unisim_head &from) : features(from.features), extra_inputs(from.extra_inputs) {
        layers.reserve(from.count);
        for (int i = 0; i < from.count; ++i) layers.emplace_back(from.layers[i]);
    }
    // Floats of scratch memory that `run` needs.
    size_t scratch() const {
        size_t size = features + SH_WIDTH + extra_inputs;
        for (const auto &layer : layers) size += layer.wide;
        return size * TILE;
    }
    // Runs at most TILE points; `raw` and `active` receive the output, as of `convolve`.
    template <class A>
    void run(const float *feature, const float *directions, const float *extra, int count, float *work, float *raw,
             A *active) const {
        int64_t wide = features + SH_WIDTH + extra_inputs;
        for (int i = 0; i < count; ++i) {
            float *x = work + i * wide;
            std::memcpy(x, feature + static_cast<int64_t>(i) * features, sizeof(float) * features);
            spherical_harmonics(directions + 3 * i, x + features);
            for (int j = 0; j < extra_inputs; ++j)
                x[features + SH_WIDTH + j] = extra[static_cast<int64_t>(i) * extra_inputs + j];
        }
        for (size_t i = 0; i < layers.size(); ++i) {
            const float *in = work;
            work += TILE * wide;
            if (i + 1 < layers.size())
                convolve<float, float>(layers[i], &in, wide, count, nullptr, nullptr, work);
            else
                convolve<float, A>(layers[i], &in, wide, count, nullptr, raw, active);
            wide = layers[i].wide;
        }
    }
    int features, extra_inputs;
    std::vector<Layer<float>> layers;
};

// Ray head and camera decoder.
struct Network {
    Network(const unisim_head &from, const unisim_layer *layers, int count) : head(from) {
        convolutions.reserve(count);
        for (int i = 0; i < count; ++i) convolutions.emplace_back(layers[i]);
    }
    int reach() const {
        int sum = 0;
        for (const auto &layer : convolutions) sum += layer.kernel / 2;
        return sum;
    }
    // Whether the input of convolution i is added to the output of the next one: a residual block.
    bool starts_block(size_t i) const { return i % 2 == 0 && i + 1 < convolutions.size(); }
    Head head;
    std::vector<Layer<Active>> convolutions;
};

struct Image {
    const float *features, *directions;
    int height, width, up;
    float *rgb;
};

// Ring buffer of the input rows of one convolution.
struct Ring {
    int left;       // the image's column at which a row begins, negative outside the image
    int begin, end; // columns that are computed; those outside the image replicate its edge
    int next;       // the row that is computed next
    int pitch;      // pixels that a row has room for
    Buffer<Active> active;
    Buffer<float> raw;
};

// One strip and band of an image, decoded row by row.
struct Window {
    Window(const Network &net, const Image &image, int left, int top, int right)
        : net(net), image(image), left(left), right(right), work(net.head.scratch()),
          logits(static_cast<size_t>(right - left + ROWS) * net.convolutions.back().wide) {
        int begin = left, end = right, row = top, kernels = 0;
        for (size_t i = net.convolutions.size(); i-- > 0;) {
            const Layer<Active> &layer = net.convolutions[i];
            const int p = layer.kernel / 2, pitch = end - begin + 2 * p + ROWS, from = begin - p;
            begin = std::max(0, begin - p), end = std::min(image.width, end + p), row = std::max(0, row - p);
            const size_t size = static_cast<size_t>(layer.kernel) * pitch * wide(i);
            rings.push_back({from, begin, end, row, pitch, Buffer<Active>(size / CHANNELS<Active>),
                             Buffer<float>(net.starts_block(i) ? size : 0)});
            kernels = std::max(kernels, layer.kernel);
        }
        std::reverse(rings.begin(), rings.end());
        rows.resize(net.convolutions.size() * kernels);
    }
    // Floats per pixel of the input of convolution i.
    int64_t wide(size_t i) const { return i ? net.convolutions[i - 1].wide : net.head.layers.back().wide; }
    int64_t place(size_t i, int y, int x) const {
        return (static_cast<int64_t>(y % net.convolutions[i].kernel) * rings[i].pitch + x - rings[i].left) * wide(i);
    }
    // Computes row y of convolution i, columns begin to end, which are those of the next one's ring.
    void output(size_t i, int y, int begin, int end, float *raw, Active *active) {
        const Layer<Active> &layer = net.convolutions[i];
        const int p = layer.kernel / 2;
        fill(i, std::min(image.height, y + p + 1));
        const Active **at = &rows[i * (rows.size() / rings.size())];
        for (int k = 0; k < layer.kernel; ++k)
            at[k] = rings[i].active.data +
                    place(i, std::clamp(y + k - p, 0, image.height - 1), begin - p) / CHANNELS<Active>;
        const float *add = i % 2 ? rings[i - 1].raw.data + place(i - 1, y, begin) : nullptr;
        convolve(layer, at, wide(i) / CHANNELS<Active>, end - begin, add, raw, active);
    }
    // Computes the input rows of convolution i up to before `stop`.
    void fill(size_t i, int stop) {
        Ring &ring = rings[i];
        const int64_t pixel = wide(i) / CHANNELS<Active>;
        for (; ring.next < stop; ++ring.next) {
            const int y = ring.next;
            float *raw = net.starts_block(i) ? ring.raw.data + place(i, y, ring.begin) : nullptr;
            Active *active = ring.active.data + place(i, y, ring.begin) / CHANNELS<Active>;
            if (i > 0)
                output(i - 1, y, ring.begin, ring.end, raw, active);
            else
                for (int x = ring.begin; x < ring.end; x += TILE) {
                    const int64_t at = static_cast<int64_t>(y) * image.width + x, to = (x - ring.begin) * wide(0);
                    net.head.run(image.features + at * net.head.features, image.directions + 3 * at, nullptr,
                                 std::min(TILE, ring.end - x), work.data, raw ? raw + to : nullptr,
                                 active + to / CHANNELS<Active>);
                }
            const int before = ring.begin - ring.left, count = ring.end - ring.begin;
            const int after = i + 1 < rings.size() ? rings[i + 1].end : right;
            const int beyond = after + net.convolutions[i].kernel / 2 - ring.end;
            for (int k = 1; k <= before; ++k) std::copy_n(active, pixel, active - k * pixel);
            for (int k = 0; k < beyond; ++k)
                std::copy_n(active + (count - 1) * pixel, pixel, active + (count + k) * pixel);
        }
    }
    // Writes row y of cells, which is `up` rows of the image.
    void write_row(int y) {
        const int row = 3 * image.up;
        const int64_t cell = net.convolutions.back().wide, count = right - left;
        output(rings.size() - 1, y, left, right, logits.data, nullptr);
        for (int i = 0; i < image.up; ++i) {
            float *out = image.rgb + ((static_cast<int64_t>(y) * image.up + i) * image.width + left) * row;
            for (int64_t x = 0; x < count; ++x)
                for (int j = 0; j < row; ++j) out[x * row + j] = logits.data[x * cell + i * row + j];
            int64_t j = 0;
            for (; j + LANES <= count * row; j += LANES) store(out + j, sigmoid(load(out + j)));
            float last[LANES] = {};
            std::copy_n(out + j, count * row - j, last);
            store(last, sigmoid(load(last)));
            std::copy_n(last, count * row - j, out + j);
        }
    }
    const Network &net;
    const Image &image;
    int left, right;
    Buffer<float> work, logits;
    std::vector<Ring> rings;
    std::vector<const Active *> rows;
};

// The numbers of strips and bands that take the least time, by the pixels that the busiest thread computes.
std::pair<int, int> choose_split(const Network &net, int height, int width, int threads) {
    int64_t column = 0;
    for (size_t i = 0; i < net.convolutions.size(); ++i) {
        const int64_t wide = i ? net.convolutions[i - 1].wide : net.head.layers.back().wide;
        column += net.convolutions[i].kernel * wide *
                  (sizeof(Active) / CHANNELS<Active> + (net.starts_block(i) ? sizeof(float) : 0));
    }
    const int reach = net.reach();
    // large kernels compute much per loaded value: for them, computing twice costs more than missing the cache
    const int64_t widest = reach == 0 ? TILE : std::max<int64_t>({TILE, 25 * reach, RINGS / column});
    const int fewest = static_cast<int>((width + widest - 1) / widest);
    std::pair<int, int> best{fewest, 1};
    double lowest = INFINITY;
    for (int strips = fewest; strips <= std::min(width, fewest + 8 * threads); ++strips)
        for (int bands = 1; bands <= std::min(height, 8 * threads); ++bands) {
            // a tenth more: threads do not finish at the same time
            const double rounds = (strips * bands + threads - 1) / threads + 0.1;
            const int across = ((width + strips - 1) / strips + reach + ROWS - 1) / ROWS * ROWS;
            const double pixels = rounds * across * ((height + bands - 1) / bands + reach);
            if (pixels < lowest) lowest = pixels, best = {strips, bands};
        }
    return best;
}

} // namespace

#if !defined(__AVX512BF16__)
// out (n, outputs) of feature (n, features), directions (n, 3) and extra (n, extra_inputs).
extern "C" int UNISIM_NAME(unisim_head_forward)(const unisim_head *from, const float *feature, const float *directions,
                                                const float *extra, int64_t n, float *out, int threads) {
    const Head head(*from);
    const int64_t wide = head.layers.back().wide, outputs = from->layers[from->count - 1].outputs;
    parallel_blocks(n, 16 * TILE, threads, [&](int64_t begin, int64_t end) {
        Buffer<float> work(head.scratch()), result(TILE * wide);
        for (int64_t first = begin; first < end; first += TILE) {
            const int count = static_cast<int>(std::min<int64_t>(TILE, end - first));
            head.run<float>(feature + first * head.features, directions + 3 * first, extra + first * head.extra_inputs,
                            count, work.data, result.data, nullptr);
            for (int64_t i = 0; i < count; ++i)
                std::copy_n(result.data + i * wide, outputs, out + (first + i) * outputs);
        }
    });
    return 0;
}

// Whether both this build and this processor multiply bfloat16.
extern "C" int UNISIM_NAME(unisim_has_half)() {
#if defined(__AVX512F__) && defined(UNISIM_HAS_AVX512BF16)
    return __builtin_cpu_supports("avx512bf16") ? 1 : 0;
#else
    return 0;
#endif
}
#endif

#if defined(__AVX512F__) && !defined(__AVX512BF16__) && defined(UNISIM_HAS_AVX512BF16)
#define UNISIM_DECODE_HALF unisim_decode_image_avx512bf16
extern "C" int UNISIM_DECODE_HALF(const unisim_head *, const unisim_layer *, int, int, const float *, const float *,
                                  int, int, float *, int, int);
#endif

// The image rgb (height up, width up, 3) of features (height, width, features) along directions (height, width, 3).
// `layers`: two convolutions per residual block, then the last one, whose outputs are the rows, columns and colours of
// a cell's pixels. `half`: convolutions multiply bfloat16, where `has_half` is true.
extern "C" int UNISIM_NAME(unisim_decode_image)(const unisim_head *head, const unisim_layer *layers, int count, int up,
                                                const float *features, const float *directions, int height, int width,
                                                float *rgb, int half, int threads) {
#if defined(UNISIM_DECODE_HALF)
    if (half && UNISIM_NAME(unisim_has_half)())
        return UNISIM_DECODE_HALF(head, layers, count, up, features, directions, height, width, rgb, half, threads);
#endif
    (void)half;
    if (height < 1 || width < 1) return 0;
    const Network net(*head, layers, count);
    const Image image{features, directions, height, width, up, rgb};
    const auto split = choose_split(net, height, width, std::max(1, threads));
    const int strips = split.first, bands = split.second;
    const auto begin_of = [](int64_t size, int i, int n) { return static_cast<int>(size * i / n); };
    parallel_blocks(static_cast<int64_t>(strips) * bands, 1, threads, [&](int64_t block, int64_t) {
        const int s = static_cast<int>(block % strips), b = static_cast<int>(block / strips),
                  top = begin_of(height, b, bands);
        Window window(net, image, begin_of(width, s, strips), top, begin_of(width, s + 1, strips));
        for (int y = top; y < begin_of(height, b + 1, bands); ++y) window.write_row(y);
    });
    return 0;
}
