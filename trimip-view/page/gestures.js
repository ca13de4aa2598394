// Mouse, touch, wheel and keys turn, move and zoom a camera.

/** Calls `leave` before the camera moves and `changed` after it. */
export function gestures(view, orbit, changed, leave = () => {}) {
  const find = (id) => document.getElementById(id);
  const keys = () => find("keys").showModal();
  const fullScreen = () => {
    const done = document.fullscreenElement ? document.exitFullscreen() : find("stage").requestFullscreen?.();
    // The browser may forbid it.
    done?.catch(() => {});
  };
  find("show-keys").addEventListener("click", keys);
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
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const zooms = { "+": 0.9, "=": 0.9, "-": 1 / 0.9 };
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key in steps) {
      const [x, y] = steps[event.key];
      leave();
      if (event.shiftKey) orbit.pan(0.05 * x, 0.05 * y);
      else orbit.turn(0.1 * x, 0.1 * y);
    } else if (event.key in zooms) {
      leave();
      orbit.zoom(zooms[event.key]);
    } else if (event.key === "Home") {
      leave();
      orbit.home();
    } else if (event.key === "?") {
      return keys();
    } else if (event.key === "f") {
      return fullScreen();
    } else {
      return;
    }
    event.preventDefault();
    changed();
  });
}
