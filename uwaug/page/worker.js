// Beside the page, so that it never waits: answers each message with one of the same number.

let tables, scene;

const bytesOfText = text => Uint8Array.from(atob(text), letter => letter.charCodeAt(0));

async function distancesOf({ pixels, width, height, from, seed }) {
  if (from.metres) return new Float32Array(width * height).fill(from.metres);
  if (from.embedded) {
    const { packed, near, step } = from.embedded; // codes in equal steps of the logarithm, each less the one before
    const codes = new Uint16Array((await inflated([bytesOfText(packed)])).buffer);
    for (let i = 1; i < codes.length; i++) codes[i] += codes[i - 1];
    return Float32Array.from(codes, code => code === 65535 ? Infinity : near * Math.exp(code * step));
  }
  if (!from.file) return madeUp(pixels, width, height, randomOf(seed), tables.cue);
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
  open: message => {
    const { cue } = message.tables;
    tables = { ...message.tables, cue: { ...cue, layers: layersOf(cue.shapes, bytesOfText(cue.weights)) } };
  },
  async scene(message, tell) {
    const { pixels, width, height } = message, distance = await distancesOf(message);
    scene = null; // makes room
    scene = sceneOf(pixels, distance, width, height, tables, tell);
    return { distance };
  },
  form({ settings, terms, step }) {
    const water = waterTable(scene, settings, tables), gain = gainOf(scene, water, settings, tables);
    const lights = Array.from({ length: ENTRIES + 1 }, (_, place) => lightAt(place, water, scene.K, tables));
    const { table, ...said } = water;
    const { near, step: stepOfPlace } = scene;
    return { ...form(scene, water, gain, settings, { step, terms }, tables), ...said, lights, rise: water.rise, near, stepOfPlace };
  },
  draw({ settings, held, seed, step }) {
    const drawn = drawnBy(randomOf(seed), settings, held, tables.draws);
    return { ...answers.form({ settings: drawn, step }), drawn };
  },
  /** `small`: the scene's picture and the photograph as `uwaug.like` looks at them. */
  like({ small: { pixels, width, height }, photograph, settings, held, seed }, tell) {
    const shrink = scene.width / width, metres = Float32Array.from({ length: width * height }, (_, p) => {
      const row = Math.floor((Math.floor(p / width) + 0.5) * shrink), column = Math.floor((p % width + 0.5) * shrink);
      const place = scene.place[Math.min(row, scene.height - 1) * scene.width + Math.min(column, scene.width - 1)];
      return place === ENTRIES ? Infinity : scene.near * Math.exp(place * scene.step);
    });
    return nearestDraw(sceneOf(pixels, metres, width, height, tables), photograph, settings, held, randomOf(seed), tables, tell);
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
