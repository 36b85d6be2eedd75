/* The boxes over the map: what is shown, legend, attributes, coordinates, scale. All names are text. */
const CATEGORIES = [
  "#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#e69f00", "#009e73", "#882255",
  "#999933", "#88ccee", "#cc6677", "#117733", "#ddcc77", "#332288", "#44aa99",
];
const MOST_LISTED = 40;
const SUFFIXES = { cut: "2–98 %", all: "all values" };

const hexOf = (colors, t) => `#${[0, 1, 2].map((k) => colors[3 * t + k].toString(16).padStart(2, "0")).join("")}`;

function element(name, text = "", className = "") {
  const made = document.createElement(name);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

/** Fill the list of columns: colours, then those of triangles, then bands at nodes. */
function listColumns(meshes) {
  const select = $("column");
  if (meshes.some((mesh) => mesh.about.colored)) select.add(new Option("colours of the image", ""));
  else select.add(new Option("none", ""));
  const groups = { "bands, as a surface": [], triangles: [], shape: [] };
  for (const mesh of meshes) {
    for (const [key, column] of mesh.columns) {
      const group = column.at === "nodes" ? "bands, as a surface" : column.measured ? "shape" : "triangles";
      if (!groups[group].some(([other]) => other === key)) groups[group].push([key, column.name]);
    }
  }
  for (const [label, entries] of Object.entries(groups)) {
    if (!entries.length) continue;
    const group = document.createElement("optgroup");
    group.label = label;
    for (const [key, name] of entries) group.append(new Option(name, key));
    select.append(group);
  }
}

function showLegend(style, column) {
  const isNumber = style.byValue && !column.texts;
  $("legend").hidden = !isNumber;
  $("classes").hidden = !(style.byValue && column.texts);
  if (isNumber) {
    const canvas = $("ramp").getContext("2d"), image = canvas.createImageData(256, 1);
    for (let i = 0; i < 256; i++) image.data.set([...style.rampColors.subarray(3 * i, 3 * i + 3), 255], 4 * i);
    canvas.putImageData(image, 0, 0);
    $("low").value = format(style.cut[0]);
    $("high").value = format(style.cut[1]);
    $("unit").textContent = column.unit;
    $("cut").textContent = SUFFIXES[style.isWhole ? "cut" : "all"];
    $("ramps").value = style.rampName;
  } else if (style.byValue) {
    const rows = column.texts.slice(0, MOST_LISTED).map((text, code) => {
      const row = element("li"), swatch = element("span");
      swatch.style.background = CATEGORIES[code % CATEGORIES.length];
      row.append(swatch, withUnit(text, column.unit));
      return row;
    });
    const more = column.texts.length - MOST_LISTED;
    if (more > 0) rows.push(element("li", `and ${more.toLocaleString("en")} more`));
    $("classes").replaceChildren(...rows);
  }
}

/** Return all attributes of a triangle: name, value, unit. */
async function attributesOf(mesh, t) {
  const { node, triangle } = await mesh.ids(), rows = [["id", triangle[t], ""]];
  for (let k = 0; k < 3; k++) rows.push([`n${k}`, node[mesh.corners[3 * t + k]], ""]);
  const measures = mesh.measure(t);
  for (const name of mesh.about.measured) {
    if (name in MEASURES) rows.push([name, measures[name], mesh.columns.get(name).unit]);
  }
  for (const [key, column] of mesh.columns) {
    if (column.measured || column.at === "nodes") continue;
    await readColumn(mesh, key);
    rows.push([column.name, valueAt(column, t), column.unit]);
  }
  if (mesh.about.colored) rows.push(["color", hexOf(mesh.colors, t), ""]);
  return rows;
}

function showAttributes(mesh, rows, close) {
  const table = element("table");
  for (const [name, value, unit] of rows) {
    const row = table.insertRow(), head = element("th", name);
    head.scope = "row";
    const text = typeof value === "string" ? value : format(value);
    const cell = element("td", value === null ? text : withUnit(text, unit));
    if (name === "color" && mesh.about.colored) {
      const swatch = element("span", "", "swatch");
      swatch.style.background = text;
      cell.prepend(swatch);
    }
    row.append(head, cell);
  }
  const button = element("button", "×");
  button.type = "button";
  button.setAttribute("aria-label", "Close");
  button.addEventListener("click", close);
  $("info").replaceChildren(button, table);
  $("info").hidden = false;
}

/** Show where the pointer is, and the value there. */
function showPlace(frame, view, x, y, value) {
  const own = frame.crs === null && frame.unit === "px" ? view.toMap(x, y) : view.toMap(x, y);
  const lines = [`${own.map((each) => each.toFixed(frame.decimals)).join(", ")}${frame.crs ? "" : " px"}`];
  const place = frame.unit === "°" && !frame.lonlat?.name ? null : lonLatOf(frame, x, y);
  if (place) {
    const degrees = place.map((each) => `${each.toFixed(frame.lonlat.decimals)}°`).join(", ");
    lines.push(frame.lonlat.name ? `${degrees} (${frame.lonlat.name})` : degrees);
  }
  if (value) lines.push(value);
  $("at").textContent = lines.join("\n");
}

function showScale(frame, view) {
  const per = view.unit * (frame.crs ? frame.metres : 1), wanted = per * 110, ten = 10 ** Math.floor(Math.log10(wanted));
  const round = [5, 2, 1].find((each) => each * ten <= wanted * 1.0001) * ten;
  const length = !frame.crs ? `${format(round)} px` : round >= 1000 ? `${format(round / 1000)} km` : round >= 1 ? `${format(round)} m` : `${format(round * 1000)} mm`;
  $("bar").style.width = `${round / per}px`;
  $("length").textContent = length;
}

/** Join a value and its unit: degrees without a space. */
const withUnit = (text, unit) => (unit ? `${text}${unit === "°" ? "" : " "}${unit}` : text);

function fail(message) {
  $("failure").textContent = message;
  $("failure").hidden = false;
}
