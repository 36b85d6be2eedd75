/* A mesh as one layer of deck.gl. It comes after deck.gl and after codec.js of geomesh's own page,
   so that both read the same blocks in the same way. */
const about = JSON.parse($("head").textContent);

/** Polygons with colours of their own, which deck.gl takes without looking at each. */
function solidPolygons(x, y, corners, colors) {
  const places = new Float32Array(2 * corners.length), bytes = new Uint8Array(4 * corners.length).fill(255);
  const indices = new Uint32Array(corners.length), starts = new Uint32Array(corners.length / 3 + 1);
  for (let k = 0; k < corners.length; k++) {
    places[2 * k] = x[corners[k]] / 256;
    places[2 * k + 1] = y[corners[k]] / 256;
    bytes.set(colors.subarray(3 * Math.floor(k / 3), 3 * Math.floor(k / 3) + 3), 4 * k);
    indices[k] = k;
  }
  for (let t = 0; t < starts.length; t++) starts[t] = 3 * t;
  return new deck.SolidPolygonLayer({
    id: "mesh",
    data: {
      length: corners.length / 3,
      startIndices: starts,
      attributes: {
        getPolygon: { value: places, size: 2 },
        getFillColor: { value: bytes, size: 4, normalized: true },
        indices: { value: indices, size: 1 },
      },
    },
    coordinateSystem: deck.COORDINATE_SYSTEM.CARTESIAN,
    _normalize: false,
    positionFormat: "XY",
    filled: true,
    extruded: false,
  });
}

/** One instance of a mesh whose triangles share no vertices, because each has its own colour. */
function simpleMesh(x, y, corners, colors) {
  const positions = new Float32Array(3 * corners.length), shades = new Float32Array(3 * corners.length);
  for (let k = 0; k < corners.length; k++) {
    positions[3 * k] = x[corners[k]] / 256;
    positions[3 * k + 1] = y[corners[k]] / 256;
    for (let band = 0; band < 3; band++) shades[3 * k + band] = colors[3 * Math.floor(k / 3) + band] / 255;
  }
  return new deck.SimpleMeshLayer({
    id: "mesh",
    data: [{}],
    mesh: {
      header: { vertexCount: corners.length },
      attributes: { positions: { value: positions, size: 3 }, colors: { value: shades, size: 3 } },
    },
    getPosition: [0, 0, 0],
    getColor: [255, 255, 255],
    coordinateSystem: deck.COORDINATE_SYSTEM.CARTESIAN,
    material: { ambient: 1, diffuse: 0, shininess: 0, specularColor: [0, 0, 0] },
  });
}

/** Wait for the GPU, and return whether the middle of the map has been drawn. */
function isDrawn() {
  const gl = document.querySelector("canvas").getContext("webgl2"), pixel = new Uint8Array(4);
  gl.readPixels(gl.drawingBufferWidth / 2, gl.drawingBufferHeight / 2, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
  return pixel[3] > 0;
}

const times = { start: performance.now() };
window.bench = {
  times,
  ready: (async () => {
    const [nodes, triangles, shades] = await Promise.all(["nodes", "triangles", "colors"].map(readBlock));
    const x = addUp(joinSigned(nodes, 0, about.nodes)), y = addUp(joinSigned(nodes, 4 * about.nodes, about.nodes));
    const corners = joinBelowHighest(triangles), colors = joinColors(shades);
    times.decoded = performance.now();
    const [left, top, right, bottom] = about.box.map((side) => side / 256);
    const layer = { solidPolygons, simpleMesh }[about.layer](x, y, corners, colors);
    times.built = performance.now();
    await new Promise((done, failed) => {
      new deck.Deck({
        parent: document.body,
        views: new deck.OrthographicView({ flipY: true }),
        initialViewState: {
          target: [(left + right) / 2, (top + bottom) / 2, 0],
          zoom: Math.log2(Math.min(innerWidth / (right - left), innerHeight / (bottom - top)) / 1.06),
        },
        controller: true,
        layers: [layer],
        onError: failed,
        onAfterRender: () => { if (!times.firstFrame && isDrawn()) done(times.firstFrame = performance.now()); },
      });
    });
  })(),
  /** Wait until the last frame that was asked for has been drawn. */
  idle: () => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => { isDrawn(); done(); }))),
};
