/* The hand: mouse, touch and keys move the view. */
const CLICK = 5; // CSS pixels that a click may move
const STEP = 90; // CSS pixels for an arrow key

/** Listen on the canvas. `on` has moved(), hover(x, y), left(), choose(x, y), fit() and key(name). */
function listen(canvas, view, on) {
  const hands = new Map();
  let moved = 0;
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 18 : 1, turn = event.deltaY * lines;
    view.zoom(event.clientX, event.clientY, Math.exp(Math.sign(turn) * Math.min(0.4, Math.abs(turn) / 400)));
    on.moved();
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    hands.set(event.pointerId, [event.clientX, event.clientY]);
    if (hands.size === 1) moved = 0;
  });
  const lift = (event) => {
    const was = hands.delete(event.pointerId);
    if (was && event.type === "pointerup" && !hands.size && moved < CLICK) on.choose(event.clientX, event.clientY);
  };
  canvas.addEventListener("pointerup", lift);
  canvas.addEventListener("pointercancel", lift);
  canvas.addEventListener("pointerleave", () => on.left());
  canvas.addEventListener("pointermove", (event) => {
    const before = hands.get(event.pointerId), now = [event.clientX, event.clientY];
    if (!before) {
      on.hover(...now);
      return;
    }
    if (hands.size === 2) {
      const [, other] = [...hands].find(([id]) => id !== event.pointerId);
      const span = (hand) => Math.max(1, Math.hypot(hand[0] - other[0], hand[1] - other[1]));
      view.pan((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
      view.zoom((now[0] + other[0]) / 2, (now[1] + other[1]) / 2, span(before) / span(now));
    } else {
      view.pan(now[0] - before[0], now[1] - before[1]);
    }
    moved += Math.abs(now[0] - before[0]) + Math.abs(now[1] - before[1]);
    hands.set(event.pointerId, now);
    on.moved();
  });
  // Also before the map has been clicked.
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || ![canvas, document.body].includes(event.target)) return;
    const [width, height] = view.size;
    const pan = { ArrowLeft: [STEP, 0], ArrowRight: [-STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] }[event.key];
    const zoom = { "+": 0.7, "=": 0.7, "-": 1 / 0.7, _: 1 / 0.7 }[event.key];
    if (pan) view.pan(...pan);
    else if (zoom) view.zoom(width / 2, height / 2, zoom);
    else if (event.key === "0") on.fit();
    else if (event.key === "Enter") on.choose(width / 2, height / 2);
    else {
      on.key(event.key);
      return;
    }
    event.preventDefault();
    on.moved();
  });
}

/** Let the swipe be dragged, or moved by arrow keys. */
function listenToSwipe(handle, moved) {
  handle.addEventListener("pointerdown", (event) => {
    handle.setPointerCapture(event.pointerId);
    event.preventDefault();
  });
  handle.addEventListener("pointermove", (event) => {
    if (handle.hasPointerCapture(event.pointerId)) moved(event.clientX / innerWidth);
  });
  handle.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -0.05, ArrowRight: 0.05 }[event.key];
    if (!step) return;
    event.preventDefault();
    moved(Number(handle.getAttribute("aria-valuenow")) / 100 + step);
  });
}
