// Printing and start-up of a report.

// Prints are light and all collapsed parts are open, except settings and logs of several runs.
let opened = [];
function setPrinting(begins) {
  if (begins === state.printing) return;
  state.printing = begins;
  document.documentElement.classList.toggle("printing", begins);
  if (begins) {
    opened = queryAll("details:not([open])").filter((part) => runs.length === 1 || !query("pre", part));
    for (const part of opened) part.open = true;
  } else for (const part of opened) part.open = false;
  redraw();
  if (!begins) return;
  drawForPrint();
  for (const view of views) view.still();
}

function begin() {
  const first = runs.find((run) => run.center);
  state.at = first ? [...first.center] : bounds[0].map((low, a) => 0.5 * (low + bounds[1][a]));
  makeControls();
  makeGrid();
  describeFields();
  makeViews();
  makePresses();
  listeners.push(drawSlices, drawViews, drawPresses, drawCurve);
  redraw();
  followPage();
  const printing = matchMedia("print");
  printing.addEventListener("change", () => setPrinting(printing.matches));
  addEventListener("beforeprint", () => setPrinting(true));
  addEventListener("afterprint", () => setPrinting(false));
}

beginOrExplain(begin);
