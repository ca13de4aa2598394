// The page: its controls, and the reactions to their changes.

import { Orbit } from "./orbit.js";
import { Link } from "./link.js";
import { gestures } from "./gestures.js";
import { drawFrusta } from "./frusta.js";
import { control, tell } from "./training.js";

const find = (id) => document.getElementById(id);
const [view, photo, frusta] = [find("view"), find("photo"), find("frusta")];

/** Milliseconds without a change after which the camera counts as still. */
const STILL = 160;

/** Longest side of a picture, pixels. */
const MOST = 2048;

/** Maximum number of characters of a name in the list of photographs. */
const LONGEST = 24;

const scene = await (await fetch("scene.json")).json();
document.title = `${scene.name} · trimip`;
find("name").textContent = scene.name;
find("device").textContent = `${scene.encoder} · ${scene.device}`;
find("report").hidden = !scene.report;
if (scene.report) find("report").querySelector("a").href = scene.report;
for (const note of scene.notes) find("notes").append(Object.assign(document.createElement("li"), { textContent: note }));
find("renderer").replaceChildren(...scene.renderers.map((name) => new Option(name, name)));
find("renderer").value = scene.renderers.at(-1);
for (const { split, views } of scene.cameras) {
  const group = document.createElement("optgroup");
  group.label = split === "test" ? "test views" : "training views";
  views.forEach(({ name }, index) => {
    const option = new Option(shortened(name), `${split} ${index}`);
    option.title = name;
    group.append(option);
  });
  find("cameras").append(group);
}

find("show").querySelector("[value=level]").disabled = !scene.levels;

const orbit = new Orbit(scene.box, scene.up, Number(find("fov").value), view, scene.home);
/** The chosen photograph: its set, its index, and its camera. */
let chosen = null;
let path = [];
let shown = null;
let lastBitmap = null;
const times = [];

const link = new Link({
  picture: receive,
  failed: (text) => say(text),
  training: tell,
  cropped: (crop) => {
    scene.crop = crop;
    tellCrop();
    say(`The crop of the model is now ${crop}.`);
  },
  state: (open) => say(!open ? "The program does not answer. Trying again…" : shown ? "" : "Rendering the first picture…"),
});

if (scene.training) control((command) => link.command(command));

function say(text) {
  find("message").textContent = text;
}

/** Returns a name that fits the list: for a long name, its beginning and its end. */
function shortened(name) {
  const letters = [...name];
  if (letters.length <= LONGEST) return name;
  const kept = (LONGEST - 1) / 2;
  return [...letters.slice(0, Math.ceil(kept)), "…", ...letters.slice(-Math.floor(kept))].join("");
}

const currentPose = () => (chosen ? chosen.camera.pose : orbit.pose());
const currentFov = () => (chosen ? chosen.camera.fov : orbit.fov);

/** Returns the size of the finest picture. If a photograph is chosen, the picture has the photograph's aspect ratio. */
function size() {
  const factor = (Number(find("scale").value) / 100) * (window.devicePixelRatio || 1);
  let [width, height] = [view.clientWidth * factor, view.clientHeight * factor];
  if (chosen) {
    const ratio = chosen.camera.width / chosen.camera.height;
    [width, height] = width / height > ratio ? [height * ratio, height] : [width, width / ratio];
  }
  const least = Math.min(1, MOST / Math.max(width, height));
  return [width, height].map((side) => Math.max(1, Math.round(side * least)));
}

function request(moving) {
  const [width, height] = size();
  link.ask({
    pose: currentPose(),
    fov: currentFov(),
    width,
    height,
    show: find("show").value,
    renderer: find("renderer").value,
    moving,
    photo: chosen ? { split: chosen.split, index: chosen.index } : null,
    clip: clip(),
    cropped: find("cropped").checked,
  });
}

/** Two sliders per axis, for the ends of the visible part of the box. */
const clips = ["x", "y", "z"].map((axis) =>
  [0, 100].map((value, end) => {
    const label = `${end ? "upper" : "lower"} end of the box along ${axis}`;
    const slider = Object.assign(document.createElement("input"), { type: "range", min: 0, max: 100, value });
    slider.setAttribute("aria-label", label);
    slider.addEventListener("input", changed);
    return slider;
  }),
);
clips.forEach((ends, axis) => {
  const label = Object.assign(document.createElement("label"), { textContent: "xyz"[axis] });
  label.append(...ends);
  find("clips").append(label);
});
find("unclip").addEventListener("click", () => {
  clips.forEach((ends) => ends.forEach((slider, end) => (slider.value = end ? 100 : 0)));
  settled();
});

function tellCrop() {
  find("crop").hidden = scene.crop === "none";
  find("crop").querySelector("code").textContent = scene.crop;
}
tellCrop();
find("keep").hidden = !scene.keeps;
find("keep").addEventListener("click", () => link.keep(clip()));
find("cropped").checked = find("crop").closest("details").open = scene.cropped;
find("cropped").addEventListener("change", settled);

/** Returns the visible part of the box, or null for everything. */
function clip() {
  const whole = clips.every(([low, high]) => low.value === "0" && high.value === "100");
  find("unclip").disabled = find("keep").disabled = whole;
  if (whole) return null;
  const { min, max } = scene.box;
  const at = (axis, share) => min[axis] + share * (max[axis] - min[axis]);
  const parts = clips.map(([low, high]) => {
    const ends = [low, high].map((slider) => Number(slider.value) / 100).sort((a, b) => a - b);
    // If both sliders have the same value, a thin slice is visible.
    return ends[0] === ends[1] ? [ends[0] - 0.005, ends[1] + 0.005] : ends;
  });
  // A slider at its end clips nothing on that side, because unbounded scenes continue outside the box.
  const far = (share) => (share <= 0 ? -1e30 : share >= 1 ? 1e30 : null);
  return [0, 1].map((end) => parts.map((part, axis) => far(part[end]) ?? at(axis, part[end])));
}

let still = null;
function changed() {
  label();
  request(true);
  clearTimeout(still);
  still = setTimeout(() => request(false), STILL);
  overlay();
}

function settled() {
  clearTimeout(still);
  request(false);
  overlay();
}

function overlay() {
  [frusta.width, frusta.height] = size();
  frusta.hidden = !find("show-frusta").checked;
  if (!frusta.hidden) drawFrusta(frusta, scene.cameras, currentPose(), currentFov(), orbit.radius, chosen);
}

let [turns, drawn] = [0, 0];
async function receive(header, jpeg, waited) {
  turns += 1;
  const turn = turns;
  const bitmap = await createImageBitmap(jpeg);
  // Decoding a large picture may take longer than decoding a small one that arrived later.
  if (turn < drawn) return bitmap.close();
  drawn = turn;
  const [width, height] = size();
  // The canvas always has the finest size, so that coarse pictures fill the same area.
  if (view.width !== width || view.height !== height) {
    [view.width, view.height] = [width, height];
    divide();
  }
  view.getContext("2d").drawImage(bitmap, 0, 0, width, height);
  lastBitmap?.close();
  lastBitmap = bitmap;
  shown = header;
  say("");
  const now = performance.now();
  times.push(now);
  while (times.length && now - times[0] > 1000) times.shift();
  find("rendered").textContent = `${header.rendered.toFixed(0)} ms`;
  find("waited").textContent = waited === null ? "–" : `${waited.toFixed(0)} ms`;
  find("rate").textContent = String(times.length);
  // Only some pictures come with a sample count; for the others the page keeps showing the last count.
  if (header.samples !== undefined) find("samples").textContent = header.samples.toFixed(1);
  find("range").hidden = !header.range;
  if (header.range) {
    const short = (value) => (Number.isInteger(value) ? String(value) : value.toFixed(2));
    [find("least").textContent, find("most").textContent] = header.range.map(short);
    find("range").querySelector(".scale").classList.toggle("grey", find("show").value === "depth");
  }
  find("size").textContent = `${header.width}×${header.height}, ${(jpeg.size / 1024).toFixed(1)} KB${header.done ? "" : " …"}`;
  view.dataset.id = header.id;
  view.dataset.done = header.done;
  view.dataset.waited = waited;
  view.dataset.bytes = jpeg.size;
}

/** Shows a photograph over the model; the value "" returns to the free view. */
async function choose(value) {
  const [split, index] = value.split(" ");
  const camera = scene.cameras.find((set) => set.split === split)?.views[Number(index)];
  chosen = camera ? { split, index: Number(index), camera } : null;
  find("cameras").value = chosen ? value : "";
  find("cameras").title = camera?.name ?? "";
  for (const option of find("show").options) {
    if (option.value === "difference") option.disabled = !chosen;
    if (option.value === "flip") option.disabled = !chosen || !scene.flip;
  }
  if (!chosen && ["difference", "flip"].includes(find("show").value)) find("show").value = "color";
  photo.hidden = find("split").hidden = !chosen;
  if (chosen) orbit.follow(camera.pose);
  settled();
  if (!chosen) return;
  const mine = chosen;
  const [width, height] = size();
  const answer = await fetch(`photo/${split}/${index}?width=${width}&height=${height}`);
  if (!answer.ok) return say(`photograph ${camera.name} cannot be shown`);
  const bitmap = await createImageBitmap(await answer.blob());
  if (chosen !== mine) return bitmap.close();
  [photo.width, photo.height] = [width, height];
  photo.getContext("2d").drawImage(bitmap, 0, 0, width, height);
  bitmap.close();
  divide();
}

/** Clips the photograph so that it covers the picture to the right of the slider. */
function divide() {
  // The picture may be narrower than the stage.
  const [stage, ratio] = [view.clientWidth, view.width / view.height];
  const width = Math.min(stage, view.clientHeight * ratio);
  const left = 0.5 * (stage - width) + (width * Number(find("split").value)) / 100;
  photo.style.clipPath = `inset(0 0 0 ${left}px)`;
  photo.hidden = !chosen || find("show").value !== "color";
}

/** Returns from the photograph to the free view, with the field of view of the photograph. */
function leave() {
  if (chosen) {
    orbit.fov = chosen.camera.fov;
    find("fov").value = orbit.fov;
    choose("");
  }
}

gestures(view, orbit, changed, leave);

function label() {
  find("fov").value = currentFov();
  find("fov-value").textContent = `${Math.round(currentFov())}°`;
  find("scale-value").textContent = `${find("scale").value} %`;
}
find("fov").addEventListener("input", () => {
  const fov = Number(find("fov").value);
  leave();
  orbit.fov = find("fov").value = fov;
  label();
  changed();
});
find("scale").addEventListener("input", () => (label(), changed()));
find("show").addEventListener("change", () => (settled(), divide()));
find("renderer").addEventListener("change", settled);
find("split").addEventListener("input", divide);
find("show-frusta").addEventListener("change", overlay);
find("cameras").addEventListener("change", (event) => choose(event.target.value).then(label));
function step(by) {
  const all = [...find("cameras").options].map((option) => option.value).filter((value) => value);
  if (!all.length) return;
  const at = all.indexOf(find("cameras").value);
  choose(all[at < 0 ? (by > 0 ? 0 : all.length - 1) : (at + by + all.length) % all.length]).then(label);
}
find("previous").addEventListener("click", () => step(-1));
find("next").addEventListener("click", () => step(1));

function download(name, blob) {
  const anchor = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(anchor.href), 10000);
}
find("picture").addEventListener("click", () => view.toBlob((blob) => download(`${scene.name}.png`, blob)));
/** Returns the pose for `--pose` and `--path`, in the photographs' coordinates: the page's coordinates are relative to scene.origin. */
const rows = (pose) => {
  const row = (i) => [...pose.slice(4 * i, 4 * i + 3), pose[4 * i + 3] + (scene.origin[i] ?? 0)];
  return [row(0), row(1), row(2), [0, 0, 0, 1]];
};
find("pose").addEventListener("click", async () => {
  const text = JSON.stringify(rows(currentPose()));
  // Without https, browsers offer the clipboard only to pages from this machine itself.
  await (navigator.clipboard?.writeText(text) ?? Promise.reject()).then(
    () => say("The pose is in the clipboard: trimip-cli render … --pose '…'"),
    () => say(text),
  );
});
function count() {
  find("count").textContent = path.length;
  find("path").disabled = find("clear").disabled = path.length === 0;
}
find("add").addEventListener("click", () => {
  const [w, h] = size();
  path.push({ camera_angle_x: (currentFov() * Math.PI) / 180, w, h, transform_matrix: rows(currentPose()) });
  count();
});
find("clear").addEventListener("click", () => ((path = []), count()));
find("path").addEventListener("click", () => {
  download("path.json", new Blob([JSON.stringify({ frames: path }, null, 1)], { type: "application/json" }));
});

new ResizeObserver(() => (changed(), divide())).observe(view);
label();
view.focus({ preventScroll: true });
