// The watched run: its state, the curve of its error, and the buttons that control it.

const find = (id) => document.getElementById(id);

/** Size of the curve's drawing, in units of its viewBox. */
const [WIDTH, HEIGHT, MARGIN] = [260, 110, 24];

const clock = (seconds) =>
  seconds < 90 ? `${seconds.toFixed(0)} s` : seconds < 5400 ? `${(seconds / 60).toFixed(1)} min` : `${(seconds / 3600).toFixed(1)} h`;

const WORDS = {
  running: "training",
  paused: "paused",
  stopped: "stopped and saved: the same command resumes the run",
  measuring: "trained; measuring the test views",
  finished: "finished: trimip-cli view RUN shows it",
};

/** Connects the buttons to `send`, which receives their commands. */
export function control(send) {
  find("training").hidden = false;
  find("pause").addEventListener("click", () => send(find("pause").dataset.command));
  find("stop").addEventListener("click", () => send("stop"));
}

/** Shows the state of the run on the page. */
export function tell(run) {
  const over = run.state === "stopped" || run.state === "finished";
  find("state").textContent = WORDS[run.state];
  find("progress").value = run.progress ?? 0;
  const rows = [];
  if (run.seconds !== undefined) {
    rows.push(`step ${run.step.toLocaleString("en")}, ${clock(run.seconds)} of training`);
    if (run.state === "running" || run.state === "paused") rows.push(`${clock(run.seconds_left)} left, ${(run.samples_per_second / 1e6).toFixed(2)} M samples/s`);
    if (run.batch_psnr !== null) rows.push(`${run.batch_psnr.toFixed(2)} dB on training pixels`);
  }
  const last = run.curve.at(-1);
  if (last) rows.push(`${last[1].toFixed(2)} dB on test views after ${clock(last[0])}`);
  find("figures").replaceChildren(...rows.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
  find("pause").textContent = run.state === "paused" ? "resume" : "pause";
  find("pause").dataset.command = run.state === "paused" ? "resume" : "pause";
  find("pause").disabled = over || run.state === "measuring";
  find("stop").disabled = over;
  draw(run.curve);
}

function draw(curve) {
  const svg = find("curve");
  const make = (name, attributes, text = "") => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    element.textContent = text;
    return element;
  };
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
  svg.hidden = curve.length === 0;
  if (!curve.length) return;
  const most = curve.at(-1)[0];
  const values = curve.map((point) => point[1]);
  const [low, high] = [Math.floor(Math.min(...values) - 0.5), Math.ceil(Math.max(...values) + 0.5)];
  const x = (seconds) => MARGIN + ((WIDTH - MARGIN - 6) * seconds) / most;
  const y = (psnr) => HEIGHT - 16 - ((HEIGHT - 26) * (psnr - low)) / (high - low);
  const points = curve.map(([seconds, psnr]) => `${x(seconds).toFixed(1)},${y(psnr).toFixed(1)}`);
  svg.replaceChildren(
    make("line", { x1: MARGIN, y1: y(low), x2: WIDTH - 6, y2: y(low), class: "axis" }),
    make("line", { x1: MARGIN, y1: y(low), x2: MARGIN, y2: y(high), class: "axis" }),
    make("text", { x: MARGIN - 3, y: y(low), class: "end" }, low),
    make("text", { x: MARGIN - 3, y: y(high) + 6, class: "end" }, high),
    make("text", { x: MARGIN, y: HEIGHT - 3 }, "PSNR, dB"),
    make("text", { x: WIDTH - 6, y: HEIGHT - 3, class: "end" }, clock(most)),
    make("polyline", { points: points.join(" "), class: "curve" }),
    ...points.map((point) => make("circle", { cx: point.split(",")[0], cy: point.split(",")[1], r: 2.5, class: "point" })),
  );
}
