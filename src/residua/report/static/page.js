(function () {
  "use strict";
  const { day, clockTime, clockTicks, short, ticks, drawThreshold } = residuaAxes;
  const { sample, words, speak, fill, attach } = residuaReading;
  const root = document.documentElement;
  const page = JSON.parse(document.getElementById("residua-data").textContent);
  const HEIGHT = { residual: 160, statistic: 220, member: 160, scores: 240, signal: 160 };
  const everything = [];
  let colours = {};
  let drawn = 0;

  function readColours() { colours = residuaAxes.colours(); }

  function times(x) {
    if (x.list) return x.list;
    return Float64Array.from({ length: x.n }, (_, k) => x.start + k * x.step);
  }

  // Seconds become clock times (of a clock without zones, taken for UTC by the chart), or hours or days.
  function called(data) {
    const { base, factor } = data.clock;
    const shift = (t) => (base == null ? t / factor : base + t);
    data.times = Float64Array.from(times(data.x), shift);
    data.ends = data.ends.map(shift);
    data.onsets = data.onsets.map(shift);
    for (const kind in data.spans) data.spans[kind] = data.spans[kind].map((pair) => pair.map(shift));
    for (const chart of data.charts) {
      if (chart.alarms) chart.alarms = chart.alarms.map((pair) => pair.map(shift));
      if (chart.onsets) chart.onsets = chart.onsets.map(shift);
    }
  }

  function told(data, v) {
    if (v == null) return "";
    if (data.clock.base != null) return day(new Date(v * 1000)) + " " + clockTime(v, data.x.step || 1);
    return "t = " + Number(v.toPrecision(8)) + " " + data.clock.unit;
  }

  // Canvas fills below and above the lines: spans of time, the band, the threshold, the onsets.
  function below(chart, data) {
    return (u) => {
      const ctx = u.ctx, box = u.bbox;
      ctx.save();
      ctx.beginPath();
      ctx.rect(box.left, box.top, box.width, box.height);
      ctx.clip();
      for (const kind of ["undecided", "missing", "alarm"]) {
        ctx.fillStyle = colours[kind];
        for (const [a, b] of (kind === "alarm" && chart.alarms) || data.spans[kind]) {
          const left = u.valToPos(a, "x", true), right = u.valToPos(b, "x", true);
          if (right < box.left || left > box.left + box.width) continue;
          ctx.fillRect(left, box.top, Math.max(right - left, devicePixelRatio), box.height);
        }
      }
      ctx.fillStyle = colours.began;
      for (const [a, b] of chart.kind === "member" && chart.alarms ? [] : data.spans.began) {
        const left = u.valToPos(a, "x", true), right = u.valToPos(b, "x", true);
        ctx.fillRect(left, box.top, Math.max(right - left, 2 * devicePixelRatio), box.height);
      }
      if (chart.band) {
        const low = u.valToPos(chart.band[0], "y", true), high = u.valToPos(chart.band[1], "y", true);
        ctx.fillStyle = colours.band;
        ctx.fillRect(box.left, high, box.width, Math.max(low - high, devicePixelRatio));
      }
      ctx.restore();
    };
  }

  function above(chart, data) {
    return (u) => {
      const ctx = u.ctx, box = u.bbox, pixel = devicePixelRatio;
      ctx.save();
      ctx.beginPath();
      ctx.rect(box.left, box.top, box.width, box.height);
      ctx.clip();
      if (chart.kind === "scores") {
        ctx.fillStyle = colours.fade;
        let from = box.left;
        for (const [a, b] of [...data.spans.alarm, [Infinity, Infinity]]) {
          const to = a === Infinity ? box.left + box.width : u.valToPos(a, "x", true);
          if (to > from) ctx.fillRect(from, box.top, to - from, box.height);
          from = Math.max(from, a === Infinity ? from : u.valToPos(b, "x", true));
        }
      }
      ctx.lineWidth = 1.25 * pixel;
      ctx.setLineDash([2 * pixel, 3 * pixel]);
      ctx.strokeStyle = colours.onset;
      for (const onset of chart.onsets || data.onsets) {
        const at = u.valToPos(onset, "x", true);
        ctx.beginPath();
        ctx.moveTo(at, box.top);
        ctx.lineTo(at, box.top + box.height);
        ctx.stroke();
      }
      if (chart.threshold != null && !(chart.log && chart.threshold <= 0)) {
        drawThreshold(u, chart.threshold, colours);
      }
      ctx.restore();
    };
  }

  function yScale(chart, data) {
    if (chart.kind === "scores") return { range: [0, 1.02] };
    const must = [];
    if (chart.band) must.push(...chart.band);
    if (chart.threshold != null) must.push(chart.threshold);
    if (chart.log)
      return {
        distr: 3,
        range: (u, min, max) => {
          const top = Math.max(max || 0, ...must.map((v) => 1.5 * v), 1e-300);
          const low = Math.max(Math.min(min || top, ...must), top * 1e-6, chart.floor || 0);
          return uPlot.rangeLog(Math.min(low, top), top, 10, false);
        },
      };
    return {
      range: (u, min, max) => {
        let low = Math.min(min == null ? Infinity : min, ...must);
        let high = Math.max(max == null ? -Infinity : max, ...must);
        if (!(low <= high)) return [0, 1];
        const [from, to] = u.scales.x.min == null ? data.view : [u.scales.x.min, u.scales.x.max];
        if (chart.limits && !data.spans.undecided.some(([a, b]) => a <= from && to <= b)) {
          // Room for what was judged, and a quarter more: the transient of a settling filter may leave.
          const [least, most] = [Math.min(chart.limits[0], ...must), Math.max(chart.limits[1], ...must)];
          const more = 0.25 * (most - least);
          if (more > 0) [low, high] = [Math.max(low, least - more), Math.min(high, most + more)];
          if (!(low < high)) [low, high] = [least, most];
        }
        const room = 0.08 * (high - low) || 0.1 * Math.abs(high) || 1;
        return [chart.kind === "statistic" || chart.kind === "member" ? Math.min(0, low) : low - room, high + room];
      },
    };
  }

  function values(chart) {
    if (!chart.log) return chart.y;
    return chart.y.map((series) => series.map((v) => (v == null || v <= 0 ? null : v)));
  }

  function options(entry, width) {
    const { chart, data } = entry;
    const axis = { stroke: () => colours.muted, grid: { stroke: () => colours.grid, width: 1 },
      ticks: { stroke: () => colours.grid, width: 1 }, font: "12px system-ui, sans-serif",
      labelFont: "12px system-ui, sans-serif", labelSize: 18 };
    const clock = data.clock.base != null, time = clock ? "time" : "time [" + data.clock.unit + "]";
    const names = { signal: "value", residual: chart.estimate ? "estimate" : "residual", statistic: "statistic [–]", member: "statistic [–]", scores: "score [–]" };
    const several = chart.names.length > 1;
    const label = chart.axis || (chart.unit ? names[chart.kind] + " [" + chart.unit + "]" : names[chart.kind]);
    return {
      width, height: HEIGHT[chart.kind], padding: [8, 18, 0, 0],
      scales: { x: { time: clock, range: (u, min, max) => (min == null ? data.ends : [min, max]) }, y: yScale(chart, data) },
      axes: [
        { ...axis, label: clock ? "" : time, labelSize: clock ? 0 : 18, size: clock ? 44 : 30, values: clock ? clockTicks : ticks },
        { ...axis, label, size: 62, values: chart.log ? undefined : ticks, space: 24 },
      ],
      series: [
        { label: "At", value: (u, v) => told(data, v) },
        ...chart.names.map((name, k) => ({
          label: name, scale: "y", width: chart.kind === "scores" || (several && k) ? 1.75 : 1.25, value: (u, v) => short(v),
          stroke: () => colours.series[k % 8], dash: k >= 8 ? [6, 3 + 3 * Math.floor(k / 8)] : undefined,
        })),
      ],
      tzDate: (ts) => uPlot.tzDate(new Date(ts * 1000), "Etc/UTC"),
      legend: { show: chart.kind === "scores" || several },
      cursor: { y: false, drag: { x: true, y: false, dist: 4 }, bind: { dblclick: () => () => zoom(data, ...data.ends) },
        sync: { key: "residua" + data.id, setSeries: false, scales: ["x", null],
          filters: { pub: (type) => type === "mousemove" || type === "mouseleave" } } },
      hooks: { drawClear: [below(chart, data)], draw: [above(chart, data), () => count(entry)],
        setCursor: [() => read(entry)],
        setScale: [(u, key) => { if (key === "x") { zoom(data, u.scales.x.min, u.scales.x.max); fill(entry); } }] },
    };
  }

  // Time and value under the cursor, or of the last sample: in the legend, or beside the title of a chart with one line.
  function read(entry) {
    if (!entry.plot) return;
    if (entry.readout) entry.readout.textContent = entry.plot.data[0].length ? words(entry, sample(entry.plot)) : "";
    else if (entry.plot.cursor.idx == null) entry.plot.setLegend({ idx: sample(entry.plot) });
    if (document.activeElement === entry.place) speak(entry);
  }

  function count(entry) {
    if (entry.counted) return;
    entry.counted = true;
    for (const series of entry.chart.y) for (const v of series) if (v != null) drawn++;
    root.dataset.drawnPoints = drawn;
    root.dataset.drawnCharts = everything.filter((e) => e.counted).length;
  }

  // One stretch of time for all charts of a diagnosis.
  function zoom(data, min, max) {
    if (data.zooming || (data.view && data.view[0] === min && data.view[1] === max)) return;
    data.zooming = true;
    data.view = [min, max];
    for (const { plot } of data.entries)
      if (plot && (plot.scales.x.min !== min || plot.scales.x.max !== max)) plot.setScale("x", { min, max });
    data.zooming = false;
  }

  function draw(entry) {
    const width = entry.place.clientWidth;
    if (!width || entry.place.closest("details:not([open])")) return;
    if (entry.plot) entry.plot.destroy();
    entry.plot = null;
    const { data } = entry;
    entry.plot = new uPlot(options(entry, width), [data.times, ...values(entry.chart)], entry.place);
    if (data.view !== data.ends) entry.plot.setScale("x", { min: data.view[0], max: data.view[1] });
    read(entry);
    speak(entry);
  }

  function start() {
    readColours();
    const began = performance.now();
    document.querySelectorAll(".charts").forEach((block) => {
      const data = page.diagnoses[Number(block.dataset.diagnosis)];
      data.id = block.dataset.diagnosis;
      called(data);
      data.view = data.ends;
      data.entries = [];
      block.querySelectorAll("figure.chart").forEach((figure) => {
        const chart = data.charts[Number(figure.dataset.chart)];
        const entry = { chart, data, place: figure.querySelector(".plot"), readout: figure.querySelector(".readout"),
          names: chart.names, unit: chart.unit, told: (v) => told(data, v), zoom: (a, b) => zoom(data, a, b),
          whole: () => zoom(data, ...data.ends), spans: () => ({ ...data.spans, alarm: chart.alarms || data.spans.alarm }) };
        attach(entry);
        data.entries.push(entry);
        everything.push(entry);
        const box = figure.querySelector("input.log");
        if (box) {
          box.checked = chart.log;
          box.addEventListener("change", () => { chart.log = box.checked; draw(entry); });
        }
        draw(entry);
      });
      block.querySelector("button.all").addEventListener("click", () => zoom(data, ...data.ends));
    });
    document.querySelectorAll("details").forEach((details) => details.addEventListener("toggle", () => {
      if (details.open) everything.filter((e) => !e.plot && details.contains(e.place)).forEach(draw);
    }));
    // uPlot draws in a microtask, so the time is taken after those.
    Promise.resolve().then(() => Promise.resolve()).then(() => {
      root.dataset.drawMs = (performance.now() - began).toFixed(1);
      root.dataset.charts = everything.length;
    });
  }

  function repaint() {
    readColours();
    for (const { plot } of everything) if (plot) plot.redraw(false, true);
  }

  function resize(width) {
    for (const { plot, place, chart } of everything)
      if (plot && (width || place.clientWidth)) plot.setSize({ width: width || place.clientWidth, height: HEIGHT[chart.kind] });
  }

  let waiting = 0;
  window.addEventListener("resize", () => { clearTimeout(waiting); waiting = setTimeout(() => resize(), 80); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);

  // On paper: light colours, everything opened, charts as wide as the sheet.
  let closed = [];
  window.addEventListener("beforeprint", () => {
    root.dataset.print = "yes";
    closed = [...document.querySelectorAll("details:not([open], .values)")];
    closed.forEach((d) => { d.open = true; });
    readColours();
    resize(680);
    everything.filter((e) => !e.plot).forEach(draw);
    repaint();
  });
  window.addEventListener("afterprint", () => {
    delete root.dataset.print;
    closed.forEach((d) => { d.open = false; });
    resize();
    repaint();
  });

  // The picture of three residuals turns when dragged.
  document.querySelectorAll('svg.picture[data-axes="3"]').forEach((svg) => {
    let turn = Number(svg.dataset.turn), tilt = Number(svg.dataset.tilt);
    const radius = Number(svg.querySelector(".sphere").getAttribute("r"));
    function project(text) {
      const [a, b, c] = text.split(",").map(Number);
      const depth = a * Math.sin(turn) + b * Math.cos(turn);
      return [radius * (a * Math.cos(turn) - b * Math.sin(turn)), -radius * (c * Math.cos(tilt) + depth * Math.sin(tilt))];
    }
    function place() {
      svg.querySelectorAll("polygon").forEach((disc) =>
        disc.setAttribute("points", disc.dataset.rim.split(";").map((v) => project(v).join(",")).join(" ")));
      svg.querySelectorAll("g[data-v]").forEach((g) => {
        const [x, y] = project(g.dataset.v);
        const back = g.classList.contains("observed") ? 0 : -1, reach = g.classList.contains("axis") ? 1.16 : 1.08;
        const [first, second] = g.querySelectorAll("line");
        first.setAttribute("x2", back * x); first.setAttribute("y2", back * y);
        second.setAttribute("x2", x); second.setAttribute("y2", y);
        const tip = g.querySelector("circle"), text = g.querySelector("text");
        tip.setAttribute("cx", x); tip.setAttribute("cy", y);
        text.setAttribute("x", reach * x); text.setAttribute("y", reach * y);
      });
    }
    svg.addEventListener("keydown", (event) => {
      const [across, down] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key] || [];
      if (across == null) return;
      event.preventDefault();
      turn += across / 8;
      tilt = Math.max(-1.5, Math.min(1.5, tilt + down / 8));
      place();
    });
    svg.addEventListener("pointerdown", (event) => svg.setPointerCapture(event.pointerId));
    svg.addEventListener("pointermove", (event) => {
      if (!event.buttons) return;
      turn += event.movementX / 120;
      tilt = Math.max(-1.5, Math.min(1.5, tilt + event.movementY / 120));
      place();
    });
  });

  // A link to a folded part opens it.
  function unfold() {
    const part = location.hash.length > 1 && document.getElementById(location.hash.slice(1));
    const folded = part && part.querySelector(":scope > details");
    if (folded) folded.open = true;
  }
  window.addEventListener("hashchange", unfold);

  // A command is copied as one line; where the browser keeps its clipboard shut, it is selected.
  document.querySelectorAll("pre.command").forEach((line) => {
    const button = document.createElement("button"), code = line.querySelector("code");
    Object.assign(button, { type: "button", textContent: "Copy", className: "screen" });
    button.setAttribute("aria-label", "Copy " + code.textContent);
    button.addEventListener("click", () => {
      getSelection().selectAllChildren(code);
      if (navigator.clipboard) navigator.clipboard.writeText(code.textContent).then(() => { button.textContent = "Copied"; }, () => {});
    });
    line.append(button);
  });

  start();
  unfold();
})();
