// Distances: read from files (a canvas would make 8 bits of 16), or made up from the picture.

export async function inflated(parts) {
  const stream = new Blob(parts).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** {width, height, values, most} of a greyscale PNG of 8 or 16 bits; `most` is the largest it could hold. */
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
  if (colour !== 0 || bits < 8 || interlaced) throw new Error("a map of distances is a grey PNG of 8 or 16 bits, not interlaced");
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

const KINDS = { f4: Float32Array, f8: Float64Array, u2: Uint16Array, u1: Uint8Array };

/** The same of a .npy file. */
export function readNpy(buffer) {
  const view = new DataView(buffer), long = view.getUint8(6) > 1, start = long ? 12 : 10;
  const length = long ? view.getUint32(8, true) : view.getUint16(8, true);
  const header = new TextDecoder().decode(new Uint8Array(buffer, start, length));
  const kind = KINDS[/'descr': *'[<|]([^']+)'/.exec(header)?.[1]];
  const shape = /'shape': *\(([^)]*)\)/.exec(header)?.[1].split(",").filter(side => side.trim()).map(Number);
  if (!kind || shape?.length !== 2 || /'fortran_order': *True/.test(header)) throw new Error("a .npy file of distances holds one plane (H, W), float32, float64 or uint16");
  const most = kind === Uint16Array ? 65535 : kind === Uint8Array ? 255 : 1;
  return { width: shape[1], height: shape[0], values: Float32Array.from(new kind(buffer.slice(start + length))), most };
}

/** A .npy file of float32. */
export function npyOf(values, width, height) {
  const header = `{'descr': '<f4', 'fortran_order': False, 'shape': (${height}, ${width}), }`.padEnd(117) + "\n";
  return new Blob([new Uint8Array([0x93, 78, 85, 77, 80, 89, 1, 0, 118, 0]), header, values]);
}

/** Metres of what a map holds: "metres" in a unit, "relative" (0 is near) or "inverse" (large is near). */
export function metresOf({ values, most }, { holds, unit, near, far, holes }) {
  const unknown = z => !(z > 0) ? holes === "far" ? Infinity : Number(holes) || NaN : z;
  let metres;
  if (holds === "metres") metres = values.map(value => unknown(value * unit));
  else if (holds === "relative") metres = values.map(value => near + (far - near) * value / most);
  else {
    let low = Infinity, high = -Infinity;
    for (const value of values) if (Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); }
    metres = values.map(value => unknown(1 / (1 / far + (1 / near - 1 / far) * (value - low) / (high - low))));
  }
  if (holds === "relative" && values.some(value => !(value >= 0 && value <= most))) throw new Error("relative distances lie between 0 (near) and 1 (far); are these metres, or inverse?");
  const missing = metres.reduce((count, z) => count + !(z > 0), 0);
  if (missing) throw new Error(`${missing} pixels have no distance: choose what they get, or fill them first (uwaug.distance.fill_unknown)`);
  const known = metres.filter(z => z < Infinity).sort(), median = known[known.length >> 1];
  if (median > 500) throw new Error(`the median distance is ${median.toPrecision(3)} m, farther than anybody sees: is the unit mm?`);
  return metres;
}

/** Distances [m] made up from a picture (RGBA bytes), in the way of uwaug.distance.MadeUp: a ground with a
 *  horizon, regions of like colour at distances of their own, a smooth field, open water at a plain top. */
export function madeUp(pixels, width, height, random, near = 1, far = 8) {
  const shrink = Math.max(1, Math.sqrt(width * height / 4096)), w = Math.ceil(width / shrink), h = Math.ceil(height / shrink), n = w * h;
  const small = Float32Array.from({ length: 3 * n }, (_, i) => {
    const p = Math.floor(i / 3), x = Math.min(width - 1, Math.floor((p % w + 0.5) * shrink)), y = Math.min(height - 1, Math.floor((Math.floor(p / w) + 0.5) * shrink));
    return pixels[4 * (y * width + x) + i % 3] / 255;
  });
  const differ = (p, q) => Math.max(...[0, 1, 2].map(c => Math.abs(small[3 * p + c] - small[3 * q + c])));
  // regions: neighbours join where they differ less than what is inside either (Felzenszwalb 2004)
  const parent = Int32Array.from({ length: n }, (_, p) => p), count = new Int32Array(n).fill(1), inside = new Float32Array(n);
  const root = p => { while (parent[p] !== p) p = parent[p] = parent[parent[p]]; return p; };
  const edges = [];
  for (let p = 0; p < n; p++) { if ((p + 1) % w) edges.push([differ(p, p + 1), p, p + 1]); if (p + w < n) edges.push([differ(p, p + w), p, p + w]); }
  edges.sort((one, other) => one[0] - other[0]);
  for (const few of [0, n / 150]) for (const [step, p, q] of edges) {
    const a = root(p), b = root(q);
    const join = few ? Math.min(count[a], count[b]) < few : step <= Math.min(inside[a] + 2 / count[a], inside[b] + 2 / count[b]);
    if (a !== b && join) { parent[b] = a; count[a] += count[b]; inside[a] = step; }
  }
  const normal = () => Math.sqrt(-2 * Math.log(1 - random())) * Math.cos(2 * Math.PI * random());
  const horizon = 0.4 * random(), standing = random(), spread = 0.1 + 0.4 * random(), slant = 0.12 * normal();
  const waves = Array.from({ length: 6 }, () => [3 * normal(), 3 * normal(), 2 * Math.PI * random()]), sway = 0.15 * random();
  const ground = Array.from({ length: n }, (_, p) => -Math.log(Math.max((Math.floor(p / w) + 0.5) / h - horizon + slant * ((p % w) / w - 0.5), 0) + 0.08));
  const foot = new Float32Array(n).fill(Infinity), own = Float32Array.from({ length: n }, () => spread * normal());
  for (let p = 0; p < n; p++) foot[root(p)] = Math.min(foot[root(p)], ground[p]);
  const depth = ground.map((z, p) => {
    const r = root(p), field = waves.reduce((total, [kx, ky, phase]) => total + Math.cos(kx * (p % w) / w + ky * Math.floor(p / w) / h + phase), 0);
    return z + standing * (foot[r] - z) + 2 * (own[r] + sway * field);
  });
  const open = new Uint8Array(n); // from the top down, as long as all is plain
  for (let p = 0; p < n; p++) open[p] = (p < w || (open[p - w] && differ(p, p - w) < 0.06)) && p < w * (horizon + 0.2) * h ? 1 : 0;
  const sorted = [...depth].sort((one, other) => one - other), low = sorted[n >> 6], high = sorted[n - 1 - (n >> 6)];
  const share = depth.map((z, p) => open[p] ? 2 : Math.min(Math.max((z - low) / (high - low || 1), 0), 1));
  return Float32Array.from({ length: width * height }, (_, i) => { // of the four nearest, those of like colour
    const x = (i % width + 0.5) / shrink - 0.5, y = (Math.floor(i / width) + 0.5) / shrink - 0.5, x0 = Math.floor(x), y0 = Math.floor(y);
    let total = 0, weights = 0;
    for (let k = 0; k < 4; k++) {
      const [u, v] = [x0 + (k & 1), y0 + (k >> 1)], q = Math.min(Math.max(v, 0), h - 1) * w + Math.min(Math.max(u, 0), w - 1);
      let apart = 0;
      for (let c = 0; c < 3; c++) apart += (pixels[4 * i + c] / 255 - small[3 * q + c]) ** 2;
      const weight = (1 - Math.abs(x - u)) * (1 - Math.abs(y - v)) * Math.exp(-apart / 0.003) + 1e-9;
      total += weight * share[q]; weights += weight;
    }
    const t = total / weights;
    return near * (far / near) ** Math.min(t, 1) / Math.min(Math.max((1.95 - t) / 0.9, 0), 1);
  });
}
