// The page of `export web`: loads the model and renders it, coarsely while the camera moves and at full resolution when it stands still.

import { Orbit } from "./orbit.js";
import { gestures } from "./gestures.js";
import start, { Viewer } from "./trimip_web.js";

const find = (id) => document.getElementById(id);
const view = find("view");

/** Time limit of a picture while the camera moves, milliseconds. */
const COARSE = 60;

/** Milliseconds without a change after which the camera counts as still. */
const STILL = 160;

/** Longest side of a picture, pixels. */
const MOST = 2048;

/** Minimum number of pixels along the longer side of a picture. */
const LEAST = 48;

function say(text) {
  find("message").textContent = text;
}

async function bytes(file) {
  const answer = await fetch(file);
  if (!answer.ok) throw new Error(`${file}: ${answer.status} ${answer.statusText}`);
  const [all, parts] = [Number(answer.headers.get("content-length")), []];
  let have = 0;
  for (const reader = answer.body.getReader(); ; ) {
    const { done, value } = await reader.read();
    if (done) break;
    parts.push(value);
    have += value.length;
    say(`Loading: ${(have / 1e6).toFixed(1)}${all ? ` of ${(all / 1e6).toFixed(1)}` : ""} MB`);
  }
  const whole = new Uint8Array(have);
  parts.reduce((at, part) => (whole.set(part, at), at + part.length), 0);
  return whole;
}

async function open() {
  if (!window.isSecureContext) throw new Error("WebGPU needs an address with https:// or localhost.");
  if (!navigator.gpu || !(await navigator.gpu.requestAdapter())) {
    throw new Error("This browser has no WebGPU, which this page needs. Recent versions of Chrome, Edge, Firefox and Safari support it.");
  }
  await start();
  const { name, model, cropped, home } = await (await fetch("about.json")).json();
  document.title = `${name} · trimip`;
  find("name").textContent = name;
  const viewer = await Viewer.load(await bytes(model));
  return [viewer, { ...JSON.parse(viewer.about()), cropped, home }];
}

let viewer, orbit;
/** Measured rendering speed, pixels per millisecond. */
let speed = 20;
let [running, wanted] = [null, null];

/** Requests a picture; the promise is fulfilled once the newest requested picture is drawn. */
function draw(moving) {
  wanted = { moving };
  running ??= drawAll().finally(() => (running = null));
  return running;
}

async function drawAll() {
  try {
    while (wanted) {
      const { moving } = wanted;
      wanted = null;
      const factor = (Number(find("scale").value) / 100) * (window.devicePixelRatio || 1);
      const whole = [view.clientWidth * factor, view.clientHeight * factor];
      const most = MOST / Math.max(...whole);
      const fits = Math.min(most, moving ? Math.sqrt((speed * COARSE) / (whole[0] * whole[1])) : 1);
      const part = Math.min(1, Math.max(fits, LEAST / Math.max(...whole)));
      const [width, height] = whole.map((side) => Math.max(1, Math.round(side * part)));
      const begun = performance.now();
      const pixels = await viewer.render(Float64Array.from(orbit.pose()), orbit.fov, width, height, find("cropped").checked);
      const took = Math.max(performance.now() - begun, 1);
      speed += 0.4 * ((width * height) / took - speed);
      [view.width, view.height] = [width, height];
      view.getContext("2d").putImageData(new ImageData(new Uint8ClampedArray(pixels.buffer), width, height), 0, 0);
      find("rendered").textContent = `${took.toFixed(0)} ms`;
      find("size").textContent = `${width}×${height}`;
      view.dataset.done = !moving;
    }
  } catch (error) {
    say(String(error));
  }
}

let still = null;
function changed() {
  draw(true);
  clearTimeout(still);
  still = setTimeout(() => draw(false), STILL);
}

try {
  let about;
  [viewer, about] = await open();
  orbit = new Orbit(about.box, about.up, Number(find("fov").value), view, about.home);
  const label = () => {
    find("fov").value = orbit.fov;
    find("fov-value").textContent = `${Math.round(orbit.fov)}°`;
  };
  label();
  gestures(view, orbit, changed);
  find("crop").hidden = about.crop === "none";
  find("crop").querySelector("code").textContent = about.crop;
  find("cropped").checked = about.cropped;
  find("cropped").addEventListener("change", changed);
  find("fov").addEventListener("input", () => {
    orbit.fov = Number(find("fov").value);
    label();
    changed();
  });
  find("scale").addEventListener("input", () => {
    find("scale-value").textContent = `${find("scale").value} %`;
    changed();
  });
  find("home").addEventListener("click", () => (orbit.home(), label(), changed()));
  find("picture").addEventListener("click", async () => {
    await draw(false);
    view.toBlob((blob) => {
      const anchor = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: `${find("name").textContent}.png` });
      anchor.click();
      setTimeout(() => URL.revokeObjectURL(anchor.href), 10000);
    });
  });
  new ResizeObserver(changed).observe(view);
  say("");
  view.focus({ preventScroll: true });
  // An interface for scripts that returns the RGBA pixels of a view, of everything or only of the crop.
  window.trimip = { render: (pose, fov, width, height, cropped = false) => viewer.render(Float64Array.from(pose), fov, width, height, cropped) };
} catch (error) {
  say(error.message ?? String(error));
}
