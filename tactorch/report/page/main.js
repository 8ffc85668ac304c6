// Controls, printing and start-up.

function makeControls() {
  const fields = Object.keys(data.fields).filter((f) => runs.some((run) => run.fields[f]));
  const shown = query("#shown"), quantity = query("#quantity");
  if (shown)
    for (const field of fields) {
      const label = shown.appendChild(document.createElement("label"));
      const tick = label.appendChild(document.createElement("input"));
      tick.type = "checkbox";
      tick.checked = !state.hidden.has(field);
      tick.disabled = field === "youngs";
      label.append(` ${data.fields[field].title}`);
      tick.addEventListener("change", () => {
        state.hidden[tick.checked ? "delete" : "add"](field);
        rebuild();
      });
    }
  if (quantity) {
    for (const field of fields.filter((f) => f !== "truth" && f !== "reference"))
      quantity.add(new Option(data.fields[field].title, field));
    quantity.addEventListener("change", () => {
      state.quantity = quantity.value;
      rebuild();
    });
  }
  const colours = query("#colours");
  colours.value = state.colours;
  colours.addEventListener("change", () => {
    state.colours = colours.value;
    scheduleRedraw();
  });
  query("#scale").addEventListener("change", (event) => {
    state.log = event.target.value === "log";
    scheduleRedraw();
  });
  query("#outlines").addEventListener("change", (event) => {
    state.outlines = event.target.checked;
    scheduleRedraw();
  });
}

function rebuild() {
  makeGrid();
  describeFields();
  scheduleRedraw();
}

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
  new ResizeObserver(scheduleRedraw).observe(query("main"));
  for (const query of ["(prefers-color-scheme: dark)", "(min-resolution: 1.5dppx)"])
    matchMedia(query).addEventListener("change", scheduleRedraw);
  const printing = matchMedia("print");
  printing.addEventListener("change", () => setPrinting(printing.matches));
  addEventListener("beforeprint", () => setPrinting(true));
  addEventListener("afterprint", () => setPrinting(false));
  document.documentElement.dataset.ready = "true";
}

try {
  begin();
} catch (error) {
  const box = query("#error");
  box.hidden = false;
  box.textContent = `The figures could not be drawn (${error.message}); try a newer browser.` +
    " Text and tables are complete without them.";
  throw error;
}
