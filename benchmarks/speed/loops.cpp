#include <cmath>
#include <vector>

// The model as one loop, see `scaling.Fused`. Row by row: curves and weights of its pixels, then for
// every blur a vertical and a horizontal pass, added in place. Planar float32; tables as laid out by
// `Fused`. Width law σ = spread·z; half-sample symmetric edges.

static int mirror(int i, int n) {
    i = ((i % (2 * n)) + 2 * n) % (2 * n);
    return i < n ? i : 2 * n - 1 - i;
}

extern "C" void form(const float* image, const float* z, float* out, int h, int w, int blurs,
                     const int* reach, const float* taps, int terms, const float* coefficients,
                     float spread, float slope, float offset, int rates, const float* beta,
                     const float* direct, int scatter_rates, const float* G, const float* signal,
                     const float* veil) {
    int margin = 0;
    for (int k = 0; k < blurs; k++) margin = reach[k] > margin ? reach[k] : margin;
    std::vector<float> weight(blurs * w), T(3 * w), share(3 * w), backscatter(3 * w), mixed(3 * w);
    std::vector<float> line(w + 2 * margin), v(w), e(w);
    std::vector<int> column(w + 2 * margin);
    for (int i = 0; i < w + 2 * margin; i++) column[i] = mirror(i - margin, w);
    for (int y = 0; y < h; y++) {
        const float* distance = z + (long)y * w;
        for (int x = 0; x < w; x++) {
            float s = spread * distance[x], u = std::log(1 + 2 * s * s) * slope + offset;
            v[x] = u < -1 ? -1 : u > 1 ? 1 : u;
        }
        for (int k = 0; k < blurs; k++) {
            const float* c = coefficients + k * terms;
            for (int x = 0; x < w; x++) {  // Clenshaw
                float a = 0, b = 0;
                for (int i = terms - 1; i > 0; i--) {
                    float t = c[i] + 2 * v[x] * a - b;
                    b = a;
                    a = t;
                }
                weight[k * w + x] = c[0] + v[x] * a - b;
            }
        }
        for (int x = 0; x < 3 * w; x++) T[x] = share[x] = backscatter[x] = mixed[x] = 0;
        for (int r = 0; r < rates; r++) {
            for (int x = 0; x < w; x++) e[x] = std::exp(-beta[r] * distance[x]);
            for (int c = 0; c < 3; c++)
                for (int x = 0; x < w; x++) T[c * w + x] += direct[c * rates + r] * e[x];
        }
        for (int r = 0; r < scatter_rates; r++) {
            for (int x = 0; x < w; x++) e[x] = std::exp(-G[r] * distance[x]);
            for (int c = 0; c < 3; c++) {
                float s = signal[c * scatter_rates + r], b = veil[c * scatter_rates + r];
                for (int x = 0; x < w; x++) {
                    share[c * w + x] += s * e[x];
                    backscatter[c * w + x] += b * (1 - e[x]);
                }
            }
        }
        const float* tap = taps;  // of each blur: the middle one and one half
        for (int k = 0; k < blurs; tap += reach[k++] + 1)
            for (int c = 0; c < 3; c++) {
                const float* plane = image + (long)c * h * w;
                float* middle = line.data() + margin;
                for (int x = 0; x < w; x++) middle[x] = tap[0] * plane[(long)y * w + x];
                for (int n = 1; n <= reach[k]; n++) {
                    const float* up = plane + (long)mirror(y - n, h) * w;
                    const float* down = plane + (long)mirror(y + n, h) * w;
                    for (int x = 0; x < w; x++) middle[x] += tap[n] * (up[x] + down[x]);
                }
                for (int i = 0; i < margin; i++) {
                    line[i] = middle[column[i]];
                    line[margin + w + i] = middle[column[margin + w + i]];
                }
                for (int x = 0; x < w; x++) e[x] = tap[0] * middle[x];
                for (int n = 1; n <= reach[k]; n++)
                    for (int x = 0; x < w; x++) e[x] += tap[n] * (middle[x - n] + middle[x + n]);
                for (int x = 0; x < w; x++) mixed[c * w + x] += weight[k * w + x] * e[x];
            }
        for (int c = 0; c < 3; c++)
            for (int x = 0; x < w; x++) {
                long at = ((long)c * h + y) * w + x;
                int i = c * w + x;
                out[at] = T[i] * image[at] + (share[i] - T[i]) * mixed[i] + backscatter[i];
            }
    }
}
