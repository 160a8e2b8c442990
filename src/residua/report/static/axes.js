// Numbers, times, colours and thresholds as the charts of all pages show them.
const residuaAxes = (function () {
  "use strict";

  function colours() {
    const style = getComputedStyle(document.documentElement), found = {};
    for (const name of ["paper", "text", "muted", "grid", "alarm", "missing", "undecided", "band", "threshold", "onset", "fade", "began"])
      found[name] = style.getPropertyValue("--" + name).trim();
    found.series = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => style.getPropertyValue("--c" + k).trim());
    return found;
  }

  const two = (v) => String(v).padStart(2, "0");
  const day = (d) => d.getUTCFullYear() + "-" + two(d.getUTCMonth() + 1) + "-" + two(d.getUTCDate());

  function clockTime(seconds, step) {
    const digits = step >= 1 ? 0 : Math.min(3, Math.ceil(-Math.log10(step) - 1e-9));
    const d = new Date(Math.round(seconds * 10 ** digits) / 10 ** digits * 1000);
    const rest = digits ? "." + String(d.getUTCMilliseconds()).padStart(3, "0").slice(0, digits) : "";
    return two(d.getUTCHours()) + ":" + two(d.getUTCMinutes()) + ":" + two(d.getUTCSeconds()) + rest;
  }

  // The time of day at each tick, without seconds where all are whole minutes; the date below the first of each day.
  function clockTicks(u, splits) {
    const step = splits.length > 1 ? splits[1] - splits[0] : 60;
    let last = "";
    return splits.map((v) => {
      const date = day(new Date(v * 1000));
      const time = step >= 86400 ? "" : step >= 60 ? clockTime(v, 1).slice(0, 5) : clockTime(v, step);
      const text = date === last ? time : time + (time ? "\n" : "") + (last ? date.slice(5) : date);
      last = date;
      return text;
    });
  }

  function short(value) {
    if (value == null) return "";
    const size = Math.abs(value);
    if (size !== 0 && (size >= 1e6 || size < 1e-4)) return value.toExponential(3);
    return String(Number(value.toPrecision(5)));
  }

  // Tick labels with the digits that neighbouring ticks need, short at any magnitude.
  function ticks(u, splits) {
    const seen = splits.filter((v) => v != null);
    const size = Math.max(...seen.map(Math.abs), 0);
    const step = seen.length > 1 ? Math.abs(seen[1] - seen[0]) : size;
    const digits = step > 0 ? Math.min(15, Math.max(1, Math.ceil(Math.log10(size / step)) + 2)) : 4;
    const exponent = size >= 1e6 || (size < 1e-3 && size > 0);
    return splits.map((v) => {
      if (v == null) return "";
      if (Math.abs(v) < step * 1e-6) return "0";
      const rounded = Number(v.toPrecision(digits));
      return exponent ? rounded.toExponential().replace("e+", "e") : String(rounded);
    });
  }

  // The line of a threshold with its value, above everything else in the chart.
  function drawThreshold(u, threshold, colours) {
    const ctx = u.ctx, box = u.bbox, pixel = devicePixelRatio;
    const at = u.valToPos(threshold, "y", true);
    ctx.setLineDash([7 * pixel, 4 * pixel]);
    ctx.strokeStyle = ctx.fillStyle = colours.threshold;
    ctx.lineWidth = 1.75 * pixel;
    ctx.beginPath();
    ctx.moveTo(box.left, at);
    ctx.lineTo(box.left + box.width, at);
    ctx.stroke();
    ctx.textAlign = "left";
    ctx.font = 12 * pixel + "px system-ui, sans-serif";
    const room = at - box.top > 20 * pixel;
    ctx.textBaseline = room ? "bottom" : "top";
    const place = ["threshold " + short(threshold), box.left + 6 * pixel, at + (room ? -3 : 3) * pixel];
    ctx.setLineDash([]);
    ctx.strokeStyle = colours.paper;
    ctx.lineWidth = 4 * pixel;
    ctx.lineJoin = "round";
    ctx.strokeText(...place);
    ctx.fillText(...place);
  }

  return { colours, two, day, clockTime, clockTicks, short, ticks, drawThreshold };
})();
