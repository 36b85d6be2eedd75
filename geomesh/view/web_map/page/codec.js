/* Blocks of numbers: base64 of zlib in <script type="text/plain">, unpacked when first asked for. */
const $ = (id) => document.getElementById(id);

const parsed = document.readyState === "loading"
  ? new Promise((done) => addEventListener("DOMContentLoaded", done, { once: true }))
  : Promise.resolve();

function fromBase64(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

/** Return the bytes of a block. Its text is removed, so a block can be read once. */
async function readBlock(id) {
  if (!$(id)) await parsed; // later blocks come after the script
  const packed = fromBase64($(id).textContent);
  $(id).remove();
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Return 16-bit numbers of which all low bytes come first. */
function joinPlanes16(bytes) {
  const count = bytes.length / 2, numbers = new Uint16Array(count);
  for (let i = 0; i < count; i++) numbers[i] = bytes[i] | (bytes[count + i] << 8);
  return numbers;
}

/** Return `count` signed numbers from byte planes that start at `start`: 2 d, or -2 d - 1. */
function joinSigned(bytes, start, count) {
  const numbers = new Int32Array(count);
  const second = start + count, third = second + count, fourth = third + count;
  for (let i = 0; i < count; i++) {
    const code = bytes[start + i] | (bytes[second + i] << 8) | (bytes[third + i] << 16) | (bytes[fourth + i] << 24);
    numbers[i] = (code >>> 1) ^ -(code & 1);
  }
  return numbers;
}

/** Replace each difference by the sum up to it. */
function addUp(numbers) {
  for (let i = 1; i < numbers.length; i++) numbers[i] += numbers[i - 1];
  return numbers;
}

/** Return ids that are stored as distances below the next new id. */
function joinBelowHighest(bytes) {
  const count = bytes.length / 4, ids = new Uint32Array(count);
  const second = count, third = 2 * count, fourth = 3 * count;
  for (let i = 0, highest = 0; i < count; i++) {
    const below = bytes[i] | (bytes[second + i] << 8) | (bytes[third + i] << 16) | (bytes[fourth + i] << 24);
    ids[i] = highest - below;
    if (below === 0) highest++;
  }
  return ids;
}

/** Return colours, three bytes each, stored as green, red - green and blue - green. */
function joinColors(bytes) {
  const count = bytes.length / 3, colors = new Uint8Array(bytes.length);
  for (let i = 0; i < count; i++) {
    const green = bytes[i];
    colors[3 * i] = green + bytes[count + i];
    colors[3 * i + 1] = green;
    colors[3 * i + 2] = green + bytes[2 * count + i];
  }
  return colors;
}
