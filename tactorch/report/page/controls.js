// Controls of the slices.

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
  const range = query("#range");
  if (range)
    range.addEventListener("change", () => {
      state.own = range.value === "own";
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

// Begin, or say in the page why it cannot.
function beginOrExplain(begin) {
  try {
    begin();
    document.documentElement.dataset.ready = "true";
  } catch (error) {
    const box = query("#error");
    box.hidden = false;
    box.textContent = `The figures could not be drawn (${error.message}); try a newer browser.` +
      " Text and tables are complete without them.";
    throw error;
  }
}

// Redraw where the size of the page, its colours or the sharpness of the screen change.
function followPage() {
  new ResizeObserver(scheduleRedraw).observe(query("main"));
  for (const query of ["(prefers-color-scheme: dark)", "(min-resolution: 1.5dppx)"])
    matchMedia(query).addEventListener("change", scheduleRedraw);
}
