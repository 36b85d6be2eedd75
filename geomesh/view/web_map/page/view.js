/* What part of the map the window shows: its centre in lattice steps, and map units for a CSS pixel. */
class View {
  constructor(frame, canvas) {
    this.frame = frame;
    this.canvas = canvas;
    this.x = this.y = 0;
    this.unit = 1;
  }

  get size() {
    return [this.canvas.clientWidth || 1, this.canvas.clientHeight || 1];
  }

  /** From steps of the lattice to CSS pixels, which run down. */
  matrix(unit = this.unit) {
    const [a, b, , d, e] = this.frame.affine, { narrow, down } = this.frame, up = down ? 1 : -1;
    return [(a * narrow) / unit, (b * narrow) / unit, (up * d) / unit, (up * e) / unit];
  }

  toScreen(x, y, state = this) {
    const [a, b, d, e] = this.matrix(state.unit), [width, height] = this.size;
    return [width / 2 + a * (x - state.x) + b * (y - state.y), height / 2 + d * (x - state.x) + e * (y - state.y)];
  }

  toLattice(px, py, state = this) {
    const [a, b, d, e] = this.matrix(state.unit), [width, height] = this.size, determinant = a * e - b * d;
    const dx = px - width / 2, dy = py - height / 2;
    return [state.x + (e * dx - b * dy) / determinant, state.y + (a * dy - d * dx) / determinant];
  }

  toMap(x, y) {
    const [a, b, c, d, e, f] = this.frame.affine;
    return [a * x + b * y + c, d * x + e * y + f];
  }

  fromMap(mx, my) {
    const [a, b, c, d, e, f] = this.frame.affine, determinant = a * e - b * d;
    return [(e * (mx - c) - b * (my - f)) / determinant, (a * (my - f) - d * (mx - c)) / determinant];
  }

  /** The window in the lattice, with some CSS pixels around it. */
  window(around = 0, state = this) {
    const [width, height] = this.size, xs = [], ys = [];
    for (const px of [-around, width + around]) {
      for (const py of [-around, height + around]) {
        const [x, y] = this.toLattice(px, py, state);
        xs.push(x);
        ys.push(y);
      }
    }
    return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
  }

  state() {
    return { x: this.x, y: this.y, unit: this.unit };
  }

  /** The state that shows a box of the lattice. */
  fitted([left, top, right, bottom]) {
    const [width, height] = this.size, [a, b, d, e] = this.matrix(1);
    const w = right - left, h = bottom - top;
    const unit = Math.max((Math.abs(a * w) + Math.abs(b * h)) / width, (Math.abs(d * w) + Math.abs(e * h)) / height);
    return { x: (left + right) / 2, y: (top + bottom) / 2, unit: (unit || 1) * 1.06 };
  }

  /** Limits: the whole mesh in a few pixels, and a step of the lattice in 40. */
  limited(unit) {
    const [a, b, d, e] = this.matrix(1), step = Math.min(Math.hypot(a, d), Math.hypot(b, e));
    return Math.min(Math.max(unit, step / 40), this.fitted(this.frame.box).unit * 50);
  }

  zoom(px, py, factor) {
    const [x, y] = this.toLattice(px, py);
    this.unit = this.limited(this.unit * factor);
    const [x2, y2] = this.toLattice(px, py);
    this.x += x - x2;
    this.y += y - y2;
  }

  pan(dx, dy) {
    const [width, height] = this.size;
    [this.x, this.y] = this.toLattice(width / 2 - dx, height / 2 - dy);
  }
}

const sameState = (one, other) => one.x === other.x && one.y === other.y && one.unit === other.unit;

/** Interpolate in a grid of side x side numbers, at shares of its width and height. */
function interpolate(numbers, side, across, down) {
  const u = across * (side - 1), v = down * (side - 1);
  const i = Math.min(Math.max(Math.floor(u), 0), side - 2), j = Math.min(Math.max(Math.floor(v), 0), side - 2);
  const s = u - i, t = v - j, k = j * side + i;
  return (1 - t) * ((1 - s) * numbers[k] + s * numbers[k + 1]) + t * ((1 - s) * numbers[k + side] + s * numbers[k + side + 1]);
}

/** Return longitude and latitude of a place of the lattice; null far from the mesh. */
function lonLatOf(frame, x, y) {
  const places = frame.lonlat, [left, top, right, bottom] = frame.box;
  if (!places) return null;
  const across = (x - left) / (right - left || 1), down = (y - top) / (bottom - top || 1);
  if (across < -0.1 || down < -0.1 || across > 1.1 || down > 1.1) return null;
  const lon = interpolate(places.lon, places.side, across, down);
  return [((((lon + 180) % 360) + 360) % 360) - 180, interpolate(places.lat, places.side, across, down)];
}
