// "Like this": draws held against a photograph by the twelve numbers of uwaug.transforms.appearance.

function middle(values) {
  const sorted = Float64Array.from(values).sort(), n = sorted.length;
  return (sorted[n >> 1] + sorted[(n - 1) >> 1]) / 2;
}
function mean(values) {
  let total = 0;
  for (const value of values) total += value;
  return total / values.length;
}
function spread(values) {
  const centre = mean(values);
  let total = 0;
  for (const value of values) total += (value - centre) ** 2;
  return Math.sqrt(total / values.length);
}
const lightOf = Float64Array.from({ length: 256 }, (_, byte) => decode(byte / 255));
const cubic = t => t > 0.008856 ? Math.cbrt(t) : 7.787 * t + 16 / 116;

/** The numbers of a picture (RGBA bytes), in the order of WATER_FEATURES. */
export function featuresOf({ pixels, width, height }) {
  const n = width * height, plane = () => new Float64Array(n), [R, G, B, L, a, b, chroma, bright] = Array.from({ length: 8 }, plane);
  const light = [0, 0, 0];
  for (let p = 0; p < n; p++) {
    const [r, g, blue] = [pixels[4 * p], pixels[4 * p + 1], pixels[4 * p + 2]], [lr, lg, lb] = [lightOf[r], lightOf[g], lightOf[blue]];
    [R[p], G[p], B[p], bright[p]] = [r / 255, g / 255, blue / 255, 1 - Math.min(g, blue) / 255];
    [light[0], light[1], light[2]] = [light[0] + lr, light[1] + lg, light[2] + lb];
    const x = cubic((0.412453 * lr + 0.35758 * lg + 0.180423 * lb) / 0.95047), y = cubic(0.212671 * lr + 0.71516 * lg + 0.072169 * lb);
    [L[p], a[p], b[p]] = [116 * y - 16, 500 * (x - y), 200 * (y - cubic((0.019334 * lr + 0.119193 * lg + 0.950227 * lb) / 1.08883))];
    chroma[p] = Math.hypot(a[p], b[p]);
  }
  const side = Math.max(2, Math.floor(Math.min(width, height) / 16)), blocks = [];
  for (let y = 0; y + side <= height; y += side) for (let x = 0; x + side <= width; x += side) {
    const inBlock = [];
    for (let v = y; v < y + side; v++) for (let u = x; u < x + side; u++) inBlock.push(v * width + u);
    blocks.push(inBlock);
  }
  const ranks = values => { // of each block among all
    const rank = [];
    values.map((_, i) => i).sort((i, j) => values[i] - values[j]).forEach((block, place) => { rank[block] = place; });
    return rank;
  };
  const texture = ranks(blocks.map(block => spread(block.map(p => L[p]))));
  const lessRed = ranks(blocks.map(block => mean(block.map(p => Math.max(G[p], B[p]) - R[p]))));
  const veiled = blocks.map((_, i) => i).sort((i, j) => texture[i] - lessRed[i] - texture[j] + lessRed[j]);
  const veil = veiled.slice(0, Math.max(2, Math.floor(blocks.length / 10))).flatMap(i => blocks[i]);
  const [red, green, blue] = light.map(total => total / n + 0.004), [ofRed, ofGreen] = [spread(R), spread(G)], [meanR, meanG] = [mean(R), mean(G)];
  let together = 0;
  for (let p = 0; p < n; p++) together += (R[p] - meanR) * (G[p] - meanG) / n;
  return [mean(L), mean(a), mean(b), mean(chroma), ...[L, a, b].map(x => middle(veil.map(p => x[p]))),
    Math.log2(red / green), Math.log2(blue / green), Math.log2((ofRed + 0.004) / (ofGreen + 0.004)),
    together / Math.sqrt((ofRed ** 2 + 1e-8) * (ofGreen ** 2 + 1e-8)),
    1 - mean(widened(bright, height, width, (side - 1) >> 1))]; // the darkest nearby is least bright
}

/** A number a share of the way from one draw to another; of contents the ratio counts. */
const mixed = (low, high, share, isContent) => Number((isContent && low * high > 0 ? low * (high / low) ** share : low + share * (high - low)).toPrecision(3));

/** Numbers that a picture draws by default, as uwaug.transforms.conditions does, but for those that are held. */
export function drawnBy(random, settings, held, { conditions, sums, between, contents, visible, left, pitch }) {
  const drawn = { ...settings }, pick = at => conditions[sums.findIndex(sum => sum > at * sums.at(-1))];
  const first = pick(random()), second = pick(random()), share = between * random();
  const numbers = { pitch: mixed(...pitch, random()) };
  for (const name in first) numbers[name] = mixed(first[name], second[name], share, contents.includes(name));
  const medians = mixed(...visible, numbers.clearness, true); // of the scene that one sees
  Object.assign(numbers, { contrast: Number((left ** (1 / medians)).toPrecision(3)), white_balance: Math.max(numbers.white_balance, 0) }); // below, none
  delete numbers.clearness;
  for (const name in numbers) if (!held.includes(contents.includes(name) ? "water" : name)) drawn[name] = numbers[name];
  return held.includes("water") ? drawn : { ...drawn, water: "contents", share: 0, other: "" };
}

const NEW = 80, BETWEEN = 40, PARENTS = 12; // draws; uwaug.like tries as many again on further pictures

/** The draw that makes a scene look most like a photograph: {drawn, away, usual, off}, in standard deviations of photographs. */
export async function nearestDraw(scene, photograph, settings, held, random, tables, tell) {
  const features = Object.values(tables.appearance), counts = features.map(([, count]) => count);
  const unit = Math.sqrt(mean(counts.map(count => count ** 2))), reference = featuresOf(photograph), tried = [];
  const attempt = async drawn => {
    const water = waterTable(scene, drawn, tables), made = form(scene, water, gainOf(scene, water, drawn, tables), drawn, {}, tables);
    const over = featuresOf(made).map((value, i) => (value - reference[i]) / features[i][0] * counts[i] / unit);
    tried.push({ drawn, over, away: Math.sqrt(mean(over.map(value => value ** 2))) });
    tell(tried.length / (NEW + BETWEEN));
    await new Promise(resolve => setTimeout(resolve)); // pictures come between
  };
  while (tried.length < NEW) await attempt(drawnBy(random, settings, held, tables.draws));
  const usual = middle(tried.map(({ away }) => away)), byDistance = (one, other) => one.away - other.away;
  const parents = tried.toSorted(byDistance).slice(0, PARENTS), pick = () => parents[Math.floor(random() * PARENTS)].drawn;
  while (tried.length < NEW + BETWEEN) {
    const drawn = { ...pick() }, other = pick();
    for (const name in drawn) { // what is held is alike in both
      const isContent = tables.draws.contents.includes(name);
      if (typeof drawn[name] === "number" && drawn[name] !== other[name]) drawn[name] = mixed(drawn[name], other[name], random(), isContent);
    }
    await attempt(drawn);
  }
  const { drawn, away, over } = tried.sort(byDistance)[0];
  const worst = over.map((_, i) => i).sort((i, j) => Math.abs(over[j]) - Math.abs(over[i])).slice(0, 3);
  return { drawn, away, usual, off: away < 1 ? [] : worst.map(i => features[i][over[i] > 0 ? 3 : 2]) };
}
