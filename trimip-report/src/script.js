// A slider between rendering and photograph, and pictures that are enlarged on a click. Without this script the pictures are side by side.
"use strict";
(() => {
  document.documentElement.classList.add("js");
  const make = (tag, name, text) =>
    Object.assign(document.createElement(tag), { className: name || "", textContent: text || "" });
  const shown = [];
  let at = 0;

  // The rendering is to the left of the slider, the photograph to its right.
  function wipe(rendered, photograph, click) {
    const box = make("div", "wipe");
    const stack = make("div", "stack");
    const range = make("input");
    const names = make("div", "names");
    Object.assign(range, { type: "range", min: 0, max: 100, step: 0.5, value: 50 });
    range.setAttribute("aria-label", "how much of the rendering covers the photograph");
    const show = () => stack.style.setProperty("--at", range.value + "%");
    range.addEventListener("input", show);
    let from = null;
    let moved = false;
    stack.addEventListener("pointerdown", (event) => { from = event.clientX; moved = false; });
    stack.addEventListener("pointermove", (event) => {
      if (from === null || (!moved && Math.abs(event.clientX - from) < 5)) return;
      if (!moved) stack.setPointerCapture(event.pointerId);
      moved = true;
      const frame = stack.getBoundingClientRect();
      range.value = (100 * (event.clientX - frame.left)) / frame.width;
      show();
    });
    for (const end of ["pointerup", "pointercancel"]) stack.addEventListener(end, () => { from = null; });
    stack.addEventListener("click", () => { if (!moved && click) click(); });
    rendered.draggable = photograph.draggable = false;
    stack.append(rendered, photograph, make("i"));
    names.append(make("span", "", "rendered"), make("span", "", "photograph"));
    box.append(stack, range, names);
    show();
    return box;
  }

  const light = make("dialog", "light");
  const stage = make("div", "stage");
  const caption = make("p");
  const bar = make("div", "bar-of-buttons");
  const button = (text, name, act) => {
    const element = make("button", "", text);
    element.type = "button";
    element.setAttribute("aria-label", name);
    element.addEventListener("click", act);
    bar.append(element);
  };
  function enlarge(i) {
    at = (i + shown.length) % shown.length;
    const item = shown[at];
    stage.replaceChildren(item.make());
    stage.style.setProperty("--ratio", item.width / item.height);
    caption.textContent = item.text;
    if (light.open) return;
    light.showModal();
    // Otherwise the slider would have the focus and receive the arrow keys.
    bar.children[1].focus();
  }
  button("‹", "previous picture", () => enlarge(at - 1));
  button("›", "next picture", () => enlarge(at + 1));
  button("×", "close", () => light.close());
  light.append(stage, caption, bar);
  light.addEventListener("click", (event) => { if (event.target === light) light.close(); });
  light.addEventListener("keydown", (event) => {
    if (event.target.type === "range") return;
    if (event.key === "ArrowLeft") enlarge(at - 1);
    if (event.key === "ArrowRight") enlarge(at + 1);
  });
  document.body.append(light);

  // Registers a picture for the enlarged view; returns the click handler.
  function offer(image, text, build) {
    const i = shown.length;
    shown.push({ make: build, text, width: Number(image.getAttribute("width")), height: Number(image.getAttribute("height")) });
    return () => enlarge(i);
  }
  function alone(image, text) {
    image.addEventListener("click", offer(image, text, () => image.cloneNode()));
  }
  for (const view of document.querySelectorAll(".view")) {
    const [rendered, photograph, difference] = view.querySelectorAll("img");
    const text = view.querySelector("figcaption").textContent;
    const panes = view.querySelectorAll(".pane");
    const click = offer(rendered, text, () => wipe(rendered.cloneNode(), photograph.cloneNode()));
    panes[0].replaceChildren(wipe(rendered, photograph, click));
    panes[1].remove();
    alone(difference, "difference: " + text);
  }
  for (const shot of document.querySelectorAll(".shot")) {
    alone(shot.querySelector("img"), shot.querySelector("figcaption").textContent);
  }
  // `trimip-cli view` serves the report under an address that does not show that of the viewer.
  const viewer = document.getElementById("viewer");
  if (viewer) {
    viewer.hidden = !/^\/[0-9a-f]{32}\/report\.html$/.test(location.pathname);
    viewer.addEventListener("click", (event) => {
      event.preventDefault();
      history.back();
    });
  }
})();
