// Beside the page, so that it never waits: answers each message with one of the same number.

let tables, scene;

async function distancesOf({ pixels, width, height, from, seed }) {
  if (from.metres) return new Float32Array(width * height).fill(from.metres);
  if (from.embedded) {
    const { packed, near, step } = from.embedded; // codes in equal steps of the logarithm, each less the one before
    const codes = new Uint16Array((await inflated([Uint8Array.from(atob(packed), letter => letter.charCodeAt(0))])).buffer);
    for (let i = 1; i < codes.length; i++) codes[i] += codes[i - 1];
    return Float32Array.from(codes, code => code === 65535 ? Infinity : near * Math.exp(code * step));
  }
  if (!from.file) return madeUp(pixels, width, height, randomOf(seed));
  const map = from.npy ? readNpy(from.file) : await readPng(from.file), { whole, said } = from;
  const apart = Math.abs(map.width * whole[1] - map.height * whole[0]);
  if (apart > Math.max(0.01 * map.width * whole[1], Math.min(...whole) - 1)) {
    throw new Error(`the map is ${map.width}×${map.height} px, the picture ${whole[0]}×${whole[1]}: of another aspect`);
  }
  if (said.holds === "metres" && map.most === 255) throw new Error("8 bits are too few for metres: relative or inverse?");
  if (said.holds !== "metres" && !(said.near > 0 && said.near < said.far)) {
    throw new Error("nearest must be above 0 m and below farthest");
  }
  return metresOf(map, width, height, said);
}

const answers = {
  open: message => { tables = message.tables; },
  async scene(message, tell) {
    const { pixels, width, height } = message, distance = await distancesOf(message);
    scene = null; // makes room
    scene = sceneOf(pixels, distance, width, height, tables, tell);
    return { distance };
  },
  form({ settings, terms, step }) {
    const water = waterTable(scene, settings, tables), gain = gainOf(scene, water, settings, tables);
    const left = Float32Array.from({ length: ENTRIES + 1 }, (_, place) => contrastLeft(place, water, scene.K, tables));
    const { table, ...said } = water;
    const { near, step: stepOfPlace } = scene;
    return { ...form(scene, water, gain, settings, { step, terms }, tables), ...said, left, near, stepOfPlace };
  },
  /** What `RandomUnderwater` draws by default, but for the settings that are held. */
  draw({ settings, held, seed, step }) {
    const random = randomOf(seed), { waters, contents, ranges } = tables.draws, drawn = { ...settings };
    const between = ([low, high], share, log) => Number((log ? low * (high / low) ** share : low + (high - low) * share).toPrecision(3));
    const water = waters[Math.floor(random() * waters.length)];
    const inWater = Object.keys(contents).map(name => [name, between(contents[name], random(), true)]);
    if (!held.includes("water")) Object.assign(drawn, Object.fromEntries(inWater), { water, share: 0, other: "" });
    for (const name in ranges) {
      const value = between(ranges[name], random(), name === "contrast");
      if (!held.includes(name)) drawn[name] = name === "white_balance" ? Math.max(value, 0) : value; // below, none
    }
    return { ...answers.form({ settings: drawn, step }), drawn };
  },
};

self.onmessage = async ({ data: { number, what, ...message } }) => {
  const tell = share => self.postMessage({ number, share });
  try {
    const answer = await answers[what](message, tell) ?? {};
    const arrays = [answer.pixels, answer.distance].filter(Boolean);
    self.postMessage({ number, answer }, arrays.map(array => array.buffer));
  } catch (error) {
    self.postMessage({ number, error: error.message });
  }
};
