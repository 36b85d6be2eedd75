/* Starts the page. */
const app = new App(JSON.parse($("head").textContent));
const ready = app.start().then(() => app.idle());
ready.catch((error) => fail(error.message));

/** For tests, and for pages that embed this one. Places are pixels of the raster, x right, y down. */
window.geomesh = {
  ready,
  times: app.times,
  idle: () => app.idle(),
  project: ([x, y]) => app.view.toScreen(256 * x, 256 * y),
  unproject: ([px, py]) => app.view.toLattice(px, py).map((each) => each / 256),
  get view() {
    return { x: app.view.x / 256, y: app.view.y / 256, scale: 1 / app.view.unit };
  },
  setView({ x, y, scale }) {
    Object.assign(app.view, { x: 256 * x, y: 256 * y, unit: 1 / scale });
    return app.idle();
  },
};
