"use strict";
(() => {
  const LAYER = "triangles";
  const PLAIN = "#8a969c";
  // Viridis, by Stéfan van der Walt and Nathaniel Smith (CC0).
  const RAMP = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962",
    "#addc30", "#fde725"];

  const at = (id) => document.getElementById(id);
  const about = JSON.parse(at("about").textContent);
  const say = (text) => { at("level").textContent = text; };
  const number = (value) =>
    Number.isInteger(value) ? value.toLocaleString("en") : String(Number(value.toPrecision(6)));

  function embedded() {
    const text = at("tiles").textContent.trim();
    if (!text) return null;
    at("tiles").remove();
    const letters = atob(text);
    const bytes = new Uint8Array(letters.length);
    for (let k = 0; k < letters.length; k += 1) bytes[k] = letters.charCodeAt(k);
    return {
      getKey: () => "tiles",
      getBytes: async (offset, length) => ({ data: bytes.slice(offset, offset + length).buffer }),
    };
  }

  function fileSource(file) {
    return {
      getKey: () => "tiles",
      getBytes: async (offset, length) => ({
        data: await file.slice(offset, offset + length).arrayBuffer(),
      }),
    };
  }

  function webSource(address) {
    const source = new pmtiles.FetchSource(new URL(address, document.baseURI).href);
    return { getKey: () => "tiles", getBytes: (...given) => source.getBytes(...given) };
  }

  function fill(attribute) {
    if (attribute === "color") return ["to-color", ["get", "color"], PLAIN];
    const range = about.ramps[attribute];
    if (!range) return PLAIN;
    const [low, high] = range;
    const last = RAMP.length - 1;
    const stops = RAMP.flatMap((color, k) => [low + ((high - low) * k) / last, color]);
    const known = ["has", attribute];
    if (!(high > low)) return ["case", known, RAMP[0], PLAIN];
    return ["case", known, ["interpolate", ["linear"], ["to-number", ["get", attribute]], ...stops],
      PLAIN];
  }

  function showLegend(attribute) {
    const range = about.ramps[attribute];
    at("legend").hidden = attribute === "color" || !range;
    if (at("legend").hidden) return;
    at("ramp").style.background = `linear-gradient(to right, ${RAMP.join(", ")})`;
    const ends = at("ends").children;
    ends[0].textContent = number(range[0]);
    ends[1].textContent = number(range[1]);
  }

  function showValues(properties) {
    const rows = [];
    for (const [name, value] of Object.entries(properties || {})) {
      const term = document.createElement("dt");
      const detail = document.createElement("dd");
      term.textContent = name;
      detail.textContent = typeof value === "number" ? number(value) : String(value);
      if (name === "color") {
        const swatch = document.createElement("span");
        swatch.className = "swatch";
        swatch.style.background = String(value);
        detail.prepend(swatch);
      }
      rows.push(term, detail);
    }
    at("values").replaceChildren(...rows);
    at("hint").hidden = rows.length > 0;
  }

  const isPhone = () => matchMedia("(max-width: 560px)").matches;

  // What the panel leaves of the map, in pixels from its sides.
  function room() {
    const panel = at("panel").getBoundingClientRect();
    const padding = { top: 24, right: 24, bottom: 24, left: 24 };
    if (isPhone()) padding.bottom += panel.height;
    else if (innerWidth > 2.2 * panel.width) padding.left += panel.right;
    return padding;
  }

  function choices() {
    const select = at("attribute");
    const names = about.fields.filter((name) => name === "color" || name in about.ramps);
    for (const name of names.length ? names : ["(one colour)"]) {
      const option = document.createElement("option");
      option.value = name;
      option.textContent = name === "color" ? "colours of the image" : name;
      select.append(option);
    }
    if (names.includes("color")) select.value = "color";
    return select;
  }

  async function start(source) {
    const archive = new pmtiles.PMTiles(source);
    let header;
    try {
      header = await archive.getHeader();
    } catch (error) {
      say(`The tiles cannot be read: ${error.message}`);
      return;
    }
    at("chooser").hidden = true;
    const protocol = new pmtiles.Protocol();
    protocol.add(archive);
    maplibregl.addProtocol("pmtiles", protocol.tile);
    const select = at("attribute");
    const map = new maplibregl.Map({
      container: "map",
      attributionControl: false,
      bounds: about.bounds,
      fitBoundsOptions: { padding: room() },
      minZoom: header.minZoom,
      maxZoom: Math.min(header.maxZoom + 5, 24),
      maxPitch: 0,
      dragRotate: false,
      fadeDuration: 0,
      style: {
        version: 8,
        sources: { mesh: { type: "vector", url: "pmtiles://tiles" } },
        layers: [
          { id: "paper", type: "background", paint: { "background-color": "#eef1f2" } },
          // Triangles share their sides exactly. A blended outline would draw seams.
          { id: "mesh", type: "fill", source: "mesh", "source-layer": LAYER,
            paint: { "fill-color": fill(select.value), "fill-antialias": false } },
          { id: "edges", type: "line", source: "mesh", "source-layer": LAYER,
            layout: { visibility: "none" },
            paint: { "line-color": "#000", "line-opacity": 0.35, "line-width": 0.6 } },
          { id: "picked", type: "line", source: "mesh", "source-layer": LAYER,
            filter: ["==", ["get", "id"], -1],
            paint: { "line-color": "#ff3d00", "line-width": 2.5 } },
        ],
      },
    });
    map.addControl(new maplibregl.NavigationControl({ showCompass: false }), "top-right");
    map.addControl(new maplibregl.ScaleControl({ maxWidth: 140 }),
      isPhone() ? "top-left" : "bottom-right");
    map.touchZoomRotate.disableRotation();
    let shown = null;
    const pick = (properties) => {
      showValues(properties);
      map.setFilter("picked", ["==", ["get", "id"], properties ? properties.id : -1]);
    };
    const tell = () => {
      const zoom = Math.min(Math.max(Math.floor(map.getZoom()), header.minZoom), header.maxZoom);
      if (zoom === shown) return;
      if (shown !== null) pick(null); // the triangles of another zoom are others
      shown = zoom;
      const level = about.levels.find((each) => each.zoom === zoom);
      if (!level) return;
      const count = `${number(level.triangles)} triangles`;
      say(level.own ? `Zoom ${zoom}: the mesh itself, ${count}`
        : `Zoom ${zoom}: a smaller mesh, ${count}`);
    };
    map.on("zoom", tell);
    map.on("error", (event) => say(`The map failed: ${event.error.message}`));
    map.on("click", (event) => {
      const [first] = map.queryRenderedFeatures(event.point, { layers: ["mesh"] });
      pick(first ? first.properties : null);
    });
    map.on("idle", () => document.documentElement.setAttribute("data-state", "drawn"));
    select.addEventListener("change", () => {
      map.setPaintProperty("mesh", "fill-color", fill(select.value));
      showLegend(select.value);
    });
    at("edges").addEventListener("change", (event) => {
      map.setLayoutProperty("edges", "visibility", event.target.checked ? "visible" : "none");
    });
    map.on("load", tell);
    window.geomesh = { map };
  }

  document.querySelector("h1").textContent = about.name;
  at("made").textContent = about.source
    ? `Made from ${about.source} by geomesh ${about.version}`
    : `Made by geomesh ${about.version}`;
  showLegend(choices().value);
  const inside = embedded();
  const begin = (source) =>
    start(source).catch((error) => say(`The map cannot be shown: ${error.message}`));
  if (inside) {
    begin(inside);
  } else if (location.protocol.startsWith("http")) {
    begin(webSource(about.address));
  } else {
    say("The tiles are in a file of their own.");
    at("chooser").hidden = false;
    at("chooser").querySelector("p").textContent =
      `A page from disk may not read other files. Choose ${about.address}, or open the page ` +
      "from a web server.";
    at("file").addEventListener("change", (event) => {
      if (event.target.files.length) begin(fileSource(event.target.files[0]));
    });
  }
})();
