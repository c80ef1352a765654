// What is on the page: settings in and out, one picture at a time.

const $ = id => document.getElementById(id), parsed = id => JSON.parse($(id).textContent);
const tables = parsed("tables"), embedded = parsed("scene"), { draws } = tables, TYPES = Object.keys(tables.waters);
const percent = value => `${Math.round(100 * value)} %`, rounded = value => Number(value.toPrecision(6));

// name: place, label, value, least, most, as shown, what else it is
const SLIDERS = {
  chlorophyll: ["contents", "Algae (chlorophyll)", 3, 0.1, 50, v => `${v.toPrecision(2)} mg/m³`, "log"],
  cdom: ["contents", "Yellow stain (dissolved matter)", 0.5, 0.02, 5, v => `${v.toPrecision(2)} /m at 440 nm`, "log"],
  minerals: ["contents", "Silt (minerals)", 0.5, 0.02, 20, v => `${v.toPrecision(2)} g/m³`, "log"],
  share: ["mixture", "How much of it", 0, 0, 1, percent],
  contrast: ["water-controls", "Clarity: contrast left midway", 0.4, 0.02, 0.95, percent, "drawn"],
  vertical_depth: ["water-controls", "Depth", 3, 0, 30, v => `${v.toFixed(1)} m`, "drawn"],
  pitch: ["water-controls", "Camera looks up", 0, -60, 60, v => `${v.toFixed(0)}°`, "drawn"],
  times: ["distances", "Stretch the distances", 1, 0.1, 10, v => `× ${v.toPrecision(2)}`, "log"],
  exposure: ["camera-controls", "Brightness", 0, -3, 3, v => `${v.toFixed(1)} stops`, "drawn"],
  white_balance: ["camera-controls", "White balance", 0.3, 0, 1, percent, "drawn"],
  saturation: ["camera-controls", "Colourfulness", 1, 0, 2, percent, "drawn"],
  tone: ["camera-controls", "Contrast of the camera", 1.2, 0.5, 2.5, v => `× ${v.toFixed(2)}`, "drawn"],
  gamut: ["camera-controls", "Glaring colours tamed", 0.85, 0, 1, percent, "drawn"],
  color_matrix: ["camera-controls", "Colour correction (matrix)", 0.4, 0, 1, percent, "drawn"],
  full_well: ["camera-controls", "Noise: light a pixel holds", 1e5, 100, 1e5,
    v => v >= 1e5 ? "no noise" : `${+v.toPrecision(2)} electrons`, "log"],
  read_noise: ["camera-controls", "Noise in the dark", 3, 0, 20, v => `${v.toFixed(1)} electrons`],
  g: ["scattering-controls", "Lost sideways (g)", draws.g, 0, 0.4, v => v.toFixed(3)],
  mu: ["scattering-controls", "Brightness of the veil (μ)", 0.03, 0, 0.6, v => v.toFixed(3), "drawn"],
  blur: ["scattering-controls", "Blur", 1, 0, 3, v => `× ${v.toFixed(2)}`],
};
const WORDS = { ...tables.words, contents: "a mix of your own" };
const PRESETS = {
  reef: { contrast: 0.6, vertical_depth: 8 }, harbour: { contrast: 0.2, vertical_depth: 5 },
  lake: { vertical_depth: 4 }, fjord: { vertical_depth: 12 },
};
const DRAWN = ["water", ...Object.keys(SLIDERS).filter(name => SLIDERS[name][6] === "drawn")];
const DEFAULTS = { water: embedded.water ?? "3C", other: "", nature: 0 };
for (const [name, [, , value]] of Object.entries(SLIDERS)) DEFAULTS[name] = value;
const state = { ...DEFAULTS };
const settingsOf = ({ nature, contrast, full_well: well, ...rest }) =>
  ({ ...rest, contrast: nature ? null : contrast, full_well: well >= 1e5 ? 0 : well });

function readAddress() {
  const said = new URLSearchParams(location.hash.slice(1)), words = { water: [...TYPES, "contents"], other: TYPES };
  for (const name in DEFAULTS) {
    const text = said.get(name), [, , , low, high] = SLIDERS[name] ?? [0, 0, 0, 0, 1];
    if (!text || (words[name] ? !words[name].includes(text) : !Number.isFinite(+text))) state[name] = DEFAULTS[name];
    else state[name] = words[name] ? text : Math.min(Math.max(+text, low), high);
  }
}

// --- the worker: one question at a time, and of the pictures only the newest waits ------------------
const worker = new Worker(URL.createObjectURL(new Blob([$("worker").textContent])));
const questions = new Map();
let asked = 0, pending = 0, scene, wanted, drawing = [], thumbnails = [], busy = false, shown, settle;
const ask = (what, message, tell) => new Promise((resolve, reject) => {
  questions.set(++asked, { resolve, reject, tell });
  worker.postMessage({ number: asked, what, ...message });
});
worker.onmessage = ({ data: { number, answer, error, share } }) => {
  const question = questions.get(number);
  if (share !== undefined) return question.tell?.(share);
  questions.delete(number);
  if (error === undefined) question.resolve(answer); else question.reject(new Error(error));
};
async function work() {
  if (busy) return;
  busy = true;
  while (scene && (wanted || drawing.length || thumbnails.length)) {
    if (wanted) await picture(wanted); else await (drawing.shift() ?? thumbnails.shift())();
    if (scene) $("view").ariaBusy = String(Boolean(wanted || pending));
  }
  busy = false;
}
async function picture({ step, begun }) {
  wanted = undefined;
  const terms = [...$("terms").querySelectorAll("input")].map(box => +box.checked), { note } = scene;
  const made = await ask("form", { settings: settingsOf(state), terms, step }).catch(error => error);
  $("water-error").textContent = made.pixels ? "" : made.message;
  $("after").hidden = !made.pixels;
  if (!made.pixels) return say("");
  paint($("after"), made);
  shown = { ...made, ms: performance.now() - begun, step };
  const { contents, depth, veil, visibility } = made;
  const said = [`${visibility.toPrecision(2)} m of visibility`];
  if (contents > 0 && contents !== 1) said.push(`${contents.toPrecision(2)} times as much in the water as in nature`);
  if (contents > tables.much) said.push("so much that it is hardly this water any more");
  if (contents === 0) said[0] = "pure water: it leaves no more contrast at these distances";
  if (depth < state.vertical_depth) said.push(`shown ${depth.toFixed(1)} m deep: below, no exposure makes up for the light`);
  if (veil > 1.05) said.push(`the veil far away is ${veil.toPrecision(2)} times as bright as white`);
  say([...said, ...note].filter(Boolean).join("; ") + ` (${shown.ms.toFixed(0)} ms)`);
}
const past = []; // settings, the last of them those that are shown
function changed(dragging) {
  if (!dragging && JSON.stringify(state) !== JSON.stringify(past.at(-1))) past.push({ ...state });
  fill();
  $("view").ariaBusy = "true";
  wanted = { step: dragging && shown?.ms > 60 * shown.step ** 2 ? 2 : 1, begun: performance.now() };
  clearTimeout(settle);
  settle = setTimeout(() => {
    const said = Object.entries(state).filter(([name, value]) => value !== DEFAULTS[name]);
    history.replaceState(null, "", `#${new URLSearchParams(said)}`);
    if (!dragging) thumbnails = smallPictures();
    work();
  }, 500);
  work();
}
function paint(canvas, { pixels, width, height }) {
  Object.assign(canvas, { width, height });
  canvas.getContext("2d").putImageData(new ImageData(pixels, width, height), 0, 0);
}
function say(text, share) {
  $("status").lastElementChild.textContent = text;
  $("progress").hidden = share === undefined;
  $("progress").value = share ?? 0;
}

// --- controls -----------------------------------------------------------------------------------------
const isLog = name => SLIDERS[name][6] === "log";
function toSlider(name) {
  const [, , , low, high] = SLIDERS[name], value = state[name];
  return isLog(name) ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
}
function fromSlider(name, at) {
  const [, , , low, high] = SLIDERS[name];
  return Number((isLog(name) ? low * (high / low) ** at : low + (high - low) * at).toPrecision(3));
}
for (const [name, [place, label]] of Object.entries(SLIDERS)) {
  $(place).insertAdjacentHTML("beforeend", `<div class="control"><label for="${name}">${label}</label><span></span>
    <input type="range" id="${name}" min="0" max="1" step="0.002"></div>`);
  $(name).addEventListener("input", event => { state[name] = fromSlider(name, event.target.valueAsNumber); changed(true); });
  $(name).addEventListener("change", () => changed());
}
for (const name of DRAWN) {
  const hold = `<label class="chip" title="the twelve draws keep it"><input type="checkbox" id="hold-${name}"
    aria-label="hold ${name.replace("_", " ")} in the twelve draws">hold</label>`;
  $(name).closest(".row, .control").insertAdjacentHTML("beforeend", hold);
  $(`hold-${name}`).addEventListener("change", fill);
}
const options = types => types.map(type => new Option(type === "contents" ? WORDS[type] : `${type}: ${WORDS[type]}`, type));
$("water").append(...options([...TYPES, "contents"]));
$("other").append(new Option("nothing", ""), ...options(TYPES));
for (const name in PRESETS) {
  const button = document.createElement("button");
  button.textContent = name;
  const preset = { water: "contents", white_balance: 0, ...tables.places[name], ...PRESETS[name] };
  button.addEventListener("click", () => { Object.assign(state, DEFAULTS, { times: state.times }, preset); changed(); });
  $("presets").append(button);
}
$("undo").addEventListener("click", () => { past.pop(); Object.assign(state, past.at(-1)); changed(); });
$("reset").addEventListener("click", () => { Object.assign(state, DEFAULTS); changed(); });
$("water").addEventListener("change", event => { state.water = event.target.value; changed(); });
$("other").addEventListener("change", event => { state.other = event.target.value; state.share ||= 0.3; changed(); });
$("nature").addEventListener("change", event => { state.nature = +event.target.checked; changed(); });
$("terms").addEventListener("change", () => changed());
function fill() {
  for (const [name, [, , , , , text]] of Object.entries(SLIDERS)) {
    $(name).value = toSlider(name);
    $(name).previousElementSibling.textContent = $(name).ariaValueText = text(state[name]);
  }
  for (const name of ["water", "other"]) $(name).value = state[name];
  $("nature").checked = Boolean(state.nature);
  $("undo").disabled = past.length < 2;
  const hide = (element, hidden) => { element.hidden = Boolean(hidden); };
  hide($("contents"), state.water !== "contents");
  hide($("mixture"), state.water === "contents");
  hide($("share").parentElement, !state.other);
  hide($("contrast").parentElement, state.nature);
  hide($("read_noise").parentElement, state.full_well >= 1e5);
  const holds = own.map ? $("holds").value : "made-up";
  for (const row of document.querySelectorAll("[data-of]")) hide(row, !row.dataset.of.includes(holds));
  const asRow = Boolean(state.nature) !== $("same").checked;
  for (const tile of $("waters").children) tile.ariaPressed = String(asRow && tile.dataset.value === state.water);
  for (const tile of $("severities").children) tile.ariaPressed = String(!state.nature && +tile.dataset.value === state.contrast);
  const { unsaved } = scene?.files ?? embedded.files, isMap = $("left").value === "depths", { near, far } = scene ?? {};
  const [yellow, violet] = [near, far].map(z => (z * state.times).toPrecision(2)), made = scene?.files.guessed ? ", made up" : "";
  hide($("depths"), !isMap);
  $("left-tag").textContent = isMap && scene ? `yellow ${yellow} m, violet ${violet} m${made}` : "in air";
  hide($("unsaved"), !unsaved);
  hide($("save-scene"), !unsaved);
  $("code").textContent = code();
}

// --- small pictures -----------------------------------------------------------------------------------
function tile(parent, label, value, choose) {
  const button = document.createElement("button");
  button.append(document.createElement("canvas"), label);
  button.dataset.value = value;
  button.addEventListener("click", choose);
  $(parent).append(button);
  return button;
}
async function fillTile(button, what, message, width) {
  const made = await ask(what, { ...message, step: Math.ceil(scene.width / width) }).catch(error => error);
  button.title = made.message ?? "";
  button.disabled = !made.pixels;
  if (made.pixels) paint(button.firstChild, made);
  return made;
}
for (const type of TYPES) tile("waters", type, type, () => {
  Object.assign(state, { water: type, other: "", nature: +!$("same").checked });
  changed();
}).lastChild.title = WORDS[type];
$("same").addEventListener("change", () => {
  $("as").textContent = $("same").checked ? "all of the same clarity" : "as clear as in nature";
  changed();
});
draws.severities.forEach((contrast, i) => tile("severities", `${i + 1}: ${percent(contrast)} left`, contrast, () => {
  Object.assign(state, { contrast, nature: 0 });
  changed();
}));
const smallPictures = () => [...$("waters").children, ...$("severities").children].map(button => () => {
  const { value } = button.dataset, alone = button.parentElement.id === "waters";
  const kept = $("same").checked ? state.contrast : null; // as in nature
  const settings = { ...settingsOf(state), ...(alone ? { water: value, other: "", contrast: kept } : { contrast: +value }) };
  return fillTile(button, "form", { settings }, 200);
});
let seed = 0, tries = 0;
const heldNames = () => DRAWN.filter(name => $(`hold-${name}`).checked || (name === "contrast" && state.nature));
function use({ contrast, full_well, ...drawn }) {
  Object.assign(state, drawn, contrast === null ? { nature: 1 } : { nature: 0, contrast });
  changed();
}
function draw() {
  const held = heldNames();
  for (let i = 0; i < 12; i++) {
    const button = $("draws").children[i] ?? tile("draws", "", i, () => use(button.drawn));
    button.disabled = true;
    drawing.push(async () => {
      const { drawn, depth } = await fillTile(button, "draw", { settings: settingsOf(state), held, seed: seed++ }, 300);
      if (!drawn) return;
      const left = drawn.contrast === null ? "as in nature" : percent(drawn.contrast);
      button.drawn = drawn;
      button.lastChild.textContent = `${drawn.water === "contents" ? "mix" : drawn.water}, ${left}, ${depth.toFixed(1)} m`;
    });
  }
  work();
}
$("draw").addEventListener("click", draw);

// --- before and after, and what is under the pointer --------------------------------------------------
function split(at) {
  const share = Math.min(Math.max(at, 0), 100);
  $("view").ariaValueNow = String(Math.round(share));
  $("view").ariaValueText = `${Math.round(share)} % in air`;
  for (const id of ["before", "depths"]) $(id).style.clipPath = `inset(0 ${100 - share}% 0 0)`;
  $("split").style.left = `${share}%`;
}
function pointed(event) {
  const box = $("view").getBoundingClientRect(), u = (event.clientX - box.left) / box.width, v = (event.clientY - box.top) / box.height;
  if (event.buttons) split(100 * u);
  if (!scene || !shown || !(u >= 0 && u < 1 && v >= 0 && v < 1)) return;
  const place = Math.floor(v * scene.height) * scene.width + Math.floor(u * scene.width), z = scene.distance[place];
  const last = shown.lights.length - 1, entry = Math.round(Math.log(z / shown.near) / shown.stepOfPlace);
  const [detail, surface, veil] = shown.lights[z === Infinity ? last : Math.min(entry, last - 1)];
  const left = detail > 0 ? detail / (surface + shown.rise[place] * veil) : 0;
  const metres = z === Infinity ? "open water" : `${(z * state.times).toPrecision(3)} m`;
  $("readout").innerHTML = `<b>${metres}</b> away, <b>${(100 * left).toPrecision(2)} %</b> of fine contrast left
    <span>(--min-contrast ${left.toPrecision(2)})</span>`;
}
$("view").addEventListener("pointerdown", event => { $("view").setPointerCapture(event.pointerId); pointed(event); });
$("view").addEventListener("pointermove", pointed);
$("view").addEventListener("keydown", event => {
  const by = { ArrowLeft: -2, ArrowDown: -2, PageDown: -20, Home: -100, ArrowRight: 2, ArrowUp: 2, PageUp: 20, End: 100 }[event.key];
  if (by) { split(Number($("view").ariaValueNow) + by); event.preventDefault(); }
});

// --- pictures -----------------------------------------------------------------------------------------
const own = {}; // files that were chosen
function pixelsOf(picture, width, height) {
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.imageSmoothingQuality = "high";
  context.drawImage(picture, 0, 0, width, height);
  return { pixels: context.getImageData(0, 0, width, height).data, width, height };
}
const VIRIDIS = [[253, 231, 37], [94, 201, 98], [33, 145, 140], [59, 82, 139], [68, 1, 84]]; // near to far
function coloured({ distance, width, height, near, far }) {
  const pixels = new Uint8ClampedArray(4 * width * height).fill(255);
  distance.forEach((z, p) => { // open water as what is farthest
    const at = 4 * Math.min(Math.log(z / near) / Math.max(Math.log(far / near), 1e-9), 1), i = Math.min(Math.floor(at), 3);
    for (let c = 0; c < 3; c++) pixels[4 * p + c] = VIRIDIS[i][c] + (at - i) * (VIRIDIS[i + 1][c] - VIRIDIS[i][c]);
  });
  return { pixels, width, height };
}
/** One height for what stands side by side. */
function arrange() {
  const image = $("reference").firstElementChild, aspect = $("after").width / $("after").height;
  const other = $("reference").hidden ? 0 : image.naturalWidth / image.naturalHeight;
  $("view").style.cssText = `flex-grow: ${aspect}; aspect-ratio: ${aspect}`;
  $("reference").style.cssText = `flex-grow: ${other}; aspect-ratio: ${other}`;
  $("stage").style.setProperty("--aspect", aspect + other);
}
async function setScene(bitmap, from, files, note) {
  const [before, whole] = [scene, [bitmap.width, bitmap.height]];
  const shrink = Math.min(1, Math.sqrt(tables.pixels / (whole[0] * whole[1])));
  const [width, height] = whole.map(side => Math.max(1, Math.round(side * shrink)));
  const { pixels } = pixelsOf(bitmap, width, height);
  bitmap.close();
  scene = undefined;
  [drawing, thumbnails] = [[], []];
  $("view").ariaBusy = "true";
  try {
    const message = { pixels, width, height, from: { ...from, whole }, seed: seed++ };
    const { distance } = await ask("scene", message, share => say("making the blurs of the picture", share));
    if (shrink < 1) note.push(`shown at ${width}×${height} of ${whole[0]}×${whole[1]} px`);
    const finite = distance.filter(z => z < Infinity).sort(), [near, far] = [finite[0] ?? 1, finite.at(-1) ?? 1];
    scene = { width, height, distance, near, far, note, files: { width: files.unsaved ? width : whole[0], ...files } };
  } catch (error) {
    scene = before;
    throw error;
  } finally {
    if (scene) { // also where the one before stays
      changed();
      draw();
    }
  }
  paint($("before"), { pixels, width, height });
  paint($("depths"), coloured(scene));
  Object.assign($("after"), { width, height });
  arrange();
  split(50);
}
async function take(files) {
  $("files-error").textContent = "";
  const isMap = ({ name, bytes }) => name.endsWith(".npy") || (/\.png$/i.test(name) && bytes[25] === 0);
  const read = await Promise.all(files.map(async file => ({ name: file.name, file, bytes: new Uint8Array(await file.arrayBuffer()) })));
  const maps = read.filter(isMap), pictures = read.filter(one => !isMap(one));
  if (!own.picture && read.length === 1 && !read[0].name.endsWith(".npy")) pictures.push(...maps.splice(0)); // a grey picture
  if (pictures.length > 1 || maps.length > 1 || !(pictures.length || own.picture)) {
    const got = `got ${pictures.length} and ${maps.length}`;
    throw new Error(`choose one picture in colour, and one map (grey PNG of 8 or 16 bits, or .npy) if there is one: ${got}`);
  }
  if (pictures.length) Object.assign(own, { picture: pictures[0], map: undefined });
  if (maps.length) own.map = maps[0];
  await useOwn();
}
async function useOwn() {
  const { picture: { name, file, bytes }, map } = own, stem = name.replace(/\.\w+$/, ""), without = $("without").value;
  const undecoded = () => { throw new Error(`${name} cannot be decoded as a picture`); };
  const bitmap = await createImageBitmap(file, { colorSpaceConversion: "none" }).catch(undecoded);
  const said = { unit: +$("unit").value, near: +$("near").value, far: +$("far").value };
  Object.assign(said, { holds: map ? $("holds").value : "metres", holes: map ? $("holes").value : "error" });
  const taken = /\.jpe?g$/i.test(name) || (/\.png$/i.test(name) && bytes[25] !== 3);
  const note = taken ? [] : ["uwaug degrade takes PNG and JPEG, without a palette"];
  if (map) await setScene(bitmap, { file: map.bytes.buffer, npy: map.name.endsWith(".npy"), said }, { picture: name, distance: map.name, ...said }, note);
  else if (without !== "made-up") await setScene(bitmap, { metres: +without }, { ...said, picture: name, distance: without }, note);
  else await setScene(bitmap, {}, { ...said, unit: 1, picture: `${stem}-scene.png`, distance: `${stem}-scene.npy`, unsaved: true, guessed: true }, []);
}
let taking = Promise.resolve(); // one after another
function queued(job) {
  pending++;
  $("view").ariaBusy = "true";
  taking = taking.then(job).catch(error => { $("files-error").textContent = error.message; fill(); }).finally(() => {
    pending--;
    if (scene && !busy && !wanted) $("view").ariaBusy = String(pending > 0);
  });
}
$("files").addEventListener("change", event => { const files = [...event.target.files]; if (files.length) queued(() => take(files)); });
for (const id of ["holds", "unit", "near", "far", "holes", "without"]) {
  $(id).addEventListener("change", () => { fill(); $("files-error").textContent = ""; if (own.picture) queued(useOwn); });
}
for (const kind of ["dragover", "dragleave", "drop"]) addEventListener(kind, event => {
  event.preventDefault();
  $("view").classList.toggle("drop", kind === "dragover");
  if (kind === "drop") { const files = [...event.dataTransfer.files]; queued(() => take(files)); }
});
let real; // {name, bitmap}
$("real").addEventListener("change", async ({ target: { files: [file] } }) => {
  const image = $("reference").firstElementChild;
  URL.revokeObjectURL(image.src);
  real = undefined;
  if (file) {
    image.src = URL.createObjectURL(file);
    const decoded = await image.decode().then(() => true, () => false);
    if (decoded) real = { name: file.name, image };
    $("files-error").textContent = decoded ? "" : `${file.name} cannot be decoded as a picture`;
  }
  $("reference").hidden = $("like").hidden = !real;
  arrange();
  fill();
});
$("like").addEventListener("click", async () => {
  const short = picture => { // as uwaug.like looks at pictures
    const [width, height] = [picture.naturalWidth ?? picture.width, picture.naturalHeight ?? picture.height], scale = 128 / Math.min(width, height);
    return pixelsOf(picture, Math.round(width * scale), Math.round(height * scale));
  };
  const at = scene, message = { small: short($("before")), photograph: short(real.image), settings: settingsOf(state), held: heldNames(), seed: tries++ };
  $("like").disabled = true;
  try {
    const { drawn, away, usual, off } = await ask("like", message, share => say("trying 120 draws", share));
    if (scene !== at) return;
    const still = off.length ? `; it is still ${off.join(", ")}` : "";
    scene.note = [`${away.toFixed(2)} away from the real picture, most draws ${usual.toFixed(2)}: 1 is as much as photographs differ${still}`];
    use(drawn);
  } catch (error) {
    say(error.message);
  } finally {
    $("like").disabled = false;
  }
});

// --- copies -------------------------------------------------------------------------------------------
/** Options of RandomUnderwater, as TOML and JSON hold them; for draws, those that are held. */
function optionsOf(files, everything) {
  const { water, other, share, nature, g, mu, blur, times, full_well, read_noise } = state;
  const options = {}, ofWater = {}, development = {};
  const held = name => everything || $(`hold-${name}`).checked;
  const contents = ["chlorophyll", "cdom", "minerals"].map(name => `${name}=${state[name]}`).join(",");
  const mixture = other && share ? `${rounded(1 - share)}*${water}+${share}*${other}` : water;
  if (held("water")) ofWater.waters = [water === "contents" ? contents : mixture];
  if (held("contrast") || nature) ofWater.contrast = nature ? null : state.contrast;
  if (held("vertical_depth")) ofWater.vertical_depth = state.vertical_depth;
  if (everything) ofWater.field = null;
  if (held("pitch")) options.light = { pitch: state.pitch, ...everything && { share: 0 } };
  if (g !== DEFAULTS.g) ofWater.g = g;
  if (held("mu")) ofWater.mu = mu;
  if (held("color_matrix")) ofWater.color_matrix = state.color_matrix;
  const { scale, exponent } = tables.law;
  if (blur !== 1) ofWater.point_spread = { scale: rounded(scale * blur * files.width), exponent, shape: "exponential" };
  const ofCamera = name => SLIDERS[name]?.[0] === "camera-controls" && name !== "color_matrix";
  for (const name of DRAWN) if (ofCamera(name) && held(name)) development[name] = state[name];
  development.noise = full_well < 1e5 ? { full_well, read_noise } : null;
  if (Object.keys(ofWater).length) options.water = ofWater;
  options.development = development;
  const holes = files.holes === "error" ? {} : { holes: rounded(files.holes * times) || files.holes };
  const near = rounded(files.near * times), far = rounded(files.far * times);
  if (Number.isFinite(+files.distance)) options.distance = rounded(files.distance * times);
  else if (files.holds === "relative") options.distance = { kind: "Relative", near, far, ...holes };
  else if (files.holds === "inverse") options.distance = { kind: "Inverse", near, far, ...holes };
  else if (files.holes !== "error") options.distance = { kind: "Metres", ...holes };
  return options;
}
function toml(value) {
  if (value === null) return '"none"';
  if (Array.isArray(value)) return `[${value.map(toml).join(", ")}]`;
  if (typeof value !== "object") return JSON.stringify(value);
  return `{${Object.entries(value).map(([name, inner]) => `${name} = ${toml(inner)}`).join(", ")}}`;
}
const quoted = text => /^[\w./:=,+-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;
function code() {
  const files = { width: 0, ...embedded.files, ...scene?.files }, language = $("language").value;
  const options = optionsOf(files, language !== "command for draws");
  const map = Number.isFinite(+files.distance) ? null : files.distance;
  const unit = files.holds === "metres" ? rounded(files.unit * state.times) : null;
  if (language === "Python") {
    const plain = JSON.stringify(options, null, 4).replaceAll("null", '"none"');
    const distance = map ? `read_distance(${JSON.stringify(map)}, ${unit ?? "None"})` : "None";
    return ["import uwaug", "from uwaug.files import read_distance, read_picture, write_picture", "",
      `augment = uwaug.RandomUnderwater.from_dict(${plain})`, `image = read_picture(${JSON.stringify(files.picture)})`,
      `distance = ${distance}`, "wet = augment.transform(image, distance, augment.make_params(image))",
      `write_picture("wet.png", wet)`].join("\n");
  }
  const words = [`uwaug degrade ${quoted(files.picture)} --distance ${map ? quoted(map) : options.distance}`];
  if (map && unit && unit !== 1) words.push(`--unit ${unit}`);
  if (!map) delete options.distance;
  const entries = Object.entries(options);
  if (language === "TOML") {
    const lines = entries.map(([name, value]) => `${name} = ${toml(value)}`);
    return [`# ${words.join(" ")} --options this.toml --out wet/`, ...lines].join("\n");
  }
  const { waters, contrast, ...rest } = options.water ?? {}, flat = { ...options };
  delete flat.water;
  for (const [name, value] of Object.entries(rest)) flat[`water.${name}`] = value;
  if (waters) words.push(`--water ${quoted(waters[0])}`);
  if (contrast !== undefined) words.push(`--contrast ${contrast ?? "none"}`);
  for (const [name, value] of Object.entries(flat)) {
    words.push(`--set ${quoted(`${name}=${value === null ? "none" : toml(value)}`)}`);
  }
  const draws = language === "command for draws";
  if (real && draws) words.push(`--like ${quoted(real.name)}`);
  return `${words.join(" ")}${draws ? " --variants 12 --sheet" : ""} --out wet/`;
}
function download(blob, name) {
  const href = URL.createObjectURL(blob);
  Object.assign(document.createElement("a"), { href, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(href), 1000);
}
/** A .npy file of float32. */
function npyOf(values, width, height) {
  const header = `{'descr': '<f4', 'fortran_order': False, 'shape': (${height}, ${width}), }`.padEnd(117) + "\n";
  return new Blob([new Uint8Array([0x93, 78, 85, 77, 80, 89, 1, 0, 118, 0]), header, values]);
}
for (const id of ["language", "left"]) $(id).addEventListener("change", fill);
$("copy").addEventListener("click", async () => {
  try {
    await navigator.clipboard.writeText(code());
    say("copied");
  } catch {
    getSelection().selectAllChildren($("code"));
    say("the browser does not let pages copy here: it is selected, copy by Ctrl+C");
  }
});
$("save").addEventListener("click", () => { if (shown) $("after").toBlob(blob => download(blob, "wet.png")); });
$("save-scene").addEventListener("click", () => {
  if (!scene) return;
  const { files: { picture, distance }, width, height } = scene;
  $("before").toBlob(blob => download(blob, picture));
  download(npyOf(scene.distance, width, height), distance);
});

// --- begin --------------------------------------------------------------------------------------------
readAddress();
fill();
addEventListener("hashchange", () => { readAddress(); changed(); });
await ask("open", { tables });
const picked = Uint8Array.from(atob(embedded.picture), letter => letter.charCodeAt(0));
const first = await createImageBitmap(new Blob([picked]), { colorSpaceConversion: "none" });
const { distance: packed, near, step } = embedded;
await setScene(first, { embedded: { packed, near, step } }, embedded.files, []);
