// The charts of one plant: statistic, residuals and signals, which follow the data or stand still where zoomed.
const residuaLiveCharts = (function () {
  "use strict";
  const { day, clockTime, clockTicks, short, ticks, drawThreshold, colours: readColours } = residuaAxes;
  const { words, speak, fill, attach } = residuaReading;
  const HEIGHT = { statistic: 220, residual: 160, signal: 150 };
  const SHOWN = 6;
  const find = (selector) => document.querySelector(selector);
  let colours = {}, entries = [], made = "", data = null, view = null;

  function told(v) {
    if (v == null) return "";
    return data.dated ? day(new Date(v * 1000)) + " " + clockTime(v, data.dt) : "t = " + Number(v.toPrecision(8)) + " s";
  }

  function spansOf(plant) {
    const last = plant.time.length ? plant.time[plant.time.length - 1] : 0;
    return {
      alarm: plant.alarms.map((a) => [a.raised, a.ended == null ? last : a.ended]),
      missing: plant.missing.map(([a, b]) => [a, b == null ? last : b]),
      onsets: plant.alarms.filter((a) => a.onset != null).map((a) => a.onset),
    };
  }

  function below(entry) {
    return (u) => {
      const ctx = u.ctx, box = u.bbox;
      clipped(ctx, box, () => {
        for (const kind of ["missing", "alarm"]) {
          ctx.fillStyle = colours[kind];
          for (const [a, b] of data.spans[kind]) {
            const left = u.valToPos(a, "x", true), right = u.valToPos(b, "x", true);
            if (right < box.left || left > box.left + box.width) continue;
            ctx.fillRect(left, box.top, Math.max(right - left, 2 * devicePixelRatio), box.height);
          }
        }
        if (entry.band) {
          const low = u.valToPos(entry.band[0], "y", true), high = u.valToPos(entry.band[1], "y", true);
          ctx.fillStyle = colours.band;
          ctx.fillRect(box.left, high, box.width, Math.max(low - high, devicePixelRatio));
        }
      });
    };
  }

  function above(entry) {
    return (u) => {
      const ctx = u.ctx, box = u.bbox, pixel = devicePixelRatio;
      clipped(ctx, box, () => {
        ctx.lineWidth = 1.25 * pixel;
        ctx.setLineDash([2 * pixel, 3 * pixel]);
        ctx.strokeStyle = colours.onset;
        for (const onset of data.spans.onsets) upright(ctx, u.valToPos(onset, "x", true), box);
        if (entry.threshold != null) drawThreshold(u, entry.threshold, colours);
      });
    };
  }

  function clipped(ctx, box, paint) {
    ctx.save();
    ctx.beginPath();
    ctx.rect(box.left, box.top, box.width, box.height);
    ctx.clip();
    paint();
    ctx.restore();
  }

  function upright(ctx, at, box) {
    ctx.beginPath();
    ctx.moveTo(at, box.top);
    ctx.lineTo(at, box.top + box.height);
    ctx.stroke();
  }

  function range(entry) {
    return (u, min, max) => {
      const must = [...(entry.band || []), ...(entry.threshold == null ? [] : [entry.threshold])];
      const low = Math.min(min == null ? Infinity : min, ...must), high = Math.max(max == null ? -Infinity : max, ...must);
      if (!(low <= high)) return [0, 1];
      const room = 0.08 * (high - low) || 0.1 * Math.abs(high) || 1;
      return [entry.kind === "statistic" ? Math.min(0, low) : low - room, high + room];
    };
  }

  function options(entry, width) {
    const axis = { stroke: () => colours.muted, grid: { stroke: () => colours.grid, width: 1 },
      ticks: { stroke: () => colours.grid, width: 1 }, font: "12px system-ui, sans-serif",
      labelFont: "12px system-ui, sans-serif", labelSize: 18 };
    const quantity = { statistic: "statistic", residual: "residual", signal: "value" }[entry.kind];
    const clock = data.dated;
    return {
      width, height: HEIGHT[entry.kind], padding: [8, 18, 0, 0],
      scales: { x: { time: clock, range: (u, min, max) => (min == null ? data.ends : [min, max]) }, y: { range: range(entry) } },
      axes: [
        { ...axis, label: clock ? "" : "time [s]", labelSize: clock ? 0 : 18, size: clock ? 44 : 30, values: clock ? clockTicks : ticks },
        { ...axis, label: quantity + " [" + (entry.unit || "–") + "]", size: 62, values: ticks, space: 24 },
      ],
      series: [{}, { scale: "y", width: 1.25, stroke: () => colours.series[0] }],
      tzDate: (ts) => uPlot.tzDate(new Date(ts * 1000), "Etc/UTC"),
      legend: { show: false },
      cursor: { y: false, drag: { x: true, y: false, dist: 4 }, bind: { dblclick: () => () => whole() },
        sync: { key: "residua", setSeries: false, scales: ["x", null],
          filters: { pub: (type) => type === "mousemove" || type === "mouseleave" } } },
      hooks: { drawClear: [below(entry)], draw: [above(entry)], setCursor: [(u) => read(entry, u)],
        setScale: [(u, key) => { if (key === "x") fill(entry); }],
        setSelect: [(u) => { if (u.select.width > 0) hold(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x")); }] },
    };
  }

  function read(entry, u) {
    if (!entry.plot) return;
    entry.readout.textContent = u.cursor.idx == null ? latest(entry) : words(entry, u.cursor.idx);
    if (document.activeElement === entry.place) speak(entry);
  }

  function latest(entry) {
    const value = entry.values[entry.values.length - 1];
    return value == null ? "" : "now " + short(value) + (entry.unit ? " " + entry.unit : "");
  }

  // One stretch of time for all charts; null: all of it, as it goes on.
  function hold(min, max) { view = [min, max]; place(); }
  function whole() { view = null; place(); }

  function place() {
    find("#held").hidden = view == null;
    const [min, max] = view || data.ends;
    for (const { plot } of entries) if (plot) plot.setScale("x", { min, max });
  }

  function figure(entry, into) {
    const made = document.createElement("figure"), caption = document.createElement("figcaption");
    const name = document.createElement("span");
    entry.readout = document.createElement("span");
    entry.readout.className = "readout";
    entry.place = document.createElement("div");
    entry.place.className = "plot";
    made.className = "chart";
    made.dataset.series = entry.name;
    name.textContent = entry.title;
    caption.append(name, entry.readout);
    made.append(caption, entry.place);
    Object.assign(entry, { names: [entry.title], told, zoom: hold, whole, spans: () => data.spans });
    entry.place.setAttribute("aria-label", entry.title + " over time");
    attach(entry);
    into.append(made);
  }

  function wanted(plant) {
    const band = (r) => (r.center == null || r.band == null ? null : [r.center - r.band, r.center + r.band]);
    return [
      { kind: "statistic", name: "statistic", title: "Statistic and its threshold", unit: "", threshold: plant.threshold, values: plant.statistic },
      ...plant.residuals.map((r) => ({ kind: "residual", name: r.name, title: r.name, unit: r.unit, band: band(r), values: r.values })),
      ...plant.signals.map((s) => ({ kind: "signal", name: s.name, title: s.name, unit: s.unit, values: s.values })),
    ];
  }

  function build(list) {
    clear();
    const residuals = list.filter((e) => e.kind === "residual").length;
    const more = find("#more");
    more.hidden = residuals <= SHOWN;
    more.querySelector("summary").textContent = residuals - SHOWN + " more residuals";
    let seen = 0;
    for (const entry of list) {
      const hidden = entry.kind === "residual" && ++seen > SHOWN;
      figure(entry, find(hidden ? "#more > div" : { statistic: "#statistic", residual: "#residuals", signal: "#signals" }[entry.kind]));
    }
    entries = list;
  }

  function clear() {
    for (const { plot } of entries) if (plot) plot.destroy();
    for (const id of ["#statistic", "#residuals", "#signals", "#more > div"]) find(id).replaceChildren();
    entries = [];
    made = "";
    view = null;
  }

  function draw(entry) {
    const width = entry.place.clientWidth, values = [data.times, entry.values];
    if (!width || entry.place.closest("details:not([open])")) return;
    if (!entry.plot) {
      entry.plot = new uPlot(options(entry, width), values, entry.place);
    } else {
      if (entry.plot.width !== width) entry.plot.setSize({ width, height: HEIGHT[entry.kind] });
      entry.plot.setData(values, false);
    }
    const [min, max] = view || data.ends;
    entry.plot.setScale("x", { min, max });
    if (entry.plot.cursor.idx == null || entry.plot.cursor.left < 0) { entry.readout.textContent = latest(entry); speak(entry); }
  }

  // Show a plant as the server tells of it; charts of the same series only get their new values.
  function show(plant) {
    if (!plant.time.length) { clear(); find("#charts").hidden = true; return; }
    find("#charts").hidden = false;
    if (!Object.keys(colours).length) colours = readColours();
    const times = plant.time;
    data = { dated: plant.dated, dt: plant.dt, times, ends: [times[0], times[times.length - 1]] };
    if (data.ends[0] === data.ends[1]) data.ends[1] += plant.dt;
    data.spans = spansOf(plant);
    const list = wanted(plant), key = JSON.stringify([plant.plant, plant.dated, list.map((e) => [e.kind, e.name, e.unit])]);
    if (key !== made) { build(list); made = key; }
    list.forEach((fresh, k) => Object.assign(entries[k], { values: fresh.values, band: fresh.band, threshold: fresh.threshold }));
    entries.forEach(draw);
    document.body.dataset.drawnPoints = entries.reduce((n, e) => n + (e.plot ? e.values.filter((v) => v != null).length : 0), 0);
    document.body.dataset.drawnCharts = entries.filter((e) => e.plot).length;
  }

  function resize() {
    for (const entry of entries)
      if (entry.plot && entry.place.clientWidth) entry.plot.setSize({ width: entry.place.clientWidth, height: HEIGHT[entry.kind] });
      else if (data) draw(entry);
  }

  let waiting = 0;
  window.addEventListener("resize", () => { clearTimeout(waiting); waiting = setTimeout(resize, 80); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    colours = readColours();
    for (const { plot } of entries) if (plot) plot.redraw(false, true);
  });
  find("#whole").addEventListener("click", whole);
  find("#more").addEventListener("toggle", () => { if (data) entries.forEach(draw); });
  return { show, clear };
})();
