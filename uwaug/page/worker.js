// Beside the page, so that it never waits: answers each message with one of the same number.
let tables, scene;

const answers = {
  open: message => { tables = message.tables; },
  scene({ pixels, distance, width, height }, tell) {
    scene = null; // what is not needed any more makes room
    scene = sceneOf(pixels, distance, width, height, tables, tell);
    return { median: scene.median };
  },
  form({ settings, terms, step }) {
    const water = waterTable(scene, settings, tables), gain = gainOf(scene, water, settings, tables);
    const picture = form(scene, water, gain, settings, { step, terms }, tables);
    const { contents, depth, scale, visibility, veil, reached } = water, { near, K, step: stepOfPlace } = scene;
    const left = Float32Array.from({ length: ENTRIES + 1 }, (_, place) => contrastLeft(place, water, K, tables));
    return { ...picture, contents, depth, scale, visibility, veil, reached, left, near, stepOfPlace };
  },
  /** What `RandomUnderwater` draws by default, but for the settings that are held. */
  draw({ settings, held, seed, step }) {
    const random = randomOf(seed), { waters, contents, severities, ...ranges } = tables.draws, drawn = { ...settings };
    const between = ([low, high], share, log) => log ? low * (high / low) ** share : low + (high - low) * share;
    const water = waters[Math.floor(random() * waters.length)];
    if (!held.includes("water")) Object.assign(drawn, { water, share: 0 });
    if (!held.includes("water")) for (const name in contents) drawn[name] = between(contents[name], random(), true);
    for (const name in ranges) {
      const share = random();
      if (Array.isArray(ranges[name]) && !held.includes(name)) drawn[name] = between(ranges[name], share, name === "contrast");
    }
    return { ...answers.form({ settings: drawn, terms: [1, 1, 1], step }), drawn };
  },
};

self.onmessage = ({ data: { number, what, ...message } }) => {
  const tell = share => self.postMessage({ number, share });
  try {
    const answer = answers[what](message, tell) ?? {};
    self.postMessage({ number, answer }, answer.pixels ? [answer.pixels.buffer] : []);
  } catch (error) {
    self.postMessage({ number, error: error.message });
  }
};
