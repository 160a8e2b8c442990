// The page of a live run: data by asking every two seconds, and at once when an event comes.
(function () {
  "use strict";
  const { day, clockTime, short } = residuaAxes;
  const body = document.body, title = document.title;
  const EVERY = 2000, SILENT = 12000, ROWS = 100, KEPT = 200, PATIENCE = 8000, OLD = 60;
  const MARKS = { fault: "⚠", missing: "?", waiting: "?", quiet: "✓" };
  const STATES = { missing: "data missing", waiting: "waiting for data", quiet: "no fault" };
  const find = (selector) => document.querySelector(selector);
  const chosen = () => (location.hash.startsWith("#/") ? decoded(location.hash.slice(2)) : null);
  const decoded = (text) => { try { return decodeURIComponent(text); } catch { return text; } };
  const linkTo = (plant) => "#/" + encodeURIComponent(plant);

  let stream = null, heard = 0, begun = 0, last = null, seen = 0, broken = false, refused = false, asking = false, again = false;
  let first = 0, dated = false, alone = null, recent = [], pause = 1000, timer = 0, drawing = 0;

  // ------------------------------------------------------------- words

  function make(tag, text, name) {
    const made = document.createElement(tag);
    if (text != null) made.textContent = text;
    if (name) made.className = name;
    return made;
  }

  function put(element, text) { if (element.textContent !== text) element.textContent = text; }

  function at(t, step) {
    if (t == null) return "";
    if (!dated) return Number(t.toPrecision(8)) + " s";
    return day(new Date(1000 * t)) + " " + clockTime(t, step || 1);
  }

  // A time of today without its day.
  function when(t) {
    const text = at(t), today = day(new Date());
    return dated && text.startsWith(today) ? text.slice(11) : text;
  }

  const long = (s) => (s < 7200 ? Math.round(s / 60) + " min" : s < 172800 ? Math.round(s / 3600) + " h" : Math.round(s / 86400) + " days");
  const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);
  const number = (n) => n.toLocaleString("en");
  const plants = (n) => number(n) + (n === 1 ? " plant" : " plants");
  const stateOf = (row) => (row.state === "fault" ? row.name || "a fault, not isolated" : row.name && row.state === "missing" ? STATES.missing + ": " + row.name : STATES[row.state]);

  function says(event) {
    const name = event.name || "not isolated", sure = event.sure ? " (" + event.sure + ")" : "";
    switch (event.kind) {
      case "raised": return "Alarm: " + name + sure;
      case "renamed": return "Now attributed to " + name + sure;
      case "confirmed": return "Still attributed to " + name + sure;
      case "ended": return event.part_of != null ? "Part of the alarm of " + when(event.part_of) + ": " + name : "Alarm over: " + name;
      case "standing": return "Alarm lasts to the end of the data: " + name + sure;
      case "missing": return "Not monitored: values are missing" + (event.channels && event.channels.length ? " (" + event.channels.join(", ") + ")" : "");
      case "back": return "Monitored again: values are back";
      case "clock": return "The clock of the plant went back: its data are refused until they pass the last sample";
      default: return event.kind;
    }
  }

  // -------------------------------------------------------- connection

  function state() {
    const now = refused ? "refused" : broken ? "lost" : heard ? "live" : "connecting";
    if (body.dataset.state !== now) body.dataset.state = now;
    put(find("#status"), {
      refused: "Access refused: open the address that residua live printed at its start",
      lost: "Connection lost since " + clock(heard) + "; reconnecting, no event is lost",
      live: "Live, " + clock(heard),
      connecting: "Connecting",
    }[now]);
  }

  const clock = (ms) => (ms ? clockTime(Math.floor(ms / 1000), 1) + " UTC" : "the start");

  function follow() {
    clearTimeout(timer);
    if (stream) stream.close();
    begun = Date.now();
    stream = new EventSource("events?after=" + last);
    stream.onopen = alive;
    stream.onmessage = (message) => { alive(); take(Number(message.lastEventId), JSON.parse(message.data)); };
    stream.addEventListener("beat", alive);
    stream.addEventListener("anew", () => location.reload());
    stream.onerror = () => {
      broken = true;
      state();
      // Closed for good: the server has refused. Then the next answer to a question says why.
      if (stream.readyState === EventSource.CLOSED) later();
    };
  }

  function later() {
    clearTimeout(timer);
    timer = setTimeout(follow, pause);
    pause = Math.min(2 * pause, 15000);
    refresh();
  }

  function alive() {
    const back = broken;
    heard = Date.now();
    broken = refused = false;
    pause = 1000;
    state();
    if (back) refresh();
  }

  setInterval(() => {
    if (stream && Date.now() - Math.max(heard, begun) > SILENT) { broken = true; follow(); }
    state();
  }, 1000);

  async function ask(path) {
    const answer = await fetch(path, { cache: "no-store", signal: AbortSignal.timeout(PATIENCE) });
    if (answer.status === 401 || answer.status === 403) { refused = true; state(); throw new Error("refused"); }
    if (answer.status === 404) return null;
    if (!answer.ok) throw new Error("status " + answer.status);
    return answer.json();
  }

  // ------------------------------------------------------------ events

  function take(place, event) {
    if (last != null && place <= last) return;
    last = place;
    recent.unshift({ place, event });
    if (recent.length > KEPT) recent.length = KEPT;
    seen++;
    clearTimeout(drawing);
    drawing = setTimeout(() => { list(); refresh(); }, 50);
  }

  function list() {
    const plant = shown(), rows = recent.filter((one) => plant == null || one.event.plant === plant);
    find("#none").hidden = rows.length > 0;
    const into = find("ol.events"), known = new Map([...into.children].map((li) => [li.dataset.place, li]));
    into.replaceChildren(...rows.map(({ place, event }) => known.get(String(place)) || item(place, event)));
    Object.assign(body.dataset, { lastEvent: last, events: seen });
  }

  function item(place, event) {
    const li = make("li"), link = make("a", event.plant);
    link.href = linkTo(event.plant);
    Object.assign(li.dataset, { place, plant: event.plant, number: event.number, kind: event.kind });
    const time = make("span", at(event.time));
    if (event.clock) time.title = event.clock;
    const named = make("span");
    named.append(link);
    li.append(time, named, make("span", says(event), "what"));
    return li;
  }

  // -------------------------------------------------------------- data

  const shown = () => chosen() ?? alone;

  async function refresh() {
    if (asking) { again = true; return; }
    asking = true;
    do {
      again = false;
      try { await everything(); if (stream && stream.readyState === EventSource.OPEN) broken = false; }
      catch { if (!refused) broken = true; }
      state();
    } while (again);
    asking = false;
  }

  async function everything() {
    const query = new URLSearchParams({ first, count: ROWS, find: find("#find").value });
    const overview = await ask("overview.json?" + query);
    dated = overview.dated;
    alone = overview.plants.all === 1 && overview.rows.length ? overview.rows[0].plant : null;
    if (last == null) {
      last = Math.max(0, overview.last_event - KEPT);
      follow();
    }
    const plant = shown();
    const one = plant == null ? null : await ask("plant/" + encodeURIComponent(plant) + ".json");
    if (plant !== shown()) { again = true; return; }
    around(overview);
    if (plant == null) whole(overview); else single(plant, one);
    body.dataset.view = plant == null ? "overview" : "plant";
    find("#overview").hidden = plant != null;
    find("#plant").hidden = plant == null;
    find("#happened").hidden = find("#connections").hidden = false;
    if (one) residuaLiveCharts.show(one);
  }

  function around(overview) {
    const counts = overview.plants;
    Object.assign(body.dataset, { plants: counts.all, faults: counts.fault, missing: counts.missing });
    document.title = (counts.fault ? "⚠ " + number(counts.fault) + " · " : "") + title;
    const problems = find("#problems");
    problems.hidden = !overview.problems.length;
    lines(problems.querySelector("ul"), overview.problems);
    const ends = [...overview.sources.map((one) => ["from", one]), ...overview.sinks.map((one) => ["to", one])];
    rows(find("table.ends tbody"), ends, endRow);
    const away = ends.filter(([, one]) => !one.good);
    find("#away").hidden = !away.length;
    lines(find("#away"), away.map(([way, one]) => "⚠ " + way + " " + one.name + ": " + endText(one)));
    list();
  }

  function endRow(tr, [way, one]) {
    if (!tr.children.length) tr.append(make("td"), make("td"));
    tr.dataset.good = one.good;
    tr.dataset.name = one.name;
    if (!tr.children[0].children.length) tr.children[0].append(make("span", null, "dot"), make("span"));
    tr.children[0].children[0].className = "dot " + (one.good ? "good" : "bad");
    put(tr.children[0].children[1], way + " " + one.name);
    put(tr.children[1], endText(one));
  }

  function endText(one) {
    const waits = one.behind ? number(one.behind) + (one.behind === 1 ? " event waits" : " events wait") : "";
    return [one.text, waits].filter(Boolean).join("; ");
  }

  function rows(table, values, fill) {
    while (table.children.length > values.length) table.lastChild.remove();
    while (table.children.length < values.length) table.append(make("tr"));
    values.forEach((value, k) => fill(table.children[k], value));
  }

  function lines(list, texts) {
    while (list.children.length > texts.length) list.lastChild.remove();
    while (list.children.length < texts.length) list.append(make("li"));
    texts.forEach((text, k) => put(list.children[k], text));
  }

  // ---------------------------------------------------------- overview

  function whole(overview) {
    const { plants: counts, rows: list } = overview;
    const card = find("#summary"), kind = counts.fault ? "fault" : counts.quiet ? "none" : "";
    card.className = "verdict " + kind;
    put(card.querySelector(".mark"), MARKS[counts.fault ? "fault" : counts.quiet ? "quiet" : "waiting"]);
    put(card.querySelector(".words"), counts.fault
      ? (counts.fault === 1 ? "A fault in 1 of " : "Faults in " + number(counts.fault) + " of ") + plants(counts.all)
      : counts.all ? (counts.quiet ? "No fault in " + (counts.quiet === counts.all ? plants(counts.all) : number(counts.quiet) + " of " + plants(counts.all)) : "Waiting for data from " + plants(counts.all)) : "No plant yet");
    const words = [];
    if (counts.fault && counts.quiet) words.push("no fault in " + number(counts.quiet));
    if (counts.missing) words.push("data missing in " + number(counts.missing));
    if (counts.waiting && (counts.fault || counts.quiet)) words.push("waiting for data from " + number(counts.waiting));
    lines(card.querySelector("ul"), words.length ? [capital(words.join(", "))] : []);

    rows(find("table.plants tbody"), list, plantRow);
    const all = counts.matching ?? counts.all;
    if (first && first >= all) { first = Math.max(0, Math.floor((all - 1) / ROWS) * ROWS); again = true; }
    put(find("#range"), all ? number(first + 1) + " to " + number(first + list.length) + " of " + number(all) : "none");
    find("#back").disabled = first === 0;
    find("#on").disabled = first + list.length >= all;
    find("#back").hidden = find("#on").hidden = all <= ROWS;
  }

  function plantRow(tr, row) {
    if (!tr.children.length) {
      for (const name of ["name", "state", "since time", "sure", "num", "last time"]) tr.append(make("td", null, name));
      tr.children[0].append(make("a"));
    }
    Object.assign(tr.dataset, { plant: row.plant, state: row.state, fault: row.state === "fault" ? row.name : "" });
    const [name, state, since, sure, ratio, lastSample] = tr.children, link = name.firstChild;
    put(link, row.plant);
    if (link.getAttribute("href") !== linkTo(row.plant)) link.setAttribute("href", linkTo(row.plant));
    put(state, MARKS[row.state] + " " + stateOf(row));
    put(since, row.since == null ? "" : when(row.since));
    put(sure, row.sure || "");
    put(ratio, row.ratio == null ? "" : row.ratio.toFixed(2));
    ratio.className = "num" + (row.ratio > 1 ? " beyond" : "");
    const old = row.age != null && row.age > OLD;
    put(lastSample, row.time == null ? "" : when(row.time) + (old ? ", " + long(row.age) + " ago" : ""));
    lastSample.className = "last time" + (old ? " old" : "");
  }

  // --------------------------------------------------------- one plant

  function single(plant, one) {
    find("#all").hidden = alone != null;
    put(find("#plant h2"), plant);
    body.dataset.plant = plant;
    const card = find("#verdict"), facts = find("#facts"), row = one && one.row;
    find("#charts").hidden = !one;
    if (!one) {
      residuaLiveCharts.clear();
      card.className = "verdict";
      put(card.querySelector(".mark"), "?");
      put(card.querySelector(".words"), "There is no such plant");
      put(card.querySelector(".tag"), "");
      lines(card.querySelector("ul"), []);
      put(facts, "");
      find("#alarms").replaceChildren();
      body.dataset.fault = "";
      return;
    }
    body.dataset.fault = row.state === "fault" ? row.name : "";
    const open = one.alarms.filter((a) => a.ended == null), now = open[open.length - 1];
    card.className = "verdict " + { fault: "fault", quiet: "none" }[row.state];
    put(card.querySelector(".mark"), MARKS[row.state]);
    put(card.querySelector(".words"), now && now.lines.length ? now.lines[0] : row.state === "fault" ? "Fault: " + stateOf(row) + ", alarm since " + when(row.since)
      : row.state === "quiet" ? "No fault" : capital(stateOf(row)) + (row.since == null ? "" : ", since " + when(row.since)));
    const tag = card.querySelector(".tag");
    put(tag, row.state === "fault" ? row.sure || "" : "");
    tag.hidden = !tag.textContent;
    lines(card.querySelector("ul"), [...(now ? now.lines.slice(1) : []), ...one.notes]);
    put(facts, [one.model, "step " + short(one.dt) + " s", number(row.rows) + " samples", row.time == null ? "none yet" : "the last at " + when(row.time) + (row.age > OLD ? ", received " + long(row.age) + " ago" : "")].join(" · "));
    const alarms = [...one.alarms].reverse();
    find("#alarms").replaceChildren(...(alarms.length ? alarms.map(alarm) : [make("p", "None.", "muted")]));
  }

  function alarm(one) {
    const box = make("div", null, "told" + (one.ended == null ? " lasts" : "")), who = make("p", null, "who");
    who.append(make("span", one.name || "A fault, not isolated"));
    if (one.sure) who.append(" ", make("span", one.sure, "tag"));
    const times = "Raised " + at(one.raised) + (one.onset == null ? "" : ", first over its threshold " + at(one.onset)) +
      (one.ended == null ? "; ongoing" : "; over " + at(one.ended));
    box.append(who, make("p", times, "muted"));
    if (one.lines.length > 1) { const ul = make("ul"); lines(ul, one.lines.slice(1)); box.append(ul); }
    if (one.candidates.length)
      box.append(make("p", "Candidates: " + one.candidates.map((c) => c.name + " " + c.weight).join(", "), "candidates"));
    return box;
  }

  // ------------------------------------------------------------- start

  history.replaceState(null, "", location.pathname + location.hash);  // the token is in the cookie now
  window.addEventListener("hashchange", () => { scrollTo(0, 0); refresh(); });
  document.addEventListener("visibilitychange", () => { if (!document.hidden) refresh(); });
  let typed = 0;
  find("#find").addEventListener("input", () => { first = 0; clearTimeout(typed); typed = setTimeout(refresh, 200); });
  find("#back").addEventListener("click", () => { first = Math.max(0, first - ROWS); refresh(); });
  find("#on").addEventListener("click", () => { first += ROWS; refresh(); });
  setInterval(() => { if (!document.hidden) refresh(); }, EVERY);
  state();
  refresh();
})();
