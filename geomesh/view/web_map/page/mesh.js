/* A mesh on the lattice of 1/256 pixel: triangles along a curve, in chunks that are near each other. */
const CHUNK = 256;

class Mesh {
  constructor(number, about) {
    this.number = number;
    this.about = about;
    this.columns = new Map();
  }

  block(name) {
    return readBlock(`mesh${this.number}-${name}`);
  }

  /** Read what the first picture needs. */
  async load() {
    const names = ["nodes", "triangles", "colors", ...(this.about.surface ? ["surface"] : [])];
    const [nodes, triangles, colors, surface] = await Promise.all(names.map((name) => this.block(name)));
    const count = this.about.nodes;
    this.x = addUp(joinSigned(nodes, 0, count));
    this.y = addUp(joinSigned(nodes, 4 * count, count));
    this.corners = joinBelowHighest(triangles);
    this.colors = joinColors(colors);
    this.surface = surface && joinColors(surface);
    this.boxes = this.boxesOfChunks();
    return this;
  }

  boxesOfChunks() {
    const { x, y, corners } = this, boxes = new Int32Array(4 * Math.ceil(corners.length / (3 * CHUNK)));
    for (let chunk = 0; 4 * chunk < boxes.length; chunk++) {
      let left = 2 ** 31 - 1, top = left, right = -left, bottom = -left;
      for (let k = 3 * CHUNK * chunk, end = Math.min(k + 3 * CHUNK, corners.length); k < end; k++) {
        const col = x[corners[k]], row = y[corners[k]];
        if (col < left) left = col;
        if (col > right) right = col;
        if (row < top) top = row;
        if (row > bottom) bottom = row;
      }
      boxes.set([left, top, right, bottom], 4 * chunk);
    }
    return boxes;
  }

  /** Return runs [from, to) of triangles whose chunks meet a window of the lattice. */
  runsIn([left, top, right, bottom]) {
    const { boxes } = this, runs = [], chunks = boxes.length / 4;
    let from = -1;
    for (let chunk = 0; chunk <= chunks; chunk++) {
      const k = 4 * chunk;
      const meets = chunk < chunks && boxes[k] <= right && boxes[k + 1] <= bottom && boxes[k + 2] >= left && boxes[k + 3] >= top;
      if (meets && from < 0) from = chunk;
      if (!meets && from >= 0) {
        runs.push([CHUNK * from, Math.min(CHUNK * chunk, this.about.triangles)]);
        from = -1;
      }
    }
    return runs;
  }

  /** Return the number of the triangle at a place of the lattice; -1 if there is none. */
  find(x, y) {
    const { boxes, corners, x: xs, y: ys } = this;
    for (let k = 0; k < boxes.length; k += 4) {
      if (x < boxes[k] || y < boxes[k + 1] || x > boxes[k + 2] || y > boxes[k + 3]) continue;
      const end = Math.min((k / 4 + 1) * CHUNK, this.about.triangles);
      for (let t = (k / 4) * CHUNK; t < end; t++) {
        const a = corners[3 * t], b = corners[3 * t + 1], c = corners[3 * t + 2];
        const ab = (xs[b] - xs[a]) * (y - ys[a]) - (ys[b] - ys[a]) * (x - xs[a]);
        const bc = (xs[c] - xs[b]) * (y - ys[b]) - (ys[c] - ys[b]) * (x - xs[b]);
        const ca = (xs[a] - xs[c]) * (y - ys[c]) - (ys[a] - ys[c]) * (x - xs[c]);
        if ((ab >= 0 && bc >= 0 && ca >= 0) || (ab <= 0 && bc <= 0 && ca <= 0)) return t;
      }
    }
    return -1;
  }

  /** Return the value of a column of nodes at a place in a triangle; null if a corner has none. */
  between(column, t, px, py) {
    const { x, y } = this, [i, j, k] = this.corners.subarray(3 * t, 3 * t + 3);
    const all = (x[j] - x[i]) * (y[k] - y[i]) - (y[j] - y[i]) * (x[k] - x[i]);
    const ofJ = ((px - x[i]) * (y[k] - y[i]) - (py - y[i]) * (x[k] - x[i])) / all;
    const ofK = ((x[j] - x[i]) * (py - y[i]) - (y[j] - y[i]) * (px - x[i])) / all;
    const [a, b, c] = [i, j, k].map((node) => valueAt(column, node));
    return a === null || b === null || c === null ? null : a + (b - a) * ofJ + (c - a) * ofK;
  }

  /** Return the measures of a triangle that follow from its corners. */
  measure(t) {
    const { corners, x, y, about } = this, [a, b, d, e] = about.plane;
    const [i, j, k] = [corners[3 * t], corners[3 * t + 1], corners[3 * t + 2]];
    const side = (p, q) => Math.hypot(a * (x[p] - x[q]) + b * (y[p] - y[q]), d * (x[p] - x[q]) + e * (y[p] - y[q]));
    const [ab, ca, bc] = [side(i, j), side(j, k), side(k, i)].sort((p, q) => p - q);
    const steps = Math.abs((x[j] - x[i]) * (y[k] - y[i]) - (y[j] - y[i]) * (x[k] - x[i])) / 2;
    const plane = steps * Math.abs(a * e - b * d);
    return {
      area: steps * about.stepArea, ab, bc, ca, ki: (2 * ca * bc) / (ab + bc + ca),
      min_angle: (Math.asin(Math.min(1, (2 * plane) / (ca * bc))) * 180) / Math.PI,
      shape: (4 * Math.sqrt(3) * plane) / (ab * ab + bc * bc + ca * ca),
    };
  }

  /** Return the ids of nodes and triangles in the file. */
  async ids() {
    this.known ??= this.readIds();
    return this.known;
  }

  async readIds() {
    const { x, y, corners, about } = this;
    const [nodeBytes, triangleBytes] = await Promise.all([this.block("nodeIds"), this.block("triangleIds")]);
    // Expected are nodes row by row, and triangles by their first node.
    const node = joinSigned(nodeBytes, 0, about.nodes), triangle = joinSigned(triangleBytes, 0, about.triangles);
    const order = Uint32Array.from({ length: about.nodes }, (_, i) => i).sort((p, q) => y[p] - y[q] || x[p] - x[q] || p - q);
    order.forEach((each, rank) => { node[each] += rank; });
    const start = new Uint32Array(greatest(node) + 2);
    for (let t = 0; t < about.triangles; t++) start[node[corners[3 * t]] + 1]++;
    for (let i = 1; i < start.length; i++) start[i] += start[i - 1];
    for (let t = 0; t < about.triangles; t++) triangle[t] += start[node[corners[3 * t]]]++;
    return { node, triangle };
  }

  /** Return the outline and the breaklines: pairs of nodes. */
  async lines() {
    this.ends ??= (async () => {
      const bytes = await this.block("lines"), count = this.about.lines;
      const from = addUp(joinSigned(bytes, 0, count)), to = addUp(joinSigned(bytes, 4 * count, count));
      const pairs = new Uint32Array(2 * count);
      for (let i = 0; i < count; i++) { pairs[2 * i] = from[i]; pairs[2 * i + 1] = to[i]; }
      return pairs;
    })();
    return this.ends;
  }

  /** Return every edge once: those of a triangle that rise, and those of the outline that fall. */
  async edges() {
    const { corners, about } = this, outline = await this.lines();
    const pairs = new Uint32Array(6 * about.triangles), starts = new Uint32Array(this.boxes.length / 4 + 1);
    const falling = new Set();
    for (let i = 0; i < about.lines - about.breaklines; i++) falling.add(outline[2 * i] * about.nodes + outline[2 * i + 1]);
    let count = 0;
    for (let t = 0; t < about.triangles; t++) {
      if (t % CHUNK === 0) starts[t / CHUNK] = count;
      for (let k = 0; k < 3; k++) {
        const from = corners[3 * t + k], to = corners[3 * t + ((k + 1) % 3)];
        if (from < to || falling.has(from * about.nodes + to) || falling.has(to * about.nodes + from)) {
          pairs[2 * count] = from;
          pairs[2 * count + 1] = to;
          count++;
        }
      }
    }
    starts[starts.length - 1] = count;
    return { pairs: pairs.subarray(0, 2 * count), starts };
  }
}

function greatest(numbers) {
  let most = -1;
  for (const each of numbers) if (each > most) most = each;
  return most;
}

/** Take runs of at most `most` triangles from the front of a list. */
function takeRuns(runs, most) {
  const taken = [];
  let room = Math.floor(most / CHUNK) * CHUNK;
  while (runs.length && room > 0) {
    const [from, to] = runs[0], end = Math.min(to, from + room);
    taken.push([from, end]);
    room -= end - from;
    if (end === to) runs.shift();
    else runs[0] = [end, to];
  }
  return taken;
}
