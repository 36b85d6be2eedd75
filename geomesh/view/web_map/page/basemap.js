/* Web tiles under the mesh, if the page was made with the address of some: bent to its CRS. */
const BEND = 8; // squares along a side of a tile
const MOST_TILES = 200;
const DEEPEST = 19;

class Basemap {
  constructor(gl, frame, address, changed) {
    this.gl = gl;
    this.places = frame.mercator;
    this.address = address;
    this.changed = changed;
    this.tiles = new Map();
    this.buffer = gl.createBuffer();
  }

  /** Lattice place of a place of Web Mercator, both 0 to 1. */
  place(u, v) {
    const { box: [u0, v0, u1, v1], side, x, y } = this.places, across = (u - u0) / (u1 - u0), down = (v - v0) / (v1 - v0);
    return [interpolate(x, side, across, down), interpolate(y, side, across, down)];
  }

  /** Return the tiles in the window: zoom, column, row. */
  wanted(view, ratio) {
    const [u0, v0, u1, v1] = this.places.box, u = (u0 + u1) / 2, v = (v0 + v1) / 2, part = (u1 - u0) / 64;
    const [ax, ay] = view.toScreen(...this.place(u, v)), [bx, by] = view.toScreen(...this.place(u + part, v));
    const world = Math.hypot(ax - bx, ay - by) / part;
    const z = Math.max(0, Math.min(DEEPEST, Math.round(Math.log2((world * ratio) / 256)))), count = 2 ** z;
    const [width, height] = view.size, tiles = [];
    for (let row = Math.max(0, Math.floor(v0 * count)); row < Math.min(count, v1 * count); row++) {
      for (let col = Math.floor(u0 * count); col < u1 * count; col++) {
        const corners = [[col, row], [col + 1, row], [col, row + 1], [col + 1, row + 1]].map(([i, j]) => view.toScreen(...this.place(i / count, j / count)));
        const xs = corners.map(([x]) => x), ys = corners.map(([, y]) => y);
        const isSeen = Math.max(...xs) > 0 && Math.min(...xs) < width && Math.max(...ys) > 0 && Math.min(...ys) < height;
        if (isSeen && tiles.length < MOST_TILES) tiles.push([z, col, row]);
      }
    }
    return tiles;
  }

  texture(z, col, row) {
    const { gl } = this, name = `${z}/${col}/${row}`, count = 2 ** z;
    if (!this.tiles.has(name)) {
      this.tiles.set(name, null);
      const image = new Image();
      image.crossOrigin = "anonymous";
      image.onload = () => {
        const texture = makeTexture(gl, gl.LINEAR);
        gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
        this.tiles.set(name, texture);
        this.changed();
      };
      image.src = this.address.replace("{z}", z).replace("{x}", ((col % count) + count) % count).replace("{y}", row);
    }
    return this.tiles.get(name);
  }

  draw(view, ratio, program) {
    const { gl } = this, [width, height] = view.size;
    gl.useProgram(program.program);
    gl.uniform1f(program.uniforms.opacity, 1);
    gl.uniform1f(program.uniforms.gain, 1);
    for (const [z, col, row] of this.wanted(view, ratio)) {
      const texture = this.texture(z, col, row), count = 2 ** z, corners = [];
      if (!texture) continue;
      const add = (i, j) => {
        const [x, y] = view.toScreen(...this.place((col + i / BEND) / count, (row + j / BEND) / count));
        corners.push((2 * x) / width - 1, 1 - (2 * y) / height, i / BEND, j / BEND);
      };
      for (let j = 0; j < BEND; j++) {
        for (let i = 0; i < BEND; i++) for (const [k, l] of [[0, 0], [1, 0], [0, 1], [1, 0], [0, 1], [1, 1]]) add(i + k, j + l);
      }
      drawPicture(gl, texture, corners, this.buffer, gl.TRIANGLES);
    }
  }
}

function drawPicture(gl, texture, corners, buffer, mode) {
  gl.activeTexture(gl.TEXTURE0);
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(corners), gl.STREAM_DRAW);
  gl.enableVertexAttribArray(0);
  gl.vertexAttribPointer(0, 4, gl.FLOAT, false, 0, 0);
  gl.drawArrays(mode, 0, corners.length / 4);
  gl.disableVertexAttribArray(0);
}
