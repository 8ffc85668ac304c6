// A page that follows a session: what it shows is replaced as it arrives, without reloading.

const POLL_MS = 1500;
let version = data.version, timer = 0;

// Texts by the id of their element, and the table of the updates.
function replaceTexts(update) {
  for (const [id, text] of Object.entries(update.texts)) {
    const place = query(`#${id}`);
    place.textContent = text;
    place.hidden = !text;
  }
  query("#notes").replaceChildren(...update.notes.map((text) => {
    const note = document.createElement("p");
    note.className = "warning";
    note.textContent = text;
    return note;
  }));
  query("#updates tbody").replaceChildren(...update.rows.map((cells) => {
    const row = document.createElement("tr");
    cells.forEach((text, k) => {
      const cell = row.appendChild(document.createElement(k ? "td" : "th"));
      if (!k) cell.scope = "row";
      cell.textContent = text;
    });
    return row;
  }));
  query("#updates").hidden = !update.rows.length;
}

function replaceMap(update) {
  const [run] = runs;
  Object.assign(run, decodeMap(update.run));
  Object.assign(data.limits, update.limits);
  for (const field of Object.keys(minimums)) delete minimums[field];
  setLevels();
  for (const view of views) view.renew();
  rebuild();
}

// Called by the script that the session writes beside the page.
window.tactorchLive = (update) => {
  if (update.version === version) return;
  version = update.version;
  // Another object, or the first map: the page itself has it.
  if (update.mesh !== data.mesh) {
    location.reload();
    return;
  }
  replaceTexts(update);
  if (update.run) replaceMap(update);
  if (update.ended) clearInterval(timer);
};

// A page that is opened from a file may not read others, but may load scripts.
function poll() {
  const script = document.createElement("script");
  script.src = `${data.script}?${Date.now()}`;
  script.onload = script.onerror = () => script.remove();
  document.head.append(script);
}

beginOrExplain(() => {
  if (runs.length) {
    const [run] = runs;
    state.at = run.center ? [...run.center] : bounds[0].map((low, a) => 0.5 * (low + bounds[1][a]));
    makeControls();
    makeGrid();
    describeFields();
    makeViews();
    listeners.push(drawSlices, drawViews);
    redraw();
    followPage();
  }
  if (!data.ended) timer = setInterval(poll, POLL_MS);
});
