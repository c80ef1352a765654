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
  const metres = new Float32Array(width * height), small = Float32Array.from(map.values, scaled);
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
  if (missing) throw new Error(`${missing} pixels have no distance: choose what they get`);
  const known = metres.filter(z => z < Infinity).sort(), median = known[known.length >> 1];
  if (median > 500) throw new Error(`the median distance is ${median.toPrecision(3)} m: is the unit mm?`);
  return metres;
}

/** Distances [m] made up from a picture (RGBA bytes), in the way of uwaug.distance.MadeUp: a ground with
 *  a horizon, regions of like colour at distances of their own, a smooth field, open water at a plain top. */
export function madeUp(pixels, width, height, random, near = 1, far = 8) {
  const shrink = Math.max(1, Math.sqrt(width * height / 4096));
  const w = Math.ceil(width / shrink), h = Math.ceil(height / shrink), n = w * h;
  const at = (small, size) => Math.min(size - 1, Math.floor((small + 0.5) * shrink)), rowOf = p => Math.floor(p / w);
  const small = Float32Array.from({ length: 3 * n }, (_, i) => {
    const p = Math.floor(i / 3);
    return pixels[4 * (at(rowOf(p), height) * width + at(p % w, width)) + i % 3] / 255;
  });
  const differ = (p, q) => Math.max(...[0, 1, 2].map(c => Math.abs(small[3 * p + c] - small[3 * q + c])));
  const root = regionsOf(w, h, differ);

  const plain = new Uint8Array(n), size = new Int32Array(n), plainOf = new Int32Array(n); // of regions, at their roots
  for (let p = 0; p < n; p++) { // from the top down, as long as nothing is there
    plain[p] = p < w || (plain[p - w] && differ(p, p - w) < 0.06) ? 1 : 0;
    size[root(p)]++;
    plainOf[root(p)] += plain[p];
  }
  const closed = random() > 0.75, lowest = 0.3 + 0.5 * random(), fading = y => Math.min(Math.max((lowest - y) / 0.2, 0), 1);
  const mostly = p => !closed && plainOf[root(p)] > size[root(p)] / 2;
  let open = Float32Array.from({ length: n }, (_, p) => mostly(p) ? fading((rowOf(p) + 0.5) / h) : 0);
  const covered = open.reduce((total, value) => total + value, 0) / n;
  if (covered < 0.05) open = new Float32Array(n);
  const horizon = covered < 0.05 ? 1.4 * random() - 1 : covered;
  const slant = 0.12 * normalOf(random), standing = random(), sway = 0.15 * random();
  const spread = 0.1 + 0.4 * random(), own = Float32Array.from({ length: n }, () => spread * normalOf(random));
  const waves = Array.from({ length: 6 }, () => [3 * normalOf(random), 3 * normalOf(random), 2 * Math.PI * random()]);
  const depth = new Float32Array(n), foot = new Float32Array(n).fill(Infinity);
  for (let p = 0; p < n; p++) {
    depth[p] = -Math.log(Math.max((rowOf(p) + 0.5) / h - horizon + slant * ((p % w) / w - 0.5), 0) + 0.08);
    foot[root(p)] = Math.min(foot[root(p)], depth[p]);
  }
  for (let p = 0; p < n; p++) {
    let field = own[root(p)];
    for (const [kx, ky, phase] of waves) field += sway * Math.cos(kx * (p % w) / w + ky * rowOf(p) / h + phase);
    depth[p] += standing * (foot[root(p)] - depth[p]) + 2 * field;
  }
  const solid = depth.filter((_, p) => open[p] < 0.5).sort(), low = solid[solid.length >> 6];
  const high = solid[solid.length - 1 - (solid.length >> 6)];
  const share = depth.map((z, p) => {
    const t = high > low ? Math.min(Math.max((z - low) / (high - low), 0), 1) : 0.5;
    return t + (2 - t) * open[p];
  });

  return Float32Array.from({ length: width * height }, (_, i) => { // of the four nearest, those of like colour
    const x = (i % width + 0.5) / shrink - 0.5, y = (Math.floor(i / width) + 0.5) / shrink - 0.5;
    let total = 0, weights = 0;
    for (const v of [Math.floor(y), Math.floor(y) + 1]) for (const u of [Math.floor(x), Math.floor(x) + 1]) {
      const q = Math.min(Math.max(v, 0), h - 1) * w + Math.min(Math.max(u, 0), w - 1);
      let apart = 0;
      for (let c = 0; c < 3; c++) apart += (pixels[4 * i + c] / 255 - small[3 * q + c]) ** 2;
      const weight = (1 - Math.abs(x - u)) * (1 - Math.abs(y - v)) * Math.exp(-apart / 0.003) + 1e-9;
      total += weight * share[q];
      weights += weight;
    }
    const t = total / weights;
    return near * (far / near) ** Math.min(t, 1) / Math.min(Math.max((1.95 - t) / 0.9, 0), 1);
  });
}

/** The root of each pixel's region: neighbours join where they differ less than what is inside of either
 *  (Felzenszwalb and Huttenlocher 2004); then what is small joins its nearest. */
function regionsOf(w, h, differ) {
  const n = w * h, parent = Int32Array.from({ length: n }, (_, p) => p), edges = [];
  const count = new Int32Array(n).fill(1), inside = new Float32Array(n);
  const root = p => { while (parent[p] !== p) p = parent[p] = parent[parent[p]]; return p; };
  for (let p = 0; p < n; p++) {
    if ((p + 1) % w) edges.push([differ(p, p + 1), p, p + 1]);
    if (p + w < n) edges.push([differ(p, p + w), p, p + w]);
  }
  edges.sort((one, other) => one[0] - other[0]);
  for (const few of [0, n / 150]) for (const [step, p, q] of edges) {
    const a = root(p), b = root(q), alike = step <= Math.min(inside[a] + 2 / count[a], inside[b] + 2 / count[b]);
    if (a === b || !(few ? Math.min(count[a], count[b]) < few : alike)) continue;
    parent[b] = a;
    count[a] += count[b];
    inside[a] = step;
  }
  return root;
}
