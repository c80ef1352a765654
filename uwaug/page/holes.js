// Holes of depth maps, filled with what is behind, as by uwaug.distance.fill_unknown: names and numbers are its.

const RIM_PX = 3, REACH_WIDTHS = 4, NEARER_TIMES = 1.25, FARTHEST_QUANTILE = 0.98, THIN_PX = 4, SWEEPS = 4;

/** The largest value within so many pixels along rows and columns; `outside` the picture there is but this one. */
function widened(values, height, width, reach, outside = 0) {
  for (const [count, step, lines, next] of [[width, 1, height, width], [height, width, width, 1]]) {
    const wide = new Float64Array(values.length), line = new Float64Array(count + 2 * reach);
    for (let l = 0; l < lines; l++) {
      line.fill(outside);
      for (let i = 0; i < count; i++) line[reach + i] = values[l * next + i * step];
      let window = 1; // of which each place holds the largest from it on
      for (; 2 * window <= 2 * reach + 1; window *= 2) {
        for (let i = 0; i + window < line.length; i++) line[i] = Math.max(line[i], line[i + window]);
      }
      const rest = 2 * reach + 1 - window;
      for (let i = 0; i < count; i++) wide[l * next + i * step] = Math.max(line[i], line[i + rest]);
    }
    values = wide;
  }
  return values;
}

/** 1, 2, … at the pixels of each hole, which touch by sides or corners; 0 elsewhere. */
function labelled(unknown, height, width) {
  const labels = new Int32Array(unknown.length);
  let count = 0;
  for (let start = 0; start < unknown.length; start++) {
    if (!unknown[start] || labels[start]) continue;
    labels[start] = ++count;
    for (const waiting = [start]; waiting.length;) {
      const p = waiting.pop(), x = p % width, y = (p - x) / width;
      for (let v = Math.max(y - 1, 0); v <= Math.min(y + 1, height - 1); v++) {
        for (let u = Math.max(x - 1, 0); u <= Math.min(x + 1, width - 1); u++) {
          const q = v * width + u;
          if (unknown[q] && !labels[q]) waiting.push(q), labels[q] = count;
        }
      }
    }
  }
  return labels;
}

/** For each of some pixels which of the sources is nearest, and how far away: [index, away]. */
function nearestOf(pixels, isSource, width, index, away) {
  let left = Infinity, right = 0, top = Infinity, bottom = 0;
  for (const p of pixels) {
    const x = p % width, y = (p - x) / width;
    [left, right, top, bottom] = [Math.min(left, x), Math.max(right, x), Math.min(top, y), Math.max(bottom, y)];
  }
  const w = right - left + 1, h = bottom - top + 1, rows = new Float64Array(w * h).fill(Infinity); // of the nearest in each column
  for (const p of pixels) if (isSource(p)) rows[(Math.floor(p / width) - top) * w + p % width - left] = Math.floor(p / width);
  const nearer = (i, j, y) => { if (Math.abs(rows[j] - y) < Math.abs(rows[i] - y)) rows[i] = rows[j]; };
  for (let i = w; i < w * h; i++) nearer(i, i - w, top + Math.floor(i / w));
  for (let i = w * (h - 1) - 1; i >= 0; i--) nearer(i, i + w, top + Math.floor(i / w));
  for (const p of pixels) if (!isSource(p)) {
    const x = p % width, y = (p - x) / width;
    let best = Infinity;
    for (let far = 0; far * far < best; far++) for (const u of [x - far, x + far]) {
      const row = u < left || u > right ? Infinity : rows[(y - top) * w + u - left], square = far * far + (row - y) ** 2;
      if (square < best) [best, index[p], away[p]] = [square, row * width + u, Math.sqrt(square)];
      if (u < left && x + far > right) best = Math.min(best, far * far);
    }
  }
}

/** Values that solve Laplace's equation where they are not fixed: from coarse grids to fine ones. */
function membrane(values, fixed, height, width) {
  if (fixed.every(Boolean)) return values;
  const h = (height + 1) >> 1, w = (width + 1) >> 1, totals = new Float64Array(h * w), shares = new Float64Array(h * w);
  values.forEach((value, p) => {
    const half = (Math.floor(p / width) >> 1) * w + ((p % width) >> 1);
    totals[half] += fixed[p] * value;
    shares[half] += fixed[p];
  });
  const means = totals.map((total, i) => total / Math.max(shares[i], 1));
  const coarse = doubled({ height: h, width: w, values: membrane(means, shares.map(Math.sign), h, w) }).values;
  let guess = values.map((value, p) => fixed[p] ? value : coarse[Math.floor(p / width) * 2 * w + p % width]);
  for (let n = 0; n < SWEEPS; n++) {
    const last = guess;
    guess = last.map((value, p) => {
      const x = p % width, above = p < width ? p : p - width, below = p + width < last.length ? p + width : p;
      return fixed[p] ? value : (last[above] + last[below] + last[x ? p - 1 : p] + last[x + 1 < width ? p + 1 : p]) / 4;
    });
  }
  return guess;
}

/** Distances of a map, of which those that are not above 0 get what is behind them. */
export function filledFromBehind(distance, height, width) {
  const unknown = Float64Array.from(distance, z => +!(z > 0)), holes = labelled(unknown, height, width);
  if (!unknown.includes(1)) return distance;
  if (!unknown.includes(0)) throw new Error("no pixel of the map has a distance");
  const beside = Int32Array.from(holes, (_, p) => p), near = widened(unknown, height, width, RIM_PX);
  const rim = near.map((value, p) => +(value > unknown[p]));
  rim.forEach((is, p) => { // the nearest pixel of a hole
    const x = p % width, y = (p - x) / width;
    for (let v = y - RIM_PX, best = Infinity; is && v <= y + RIM_PX; v++) for (let u = x - RIM_PX; u <= x + RIM_PX; u++) {
      const square = (u - x) ** 2 + (v - y) ** 2, inside = u >= 0 && u < width && v >= 0 && v < height;
      if (inside && square < best && unknown[v * width + u]) [best, beside[p]] = [square, v * width + u];
    }
  });
  const owner = holes.map((hole, p) => holes[beside[p]]), members = [];
  owner.forEach((hole, p) => { if (hole) (members[hole] ??= []).push(p); });
  const rims = members.map(pixels => pixels.filter(p => rim[p]).sort((p, q) => distance[p] - distance[q]));
  const farthest = rims.map(pixels => pixels[Math.floor(FARTHEST_QUANTILE * (pixels.length - 1))]);
  const measured = unknown.map(value => 1 - value), beyond = px => widened(measured, height, width, px, 1); // 0 deeper than that
  const wide = Math.max(4, Math.min(height, width) / 20), notMiddle = beyond(Math.ceil(wide) - 1);
  const index = Int32Array.from(holes, (hole, p) => notMiddle[p] ? p : farthest[hole]);
  const values = Float64Array.from(index, (source, p) => rim[p] || !notMiddle[p] ? distance[source] : 0);
  const within = widened(values, height, width, 2 * REACH_WIDTHS), across = within.map((value, p) => unknown[p] * value || 0);
  for (let half = 1; half < 2 * wide; half *= 2) {
    const core = beyond(half).map(value => 1 - value); // of holes that are at least so wide, up to their rims
    if (!core.includes(1)) break;
    const opened = widened(core, height, width, half), further = widened(values, height, width, REACH_WIDTHS * (half + 1));
    opened.forEach((is, p) => { if (is && unknown[p]) across[p] = further[p]; });
  }
  const most = rims.map(pixels => distance[pixels.at(-1)]), away = new Float64Array(holes.length);
  const isFarSide = rim.map((is, p) =>
    +(!notMiddle[p] || (is && values[p] * NEARER_TIMES >= Math.min(across[beside[p]], most[owner[p]]))));
  const sources = index.slice();
  members.forEach(pixels => nearestOf(pixels, p => isFarSide[p], width, sources, away));
  const nearest = Float64Array.from(sources, p => distance[index[p]]), weight = away.map(px => Math.min(Math.max(px / THIN_PX - 1, 0), 1));
  const fixed = rim.map((is, p) => +(is || !notMiddle[p])), inverse = nearest.map((z, p) => fixed[p] ? 1 / z : 0);
  const smooth = weight.some(Boolean) ? membrane(inverse, fixed, height, width) : inverse;
  return Float32Array.from(distance, (z, p) => unknown[p] ? 1 / ((1 - weight[p]) / nearest[p] + weight[p] * smooth[p]) : z);
}
