/* Relief: how much light from the north-west falls on the surface at each node. */
const FLAT = 170; // the light on flat ground, of 255
const SUN = [-0.5, -0.5, Math.SQRT1_2]; // to the east, to the south, up

/** Return the light at each node, 0 to 255, from heights in metres; flat where there is none. */
function lightOf(mesh, view, heights) {
  const { x, y, corners } = mesh, [a, b, d, e] = view.matrix(1), { metres } = view.frame, count = mesh.about.nodes;
  const normals = new Float32Array(3 * count);
  for (let k = 0; k < corners.length; k += 3) {
    const [i, j, l] = [corners[k], corners[k + 1], corners[k + 2]];
    const ux = x[j] - x[i], uy = y[j] - y[i], vx = x[l] - x[i], vy = y[l] - y[i];
    const px = (a * ux + b * uy) * metres, py = (d * ux + e * uy) * metres, pz = heights[j] - heights[i];
    const qx = (a * vx + b * vy) * metres, qy = (d * vx + e * vy) * metres, qz = heights[l] - heights[i];
    let nx = py * qz - pz * qy, ny = pz * qx - px * qz, nz = px * qy - py * qx;
    if (!(Math.abs(nz) > 0) || !Number.isFinite(nx + ny)) continue;
    if (nz < 0) [nx, ny, nz] = [-nx, -ny, -nz];
    for (const node of [i, j, l]) {
      normals[3 * node] += nx;
      normals[3 * node + 1] += ny;
      normals[3 * node + 2] += nz;
    }
  }
  const light = new Uint8Array(count).fill(FLAT);
  for (let node = 0; node < count; node++) {
    const nx = normals[3 * node], ny = normals[3 * node + 1], nz = normals[3 * node + 2], length = Math.hypot(nx, ny, nz);
    if (!length) continue;
    const falls = (nx * SUN[0] + ny * SUN[1] + nz * SUN[2]) / length;
    light[node] = Math.max(40, Math.min(255, (FLAT * falls) / SUN[2]));
  }
  return light;
}
