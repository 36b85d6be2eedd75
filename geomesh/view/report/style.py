"""The style of the page of a report: on light and dark screens, on phones, and on paper."""

STYLE = """
:root { color-scheme: light dark; --paper: #ffffff; --ink: #1b2228; --soft: #59656f;
  --line: #dbe0e4; --panel: #f4f6f8; --bar: #2f7ea8; --good: #0a6e3d; --good-paper: #e6f4ec;
  --bad: #a3261c; --bad-paper: #fbeae8; --angle: #b34700; --error: #005b96; }
@media screen and (prefers-color-scheme: dark) {
  :root { --paper: #14191d; --ink: #e6eaed; --soft: #9aa7b1; --line: #323b43; --panel: #1d242a;
    --bar: #58a9d4; --good: #66d39b; --good-paper: #12301f; --bad: #ff9d92; --bad-paper: #3a1815;
    --angle: #ffa25e; --error: #76bff0; } }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", "Liberation Sans", Roboto, sans-serif; }
main, header, footer { max-width: 62rem; margin: 0 auto; padding: 0 1.25rem; }
header { padding-top: 2.2rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .3rem; overflow-wrap: anywhere;
  letter-spacing: -.01em; }
h2 { font-size: 1.25rem; margin: 2.6rem 0 .8rem; padding-top: .8rem;
  border-top: 1px solid var(--line); }
h3 { font-size: 1rem; margin: 1.4rem 0 .4rem; }
p { margin: .4rem 0; max-width: 46rem; overflow-wrap: anywhere; }
.soft, figcaption, footer { color: var(--soft); font-size: .875rem; }
.name { unicode-bidi: isolate; overflow-wrap: anywhere; }
.badge { display: inline-block; margin: .9rem 0 0; padding: .3rem .8rem; border-radius: 2rem;
  font-weight: 600; color: var(--good); background: var(--good-paper);
  border: 1px solid currentColor; }
.badge.failed { color: var(--bad); background: var(--bad-paper); }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(9.2rem, 1fr));
  gap: .7rem; margin: 1.2rem 0 0; }
.figures div { background: var(--panel); border: 1px solid var(--line); border-radius: .5rem;
  padding: .65rem .85rem; min-width: 0; }
.figures dt { color: var(--soft); font-size: .8rem; overflow-wrap: anywhere; }
.figures dd { margin: 0; font-size: 1.4rem; font-weight: 650; line-height: 1.25;
  font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
.figures dd.note { font-size: .8rem; font-weight: 400; color: var(--soft); }
figure { margin: 0; min-width: 0; }
figcaption { margin: .35rem 0 0; max-width: 46rem; overflow-wrap: anywhere; }
.map { position: relative; margin: 0 auto; background: var(--panel);
  border: 1px solid var(--line); }
.map img, .map svg { display: block; width: 100%; height: 100%; }
.map svg { position: absolute; inset: 0; }
.map text { font: 650 17px system-ui, "Liberation Sans", sans-serif; text-anchor: middle; }
.map .leader { stroke-width: 2.5; }
.map .halo { stroke: #ffffff; stroke-width: 6; opacity: .8; }
.map .spot { stroke: #ffffff; stroke-width: 2; }
.map .disc { stroke: #ffffff; stroke-width: 2.5; }
.map .angle { fill: #b34700; stroke: #b34700; }
.map .error { fill: #005b96; stroke: #005b96; }
.map .spot, .map .disc { stroke: #ffffff; }
.map .mark { fill: #ffffff; }
.map .bar-halo { stroke: #ffffff; stroke-width: 9; opacity: .85; }
.map .bar-line { stroke: #1b2228; stroke-width: 4; }
.map .bar-text { fill: #1b2228; stroke: #ffffff; stroke-width: 5; paint-order: stroke;
  stroke-opacity: .85; }
.map g { transform-box: fill-box; transform-origin: center; }
.pair { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: .9rem;
  margin: 0 0 1.2rem; }
.pair img { display: block; width: 100%; height: auto; background: var(--panel);
  border: 1px solid var(--line); }
.pair.alone { grid-template-columns: minmax(0, 34rem); }
.charts { display: grid; grid-template-columns: repeat(auto-fit, minmax(17rem, 1fr));
  gap: 1.2rem 1.6rem; }
.chart { display: block; width: 100%; max-width: 30rem; height: auto; overflow: visible; }
.charts figcaption { color: var(--ink); }
.charts figcaption small { display: block; color: var(--soft); }
.tick { font: 10.5px system-ui, "Liberation Sans", sans-serif; fill: var(--soft); }
.grid { stroke: var(--line); stroke-width: 1; }
.axis { stroke: var(--soft); stroke-width: 1; }
.bar { fill: var(--bar); }
.median { stroke: var(--ink); stroke-width: 1.4; stroke-dasharray: 4 3; }
.median-label { fill: var(--ink); }
.limit { stroke: var(--angle); stroke-width: 1.8; }
.limit-label { fill: var(--angle); font-weight: 600; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; }
th, td { padding: .32rem .6rem; text-align: right; border-bottom: 1px solid var(--line);
  font-variant-numeric: tabular-nums; vertical-align: top; }
th { font-weight: 600; color: var(--soft); }
td { white-space: nowrap; }
.left { text-align: left; }
tbody th { color: var(--ink); font-weight: 400; text-align: left; }
.facts { display: grid; grid-template-columns: max-content minmax(0, 1fr); gap: .25rem 1.2rem;
  margin: .4rem 0; }
.facts dt { color: var(--soft); }
.facts dd { margin: 0; overflow-wrap: anywhere; }
.settings { display: grid; grid-template-columns: repeat(auto-fill, minmax(17rem, 1fr));
  gap: 0 1.6rem; margin: .6rem 0; font-size: .9rem; }
.settings div { display: flex; justify-content: space-between; gap: .8rem; padding: .22rem .4rem;
  border-bottom: 1px solid var(--line); break-inside: avoid; }
.settings dt, .settings dd { margin: 0; min-width: 0; overflow-wrap: anywhere; }
.settings dt { color: var(--soft); }
.settings dd { text-align: right; }
.settings .changed { background: var(--panel); border-left: 3px solid var(--angle); }
.settings .changed dt, .settings .changed dd { color: var(--ink); font-weight: 600; }
.settings small { display: block; font-weight: 400; color: var(--soft); }
.checks { list-style: none; margin: .6rem 0; padding: 0; max-width: 50rem; }
.checks li { position: relative; padding: .3rem 0 .3rem 1.9rem; break-inside: avoid; }
.checks li > b { position: absolute; left: 0; width: 1.3rem; text-align: center; }
.checks .held > b { color: var(--good); }
.checks .failed > b { color: var(--bad); }
.checks .failed { background: var(--bad-paper); }
.checks small { display: block; color: var(--soft); overflow-wrap: anywhere; }
.key { display: inline-block; min-width: 2.1rem; padding: 0 .4rem; border-radius: 1rem;
  text-align: center; font-weight: 650; font-size: .8rem; color: #ffffff; }
.key.angle { background: #b34700; }
.key.error { background: #005b96; border-radius: .2rem; }
.warnings { border-left: 4px solid var(--angle); background: var(--panel);
  padding: .5rem 1rem .5rem 2rem; margin: .6rem 0; overflow-wrap: anywhere; }
pre { background: var(--panel); border: 1px solid var(--line); border-radius: .4rem;
  padding: .8rem 1rem; margin: .6rem 0; overflow-x: auto;
  font: .9rem/1.5 ui-monospace, "Liberation Mono", Menlo, Consolas, monospace; }
footer { margin-top: 3rem; padding-bottom: 2.5rem; }
@media (max-width: 40rem) {
  body { font-size: 15px; }
  h1 { font-size: 1.5rem; }
  .pair { gap: .5rem; }
  .figures { grid-template-columns: repeat(2, minmax(0, 1fr)); }
  .facts { grid-template-columns: minmax(0, 1fr); gap: 0; }
  .facts dd { margin-bottom: .4rem; }
  .map svg { overflow: visible; }
  .map g { transform: scale(1.6); }
  .map .bar-text { font-size: 28px; } }
@page { size: A4; margin: 15mm 14mm; }
@media print {
  :root { color-scheme: light; }
  * { -webkit-print-color-adjust: exact; print-color-adjust: exact; }
  body { font-size: 10pt; }
  main, header, footer { max-width: none; padding: 0; }
  header { padding-top: 0; }
  h1 { font-size: 18pt; }
  h2 { font-size: 13pt; margin-top: 7mm; }
  h2, h3, h2 + p, h3 + p { break-after: avoid; }
  p, figure, tr, .wide, .figures, .pair, pre, .warnings, .facts { break-inside: avoid; }
  pre { white-space: pre-wrap; overflow-wrap: anywhere; }
  .map { max-width: calc(150mm * var(--shape)) !important; }
  .figures dd { font-size: 13pt; }
  .figures { grid-template-columns: repeat(auto-fit, minmax(25mm, 1fr)); gap: 2.5mm; }
  .figures div { padding: 1.5mm 2mm; }
  footer { margin-top: 4mm; padding-bottom: 0; break-before: avoid; }
  .charts { grid-template-columns: repeat(2, minmax(0, 1fr)); }
  .settings { grid-template-columns: repeat(2, minmax(0, 1fr)); font-size: 9pt; }
  .wide { overflow: visible; }
  td { white-space: normal; overflow-wrap: anywhere; }
  table { font-size: 8.5pt; }
  th, td { padding: .8mm 1.4mm; }
  thead { display: table-header-group; } }
"""
