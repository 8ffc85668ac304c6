// Begin.

function makeChoices() {
  const fields = Object.keys(data.fields).filter((f) => runs.some((run) => run.fields[f]));
  const shown = one("#shown"), quantity = one("#quantity");
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
  const colours = one("#colours");
  colours.value = state.colours;
  colours.addEventListener("change", () => {
    state.colours = colours.value;
    changed();
  });
  one("#scale").addEventListener("change", (event) => {
    state.log = event.target.value === "log";
    changed();
  });
  one("#outlines").addEventListener("change", (event) => {
    state.outlines = event.target.checked;
    changed();
  });
}

function rebuild() {
  makeGrid();
  describe();
  changed();
}

// On paper all is light, whatever the screen, and folded parts are open; but the settings and logs
// of several runs, page after page, only where the reader has opened them.
let folded = [];
function paper(begins) {
  if (begins === state.printing) return;
  state.printing = begins;
  document.documentElement.classList.toggle("printing", begins);
  if (begins) {
    folded = all("details:not([open])").filter((part) => runs.length === 1 || !one("pre", part));
    for (const part of folded) part.open = true;
  } else for (const part of folded) part.open = false;
  redraw();
  if (!begins) return;
  drawForPrint();
  for (const view of views) view.still();
}

function begin() {
  const first = runs.find((run) => run.center);
  state.at = first ? [...first.center] : bounds[0].map((low, a) => 0.5 * (low + bounds[1][a]));
  makeChoices();
  makeGrid();
  describe();
  makeSolid();
  makePresses();
  listeners.push(drawSlices, drawSolid, drawPresses, drawCurve);
  redraw();
  new ResizeObserver(changed).observe(one("main"));
  for (const query of ["(prefers-color-scheme: dark)", "(min-resolution: 1.5dppx)"])
    matchMedia(query).addEventListener("change", changed);
  const printing = matchMedia("print");
  printing.addEventListener("change", () => paper(printing.matches));
  addEventListener("beforeprint", () => paper(true));
  addEventListener("afterprint", () => paper(false));
  document.documentElement.dataset.ready = "true";
}

try {
  begin();
} catch (error) {
  const box = one("#trouble");
  box.hidden = false;
  box.textContent = `The pictures could not be drawn (${error.message}); try a newer browser.` +
    " Text and tables stand below all the same.";
  throw error;
}
