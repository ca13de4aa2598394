// Draws the cameras of the photographs as pyramids over the picture.

import { column, project } from "./orbit.js";

/** Length of a pyramid, relative to the radius of the box. */
const LENGTH = 0.12;

/** Returns the corners of a camera's pyramid: its apex, then its base. */
function corners({ pose, fov, width, height }, length) {
  const [right, up, back, eye] = [0, 1, 2, 3].map((axis) => column(pose, axis));
  const x = Math.tan((fov * Math.PI) / 360);
  const y = (x * height) / width;
  const at = (a, b) => eye.map((e, i) => e + length * (a * x * right[i] + b * y * up[i] - back[i]));
  return [eye, at(-1, -1), at(1, -1), at(1, 1), at(-1, 1)];
}

const EDGES = [[0, 1], [0, 2], [0, 3], [0, 4], [1, 2], [2, 3], [3, 4], [4, 1]];

/** Draws the cameras of all sets, the `chosen` one with bold lines. */
export function drawFrusta(canvas, sets, pose, fov, radius, chosen) {
  const context = canvas.getContext("2d");
  const { width, height } = canvas;
  context.clearRect(0, 0, width, height);
  for (const { split, views } of sets) {
    context.strokeStyle = split === "test" ? "#d9481c" : "#1c6fd9";
    views.forEach((view, index) => {
      if (view.pose.every((number, i) => Math.abs(number - pose[i]) < 1e-6)) return; // the camera of this picture
      const points = corners(view, LENGTH * radius).map((point) => project(point, pose, fov, width, height));
      context.lineWidth = chosen?.split === split && chosen.index === index ? 3 : 1;
      context.beginPath();
      for (const [a, b] of EDGES) {
        if (!points[a] || !points[b]) continue;
        context.moveTo(...points[a]);
        context.lineTo(...points[b]);
      }
      context.stroke();
    });
  }
}
