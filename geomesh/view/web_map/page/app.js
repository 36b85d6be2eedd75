/* Puts everything together: reads the meshes, keeps the state, draws frames. */
const REST = 130; // milliseconds after the last move until a slow GPU draws anew
const SWITCHES = ["edges", "nodes", "breaklines", "smooth", "relief", "bright"];
const QUICK = 60; // milliseconds: a GPU that draws a picture in less draws it in every frame

class App {
  constructor(head) {
    this.head = head;
    this.frame = head.frame;
    this.canvas = $("map");
    this.times = { start: performance.now() };
    this.style = { edges: false, nodes: false, breaklines: false, smooth: true, relief: true, bright: true, byValue: false };
    this.split = 0.5;
    this.column = "";
    this.chosen = null;
    this.lastMove = 0;
    this.waiting = [];
    this.changes = Promise.resolve(); // of what is shown
  }

  async start() {
    const gl = this.canvas.getContext("webgl2", { antialias: false, premultipliedAlpha: true });
    if (!gl) throw Error("This browser cannot show the map: it has no WebGL 2. Use a recent Firefox, Chrome, Edge or Safari, and switch hardware acceleration on.");
    this.gl = gl;
    this.canvas.addEventListener("webglcontextlost", () => fail("The graphics memory was lost. Reload the page."));
    this.view = new View(this.frame, this.canvas);
    this.meshes = await Promise.all(this.head.meshes.map((about, number) => new Mesh(number, about).load()));
    this.times.decoded = performance.now();
    const smoothed = !drawsInSoftware(gl);
    const programs = makePrograms(gl);
    this.painters = this.meshes.map((mesh) => new Painter(gl, mesh, programs, smoothed));
    this.times.uploaded = performance.now();
    this.screen = new Screen(gl, this.canvas, this.view, programs);
    this.meshes.forEach(addColumns);
    this.prepareStyle();
    this.preparePanel();
    this.fit();
    await this.readAddress();
    this.connect();
    this.request();
  }

  prepareStyle() {
    const { gl } = this;
    this.ramps = Object.fromEntries(Object.entries(this.head.ramps).map(([name, text]) => [name, fromBase64(text)]));
    this.textures = Object.fromEntries(Object.entries(this.ramps).map(([name, colors]) => [name, makeRamp(gl, colors)]));
    const palette = Uint8Array.from(CATEGORIES.flatMap((color) => [1, 3, 5].map((k) => parseInt(color.slice(k, k + 2), 16))));
    this.style.palette = makeRamp(gl, palette);
    this.style.classes = CATEGORIES.length;
    this.setRamp(Object.keys(this.ramps)[0]);
  }

  setRamp(name) {
    Object.assign(this.style, { rampName: name, rampColors: this.ramps[name], ramp: this.textures[name] });
  }

  preparePanel() {
    const { head, frame, meshes } = this, [first] = meshes;
    const count = (mesh) => `${mesh.about.triangles.toLocaleString("en")} triangles`;
    $("count").textContent = [meshes.map(count).join(" | "), frame.crs ?? "no CRS"].join(", ");
    if (frame.name) $("count").title = frame.name;
    listColumns(meshes);
    for (const name of Object.keys(this.ramps)) $("ramps").add(new Option(name, name));
    $("lines").textContent = meshes.some((mesh) => mesh.about.breaklines) ? "breaklines" : "outline";
    $("smooth").parentElement.hidden = !meshes.some((mesh) => mesh.surface);
    $("relief").parentElement.hidden = !meshes.some((mesh) => mesh.about.height);
    $("bright").parentElement.hidden = !meshes.some((mesh) => mesh.about.gain > 1.02);
    $("basemap").parentElement.hidden = !(head.basemap && frame.mercator);
    if (innerWidth <= 620) $("panel").open = false;
    const right = meshes[1]?.about.name ?? head.image?.name;
    $("swipe").hidden = right === undefined;
    $("left").textContent = right === first.about.name && head.image ? `${first.about.name}, mesh` : first.about.name;
    $("right").textContent = right ?? "";
  }

  connect() {
    listen(this.canvas, this.view, {
      moved: () => this.moved(),
      hover: (px, py) => this.hover(px, py),
      left: () => { $("at").textContent = ""; },
      choose: (px, py) => this.choose(px, py),
      fit: () => this.fit(),
      key: (key) => this.key(key),
    });
    listenToSwipe($("swipe"), (split) => this.swipe(split));
    $("column").addEventListener("change", (event) => this.setColumn(event.target.value));
    for (const name of SWITCHES) $(name).addEventListener("change", () => this.restyle());
    $("basemap").addEventListener("change", () => this.setBasemap());
    $("ramps").addEventListener("change", (event) => { this.setRamp(event.target.value); this.restyle(); });
    $("cut").addEventListener("click", () => this.setCut(!this.style.isWhole));
    for (const end of ["low", "high"]) $(end).addEventListener("change", () => this.cutByHand());
    new ResizeObserver(() => this.request()).observe(this.canvas);
    addEventListener("hashchange", () => { if (location.hash !== this.address) this.readAddress(); });
  }

  /* ---- what is shown ---- */
  fit() {
    Object.assign(this.view, this.view.fitted(this.frame.box));
    this.request();
  }

  moved() {
    this.lastMove = performance.now();
    this.request();
  }

  key(key) {
    const toggle = { e: "edges", n: "nodes", b: "breaklines", s: "smooth" }[key];
    if (toggle && !$(toggle).parentElement.hidden) {
      $(toggle).checked = !$(toggle).checked;
      this.restyle();
    }
    if (key === "Escape") this.forget();
  }

  /** Let `idle` wait for a change of what is shown. */
  change(work) {
    this.changes = Promise.all([this.changes, work]);
    return work;
  }

  restyle() {
    return this.change(this.applyStyle());
  }

  async applyStyle() {
    for (const name of SWITCHES) this.style[name] = $(name).checked;
    await Promise.all(this.painters.flatMap((painter) => [
      painter.prepareLines(this.style),
      this.style.relief && painter.prepareRelief(this.view),
    ]));
    const column = this.shownColumn();
    if (column) showLegend(this.style, column);
    this.painters.forEach((painter) => painter.restyle());
    this.request();
  }

  shownColumn() {
    return this.painters.map((painter) => painter.column).find(Boolean) ?? null;
  }

  setColumn(key) {
    return this.change(this.applyColumn(key));
  }

  async applyColumn(key) {
    this.column = $("column").value = key;
    const columns = await Promise.all(this.meshes.map((mesh) => (key ? readColumn(mesh, key) : null)));
    if (this.column !== key) return; // another one was chosen meanwhile
    this.painters.forEach((painter, k) => painter.setColumn(columns[k]));
    const some = columns.find(Boolean);
    this.style.byValue = Boolean(some);
    if (some) {
      const cyclic = Object.keys(this.ramps).at(-1), [first] = Object.keys(this.ramps);
      if ((some.kind === "circle") !== (this.style.rampName === cyclic)) this.setRamp(some.kind === "circle" ? cyclic : first);
      this.setCut(false);
    } else {
      showLegend(this.style, null);
      await this.restyle();
    }
  }

  /** Spread the colours over the whole range, or over all but 2 % at each end. */
  setCut(isWhole) {
    const columns = this.painters.map((painter) => painter.column).filter(Boolean);
    const ranges = columns.map((column) => (isWhole || column.kind === "circle" ? rangeOf(column) : column.cut));
    this.style.isWhole = isWhole;
    this.style.cut = [Math.min(...ranges.map(([low]) => low)), Math.max(...ranges.map(([, high]) => high))];
    return this.restyle();
  }

  cutByHand() {
    const cut = [Number($("low").value), Number($("high").value)];
    if (cut.every(Number.isFinite) && cut[0] < cut[1]) this.style.cut = cut;
    this.restyle();
  }

  setBasemap() {
    const { basemap } = this.head, isOn = $("basemap").checked;
    this.screen.basemap = isOn ? new Basemap(this.gl, this.frame, basemap, () => this.request()) : null;
    $("credit").textContent = isOn ? `Basemap: ${new URL(basemap.replace(/[{}]/g, "")).hostname}` : "";
    $("credit").hidden = !isOn;
    this.request();
  }

  swipe(split) {
    this.split = Math.min(1, Math.max(0, split));
    const { style } = $("swipe");
    style.left = `${100 * this.split}%`;
    $("swipe").setAttribute("aria-valuenow", Math.round(100 * this.split));
    this.request();
  }

  /* ---- the pointer ---- */
  painterAt(px) {
    const isRight = !$("swipe").hidden && px > this.split * innerWidth;
    if (!isRight) return this.painters[0];
    return this.painters[1] ?? null; // null: the image
  }

  hover(px, py) {
    const [x, y] = this.view.toLattice(px, py), painter = this.painterAt(px), column = painter?.column;
    const t = column ? painter.mesh.find(x, y) : -1;
    const value = t < 0 ? null : column.at === "nodes" ? painter.mesh.between(column, t, x, y) : valueAt(column, t);
    const told = value === null ? "" : `${column.name} ${withUnit(typeof value === "string" ? value : format(value), column.unit)}`;
    showPlace(this.frame, this.view, x, y, told);
  }

  async choose(px, py) {
    const painter = this.painterAt(px), t = painter ? painter.mesh.find(...this.view.toLattice(px, py)) : -1;
    if (t < 0) {
      this.forget();
      return;
    }
    const chosen = (this.chosen = { painter, triangle: t });
    this.request();
    const rows = await attributesOf(painter.mesh, t);
    if (this.chosen === chosen) showAttributes(painter.mesh, rows, () => this.forget());
  }

  forget() {
    this.chosen = null;
    $("info").hidden = true;
    this.request();
  }

  /* ---- the address: a link to just this view ---- */
  writeAddress() {
    this.address = addressOf(this.view, this.style, this.column, $("swipe").hidden ? 0.5 : this.split);
    try {
      history.replaceState(null, "", this.address);
    } catch {
      // A page inside another one may have no address of its own.
    }
  }

  async readAddress() {
    const { at, show, swipe, column } = parseAddress(location.hash), { view } = this;
    if (at) {
      [view.x, view.y] = view.fromMap(at[0], at[1]);
      view.unit = view.limited(at[2]);
    }
    for (const name of LINKED) $(name).checked = show.includes(name);
    if (swipe !== null) this.swipe(swipe);
    const isKnown = [...$("column").options].some(({ value }) => value === column);
    await this.setColumn(isKnown ? column : this.head.column);
  }

  /* ---- frames ---- */
  request(isChanged = true) {
    this.isChanged ||= isChanged;
    if (this.isRequested) return;
    this.isRequested = true;
    requestAnimationFrame(() => this.drawFrame());
  }

  drawFrame() {
    this.isRequested = false;
    const { painters, screen, view } = this, isResting = performance.now() - this.lastMove > REST;
    let isBusy = false;
    for (const painter of painters) {
      const mayStart = isResting || painter.cost < QUICK, { shown } = painter;
      isBusy = painter.advance(view, screen.ratio, this.style, mayStart) || isBusy;
      if (painter.shown !== shown) this.isChanged = true;
      if (isBusy && painter.job) break; // one after the other
    }
    // Before the first picture there is nothing to show, and showing it would wait for the GPU.
    if (this.isChanged && painters.some(({ shown }) => shown)) this.compose();
    const isCurrent = painters.every((painter) => painter.shows(painter.shown, view, screen.ratio));
    if (isCurrent && !this.times.firstFrame) this.arrived();
    if (isBusy || !isResting) this.request(false);
    if (isCurrent) {
      if (isResting) this.writeAddress();
      this.waiting.splice(0).forEach((done) => done());
    }
  }

  /** Put the pictures on the screen. */
  compose() {
    const { painters, screen } = this;
    this.isChanged = false;
    const right = $("swipe").hidden ? null : (painters[1] ?? (screen.image ? "image" : null));
    const gain = this.style.bright ? this.meshes[0].about.gain : 1;
    screen.draw(painters[0], right, this.split, screen.basemap ? 0.65 : 1, gain, this.chosen);
    showScale(this.frame, this.view);
  }

  arrived() {
    this.times.firstFrame = performance.now();
    if (this.head.image) this.change(this.screen.addImage(this.head.image).then(() => this.request()));
  }

  /** Wait until the window shows just what it should. */
  async idle() {
    await this.changes;
    await new Promise((done) => {
      this.waiting.push(done);
      this.request();
    });
  }
}
