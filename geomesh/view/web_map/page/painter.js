/* Draws one mesh into pictures, in slices that each take a part of a frame, so that no frame waits
   for a slow GPU. The last finished picture is shown, moved, until the next one is finished. */
const SLICE_TIME = 60; // milliseconds
const FIRST_SLICE = 100000; // triangles
const LEAST_SLICE = 50000;
const MARGIN = 0.1; // of the window, drawn around it for the next pan
const EDGE_ROOM = 3; // CSS pixels between edges below which they would hide the mesh

class Painter {
  constructor(gl, mesh, programs, smoothed) {
    this.gl = gl;
    this.mesh = mesh;
    this.programs = programs;
    this.pictures = [new Picture(gl, smoothed), new Picture(gl, smoothed)];
    this.overview = new Picture(gl, smoothed);
    this.shown = null; // the finished picture, and what it shows
    this.whole = null; // the same of the overview
    this.job = null;
    this.slice = FIRST_SLICE;
    this.cost = Infinity; // milliseconds for the last picture
    this.column = null;
    this.upload();
  }

  upload() {
    const { gl, mesh } = this, { nodes, owners, index } = shareVertices(mesh), vertices = nodes.length;
    this.nodes = nodes;
    this.owners = owners;
    const steps = new Int32Array(2 * vertices);
    for (let i = 0; i < vertices; i++) {
      steps[2 * i] = mesh.x[nodes[i]];
      steps[2 * i + 1] = mesh.y[nodes[i]];
    }
    this.steps = makeBuffer(gl, steps);
    this.index = makeBuffer(gl, index, gl.ELEMENT_ARRAY_BUFFER);
    this.colors = { flat: this.colorBuffer(mesh.colors, this.owners) };
    if (mesh.surface) this.colors.smooth = this.colorBuffer(mesh.surface, this.nodes);
    this.codes = null;
  }

  colorBuffer(colors, rows) {
    const bytes = new Uint8Array(4 * rows.length);
    for (let i = 0; i < rows.length; i++) {
      const k = 3 * rows[i];
      bytes[4 * i] = colors[k];
      bytes[4 * i + 1] = colors[k + 1];
      bytes[4 * i + 2] = colors[k + 2];
    }
    return makeBuffer(this.gl, bytes);
  }

  /** Draw from now on by a column, or by colours if there is none. */
  setColumn(column) {
    const { gl } = this;
    if (this.codes) gl.deleteBuffer(this.codes);
    this.codes = null;
    this.column = column;
    if (!column) return;
    const rows = column.at === "nodes" ? this.nodes : this.owners, codes = new Uint16Array(rows.length);
    for (let i = 0; i < rows.length; i++) codes[i] = column.codes[rows[i]];
    this.codes = makeBuffer(gl, codes);
  }

  /** Work out how light falls on the surface, if it has heights. */
  async prepareRelief(view) {
    const { height } = this.mesh.about;
    if (!height || this.light) return;
    const column = await readColumn(this.mesh, height.key), heights = new Float64Array(this.mesh.about.nodes);
    for (let node = 0; node < heights.length; node++) heights[node] = (valueAt(column, node) ?? NaN) * height.metres;
    const light = lightOf(this.mesh, view, heights);
    this.light = makeBuffer(this.gl, Uint8Array.from(this.nodes, (node) => light[node]));
  }

  async prepareLines(wanted) {
    const { gl, mesh } = this;
    const ends = (pairs) => {
      const steps = new Int32Array(2 * pairs.length);
      for (let i = 0; i < pairs.length; i++) {
        steps[2 * i] = mesh.x[pairs[i]];
        steps[2 * i + 1] = mesh.y[pairs[i]];
      }
      return makeBuffer(gl, steps);
    };
    if (wanted.breaklines && !this.lines) {
      const pairs = await mesh.lines();
      this.lines = { buffer: ends(pairs), count: pairs.length / 2 };
    }
    if (wanted.edges && !this.edges) {
      const { pairs, starts } = await mesh.edges();
      this.edges = { buffer: ends(pairs), starts };
    }
  }

  /** Draw anew: the style has changed. */
  restyle() {
    this.abandon();
    if (this.shown) this.shown.stale = true;
    this.whole = null;
  }

  abandon() {
    this.job = null;
  }

  /** Whether a picture shows just what the window shows now. */
  shows(shot, view, ratio) {
    const [width, height] = view.size;
    return Boolean(shot) && !shot.stale && sameState(shot.state, view)
      && shot.size[0] === width && shot.size[1] === height && shot.ratio === ratio;
  }

  /** Do a part of the work, if the GPU is done with the last one. Return whether there is more.

      A new picture is begun only if `mayStart`, because it costs time while the map is moved. */
  advance(view, ratio, style, mayStart) {
    if (!this.isFree()) return true;
    if (this.job?.isDrawn) this.finish();
    const isCurrent = this.shows(this.shown, view, ratio);
    if (this.job && !(this.job.isOverview ? isCurrent : this.shows(this.job, view, ratio))) this.abandon();
    if (!this.job) {
      if (isCurrent && this.whole) return false;
      if (!mayStart) return true;
      this.start(view, isCurrent ? view.fitted(this.mesh.about.box) : view.state(), ratio, isCurrent);
    }
    this.drawSlice(view, style);
    return true;
  }

  /** Whether the GPU has drawn the last slice. The next one is as large as time allows. */
  isFree() {
    const { gl } = this;
    if (!this.fence) return true;
    if (gl.getSyncParameter(this.fence, gl.SYNC_STATUS) !== gl.SIGNALED) return false;
    gl.deleteSync(this.fence);
    this.fence = null;
    const took = Math.max(performance.now() - this.sliceBegun, 1);
    if (this.sliced > this.slice / 2 || took > SLICE_TIME) {
      this.slice = Math.max(LEAST_SLICE, this.slice * Math.min(4, Math.max(0.5, SLICE_TIME / took)));
    }
    return true;
  }

  /** Begin a picture. The overview, of the whole mesh, is shown where the other one ends. */
  start(view, state, ratio, isOverview) {
    const [width, height] = view.size;
    const margin = isOverview ? 0 : Math.round(MARGIN * Math.max(width, height));
    const picture = isOverview ? this.overview : this.pictures.find((each) => each !== this.shown?.picture);
    const runs = this.mesh.runsIn(view.window(margin, state));
    this.job = { picture, state, size: [width, height], ratio, margin, runs, isOverview, begun: performance.now() };
    picture.begin(Math.round((width + 2 * margin) * ratio), Math.round((height + 2 * margin) * ratio));
  }

  finish() {
    const { job } = this;
    this.job = null;
    if (job.isOverview) {
      this.whole = job;
      return;
    }
    this.shown = job;
    this.cost = performance.now() - job.begun;
  }

  drawSlice(view, style) {
    const { gl, job } = this;
    this.sliceBegun = performance.now();
    job.picture.bind();
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    // Nobody can move the map before there is one.
    const runs = takeRuns(job.runs, this.shown ? this.slice : Infinity);
    this.sliced = runs.reduce((sum, [from, to]) => sum + to - from, 0);
    if (runs.length) this.drawTriangles(view, runs, style);
    if (!job.runs.length) {
      this.drawMarks(view, style);
      job.picture.finish();
      job.isDrawn = true;
    }
    gl.disable(gl.BLEND);
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
  }

  /** Use a program with the places of a job's picture. */
  use(view, { program, uniforms }, { state, size, margin }) {
    const { gl } = this, [a, b, d, e] = view.matrix(state.unit);
    const w = size[0] + 2 * margin, h = size[1] + 2 * margin;
    const left = Math.floor(state.x), top = Math.floor(state.y);
    gl.useProgram(program);
    gl.uniformMatrix2fv(uniforms.turn, false, [(2 * a) / w, (-2 * d) / h, (2 * b) / w, (-2 * e) / h]);
    gl.uniform2i(uniforms.origin, left, top);
    gl.uniform2f(uniforms.rest, state.x - left, state.y - top);
  }

  drawTriangles(view, runs, style) {
    const { gl, column, mesh } = this;
    const isSmooth = column ? column.at === "nodes" : style.smooth && mesh.surface;
    const drawing = isSmooth ? this.programs.smooth : this.programs.flat, { uniforms } = drawing;
    this.use(view, drawing, this.job);
    gl.uniform1i(uniforms.byValue, style.byValue ? 1 : 0);
    gl.uniform1f(uniforms.gain, style.bright ? mesh.about.gain : 1);
    // Always another texture than that of the picture which is drawn.
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, column?.texts ? style.palette : style.ramp);
    if (style.byValue) {
      gl.uniform1i(uniforms.classes, column?.texts ? style.classes : 0);
      const [low, high] = style.cut, first = column ? column.low : 0, step = column ? column.step : 1;
      if (column?.texts) gl.uniform2f(uniforms.cut, 0, 1);
      else gl.uniform2f(uniforms.cut, (low - first) / step, (256 * step) / (high - low || step));
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, this.steps);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 2, gl.INT, 0, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, isSmooth && !column ? this.colors.smooth : this.colors.flat);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 4, gl.UNSIGNED_BYTE, true, 0, 0);
    if (this.codes) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.codes);
      gl.enableVertexAttribArray(2);
      gl.vertexAttribIPointer(2, 1, gl.UNSIGNED_SHORT, 0, 0);
    } else {
      gl.vertexAttribI4ui(2, NULL, 0, 0, 0); // a mesh without this column
    }
    if (this.light && style.relief && (!column || column.key === mesh.about.height.key)) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.light);
      gl.enableVertexAttribArray(3);
      gl.vertexAttribPointer(3, 1, gl.UNSIGNED_BYTE, true, 0, 0);
      gl.uniform1f(uniforms.brightness, 255 / FLAT);
    } else {
      gl.vertexAttrib1f(3, 1);
      gl.uniform1f(uniforms.brightness, 1);
    }
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.index);
    for (const [from, to] of runs) gl.drawElements(gl.TRIANGLES, 3 * (to - from), gl.UNSIGNED_INT, 12 * from);
    for (const place of [0, 1, 2, 3]) gl.disableVertexAttribArray(place);
  }

  /** Draw edges, outline, breaklines and nodes over the triangles. */
  drawMarks(view, style) {
    const { gl, job, mesh } = this, { ratio } = job;
    const [a, b, d, e] = view.matrix(job.state.unit);
    const seen = mesh.runsIn(view.window(job.margin, job.state));
    const triangles = seen.reduce((sum, [from, to]) => sum + to - from, 0);
    // Edges and nodes are shown where they have room.
    const [left, top, right, bottom] = mesh.about.box, pixels = Math.abs(a * e - b * d) * (right - left) * (bottom - top);
    const room = Math.sqrt(pixels / Math.max(mesh.about.triangles, 1));
    const strength = Math.min(1, Math.max(0, (room - EDGE_ROOM) / 6)) || (triangles < 2000 ? 1 : 0);
    if (style.edges && this.edges && strength) {
      const runs = seen.map(([from, to]) => [from / CHUNK, Math.ceil(to / CHUNK)].map((chunk) => this.edges.starts[chunk]));
      this.drawLines(view, this.edges.buffer, runs, 1 * ratio, [0.05, 0.05, 0.05, 0.7 * strength]);
    }
    if (style.breaklines && this.lines) {
      const outline = this.lines.count - mesh.about.breaklines;
      this.drawLines(view, this.lines.buffer, [[0, outline]], 1.5 * ratio, [0.05, 0.05, 0.05, 1]);
      this.drawLines(view, this.lines.buffer, [[outline, this.lines.count]], 2.5 * ratio, [0.9, 0.2, 0.05, 1]);
    }
    if (style.nodes && strength) {
      const { uniforms } = this.programs.nodes;
      this.use(view, this.programs.nodes, job);
      gl.uniform4f(uniforms.color, 0.85, 0.1, 0.1, strength);
      gl.uniform1f(uniforms.width, ratio * Math.min(7, Math.max(3, room / 5)));
      gl.bindBuffer(gl.ARRAY_BUFFER, this.steps);
      gl.enableVertexAttribArray(0);
      gl.vertexAttribIPointer(0, 2, gl.INT, 0, 0);
      gl.drawArrays(gl.POINTS, 0, mesh.about.nodes);
      gl.disableVertexAttribArray(0);
    }
  }

  drawLines(view, buffer, runs, width, color, shot = this.job) {
    const { gl } = this, { uniforms } = this.programs.lines;
    this.use(view, this.programs.lines, shot);
    const [w, h] = shot.size.map((side) => Math.round((side + 2 * shot.margin) * shot.ratio));
    gl.uniform2f(uniforms.size, w, h);
    gl.uniform1f(uniforms.width, width);
    gl.uniform4fv(uniforms.color, color);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    for (const place of [0, 1]) {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribDivisor(place, 1);
    }
    for (const [from, to] of runs) {
      if (to <= from) continue;
      gl.vertexAttribIPointer(0, 2, gl.INT, 16, 16 * from);
      gl.vertexAttribIPointer(1, 2, gl.INT, 16, 16 * from + 8);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, to - from);
    }
    for (const place of [0, 1]) {
      gl.vertexAttribDivisor(place, 0);
      gl.disableVertexAttribArray(place);
    }
  }
}
