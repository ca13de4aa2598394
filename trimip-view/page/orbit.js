// A camera that orbits a point. Vectors are arrays of three numbers in world units. A pose is a camera-to-world matrix
// [R|t] of 12 numbers, row by row; its axes are right, up and back.

const add = (a, b) => a.map((x, i) => x + b[i]);
const scaled = (a, s) => a.map((x) => x * s);
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const subtract = (a, b) => a.map((x, i) => x - b[i]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const normalized = (a) => scaled(a, 1 / Math.hypot(...a));

/** Largest pitch, radians. Looking straight down, the upright direction is undefined. */
const STEEPEST = 1.55;

/** Returns column `axis` of a pose: 0 right, 1 up, 2 back, 3 the position of the camera. */
export const column = (pose, axis) => [pose[axis], pose[4 + axis], pose[8 + axis]];

export class Orbit {
  /** Creates a camera at `start` (a pose and a field of view) or, without it, one that orbits the middle of `box` and sees all of it. */
  constructor(box, up, fov, stage, start = null) {
    this.stage = stage;
    this.start = start;
    this.up = normalized(up);
    const other = Math.abs(this.up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
    this.first = normalized(cross(this.up, other));
    this.second = cross(this.up, this.first);
    this.middle = scaled(add(box.min, box.max), 0.5);
    this.radius = 0.5 * Math.hypot(...subtract(box.max, box.min));
    this.fov = fov;
    this.home();
  }

  home() {
    if (this.start) {
      this.fov = this.start.fov;
      return this.follow(this.start.pose);
    }
    this.target = [...this.middle];
    const ratio = this.stage.clientHeight / this.stage.clientWidth || 1;
    // The field of view is horizontal.
    const half = Math.atan(Math.tan((this.fov * Math.PI) / 360) * Math.min(1, ratio));
    this.distance = this.radius / Math.sin(half);
    this.yaw = 0.7;
    this.pitch = 0.5;
  }

  /** Returns the unit vector from the target to the camera. */
  back() {
    const flat = Math.cos(this.pitch);
    const around = add(scaled(this.first, flat * Math.cos(this.yaw)), scaled(this.second, flat * Math.sin(this.yaw)));
    return add(around, scaled(this.up, Math.sin(this.pitch)));
  }

  pose() {
    const back = this.back();
    const right = normalized(cross(this.up, back));
    const up = cross(back, right);
    const eye = add(this.target, scaled(back, this.distance));
    return [0, 1, 2].flatMap((i) => [right[i], up[i], back[i], eye[i]]);
  }

  /** Takes the position and direction of a pose, without its roll. The target is the point on the optical axis nearest to the middle. */
  follow(pose) {
    const back = normalized(column(pose, 2));
    const eye = column(pose, 3);
    this.distance = Math.max(dot(subtract(eye, this.middle), back), 0.05 * this.radius);
    this.target = subtract(eye, scaled(back, this.distance));
    this.pitch = Math.min(Math.max(Math.asin(Math.min(Math.max(dot(back, this.up), -1), 1)), -STEEPEST), STEEPEST);
    this.yaw = Math.atan2(dot(back, this.second), dot(back, this.first));
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.min(Math.max(this.pitch + pitch, -STEEPEST), STEEPEST);
  }

  /** Moves the target right and up, in units of the picture's width. */
  pan(x, y) {
    const pose = this.pose();
    const width = 2 * this.distance * Math.tan((this.fov * Math.PI) / 360);
    const by = add(scaled(column(pose, 0), x * width), scaled(column(pose, 1), y * width));
    this.target = add(this.target, by);
  }

  zoom(factor) {
    this.distance = Math.min(Math.max(this.distance * factor, 0.01 * this.radius), 100 * this.radius);
  }
}

/** Returns the pixel position of a point in a picture of `width` by `height` pixels, or null if it is behind the camera. */
export function project(point, pose, fov, width, height) {
  const from = subtract(point, column(pose, 3));
  const depth = -dot(from, column(pose, 2));
  if (depth <= 1e-6) return null;
  const focal = (0.5 * width) / Math.tan((fov * Math.PI) / 360);
  return [
    0.5 * width + (focal * dot(from, column(pose, 0))) / depth,
    0.5 * height - (focal * dot(from, column(pose, 1))) / depth,
  ];
}
