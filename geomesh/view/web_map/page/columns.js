/* Attributes as 16-bit codes: those in the page, and measures that follow from the geometry. */
const NULL = 65535;
const MEASURES = {
  area: "", ab: "px", bc: "px", ca: "px", ki: "px", min_angle: "°", shape: "",
};

/** Return a number as text: whole numbers in full, others with six digits. */
function format(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(6)));
}

function addColumns(mesh) {
  mesh.about.columns.forEach((about, number) => {
    mesh.columns.set(about.key, { ...about, block: `column${number}` });
  });
  for (const name of mesh.about.measured) {
    if (name in MEASURES && !mesh.columns.has(name)) {
      const unit = name === "area" ? mesh.about.areaUnit : MEASURES[name];
      mesh.columns.set(name, { name, at: "triangles", kind: "number", texts: null, unit, measured: true });
    }
  }
}

/** Return a column with its codes. */
async function readColumn(mesh, key) {
  const column = mesh.columns.get(key);
  if (!column) return null;
  column.reading ??= (async () => {
    if (column.measured) measureColumn(mesh, column);
    else column.codes = joinPlanes16(await mesh.block(column.block));
    if (column.near) addExpected(column, mesh.colors);
    return column;
  })();
  return column.reading;
}

/** Add to each code what its colour lets expect, as in `geomesh.view.web_map.columns`. */
function addExpected({ codes, near: { channel, first, step } }, colors) {
  for (let t = 0; t < codes.length; t++) {
    const code = codes[t], away = (code >>> 1) ^ -(code & 1);
    codes[t] = away + Math.floor(first + colors[3 * t + channel] * step + 0.5);
  }
}

function measureColumn(mesh, column) {
  const count = mesh.about.triangles, values = new Float64Array(count);
  let low = Infinity, high = -Infinity;
  for (let t = 0; t < count; t++) {
    const value = (values[t] = mesh.measure(t)[column.name]);
    if (value < low) low = value;
    if (value > high) high = value;
  }
  column.low = low;
  column.step = (high - low) / (NULL - 1) || 1;
  column.codes = Uint16Array.from(values, (value) => (value - low) / column.step + 0.5);
  values.sort();
  column.cut = [values[Math.floor(0.02 * (count - 1))], values[Math.ceil(0.98 * (count - 1))]];
}

/** Return the number that a code stands for. By halves: a range may be too large for a number. */
const numberOf = ({ low, step }, code) => 2 * (low / 2 + (step / 2) * code);

/** Return the value of a column for a triangle or node: a number, a text, or null. */
function valueAt(column, row) {
  const code = column.codes[row];
  if (code === NULL) return null;
  return column.texts ? column.texts[code] : numberOf(column, code);
}

/** Return the whole range of values. */
function rangeOf(column) {
  let least = NULL, most = -1;
  for (const code of column.codes) {
    if (code === NULL) continue;
    if (code < least) least = code;
    if (code > most) most = code;
  }
  return most < 0 ? [0, 0] : [numberOf(column, least), numberOf(column, most)];
}
