/* Puts the finished pictures on the canvas: base map, mesh, the other side of the swipe, the chosen
   triangle. This is quick, so it is done anew for every frame. */
class Screen {
  constructor(gl, canvas, view, programs) {
    this.gl = gl;
    this.canvas = canvas;
    this.view = view;
    this.program = programs.picture;
    this.buffer = gl.createBuffer();
    this.image = null; // { texture, affine: from its 0..1 to the lattice }
    this.basemap = null;
  }

  async addImage(about) {
    const { gl } = this, bytes = await readBlock("image");
    const bitmap = await createImageBitmap(new Blob([bytes], { type: about.type }), { premultiplyAlpha: "premultiply" });
    this.image = { texture: makeTexture(gl, gl.LINEAR), affine: about.affine };
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
  }

  get ratio() {
    return devicePixelRatio || 1;
  }

  /** Draw a frame: `left` and `right` are painters or "image"; `split` is a share of the width. */
  draw(left, right, split, opacity, gain, chosen) {
    const { gl, canvas, view, ratio } = this, [width, height] = view.size;
    const w = Math.round(width * ratio), h = Math.round(height * ratio);
    if (canvas.width !== w) canvas.width = w;
    if (canvas.height !== h) canvas.height = h;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, w, h);
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.basemap?.draw(view, ratio, this.program);
    const at = Math.round(split * w);
    this.drawSide(left, 0, right ? at : w, h, opacity);
    if (right) this.drawSide(right, at, w, h, opacity, right === "image" ? gain : 1);
    gl.disable(gl.SCISSOR_TEST);
    if (chosen) this.drawChosen(chosen);
    gl.disable(gl.BLEND);
  }

  drawSide(side, from, to, height, opacity, gain = 1) {
    const { gl } = this;
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(from, 0, Math.max(to - from, 0), height);
    gl.useProgram(this.program.program);
    gl.uniform1f(this.program.uniforms.opacity, opacity);
    gl.uniform1f(this.program.uniforms.gain, gain);
    if (side === "image") {
      this.drawImage();
      return;
    }
    const { shown, whole } = side;
    if (!shown) return;
    if (whole && opacity === 1 && !side.shows(shown, this.view, this.ratio)) this.drawShot(whole);
    this.drawShot(shown);
  }

  /** Draw the picture of a mesh where it belongs in the window. */
  drawShot(shot) {
    const { gl, view } = this, [width, height] = view.size, { margin, size: [w, h], state } = shot;
    const [x, y] = view.toScreen(state.x, state.y), scale = state.unit / view.unit;
    const left = x - (w / 2 + margin) * scale, right = x + (w / 2 + margin) * scale;
    const top = y - (h / 2 + margin) * scale, bottom = y + (h / 2 + margin) * scale;
    const toClip = (px, py) => [(2 * px) / width - 1, 1 - (2 * py) / height];
    const [x0, y0] = toClip(left, bottom), [x1, y1] = toClip(right, top);
    gl.bindTexture(gl.TEXTURE_2D, shot.picture.texture);
    const filter = scale === 1 ? gl.NEAREST : gl.LINEAR;
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filter);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, filter);
    drawPicture(gl, shot.picture.texture, [x0, y0, 0, 0, x1, y0, 1, 0, x0, y1, 0, 1, x1, y1, 1, 1], this.buffer, gl.TRIANGLE_STRIP);
  }

  drawImage() {
    const { gl, view } = this, [width, height] = view.size, [a, b, c, d, e, f] = this.image.affine;
    const corners = [[0, 0], [1, 0], [0, 1], [1, 1]].flatMap(([u, v]) => {
      const [x, y] = view.toScreen(a * u + b * v + c, d * u + e * v + f);
      return [(2 * x) / width - 1, 1 - (2 * y) / height, u, v];
    });
    drawPicture(gl, this.image.texture, corners, this.buffer, gl.TRIANGLE_STRIP);
  }

  /** Draw the sides of the chosen triangle. */
  drawChosen({ painter, triangle }) {
    const { gl, view } = this, { mesh } = painter, sides = new Int32Array(12);
    for (let k = 0; k < 3; k++) {
      const from = mesh.corners[3 * triangle + k], to = mesh.corners[3 * triangle + ((k + 1) % 3)];
      sides.set([mesh.x[from], mesh.y[from], mesh.x[to], mesh.y[to]], 4 * k);
    }
    const buffer = makeBuffer(gl, sides), shot = { state: view.state(), size: view.size, margin: 0, ratio: this.ratio };
    painter.drawLines(view, buffer, [[0, 3]], 4.5 * this.ratio, [1, 1, 1, 1], shot);
    painter.drawLines(view, buffer, [[0, 3]], 2.5 * this.ratio, [0.83, 0, 0.42, 1], shot);
    gl.deleteBuffer(buffer);
  }
}
