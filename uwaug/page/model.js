// The model, as functions of numbers and arrays: spectra band by band, then for each picture a table
// over distance, since all that a pixel does besides its blurs follows from its distance alone.
// `tables` is what uwaug/page/tables.py writes; letters are those of uwaug/optics/medium.py.

export const ENTRIES = 1024; // of the table, and one more for open water

const sum = values => values.reduce((total, value) => total + value, 0);
const join = (one, other, f) => one.map((value, i) => f(value, other[i]));

// --- water: {a, b, kd} at each band [1/m] ---------------------------------------------------------

/** Of settings: a Jerlov type, a mixture of two, or "contents". */
export function waterOf({ water, other, share, chlorophyll, cdom, minerals }, tables) {
  if (water === "contents") return waterWith(chlorophyll, cdom, minerals, tables);
  const first = tables.waters[water], second = tables.waters[other];
  if (!second || !share) return first;
  const mixed = name => join(first[name], second[name], (x, y) => (1 - share) * x + share * y);
  return { a: mixed("a"), b: mixed("b"), kd: mixed("kd") };
}

/** uwaug/optics/constituents.py: mg/m³, 1/m at 440 nm, g/m³. */
function waterWith(chlorophyll, cdom, minerals, { pure, contents, bands, sun, lostByScattering }) {
  const [at660, exponent] = contents.byPhytoplankton;
  const slope = Math.min(Math.max((Math.log10(chlorophyll) - 0.3) / 2, -1), 0);
  const a = [], b = [], kd = [];
  for (let i = 0; i < bands.length; i++) {
    a[i] = pure.a[i] + cdom * contents.cdom[i] + minerals * contents.absorbed[i];
    let particles = minerals * contents.scattered[i];
    if (chlorophyll > 0) {
      a[i] += contents.phytoplankton[i] * chlorophyll ** contents.exponents[i];
      particles += at660 * chlorophyll ** exponent * (bands[i] / 660) ** slope;
    }
    b[i] = pure.b[i] + particles;
    const lost = a[i] + pure.b[i] / 2;
    kd[i] = Math.sqrt(lost * lost + lostByScattering * lost * particles) / sun;
  }
  return { a, b, kd };
}

const pureIn = (water, { pure }) => {
  const a = join(water.a, pure.a, Math.min), b = join(water.b, pure.b, Math.min);
  return { a, b, kd: join(water.kd, join(a, b, (x, y) => x + y / 2), Math.min) };
};

/** The water with so many times what is in it besides pure water. */
export function withContents(water, factor, tables) {
  const pure = pureIn(water, tables);
  const scaled = name => join(pure[name], water[name], (p, x) => p + factor * (x - p));
  const a = scaled("a");
  const kd = join(scaled("kd"), a, (k, x) => Math.max(k, tables.leastLoss * x));
  return factor === 1 ? water : { a, b: scaled("b"), kd };
}

/** The eye's weights are 1 nm apart, bands 5 nm. */
const toEye = (rates, { eye }) => eye.map((_, nm) => {
  const band = Math.min(Math.floor(nm / 5), rates.length - 2), t = nm / 5 - band;
  return rates[band] + t * (rates[band + 1] - rates[band]);
});

const luminanceLeft = (rates, metres, tables) =>
  sum(join(tables.eye, toEye(rates, tables), (w, rate) => w * Math.exp(-rate * metres)));

/** The distance at which Σ w·e^(−rate·z) falls to a share: Newton's steps never overshoot. */
function distanceTo(share, weights, rates) {
  if (sum(weights.filter((_, i) => rates[i] <= 0)) >= share) return Infinity;
  let z = 0;
  for (let step = Infinity, n = 0; step > 1e-15 * z && n < 200; n++) {
    const left = join(weights, rates, (w, rate) => w * Math.exp(-rate * z)), total = sum(left);
    step = Math.log(total / share) * total / sum(join(left, rates, (x, rate) => x * rate));
    z += step;
  }
  return Math.max(z, 0);
}

const beta = water => join(water.a, water.b, (a, b) => a + b);

/** Visibility [m]: where 2 % of the contrast are left. */
export const visibility = (water, tables) => distanceTo(0.02, tables.eye, toEye(beta(water), tables));

/** How many times its contents leave this contrast at a distance [m], or the most; 0 where pure water leaves less. */
export function contentsFor(water, contrast, metres, tables) {
  if (metres === Infinity) return 1;
  const pure = pureIn(water, tables), still = join(pure.a, pure.b, (a, b) => a + b);
  const seen = join(tables.eye, toEye(still, tables), (w, rate) => w * Math.exp(-rate * metres));
  if (sum(seen) <= contrast) return 0;
  const contents = toEye(join(beta(water), still, (x, y) => x - y), tables);
  return Math.min(distanceTo(contrast, seen, contents.map(rate => rate * metres)), tables.mostContents);
}

/** No deeper than where a metered exposure can make up for the light. */
export function depthShown(water, depth, tables) {
  if (luminanceLeft(water.kd, depth, tables) >= tables.dimmest) return depth;
  return Math.min(depth, distanceTo(tables.dimmest, tables.eye, toEye(water.kd, tables)));
}

// --- medium: rates of each band, and what of it each curve has ------------------------------------

const product = (A, B) => A.map(row => B[0].map((_, j) => sum(row.map((x, k) => x * B[k][j]))));
const transposed = A => A[0].map((_, j) => A.map(row => row[j]));
function inverse([[a, b, c], [d, e, f], [g, h, i]]) {
  const rows = [[e * i - f * h, c * h - b * i, b * f - c * e], [f * g - d * i, a * i - c * g, c * d - a * f],
    [d * h - e * g, b * g - a * h, a * e - b * d]];
  const determinant = a * rows[0][0] + b * rows[1][0] + c * rows[2][0];
  return rows.map(row => row.map(x => x / determinant));
}

/** `Medium.from_water` with surfaces="spectral". */
export function mediumOf(water, { vertical_depth: depth, g, mu, color_matrix: share }, { sensor, reflectances }) {
  const seen = product(sensor, transposed(reflectances)), full = inverse(seen);
  const matrix = full.map((row, i) => row.map((x, j) => (i === j) + share * (x - (i === j))));
  const response = product(matrix, sensor);
  const basis = product(transposed(inverse(product(matrix, seen))), reflectances);
  const G = join(water.a, water.b, (a, b) => Math.max(a + g * b, 1e-6));
  const light = water.kd.map(kd => Math.exp(-kd * depth));
  const veil = light.map((E, i) => mu * water.b[i] * E / G[i]);
  const signal = response.flatMap(S => basis.map(rho => S.map((s, i) => s * rho[i] * light[i])));
  const bMean = sum(sensor.map(S => sum(join(S, water.b, (s, b) => s * b)))) / 3;
  return { beta: beta(water), G, signal, veil: response.map(S => join(S, veil, (s, v) => s * v)), bMean };
}

/** T_β and T_G − T_β (3x3 each), V(0) − V (3) at a distance, into `row` from `at` on. */
export function curvesAt(z, { beta, G, signal, veil }, row, at) {
  row.fill(0, at, at + 21);
  for (let i = 0; i < beta.length; i++) {
    const direct = Math.exp(-beta[i] * z), arriving = Math.exp(-G[i] * z);
    for (let j = 0; j < 9; j++) {
      row[at + j] += signal[j][i] * direct;
      row[at + 9 + j] += signal[j][i] * (arriving - direct);
    }
    for (let c = 0; c < 3; c++) row[at + 18 + c] += veil[c][i] * (1 - arriving);
  }
}

/** Weights of the blurs for a width σ [px], into `row`. */
export function weightsOf(sigma, { slope, offset, coefficients }, row, at) {
  const x = Math.min(Math.max(slope * Math.log1p(2 * sigma) + offset, -1), 1);
  coefficients.forEach((series, k) => { // Clenshaw's sum of a Chebyshev series
    let b1 = 0, b2 = 0;
    for (let i = series.length - 1; i > 0; i--) [b1, b2] = [series[i] + 2 * x * b1 - b2, b1];
    row[at + k] = series[0] + x * b1 - b2;
  });
}

// --- a picture, and its blurs ---------------------------------------------------------------------

const decode = x => x <= 0.0404482362771076 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4;
const encode = x => x <= 0.0404482362771076 / 12.92 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055;
const remainder = (i, n) => ((i % n) + n) % n;

/** Sparse rows {first, weights}, folded back at the edges, of kernels that repeat every q px. */
function folded(count, from, { a, q, first, kernels }, size) {
  return Array.from({ length: count }, (_, j) => {
    const k = remainder(j + from, a), start = first[k] + (j + from - k) / a * q, taps = kernels[k];
    if (start >= 0 && start + taps.length <= size) return { first: start, weights: taps };
    const weights = new Float64Array(size);
    taps.forEach((weight, t) => {
      const i = remainder(start + t, 2 * size);
      weights[Math.min(i, 2 * size - 1 - i)] += weight;
    });
    return { first: 0, weights };
  });
}

/** A matrix of such rows times x (h×w), turned: the result is w×rows. */
function blurredTurned(rows, x, w) {
  const turned = new Float32Array(w * rows.length), line = new Float64Array(w);
  rows.forEach(({ first, weights }, r) => {
    line.fill(0);
    for (let t = 0; t < weights.length; t++) {
      const weight = weights[t], from = (first + t) * w;
      if (weight) for (let i = 0; i < w; i++) line[i] += weight * x[from + i];
    }
    for (let i = 0; i < w; i++) turned[i * rows.length + r] = line[i];
  });
  return turned;
}

function blurred(x, h, w, { shrink, enlarge }, margin) {
  const rows = size => enlarge ? folded(Math.ceil(size * shrink.a / shrink.q) + 2 * margin, -margin, shrink, size)
    : folded(size, 0, shrink, size);
  const [down, across] = [rows(h), rows(w)];
  const small = blurredTurned(across, blurredTurned(down, x, w), down.length);
  if (!enlarge) return small;
  const back = (size, cells) => Array.from({ length: size }, (_, i) => ({
    first: enlarge.first[i % enlarge.q] + Math.floor(i / enlarge.q) * enlarge.a + margin,
    weights: enlarge.kernels[i % enlarge.q],
  }));
  return blurredTurned(back(w), blurredTurned(back(h), small, across.length), h);
}

/** Pixels at which light and distance are measured, spread by a quasi-random sequence. */
const meteredPixels = (width, height, { count, steps, turn }) => Array.from({ length: count }, (_, i) => {
  const [row, column] = steps.map(step => (i * step + turn / 2) % turn);
  return Math.floor(row * height / turn) * width + Math.floor(column * width / turn);
});

/** A picture (RGBA bytes) with distances [m], and its blurs side by side for each pixel: square roots
 *  in 16 bits, which take half the room of single precision and err by 8e-6 of white at most. */
export function sceneOf(pixels, distance, width, height, { plan, meter }, tell = () => {}) {
  const n = width * height, K = plan.coefficients.length, B = K - 1, stack = new Uint16Array(3 * B * n);
  const light = Float64Array.from({ length: 256 }, (_, byte) => decode(byte / 255)), channel = new Float32Array(n);
  for (let c = 0; c < 3; c++) {
    for (let i = 0; i < n; i++) channel[i] = light[pixels[4 * i + c]];
    plan.blurs.forEach((blur, k) => {
      const soft = blurred(channel, height, width, blur, plan.margin);
      for (let i = 0; i < n; i++) stack[(3 * i + c) * B + k] = Math.sqrt(Math.min(Math.max(soft[i], 0), 1)) * 65535 + 0.5;
      tell((c * B + k + 1) / (3 * B));
    });
  }
  let near = Infinity, far = 0;
  for (const z of distance) if (z < Infinity) { near = Math.min(near, z); far = Math.max(far, z); }
  if (far === 0) near = 1;
  const step = Math.log(Math.max(far / near, 1.001)) / (ENTRIES - 1);
  const place = distance.map(z => z === Infinity ? ENTRIES : Math.min(Math.log(z / near) / step, ENTRIES - 1));
  const finite = z => Float32Array.from(z).filter(value => value < Infinity).sort();
  const points = meteredPixels(width, height, meter);
  let known = finite(points.slice(0, meter.looks).map(p => distance[p]));
  if (!known.length) known = finite(distance);
  const median = known.length ? known[known.length >> 1] : Infinity;
  return { width, height, pixels, light, stack, K, points, place, near, step, median };
}

// --- a water, as a table over the distances of a picture ------------------------------------------

/** Settings → {table, and what came of them}; distances of the scene are multiplied by `times`. */
export function waterTable(scene, settings, tables) {
  let water = waterOf(settings, tables), contents = 1;
  if (settings.contrast !== null) {
    contents = contentsFor(water, settings.contrast, scene.median * settings.times, tables);
    water = withContents(water, contents, tables);
  }
  const depth = depthShown(water, settings.vertical_depth, tables);
  const medium = mediumOf(water, { ...settings, vertical_depth: depth }, tables);
  const { plan } = tables, { exponent, scale: perPixel, ends: [least, most] } = tables.law, size = scene.K + 21;
  const table = new Float32Array((ENTRIES + 2) * size), row = new Float64Array(size);
  const width = perPixel * settings.blur * scene.width;
  for (let entry = 0; entry <= ENTRIES; entry++) {
    const z = entry < ENTRIES ? scene.near * Math.exp(entry * scene.step) : Infinity;
    const effective = Math.min(z * settings.times, tables.farthest);
    weightsOf(width * Math.min(Math.max(medium.bMean * effective, least), most) ** exponent, plan, row, 0);
    curvesAt(effective, medium, row, scene.K);
    table.set(row, entry * size);
  }
  const veil = Math.max(...table.slice(-size - 3, -size));
  return { table, rise: riseOf(scene, settings.pitch, tables), contents, depth, veil, visibility: visibility(water, tables) };
}

/** Light of grey detail, of its surface, and of the level veil at a place of the table. */
export function lightAt(place, { table }, K, { luminance, reflectance }) {
  const row = table.subarray(Math.min(Math.round(place), ENTRIES) * (K + 21) + K);
  let detail = 0, surface = 0, veil = 0;
  for (let c = 0; c < 3; c++) {
    const direct = row[3 * c] + row[3 * c + 1] + row[3 * c + 2];
    const scatter = row[9 + 3 * c] + row[10 + 3 * c] + row[11 + 3 * c];
    detail += luminance[c] * direct * reflectance;
    surface += luminance[c] * (direct + scatter) * reflectance;
    veil += luminance[c] * row[18 + c];
  }
  return [detail, surface, veil];
}

/** Factors of the veil on the rays of a picture: uwaug/light/direction.py; pitch in degrees. */
export function riseOf({ width, height }, pitch, { direction: { view, rise, most } }) {
  const focal = width / 2 / Math.tan(view * Math.PI / 360), [sine, cosine] = [Math.sin, Math.cos].map(f => f(pitch * Math.PI / 180));
  const factors = new Float32Array(width * height);
  for (let y = 0, at = 0; y < height; y++) for (let x = 0; x < width; x++, at++) {
    const right = (x - (width - 1) / 2) / focal, down = (y - (height - 1) / 2) / focal;
    const up = (sine - down * cosine) / Math.sqrt(1 + right * right + down * down);
    factors[at] = (1 - rise * Math.min(up, most)) ** -2;
  }
  return factors;
}

// --- the camera: uwaug/formation/development.py -----------------------------------------------------

/** One 3x3 matrix: exposure, white balance and saturation, of some pixels without their blur. */
export function gainOf(scene, { table, rise }, { exposure, white_balance, saturation, gamut }, tables) {
  const { pixels, light, points, place, K } = scene, size = K + 21, { luminance, meter } = tables;
  const before = [0, 0, 0], after = [0, 0, 0], positive = [0, 0, 0], brightness = [];
  const Y = colour => sum(join(colour, luminance, (x, weight) => x * weight));
  for (const p of points) {
    const entry = Math.floor(place[p]), t = place[p] - entry, at = entry * size + K;
    const J = [0, 1, 2].map(c => light[pixels[4 * p + c]]);
    let brightest = -Infinity;
    for (let c = 0; c < 3; c++) {
      const curve = j => table[at + j] + t * (table[at + size + j] - table[at + j]);
      let arriving = curve(18 + c) * rise[p];
      for (let j = 0; j < 3; j++) arriving += (curve(3 * c + j) + curve(9 + 3 * c + j)) * J[j];
      brightest = Math.max(brightest, arriving);
      before[c] += J[c] / meter.count;
      after[c] += arriving / meter.count;
      positive[c] += Math.max(arriving, 0) / meter.count;
    }
    brightness.push(brightest);
  }
  const highlight = brightness.sort((a, b) => b - a)[Math.round(meter.burnt * meter.count) - 1], [least, most] = meter.gains;
  const automatic = Y(after) > 0 ? Math.min(Math.max(Y(before) / Y(after), least), most) : 1;
  const metered = Math.min(2 ** exposure * automatic, 2 ** Math.min(exposure, 0) / Math.max(highlight, 1 / most));
  const share = Math.max(white_balance, 0), mean = Y(positive);
  let balance = [1, 1, 1];
  if (share > 0 && mean > 0) {
    balance = positive.map(x => (mean / Math.max(x, mean / meter.most)) ** share);
    const kept = mean / Y(join(balance, positive, (x, y) => x * y));
    balance = balance.map(x => x * kept);
  }
  const colour = join(positive, balance, (x, factor) => metered * factor * x), grey = Y(colour);
  for (let i = 0; i < 2 && gamut > 0; i++) { // no colours that photographs do not have
    const vivid = colour.map(x => Math.max(grey + saturation * (x - grey), meter.leastLight));
    const [x, y, z] = meter.xyz.map(row => Math.cbrt(sum(join(row, vivid, (weight, light) => weight * light))));
    const chroma = Math.sqrt((500 * (x - y)) ** 2 + (200 * (y - z)) ** 2 + meter.leastLight);
    const highest = meter.chroma[0] + meter.chroma[1] * (116 * y - 16);
    saturation *= Math.min(highest / chroma, 1);
  }
  return [0, 1, 2].map(c => balance.map((factor, j) =>
    metered * factor * ((1 - saturation) * luminance[j] + (c === j ? saturation : 0))));
}

let bytes, toneOfBytes;
/** sRGB bytes of √light in 65536 steps, after the curve of tone. */
function bytesOf(tone, { grey, toe }) {
  if (toneOfBytes === tone) return bytes;
  const power = grey ** tone, k = tone === 1 ? 1e6 : (1 - grey) * power / (grey - power);
  const curved = x => { const size = Math.max(x, toe); return x / size * (1 + k) * size ** tone / (size ** tone + k); };
  bytes = Uint8Array.from({ length: 65537 }, (_, i) => Math.round(255 * encode(curved((i / 65536) ** 2))));
  toneOfBytes = tone;
  return bytes;
}

/** Numbers in [0, 1) from a seed (mulberry32). */
export const randomOf = seed => () => {
  let x = seed = (seed + 0x6d2b79f5) | 0;
  x = Math.imul(x ^ (x >>> 15), x | 1);
  x ^= x + Math.imul(x ^ (x >>> 7), x | 61);
  return ((x ^ (x >>> 14)) >>> 0) / 4294967296;
};

export const normalOf = random => Math.sqrt(-2 * Math.log(1 - random())) * Math.cos(2 * Math.PI * random());

let normals;
function standardNormals() {
  const random = randomOf(1);
  return normals ??= Float32Array.from({ length: 1 << 16 }, () => normalOf(random));
}

/**
 * The picture (RGBA bytes) of every `step`-th pixel. `terms` switches direct, forward and veil;
 * `exact` (3 floats a pixel) gets the light after the gamut, before tone and bytes.
 */
export function form(scene, { table, rise }, gain, { gamut, tone, full_well: well, read_noise: read }, { step = 1, terms, exact }, tables) {
  const { light, stack, place, K } = scene, size = K + 21, B = K - 1, from = tables.vividFrom, beyondFrom = 1 - from;
  const width = Math.ceil(scene.width / step), height = Math.ceil(scene.height / step);
  const shown = new Uint8ClampedArray(4 * width * height), bytes = bytesOf(tone, tables.tone);
  const noise = well > 0 ? standardNormals() : null, dark = (read / well) ** 2;
  const [direct, forward, veil] = terms ?? [1, 1, 1], [m0, m1, m2, m3, m4, m5, m6, m7, m8] = gain.flat();
  const seen = new Float64Array(3);
  for (let y = 0, at = 0; y < height; y++) for (let x = 0; x < width; x++, at++) {
    const p = y * step * scene.width + x * step, entry = place[p] | 0, t = place[p] - entry, here = entry * size;
    const J0 = light[scene.pixels[4 * p]], J1 = light[scene.pixels[4 * p + 1]], J2 = light[scene.pixels[4 * p + 2]];
    const sharp = table[here] + t * (table[here + size] - table[here]), red = 3 * p * B, green = red + B, blue = green + B;
    let soft0 = 0, soft1 = 0, soft2 = 0;
    for (let k = 0; k < B; k++) {
      const weight = table[here + 1 + k] + t * (table[here + size + 1 + k] - table[here + 1 + k]);
      soft0 += weight * stack[red + k] * stack[red + k];
      soft1 += weight * stack[green + k] * stack[green + k];
      soft2 += weight * stack[blue + k] * stack[blue + k];
    }
    soft0 = sharp * J0 + soft0 / 65535 ** 2;
    soft1 = sharp * J1 + soft1 / 65535 ** 2;
    soft2 = sharp * J2 + soft2 / 65535 ** 2;
    for (let c = 0, j = here + K; c < 3; c++, j += 3) {
      const D = table[j] * J0 + table[j + 1] * J1 + table[j + 2] * J2;
      const F = table[j + 9] * soft0 + table[j + 10] * soft1 + table[j + 11] * soft2;
      const i = j + size, v = here + K + 18 + c;
      const nextD = table[i] * J0 + table[i + 1] * J1 + table[i + 2] * J2;
      const nextF = table[i + 9] * soft0 + table[i + 10] * soft1 + table[i + 11] * soft2;
      const B = table[v] + t * (table[v + size] - table[v]);
      let arriving = direct * (D + t * (nextD - D)) + forward * (F + t * (nextF - F)) + veil * B * rise[p];
      if (noise) {
        const deviation = Math.sqrt(Math.max(arriving, 0) / well + dark);
        arriving += deviation * noise[Math.imul(3 * p + c, 0x9e3779b1) >>> 16];
      }
      seen[c] = arriving;
    }
    const r = seen[0], g = seen[1], b = seen[2];
    seen[0] = m0 * r + m1 * g + m2 * b;
    seen[1] = m3 * r + m4 * g + m5 * b;
    seen[2] = m6 * r + m7 * g + m8 * b;
    const brightest = Math.max(seen[0], seen[1], seen[2]);
    for (let c = 0; c < 3; c++) {
      let value = seen[c];
      const beyond = brightest > 0 ? (1 - value / brightest - from) / beyondFrom : 0;
      if (beyond > 0) value += (beyond - beyond / Math.sqrt(1 + beyond * beyond)) * beyondFrom * gamut * brightest;
      else if (brightest <= 0) value -= gamut * value;
      if (exact) exact[3 * at + c] = value;
      shown[4 * at + c] = value <= 0 ? 0 : value >= 1 ? 255 : bytes[(Math.sqrt(value) * 65536 + 0.5) | 0];
    }
    shown[4 * at + 3] = 255;
  }
  return { pixels: shown, width, height };
}
