/* The address of a view: place and scale, column, what is ticked, and where the swipe is. */
const LINKED = ["edges", "nodes", "breaklines"];

function addressOf(view, style, column, split) {
  const [x, y] = view.toMap(view.x, view.y), parts = new URLSearchParams();
  parts.set("at", [x, y, view.unit].map((each) => Number(each.toPrecision(12))).join(","));
  if (column) parts.set("column", column);
  const on = LINKED.filter((name) => style[name]);
  if (on.length) parts.set("show", on.join(","));
  if (split !== 0.5) parts.set("swipe", split.toFixed(3));
  return `#${parts}`;
}

/** Return what an address tells; `at` and `swipe` are null where it does not. */
function parseAddress(text) {
  const parts = new URLSearchParams(text.slice(1)), at = (parts.get("at") ?? "").split(",").map(Number);
  const isPlace = at.length === 3 && at.every(Number.isFinite) && at[2] > 0;
  return {
    at: isPlace ? at : null,
    show: (parts.get("show") ?? "").split(","),
    swipe: parts.has("swipe") ? Number(parts.get("swipe")) || 0 : null,
    column: parts.get("column"),
  };
}
