// Turns, moves and zooms a camera with mouse, touch, wheel and keys. A dialog lists the keys.

/** Direction in which each arrow key turns or moves the camera: [right, up]. */
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

/** Symbols that the dialog shows in place of the browser's names of keys. */
const SYMBOLS = { ArrowLeft: "←", ArrowRight: "→", ArrowUp: "↑", ArrowDown: "↓", "-": "−" };

/**
 * All keys, one entry per row of the list. `keys` maps the browser's name of a key to the value that `move` or `act` receives. `shift`
 * states whether the shift key has to be held; a row without `shift` works with and without it. `move` moves the camera; `act` does not.
 * `does` is the text that the list shows for a row, and `pointer` names the mouse or touch gesture with the same effect.
 */
const keyRows = (orbit, list, fullScreen) => [
  { keys: ARROWS, shift: false, pointer: "drag", does: "turn", move: ([x, y]) => orbit.turn(0.1 * x, 0.1 * y) },
  {
    keys: ARROWS,
    shift: true,
    pointer: "drag with the right button or shift",
    does: "move sideways",
    move: ([x, y]) => orbit.pan(0.05 * x, 0.05 * y),
  },
  { keys: { "+": 0.9, "-": 1 / 0.9 }, pointer: "wheel, two fingers", does: "nearer and farther", move: (factor) => orbit.zoom(factor) },
  { keys: { Home: null }, does: "the first view", move: () => orbit.home() },
  { keys: { f: null }, does: "full screen, and back", act: fullScreen },
  { keys: { "?": null }, does: "these keys", act: list },
];

/** Creates an element with these properties and children. */
function element(name, properties, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

/** Creates the dialog that lists rows of keys. */
function dialog(rows) {
  const title = element("h2", { id: "keys-title", textContent: "Keys" });
  const entries = rows.flatMap(({ keys, shift, pointer, does }) => {
    const symbols = Object.keys(keys).map((key) => SYMBOLS[key] ?? key);
    const pressed = [shift ? "shift and" : [], symbols].flat().join(" ");
    const input = [pointer ?? [], pressed].flat().join(", ");
    return [element("dt", { textContent: input }), element("dd", { textContent: does })];
  });
  const close = element("form", { method: "dialog" }, element("button", { textContent: "close" }));
  const made = element("dialog", { id: "keys" }, title, element("dl", {}, ...entries), close);
  made.setAttribute("aria-labelledby", title.id);
  return made;
}

/** Connects mouse, touch, wheel and keys to the camera. Calls `leave` before the camera moves and `changed` after it. */
export function gestures(view, orbit, changed, leave = () => {}) {
  const find = (id) => document.getElementById(id);
  const list = () => find("keys").showModal();
  const fullScreen = () => {
    const done = document.fullscreenElement ? document.exitFullscreen() : find("stage").requestFullscreen?.();
    // The browser may refuse full screen.
    done?.catch(() => {});
  };
  const rows = keyRows(orbit, list, fullScreen);
  document.body.append(dialog(rows));
  find("show-keys").addEventListener("click", list);
  find("full").addEventListener("click", fullScreen);
  const pointers = new Map();
  view.addEventListener("pointerdown", (event) => {
    view.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const end of ["pointerup", "pointercancel"]) {
    view.addEventListener(end, (event) => pointers.delete(event.pointerId));
  }
  view.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const by = [now[0] - before[0], now[1] - before[1]];
    const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
    pointers.set(event.pointerId, now);
    if (by[0] === 0 && by[1] === 0) return;
    leave();
    const width = view.clientWidth;
    if (other) {
      const apart = (at) => Math.max(Math.hypot(at[0] - other[0], at[1] - other[1]), 1);
      orbit.zoom(apart(before) / apart(now));
      orbit.pan(-0.5 * by[0] / width, 0.5 * by[1] / width);
    } else if (event.shiftKey || event.buttons & 6) {
      orbit.pan(-by[0] / width, by[1] / width);
    } else {
      orbit.turn((-4 * by[0]) / width, (4 * by[1]) / width);
    }
    changed();
  });
  view.addEventListener("contextmenu", (event) => event.preventDefault());
  view.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      leave();
      orbit.zoom(Math.exp(Math.min(Math.max(event.deltaY, -200), 200) / 500));
      changed();
    },
    { passive: false },
  );
  view.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    // "=" counts as plus, because both are on one key of many keyboards.
    const key = event.key === "=" ? "+" : event.key;
    const row = rows.find(({ keys, shift = event.shiftKey }) => Object.hasOwn(keys, key) && shift === event.shiftKey);
    if (!row) return;
    event.preventDefault();
    if (row.act) return row.act(row.keys[key]);
    leave();
    row.move(row.keys[key]);
    changed();
  });
}
