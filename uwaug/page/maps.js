// Distances: read from files (a canvas would make 8 bits of 16), or made up from the picture.
// A map is {width, height, values, most}; `most` is the largest that its kind of number holds.

export async function inflated(parts) {
  const stream = new Blob(parts).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** The map of a grey PNG of 8 or 16 bits. */
export async function readPng(buffer) {
  const view = new DataView(buffer), parts = [];
  let width, height, bits, colour, interlaced;
  for (let at = 8; at < buffer.byteLength;) {
    const length = view.getUint32(at), type = view.getUint32(at + 4), body = at + 8;
    if (type === 0x49484452) {
      [width, height] = [view.getUint32(body), view.getUint32(body + 4)];
      [bits, colour, interlaced] = [8, 9, 12].map(offset => view.getUint8(body + offset));
    } else if (type === 0x49444154) parts.push(new Uint8Array(buffer, body, length));
    at = body + length + 4;
  }
  if (colour !== 0 || bits < 8 || interlaced) throw new Error("a map is a grey PNG of 8 or 16 bits, not interlaced");
  const n = bits / 8, stride = width * n, data = await inflated(parts), values = new Float32Array(width * height);
  let above = new Uint8Array(stride);
  for (let y = 0; y < height; y++) {
    const filter = data[y * (stride + 1)], row = data.subarray(y * (stride + 1) + 1, (y + 1) * (stride + 1));
    for (let i = 0; i < stride; i++) {
      const a = i < n ? 0 : row[i - n], b = above[i], c = i < n ? 0 : above[i - n], p = a + b - c;
      const [da, db, dc] = [Math.abs(p - a), Math.abs(p - b), Math.abs(p - c)];
      row[i] += [0, a, b, (a + b) >> 1, da <= db && da <= dc ? a : db <= dc ? b : c][filter];
    }
    for (let x = 0; x < width; x++) values[y * width + x] = n === 1 ? row[x] : (row[2 * x] << 8) | row[2 * x + 1];
    above = row;
  }
  return { width, height, values, most: 2 ** bits - 1 };
}

const KINDS = { f4: Float32Array, f8: Float64Array, u2: Uint16Array, u1: Uint8Array, i2: Int16Array, i4: Int32Array, u4: Uint32Array };

/** The map of a .npy file. */
export function readNpy(buffer) {
  const view = new DataView(buffer), long = view.getUint8(6) > 1, start = long ? 12 : 10;
  const length = long ? view.getUint32(8, true) : view.getUint16(8, true);
  const header = new TextDecoder().decode(new Uint8Array(buffer, start, length));
  const kind = KINDS[/'descr': *'[<|]([^']+)'/.exec(header)?.[1]], fortran = /'fortran_order': *True/.test(header);
  const shape = /'shape': *\(([^)]*)\)/.exec(header)?.[1].split(",").filter(side => side.trim()).map(Number);
  const expected = "a .npy file of distances holds one whole plane (H, W) of floating point or whole numbers of up to 32 bits";
  while (shape?.length > 2 && shape.includes(1)) shape.splice(shape.indexOf(1), 1);
  if (!kind || shape?.length !== 2 || fortran) throw new Error(expected);
  const [height, width] = shape, data = buffer.slice(start + length);
  if (data.byteLength !== width * height * kind.BYTES_PER_ELEMENT) throw new Error(expected);
  const most = { u2: 65535, u1: 255 }[header.match(/u[12]/)?.[0]] ?? 1;
  return { width, height, values: Float32Array.from(new kind(data)), most };
}

/** Metres at each pixel of a picture, as a map holds them: "metres" in a unit, "relative" (0 is near) or
 *  "inverse" (large is near). Of a larger map the nearest values, of a smaller one linear between four that are
 *  alike: a mean across an edge is no distance. See uwaug.distance.sizes. */
export function metresOf(map, width, height, { holds, unit, near, far, holes }) {
  let low = Infinity, high = -Infinity;
  for (const value of map.values) if (Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); }
  const span = high - low, filling = holes === "far" ? Infinity : Number(holes);
  const filled = z => z >= 1e7 ? Infinity : z > 0 ? z : filling, unknown = map.most > 1 ? map.most : NaN;
  if (holds === "relative" && !(low >= 0 && high <= map.most)) {
    throw new Error("relative distances lie between 0 (near) and 1 (far): are these metres, or inverse?");
  }
  if (holds === "inverse" && !(span > 0)) throw new Error("an inverse map must vary: this one is flat");
  const scaled = {
    metres: value => value === unknown ? filling : filled(value * unit),
    relative: value => filled(near + (far - near) * value / map.most),
    inverse: value => filled(1 / (1 / far + (1 / near - 1 / far) * (value - low) / span)),
  }[holds];
  const metres = new Float32Array(width * height), own = Float32Array.from(map.values, scaled);
  const small = holes === "behind" ? filledFromBehind(own, map.height, map.width) : own;
  const place = (n, size, of) => (n + 0.5) * of / size, isSmall = map.width < width;
  const beside = (at, size) => [Math.max(Math.ceil(at - 0.5) - 1, 0), Math.min(Math.ceil(at - 0.5), size - 1)];
  for (let y = 0, i = 0; y < height; y++) for (let x = 0; x < width; x++, i++) {
    const v = place(y, height, map.height), u = place(x, width, map.width);
    metres[i] = small[Math.floor(v) * map.width + Math.floor(u)];
    if (!isSmall) continue;
    const [[v0, v1], [u0, u1]] = [beside(v, map.height), beside(u, map.width)], [dv, du] = [v - v0 - 0.5, u - u0 - 0.5];
    const [a, b, c, d] = [v0, v1].flatMap(row => [u0, u1].map(column => small[row * map.width + column]));
    const high = Math.max(a, b, c, d);
    if (high > 1.25 * Math.min(a, b, c, d) || !(high < Infinity)) continue;
    metres[i] = (1 - dv) * ((1 - du) * a + du * b) + dv * ((1 - du) * c + du * d);
  }
  const missing = metres.reduce((count, z) => count + !(z > 0), 0);
  if (missing) throw new Error(`${missing} pixels have no distance: choose what the gaps get`);
  const known = metres.filter(z => z < Infinity).sort(), median = known[known.length >> 1];
  if (median > 500) throw new Error(`the median distance is ${median.toPrecision(3)} m: is the unit mm?`);
  return metres;
}

/** The layers of uwaug.distance.cue, which guesses distances: kernels and biases by name, from bytes of float16. */
export function layersOf(shapes, bytes) {
  const numbers = Float32Array.from(new Uint16Array(bytes.buffer), h => {
    const exponent = h >> 10 & 31, size = exponent ? (1024 + (h & 1023)) * 2 ** (exponent - 25) : (h & 1023) * 2 ** -24;
    return h >> 15 ? -size : size;
  });
  let start = 0;
  const next = count => numbers.subarray(start, start += count);
  return Object.fromEntries(shapes.map(([name, after, before, side]) =>
    [name, { after, before, side, kernel: next(after * before * side * side), bias: next(after) }]));
}

const relu = x => Math.max(x, 0), silu = x => x / (1 + Math.exp(-x));

/** A stack of planes {height, width, values} through a layer; with kernels of one plane, each plane has its own. */
function convolved({ height, width, values }, { after, before, side, kernel, bias }, stride = 1) {
  const around = (side - 1) >> 1, size = of => Math.floor((of + 2 * around - side) / stride) + 1;
  const h = size(height), w = size(width), out = new Float32Array(after * h * w);
  const isApart = before === 1 && values.length > height * width;
  for (let o = 0, k = 0; o < after; o++) {
    out.fill(bias[o], o * h * w, (o + 1) * h * w);
    for (let i = 0; i < before; i++) for (let v = -around; v < side - around; v++) for (let u = -around; u < side - around; u++) {
      const weight = kernel[k++], first = Math.ceil(Math.max(-u, 0) / stride), last = Math.min(w, Math.floor((width - 1 - u) / stride) + 1);
      for (let y = Math.ceil(Math.max(-v, 0) / stride); y < h && y * stride + v < height; y++) {
        const to = (o * h + y) * w, from = ((isApart ? o : i) * height + y * stride + v) * width + u;
        for (let x = first; x < last; x++) out[to + x] += weight * values[from + x * stride];
      }
    }
  }
  return { height: h, width: w, values: out };
}

const through = (f, x) => ({ ...x, values: x.values.map(f) });
const added = (a, b) => ({ ...a, values: a.values.map((value, i) => value + b.values[i]) });

/** Stacks of one size, one upon the other. */
function joined(...stacks) {
  const values = new Float32Array(stacks.reduce((count, stack) => count + stack.values.length, 0));
  let start = 0;
  for (const stack of stacks) {
    values.set(stack.values, start);
    start += stack.values.length;
  }
  return { ...stacks[0], values };
}

/** The two halves of a stack. */
function halves(x) {
  const middle = x.values.length / 2;
  return [x.values.subarray(0, middle), x.values.subarray(middle)].map(values => ({ ...x, values }));
}

/** The largest value of a window of 2r + 1 px along rows and columns. */
function largest({ height, width, values }, r) {
  const along = (from, stride, length) => from.map((_, i) => {
    const at = Math.floor(i / stride) % length;
    let most = -Infinity;
    for (let n = Math.max(at - r, 0); n <= Math.min(at + r, length - 1); n++) most = Math.max(most, from[i + (n - at) * stride]);
    return most;
  });
  return { height, width, values: along(along(values, 1, width), width, height) };
}

/** Twice as high and wide, linear between the middles of pixels. */
function doubled({ height, width, values }) {
  const planes = values.length / (height * width), out = new Float32Array(4 * values.length);
  for (let c = 0, i = 0; c < planes; c++) for (let y = 0; y < 2 * height; y++) for (let x = 0; x < 2 * width; x++) {
    const a = y >> 1, b = x >> 1, down = Math.min(Math.max(a + (y & 1 ? 1 : -1), 0), height - 1);
    const at = row => (c * height + row) * width, across = Math.min(Math.max(b + (x & 1 ? 1 : -1), 0), width - 1);
    out[i++] = (9 * values[at(a) + b] + 3 * values[at(a) + across] + 3 * values[at(down) + b] + values[at(down) + across]) / 16;
  }
  return { height: 2 * height, width: 2 * width, values: out };
}

/** Features of a small picture (planes of 0…1, sides multiples of 32) at 1/2 to 1/32 of its size. */
function encoded(picture, { layers, stages, pooled }) {
  const layer = (name, x, stride) => through(silu, convolved(x, layers[name], stride));
  const separable = (name, x, stride) => layer(name + ".points", layer(name + ".window", x, stride));
  let x = layer("stem", picture, 2);
  const features = [x];
  for (const [stage, blocks] of Object.entries(stages)) {
    x = separable(stage + ".down", x, 2);
    if (stage === "d5") {
      x = layer("d5.pooled.in", x);
      x = layer("d5.pooled.out", joined(x, ...pooled.map(side => largest(x, side >> 1))));
    }
    let [deep, passed] = halves(layer(stage + ".split", x));
    for (let block = 0; block < blocks; block++) {
      const change = separable(`${stage}.${block}`, layer(`${stage}.${block}.in`, deep));
      deep = stage === "d5" ? change : added(deep, change);
    }
    x = layer(stage + ".joined", joined(deep, passed));
    features.push(x);
  }
  return features;
}

/** The logarithm of the distance, up to scale and shift, and the logit of open water at half the size of a small picture. */
export function guessed(picture, cue) {
  const features = encoded(picture, cue), { layers } = cue, last = features.length - 1;
  const sides = features.map((feature, level) => {
    const { height, width } = feature, even = (at, count) => count > 1 ? 2 * at / (count - 1) - 1 : -1;
    const plane = of => ({ height, width, values: Float32Array.from({ length: height * width }, (_, p) => of(p)) });
    const down = plane(p => even(Math.floor(p / width), height)), across = plane(p => even(p % width, width));
    return convolved(joined(feature, down, across), layers["side" + level]);
  });
  const means = features.slice(-2).reverse().flatMap(({ height, width, values }) =>
    Array.from({ length: values.length / (height * width) }, (_, c) =>
      values.subarray(c * height * width, (c + 1) * height * width).reduce((total, value) => total + value, 0) / (height * width)));
  const small = through(relu, convolved({ height: 1, width: 1, values: Float32Array.from(means) }, layers["whole.in"]));
  const { values: whole } = convolved(small, layers["whole.out"]), size = sides[last].height * sides[last].width;
  let x = added(sides[last], { values: sides[last].values.map((_, i) => whole[Math.floor(i / size)]) });
  x = through(relu, convolved(through(relu, x), layers["at" + last]));
  for (let level = last - 1; level >= 0; level--) {
    const finer = doubled(convolved(x, layers["up" + level]));
    x = through(relu, convolved(through(relu, added(finer, sides[level])), layers["at" + level]));
  }
  return convolved(x, layers.answer);
}

/** Distances [m] made up from a picture (RGBA bytes), in the way of uwaug.distance.MadeUp: what the network
 *  guesses, with an exponent, a smooth field and open water (in three of four pictures) drawn on top. */
export function madeUp(pixels, width, height, random, cue, near = 1, far = 8) {
  const shrink = Math.sqrt(cue.pixels / (width * height));
  const [H, W] = [height, width].map(side => Math.min(Math.max(32 * Math.round(side * shrink / 32), 32), 512));
  const area = { height: H, width: W, values: new Float32Array(3 * H * W) }, h = H / 2, w = W / 2, n = h * w;
  for (let c = 0, i = 0; c < 3; c++) for (let y = 0; y < H; y++) for (let x = 0; x < W; x++) {
    const [top, left] = [Math.floor(y * height / H), Math.floor(x * width / W)];
    const bottom = Math.ceil((y + 1) * height / H), right = Math.ceil((x + 1) * width / W);
    let total = 0;
    for (let v = top; v < bottom; v++) for (let u = left; u < right; u++) total += pixels[4 * (v * width + u) + c];
    area.values[i++] = total / (bottom - top) / (right - left) / 255;
  }
  const answer = guessed(area, cue).values, ramp = random() < 0.03;
  let log = ramp ? Float32Array.from({ length: n }, (_, p) => -Math.floor(p / w)) : answer.subarray(0, n);
  const chance = Float32Array.from({ length: n }, (_, p) => ramp ? 0 : 1 / (1 + Math.exp(-answer[n + p])));
  let open = chance.map(value => Math.min(Math.max((value - 0.4) / 0.2, 0), 1));
  const sure = chance.reduce((count, value) => count + (value > 0.7), 0);
  if (random() > 0.75 || sure < 0.03 * n || Math.min(...open) > 0) open = new Float32Array(n);
  const solid = log.filter((_, p) => open[p] < 0.5).sort(), low = solid[Math.floor(0.01 * solid.length)];
  const high = solid[Math.ceil(0.99 * solid.length) - 1], exponent = Math.exp(0.3 * normalOf(random));
  const waves = Array.from({ length: 4 }, () => [...[0, 0, 0].map(() => 3 * normalOf(random)), 0.06 * random()]);
  const share = Float32Array.from({ length: n }, (_, p) => {
    let t = high > low ? Math.min(Math.max((log[p] - low) / (high - low), 0), 1) ** exponent : 0.5;
    for (const [down, across, phase, size] of waves) {
      t += size * Math.cos(down * Math.floor(p / w) / h + phase) * Math.cos(across * ((p % w + 0.5) / w - 0.5));
    }
    t = Math.min(Math.max(t, 0), 1);
    return t + (2 - t) * open[p];
  });
  const small = (p, c) => { // the mean of two by two
    const i = (c * H + 2 * Math.floor(p / w)) * W + 2 * (p % w), { values } = area;
    return (values[i] + values[i + 1] + values[i + W] + values[i + W + 1]) / 4;
  };
  const colours = Float32Array.from({ length: 3 * n }, (_, i) => small(Math.floor(i / 3), i % 3));

  return Float32Array.from({ length: width * height }, (_, i) => { // of the four nearest, those of like colour
    const x = (i % width + 0.5) * w / width - 0.5, y = (Math.floor(i / width) + 0.5) * h / height - 0.5;
    let total = 0, weights = 0;
    for (const v of [Math.floor(y), Math.floor(y) + 1]) for (const u of [Math.floor(x), Math.floor(x) + 1]) {
      const q = Math.min(Math.max(v, 0), h - 1) * w + Math.min(Math.max(u, 0), w - 1);
      let apart = 0;
      for (let c = 0; c < 3; c++) apart += (pixels[4 * i + c] / 255 - colours[3 * q + c]) ** 2;
      const weight = (1 - Math.abs(x - u)) * (1 - Math.abs(y - v)) * Math.exp(-apart / 0.003) + 1e-9;
      total += weight * share[q];
      weights += weight;
    }
    const t = total / weights;
    return near * (far / near) ** Math.min(t, 1) / Math.min(Math.max((1.95 - t) / 0.9, 0), 1);
  });
}
