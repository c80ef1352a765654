// What is on the page: settings in and out, one picture at a time.

const $ = id => document.getElementById(id), parsed = id => JSON.parse($(id).textContent);
const tables = parsed("tables"), embedded = parsed("scene"), { draws } = tables, TYPES = Object.keys(tables.waters);
const percent = value => `${Math.round(100 * value)} %`, rounded = value => Number(value.toPrecision(6)), number = digits => value => value.toFixed(digits), MOST = 1.05e6;

// name: fieldset, label, least, most, as shown, whether the slider is logarithmic
const SLIDERS = {
  share: ["water", "Share of the other", 0, 1, percent],
  chlorophyll: ["water", "Chlorophyll", 0.1, 50, v => `${v.toPrecision(2)} mg/m³`, true],
  cdom: ["water", "Dissolved organic matter", 0.02, 5, v => `${v.toPrecision(2)} /m at 440 nm`, true],
  minerals: ["water", "Minerals", 0.02, 20, v => `${v.toPrecision(2)} g/m³`, true],
  contrast: ["water", "Contrast left at the median distance", 0.02, 0.95, percent],
  depth: ["water", "Depth below the surface", 0, 30, v => `${v.toFixed(1)} m`],
  times: ["water", "Distances times", 0.1, 10, v => `× ${v.toPrecision(2)}`, true],
  exposure: ["camera", "Exposure, from the metered one", -3, 3, v => `${v.toFixed(1)} stops`],
  whiteBalance: ["camera", "White balance", 0, 1, percent],
  saturation: ["camera", "Saturation", 0, 2, percent],
  gamut: ["camera", "Gamut compression", 0, 1, percent],
  tone: ["camera", "Tone: contrast about mid-grey", 0.5, 2.5, v => `${v.toFixed(2)} stops a stop`],
  colorMatrix: ["camera", "Colour matrix of the camera", 0, 1, percent],
  fullWell: ["camera", "Noise: full well of a pixel", 100, 1e5, v => v >= 1e5 ? "no noise" : `${v.toPrecision(2)} electrons`, true],
  readNoise: ["camera", "Noise of reading", 0, 20, v => `${v.toFixed(1)} electrons`],
  g: ["scattering", "g: scattered out of the line of sight", 0, 0.4, number(3)],
  mu: ["scattering", "μ: scattered towards the camera", 0, 0.6, number(3)],
  blur: ["scattering", "Width of the blur", 0, 3, v => `× ${v.toFixed(2)}`],
};
const state = {
  water: embedded.water ?? "3C", other: "", share: 0, chlorophyll: 3, cdom: 0.5, minerals: 0.5, contrast: 0.4, nature: 0, depth: 3, times: 1, exposure: 0,
  whiteBalance: 0.3, saturation: 1, gamut: 0.85, tone: 1.2, colorMatrix: 0.4, fullWell: 1e5, readNoise: 3, g: draws.g, mu: rounded(1.5 * draws.g), blur: 1,
};
const DEFAULTS = { ...state }, DRAWN = ["water", "contrast", "depth", "exposure", "whiteBalance", "saturation", "gamut", "tone", "colorMatrix"];
for (const [name, text] of new URLSearchParams(location.hash.slice(1))) {
  if (typeof state[name] === "string") state[name] = [...TYPES, "contents", ""].includes(text) ? text : state[name];
  else if (name in state && Number.isFinite(+text)) state[name] = Math.min(Math.max(+text, SLIDERS[name]?.[2] ?? 0), SLIDERS[name]?.[3] ?? 1);
}
const settingsOf = ({ nature, ...rest }) => ({ ...rest, contrast: nature ? null : rest.contrast, fullWell: rest.fullWell >= 1e5 ? 0 : rest.fullWell });

// --- the worker: one question at a time, and of the pictures only the newest waits ------------------
const worker = new Worker(URL.createObjectURL(new Blob([$("worker").textContent])));
const asked = new Map();
const ask = (what, message, tell) => new Promise((resolve, reject) => {
  asked.set(asked.last = (asked.last ?? 0) + 1, { resolve, reject, tell });
  worker.postMessage({ number: asked.last, what, ...message });
});
worker.onmessage = ({ data: { number, answer, error, share } }) => {
  const question = asked.get(number);
  if (share !== undefined) return question.tell?.(share);
  asked.delete(number);
  if (error === undefined) question.resolve(answer); else question.reject(new Error(error));
};
let scene, wanted, drawing = [], thumbnails = [], busy = false, shown, settle;
async function work() {
  if (busy || !scene) return;
  for (busy = true; wanted || drawing.length || thumbnails.length;) {
    const job = wanted ? () => picture(wanted) : drawing.shift() ?? thumbnails.shift();
    await job().catch(error => { $("water-error").textContent = error.message; });
    $("view").ariaBusy = String(Boolean(wanted));
  }
  busy = false;
}
async function picture({ step, begun }) {
  wanted = undefined;
  const terms = [...$("terms").querySelectorAll("input")].map(box => +box.checked);
  const made = await ask("form", { settings: settingsOf(state), terms, step });
  paint($("after"), made);
  shown = { ...made, ms: performance.now() - begun, step };
  $("water-error").textContent = "";
  const said = [`${made.visibility.toPrecision(2)} m of visibility, ${made.contents.toPrecision(2)} times what is in this water`];
  if (made.contents === 0) said[0] = "pure water: it leaves no more contrast at these distances";
  if (made.scale !== 1) said.push(`distances × ${made.scale.toPrecision(2)}, to between ${tables.sizes.nearest} and ${tables.sizes.farthest} m`);
  if (made.depth < state.depth) said.push(`shown ${made.depth.toFixed(1)} m deep: below, no exposure makes up for the light`);
  if (made.veil > 1.05) said.push(`the veil far away is ${made.veil.toPrecision(2)} times as bright as white`);
  say([...said, scene.note].filter(Boolean).join("; ") + ` (${shown.ms.toFixed(0)} ms)`);
}
function changed(dragging) {
  fill();
  $("view").ariaBusy = "true";
  wanted = { step: dragging && shown?.ms > 60 * shown.step ** 2 ? 2 : 1, begun: performance.now() };
  clearTimeout(settle);
  if (!dragging) settle = setTimeout(() => { thumbnails = thumbnailsNow(); work(); }, 500);
  work();
}
const paint = (canvas, { pixels, width, height }) => {
  Object.assign(canvas, { width, height });
  canvas.getContext("2d").putImageData(new ImageData(pixels, width, height), 0, 0);
};
const say = (text, share) => {
  $("status").lastElementChild.textContent = text;
  $("progress").hidden = share === undefined;
  $("progress").value = share ?? 0;
};

// --- controls -----------------------------------------------------------------------------------------
const toSlider = (name, value) => { const [, , low, high, , log] = SLIDERS[name]; return log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low); };
const fromSlider = (name, at) => { const [, , low, high, , log] = SLIDERS[name]; return Number((log ? low * (high / low) ** at : low + (high - low) * at).toPrecision(3)); };
for (const [name, [group, label]] of Object.entries(SLIDERS)) {
  const control = document.createElement("div");
  control.className = "control";
  control.dataset.name = name;
  control.innerHTML = `<label for="${name}">${label}</label><output for="${name}"></output><input type="range" id="${name}" min="0" max="1" step="0.002">`;
  $(`${group}-controls`).append(control);
  $(name).addEventListener("input", event => { state[name] = fromSlider(name, event.target.valueAsNumber); changed(true); });
  $(name).addEventListener("change", () => changed());
}
for (const name of DRAWN) $(name).closest(".row, .control").insertAdjacentHTML("beforeend", `<label class="hold" title="Held in the twelve draws"><input type="checkbox" id="hold-${name}">hold</label>`);
$("water").append(...TYPES.map(type => new Option(`Jerlov ${type}`, type)), new Option("of contents", "contents"));
$("other").append(new Option("nothing", ""), ...TYPES.map(type => new Option(`Jerlov ${type}`, type)));
for (const name of ["water", "other"]) $(name).addEventListener("change", event => { state[name] = event.target.value; if (name === "other") state.share ||= 0.3; changed(); });
$("nature").addEventListener("change", event => { state.nature = +event.target.checked; changed(); });
$("terms").addEventListener("change", () => changed());
$("camera-controls").addEventListener("change", () => fill());
function fill() {
  for (const [name, [, , , , text]] of Object.entries(SLIDERS)) {
    $(name).value = toSlider(name, state[name]);
    $(name).previousElementSibling.textContent = $(name).ariaValueText = text(state[name]);
  }
  for (const name of ["water", "other"]) $(name).value = state[name];
  $("nature").checked = Boolean(state.nature);
  const contents = state.water === "contents", hidden = { share: contents || !state.other, chlorophyll: !contents, cdom: !contents, minerals: !contents, contrast: state.nature, readNoise: state.fullWell >= 1e5 };
  for (const [name, hide] of Object.entries(hidden)) $(name).parentElement.hidden = Boolean(hide);
  $("other").parentElement.hidden = contents;
  for (const row of $("scene-controls").querySelectorAll("[data-of]")) row.hidden = !row.dataset.of.includes($("holds").value);
  for (const button of $("waters").children) button.ariaPressed = String(button.dataset.value === state.water);
  for (const button of $("severities").children) button.ariaPressed = String(!state.nature && Number(button.dataset.value) === state.contrast);
  $("code").textContent = code();
  const said = Object.entries(state).filter(([name, value]) => value !== DEFAULTS[name]);
  history.replaceState(null, "", `#${new URLSearchParams(said)}`);
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
for (const type of TYPES) tile("waters", type, type, () => { state.water = type; state.share = 0; state.other = ""; changed(); });
draws.severities.forEach((contrast, i) => tile("severities", `${i + 1}: ${percent(contrast)} left`, contrast, () => { state.contrast = contrast; state.nature = 0; changed(); }));
const thumbnailsNow = () => [["waters", value => ({ water: value, share: 0 })], ["severities", value => ({ contrast: Number(value) })]].flatMap(([strip, setting]) =>
  [...$(strip).children].map(button => async () => {
    const settings = { ...settingsOf(state), ...setting(button.dataset.value) };
    paint(button.firstChild, await ask("form", { settings, terms: [1, 1, 1], step: Math.ceil(scene.width / 200) }));
  }));
let seed = 1;
$("draw").addEventListener("click", () => {
  const held = DRAWN.filter(name => $(`hold-${name}`).checked), tiles = $("draws").children;
  if (state.nature) held.push("contrast");
  for (let i = 0; i < 12; i++) {
    const button = tiles[i] ?? tile("draws", "", i, () => {
      Object.assign(state, button.drawn, { nature: +(button.drawn.contrast === null), contrast: button.drawn.contrast ?? state.contrast, fullWell: state.fullWell });
      changed();
    });
    drawing.push(async () => {
      const made = await ask("draw", { settings: settingsOf(state), held, seed: seed++, step: Math.ceil(scene.width / 300) });
      button.drawn = made.drawn;
      button.lastChild.textContent = `${made.drawn.water}, ${made.drawn.contrast === null ? "as in nature" : percent(made.drawn.contrast)}, ${made.depth.toFixed(1)} m deep`;
      paint(button.firstChild, made);
    });
  }
  work();
});

// --- before and after, and what is under the pointer --------------------------------------------------
function split(at) {
  const share = Math.min(Math.max(at, 0), 100);
  $("view").ariaValueNow = String(Math.round(share));
  $("before").style.clipPath = `inset(0 ${100 - share}% 0 0)`;
  $("split").style.left = `${share}%`;
}
const placeOf = (event, box = $("after").getBoundingClientRect()) => [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
$("view").addEventListener("pointerdown", event => { $("view").setPointerCapture(event.pointerId); split(100 * placeOf(event)[0]); });
$("view").addEventListener("pointermove", event => {
  const [u, v] = placeOf(event);
  if (event.buttons) split(100 * u);
  if (!shown || !(u >= 0 && u < 1 && v >= 0 && v < 1)) return;
  const z = scene.distance[Math.floor(v * scene.height) * scene.width + Math.floor(u * scene.width)], last = shown.left.length - 1;
  const entry = z === Infinity ? last : Math.min(Math.round(Math.log(z / shown.near) / shown.stepOfPlace), last - 1);
  const metres = z === Infinity ? "open water" : `${(z * state.times).toPrecision(3)} m`;
  $("readout").innerHTML = `<b>${metres}</b> away, <b>${(100 * shown.left[entry]).toPrecision(2)} %</b> of fine contrast left <span>(--min-contrast ${shown.left[entry].toPrecision(2)})</span>`;
});
$("view").addEventListener("keydown", event => {
  const by = { ArrowLeft: -2, ArrowRight: 2, Home: -100, End: 100 }[event.key];
  if (by) { split(Number($("view").ariaValueNow) + by); event.preventDefault(); }
});

// --- pictures -----------------------------------------------------------------------------------------
async function setScene(bitmap, mapFor, files) {
  const shrink = Math.min(1, Math.sqrt(MOST / (bitmap.width * bitmap.height)));
  const width = Math.max(1, Math.round(bitmap.width * shrink)), height = Math.max(1, Math.round(bitmap.height * shrink)), canvas = document.createElement("canvas");
  Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.imageSmoothingQuality = "high";
  context.drawImage(bitmap, 0, 0, width, height);
  const { data } = context.getImageData(0, 0, width, height), distance = mapFor(data, width, height);
  paint($("before"), { pixels: data, width, height });
  Object.assign($("after"), { width, height });
  scene = null;
  const began = { width, height, distance, files: { width: bitmap.width, ...files }, note: shrink < 1 ? `shown at ${width}×${height} of ${bitmap.width}×${bitmap.height} px` : "" };
  await ask("scene", { pixels: data, distance, width, height }, share => say("making the blurs of the picture", share));
  scene = began;
  split(50);
  changed();
}
const chosen = () => ({ holds: $("holds").value, unit: +$("unit").value, near: +$("near").value, far: +$("far").value, holes: $("holes").value });
async function take(files) {
  $("files-error").textContent = "";
  $("view").ariaBusy = "true";
  const maps = [], pictures = [];
  for (const file of files) {
    const buffer = await file.arrayBuffer(), npy = file.name.endsWith(".npy");
    const grey = file.type === "image/png" && new Uint8Array(buffer)[25] === 0;
    if (npy || grey) maps.push({ ...(npy ? readNpy(buffer) : await readPng(buffer)), name: file.name, npy }); else pictures.push(file);
  }
  if (pictures.length !== 1 || maps.length > 1) throw new Error(`choose one picture in colour and at most one map, got ${pictures.length} and ${maps.length}`);
  const bitmap = await createImageBitmap(pictures[0], { colorSpaceConversion: "none" }).catch(() => { throw new Error(`${pictures[0].name} cannot be decoded as a picture`); });
  const [map] = maps, without = $("without").value, { holds, unit, near, far, holes } = chosen();
  if (map && (map.width !== bitmap.width || map.height !== bitmap.height)) throw new Error(`the map is ${map.width}×${map.height} px, the picture ${bitmap.width}×${bitmap.height}`);
  if (map && holds === "metres" && map.most === 255) throw new Error("8 bits are too few for metres: is the map relative or inverse?");
  if (map && holds !== "metres" && !(near > 0 && near < far)) throw new Error("nearest must be above 0 m and below farthest");
  const mapFor = (data, width, height) => {
    if (!map) return without === "made-up" ? madeUp(data, width, height, Math.random) : new Float32Array(width * height).fill(Number(without));
    const metres = metresOf(map, chosen());
    return Float32Array.from({ length: width * height }, (_, i) => // nearest: a mean across an edge is the distance of nothing
      metres[Math.floor((Math.floor(i / width) + 0.5) * map.height / height) * map.width + Math.floor((i % width + 0.5) * map.width / width)]);
  };
  const distance = map ? map.name : without === "made-up" ? `${pictures[0].name.replace(/\.\w+$/, "")}-distance.npy` : without;
  await setScene(bitmap, mapFor, { picture: pictures[0].name, distance, unit: map ? unit : 1, ...(map ? { holds, near, far, holes } : { holds: "metres", holes: "error" }) });
}
let own = [], taking = Promise.resolve(); // one after another
function taken(files) {
  own = [...files];
  if (own.length) taking = taking.then(() => take(own)).catch(error => { $("files-error").textContent = error.message; $("view").ariaBusy = "false"; });
}
$("files").addEventListener("change", event => taken(event.target.files));
for (const id of ["holds", "unit", "near", "far", "holes", "without"]) $(id).addEventListener("change", () => { fill(); taken(own); });
for (const kind of ["dragover", "dragleave", "drop"]) addEventListener(kind, event => {
  event.preventDefault();
  $("view").classList.toggle("drop", kind === "dragover");
  if (kind === "drop") taken(event.dataTransfer.files);
});
$("real").addEventListener("change", ({ target: { files: [file] } }) => {
  $("reference").hidden = !file;
  if (file) $("reference").lastElementChild.src = URL.createObjectURL(file);
});

// --- copies -------------------------------------------------------------------------------------------
/** Options of RandomUnderwater, as TOML and JSON hold them; for draws, those that are held. */
function optionsOf(files, everything) {
  const { depth, g, mu, blur, times, fullWell, readNoise } = state, held = name => everything || $(`hold-${name}`).checked;
  const contents = ["chlorophyll", "cdom", "minerals"].map(name => `${name}=${state[name]}`).join(",");
  const mixture = state.other && state.share ? `${rounded(1 - state.share)}*${state.water}+${state.share}*${state.other}` : state.water;
  const names = { color_matrix: "colorMatrix", exposure: "exposure", white_balance: "whiteBalance", saturation: "saturation", gamut: "gamut", tone: "tone" };
  const development = Object.fromEntries(Object.entries(names).filter(([, name]) => held(name)).map(([name, key]) => [name, state[key]]));
  if (fullWell < 1e5) development.noise = { full_well: fullWell, read_noise: readNoise };
  const options = {};
  if (held("water")) options.waters = [state.water === "contents" ? contents : mixture];
  if (held("contrast") || state.nature) options.contrast = state.nature ? null : state.contrast;
  if (held("depth")) options.vertical_depth = depth;
  if (everything) options.field = null;
  if (g !== DEFAULTS.g) options.g = g;
  if (mu !== rounded(1.5 * g)) options.mu = mu;
  if (blur !== 1) options.point_spread = { scale: rounded(tables.law.scale * blur * files.width), exponent: tables.law.exponent, shape: "exponential" };
  if (Object.keys(development).length) options.development = development;
  const holes = files.holes === "error" ? {} : { holes: Number(files.holes) || files.holes };
  if (Number.isFinite(+files.distance)) options.distance = files.distance * times;
  else if (files.holds !== "metres") options.distance = { kind: { relative: "Relative", inverse: "Inverse" }[files.holds], near: files.near * times, far: files.far * times, ...holes };
  else if (files.holes !== "error") options.distance = { kind: "Metres", ...holes };
  return options;
}
const toml = value => Array.isArray(value) ? `[${value.map(toml).join(", ")}]` : typeof value !== "object" ? JSON.stringify(value)
  : `{${Object.entries(value).map(([name, inner]) => `${name} = ${toml(inner)}`).join(", ")}}`;
function code() {
  const files = { width: 0, ...embedded.files, ...scene?.files }, language = $("language").value, options = optionsOf(files, language !== "command for draws");
  const map = Number.isFinite(+files.distance) ? null : files.distance, unit = files.holds === "metres" ? rounded(files.unit * state.times) : null;
  if (language === "TOML") {
    const none = Object.keys(options).filter(name => options[name] === null);
    const lines = Object.entries(options).filter(([, value]) => value !== null).map(([name, value]) => `${name} = ${toml(value)}`);
    return [`# uwaug degrade … --options this.toml${none.map(name => ` --set ${name}=none`).join("")}`, ...lines].join("\n");
  }
  if (language === "Python") {
    const plain = JSON.stringify(options, null, 4).replaceAll("null", "None"), reads = map && `read_distance(${JSON.stringify(map)}, ${unit ?? "None"})`;
    return `import uwaug\nfrom uwaug.files import read_distance, read_picture, write_picture\n\naugment = uwaug.RandomUnderwater.from_dict(${plain})\n`
      + `image = read_picture(${JSON.stringify(files.picture)})\ndistance = ${reads ?? "None"}\nwet = augment.transform(image, distance, augment.make_params(image))\nwrite_picture("wet.png", wet)`;
  }
  const quoted = text => /^[\w./:=,+*-]+$/.test(text) && !text.includes("*") ? text : `'${String(text).replaceAll("'", "'\\''")}'`;
  const { waters, contrast, distance, ...rest } = options, flags = [];
  if (map) flags.push(`--distance ${quoted(map)}`); else flags.push(`--distance ${distance}`);
  if (map && unit && unit !== 1) flags.push(`--unit ${unit}`);
  if (map && distance) flags.push(`--set ${quoted(`distance=${toml(distance)}`)}`);
  if (waters) flags.push(`--water ${quoted(waters[0])}`);
  if (contrast !== undefined) flags.push(`--contrast ${contrast ?? "none"}`);
  for (const [name, value] of Object.entries(rest)) flags.push(`--set ${quoted(`${name}=${value === null ? "none" : toml(value)}`)}`);
  return `uwaug degrade ${quoted(files.picture)} ${flags.join(" ")} ${options.field === null ? "--out wet.png" : "--variants 12 --sheet --out wet/"}`;
}
const download = (blob, name) => Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name }).click();
$("language").addEventListener("change", fill);
$("copy").addEventListener("click", () => navigator.clipboard.writeText(code()).then(() => say("copied"), () => { getSelection().selectAllChildren($("code")); say("select is made: copy by Ctrl+C"); }));
$("save").addEventListener("click", () => $("after").toBlob(blob => download(blob, "wet.png")));
$("save-scene").addEventListener("click", () => {
  $("before").toBlob(blob => download(blob, scene.files.picture.replace(/\.\w+$/, ".png")));
  download(npyOf(scene.distance, scene.width, scene.height), `${scene.files.picture.replace(/\.\w+$/, "")}-distance.npy`);
});

// --- begin --------------------------------------------------------------------------------------------
fill();
const bytesOf64 = text => Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
await ask("open", { tables });
const codes = new Uint16Array((await inflated([bytesOf64(embedded.distance)])).buffer); // each as the step from the one before
for (let i = 1; i < codes.length; i++) codes[i] += codes[i - 1];
const first = await createImageBitmap(new Blob([bytesOf64(embedded.picture)]), { colorSpaceConversion: "none" });
await setScene(first, () => Float32Array.from(codes, code => code === 65535 ? Infinity : embedded.near * Math.exp(code * embedded.step)), embedded.files);
