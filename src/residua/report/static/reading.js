// Reading a chart without a mouse: the sample under its cursor in words, the keys that move it, and its values as a table.
const residuaReading = (function () {
  "use strict";
  const { short } = residuaAxes;
  const ROWS = 24;
  const STATES = { alarm: "alarm", missing: "values missing", undecided: "not judged" };

  // The sample under the cursor; without a cursor the last one with a value.
  function sample(u) {
    if (u.cursor.idx != null) return u.cursor.idx;
    const [x, ...lines] = u.data;
    for (let k = x.length - 1; k >= 0; k--) if (lines.some((line) => line[k] != null)) return k;
    return x.length - 1;
  }

  // Time and values of a sample; the names of the lines where there are several.
  function words(entry, k) {
    const [x, ...lines] = entry.plot.data, several = lines.length > 1;
    const values = lines.map((line, i) => (several ? entry.names[i] + " " : "") +
      (line[k] == null ? "no value" : short(line[k]) + (entry.unit ? " " + entry.unit : "")));
    return entry.told(x[k]) + ": " + values.join(", ");
  }

  function speak(entry) {
    const u = entry.plot, k = sample(u);
    entry.place.setAttribute("aria-valuemax", Math.max(0, u.data[0].length - 1));
    entry.place.setAttribute("aria-valuenow", Math.max(0, k));
    entry.place.setAttribute("aria-valuetext", k < 0 ? "no value" : words(entry, k));
  }

  // The first and the last sample in view.
  function ends(u) {
    const { min, max } = u.scales.x, x = u.data[0];
    let first = 0, last = x.length - 1;
    while (first < last && x[first] < min) first++;
    while (last > first && x[last] > max) last--;
    return [first, last];
  }

  function pressed(entry, event) {
    const u = entry.plot;
    if (!u || !u.data[0].length || event.ctrlKey || event.altKey || event.metaKey) return;
    const [first, last] = ends(u), k = sample(u), leap = Math.max(1, Math.round((last - first) / 20));
    const steps = { ArrowLeft: k - 1, ArrowRight: k + 1, PageUp: k - leap, PageDown: k + leap, Home: first, End: last };
    const zooms = { "+": 0.25, "=": 0.25, "-": 1 };
    const x = u.data[0], middle = x[Math.min(last, Math.max(first, k))], width = u.scales.x.max - u.scales.x.min;
    if (event.key in steps) {
      const to = Math.min(last, Math.max(first, steps[event.key]));
      u.setCursor({ left: u.valToPos(x[to], "x"), top: 0 }, true, true);
    } else if (event.key in zooms) {
      const half = zooms[event.key] * width;
      entry.zoom(Math.max(x[0], middle - half), Math.min(x[x.length - 1], middle + half));
    } else if (event.key === "Escape") entry.whole();
    else return;
    event.preventDefault();
    speak(entry);
  }

  function cell(tag, text) {
    const made = document.createElement(tag);
    made.textContent = text;
    return made;
  }

  // One row for each stretch of the time in view: the smallest and the largest value of every line, and its state.
  function fill(entry) {
    const box = entry.table, u = entry.plot;
    if (!box || !box.open || !u) return;
    const [x, ...lines] = u.data, [first, last] = ends(u), spans = entry.spans();
    const table = document.createElement("table"), head = table.createTHead().insertRow(), body = table.createTBody();
    for (const name of ["From", ...entry.names, "State"]) head.append(cell("th", name));
    const rows = Math.min(ROWS, last - first + 1);
    for (let r = 0; r < rows; r++) {
      const from = first + Math.floor(r * (last - first + 1) / rows), to = first + Math.floor((r + 1) * (last - first + 1) / rows);
      const row = body.insertRow();
      row.append(cell("td", entry.told(x[from])));
      for (const line of lines) {
        const seen = line.slice(from, to).filter((v) => v != null);
        const low = seen.reduce((a, b) => Math.min(a, b), Infinity), high = seen.reduce((a, b) => Math.max(a, b), -Infinity);
        row.append(cell("td", !seen.length ? "–" : low === high ? short(low) : short(low) + " to " + short(high)));
      }
      const within = Object.keys(STATES).filter((kind) => (spans[kind] || []).some(([a, b]) => a <= x[to - 1] && b >= x[from]));
      row.append(cell("td", within.map((kind) => STATES[kind]).join(", ")));
    }
    box.lastChild.replaceChildren(table);
  }

  // Give a chart its keys and its table. An entry has place, names, unit, told, spans, zoom, whole, and plot once drawn.
  function attach(entry) {
    const { place } = entry, box = document.createElement("details"), scroll = document.createElement("div");
    Object.assign(place, { tabIndex: 0, role: "slider" });
    place.setAttribute("aria-valuemin", 0);
    place.title = "Arrow keys move the cursor, + and − zoom, Esc shows all";
    place.addEventListener("keydown", (event) => pressed(entry, event));
    box.className = "values";
    scroll.className = "scroll";
    box.append(cell("summary", "Values as a table"), scroll);
    box.addEventListener("toggle", () => fill(entry));
    entry.table = box;
    place.after(box);
  }

  return { sample, words, speak, fill, attach };
})();
