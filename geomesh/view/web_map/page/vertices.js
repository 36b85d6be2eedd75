/* Vertices for the GPU. */

/** Return the corners of triangles as vertices of which the last one of each triangle is its own: a
    "flat" colour is that of the last vertex. About half of the nodes have to be there twice; all
    nodes come first, in their order. `nodes` and `owners` are the node and the triangle of each. */
function shareVertices({ corners, about }) {
  const count = about.triangles, index = new Uint32Array(3 * count), free = new Uint8Array(about.nodes).fill(1);
  const nodes = new Uint32Array(about.nodes + count), owners = new Uint32Array(about.nodes + count);
  let vertices = about.nodes;
  for (let i = 0; i < vertices; i++) nodes[i] = i;
  for (let t = 0, k = 0; t < count; t++, k += 3) {
    let a = corners[k], b = corners[k + 1], c = corners[k + 2];
    if (!free[c]) {
      if (free[a]) [a, b, c] = [b, c, a];
      else if (free[b]) [a, b, c] = [c, a, b];
      else {
        nodes[vertices] = c;
        c = vertices++;
      }
    }
    if (c < about.nodes) free[c] = 0;
    owners[c] = t;
    index[k] = a;
    index[k + 1] = b;
    index[k + 2] = c;
  }
  return { nodes: nodes.subarray(0, vertices), owners: owners.subarray(0, vertices), index };
}
