// The live page: takes frames from the tool's WebSocket and draws them. It commands nothing; only a
// replay, which flies nobody, takes its speed and its place from here.
"use strict";

const PAST_S = 60;
const GLANCE_S = 0.5;
const SILENT_MS = 3000;
const AGAIN_MS = 1000;
const MOST_EVENTS = 300;
// Columns of a glance's followers after id, place and height.
const SEPARATION = 3, RANGE = 4, WANTED = 5;
// Of more followers than this only errors are drawn: their wanted distances differ.
const MOST_LINES = 6;
const INK = "#16202e", QUIET = "#5b6779", RULE = "#e3e8ef", SONAR = "#0f766e", CUT = "#7e22ce";
const LEVELS = ["good", "look", "act"];
const LEVEL_COLOURS = ["", "#d97706", "#dc2626"];
// The leader's colour first (page.css has them for the dots).
const COLOURS = ["#111827", "#1d4ed8", "#c2410c", "#15803d", "#be185d", "#7c3aed", "#0e7490"];

const byId = id => document.getElementById(id);
const model = { connected: false, hello: null, frame: null, past: [], events: [], heardAt: 0 };
const drawn = { top: {}, side: {}, slots: {}, metresPerPixel: 0 };
const view = { zoom: 1, centre: null, span: null };
let socket = null;
let drawing = false;
window.echowing = { model, drawn };

// ---- the tool -----------------------------------------------------------------------------------

function connect() {
  socket = new WebSocket(`ws://${location.host}/live`);
  socket.onmessage = event => take(JSON.parse(event.data));
  socket.onclose = () => {
    model.connected = false;
    redraw();
    setTimeout(connect, AGAIN_MS);
  };
}

function take(message) {
  ({ hello, past, events, frame })[message.kind](message);
  redraw();
}

function hello(message) {
  const otherFlight = !model.hello || model.hello.run !== message.run;
  model.hello = message;
  model.connected = true;
  model.heardAt = performance.now();
  past(message);
  if (otherFlight) {
    model.frame = null;
    byId("vehicles").replaceChildren();
  }
  view.centre = view.span = null;
  byId("source").textContent = message.title || { follow: "live", sim: "simulated: the truth" }[message.source];
  showReplay(message.replay);
}

function past(message) {
  model.past = message.past;
  model.events = [];
  byId("events").replaceChildren();
}

function events(message) {
  for (const [at, text] of message.events) {
    model.events.push([at, text]);
    if (!joinsTable(at, text)) showEvent(at, text);
  }
  model.events.splice(0, model.events.length - MOST_EVENTS);
  while (byId("events").children.length > MOST_EVENTS) byId("events").lastChild.remove();
}

function showEvent(at, text) {
  const item = element("li");
  item.append(element("time", at.toFixed(1)), element(isTable(text) ? "pre" : "span", text));
  item.onclick = () => ask({ seek: at });
  byId("events").prepend(item);
}

// A line of a table, its columns apart by two spaces.
const isTable = text => / {2}/.test(text);

// The lines of one table stand together, the first one on top; whether this one has gone there.
function joinsTable(at, text) {
  const newest = byId("events").firstChild;
  if (!newest || !isTable(text) || newest.lastChild.tagName !== "PRE") return false;
  if (newest.firstChild.textContent !== at.toFixed(1)) return false;
  newest.lastChild.textContent += `\n${text}`;
  return true;
}

function frame(message) {
  model.frame = message;
  model.heardAt = performance.now();
  const last = model.past.at(-1);
  if (!last || message.t - last.t >= GLANCE_S) model.past.push(glance(message));
  while (model.past.length && model.past[0].t < message.t - PAST_S) model.past.shift();
}

// As snapshot.glance.
function glance(one) {
  const leader = one.leader;
  return {
    t: one.t,
    leader: leader && [leader.id, leader.at, leader.height],
    followers: one.followers.map(
      f => [f.id, f.at, f.height, f.separation, f.sonar.range, f.wanted]),
  };
}

function ask(wish) {
  if (model.hello && model.hello.replay && socket.readyState === WebSocket.OPEN) {
    socket.send(JSON.stringify(wish));
  }
}

// ---- words --------------------------------------------------------------------------------------

function element(kind, text = "") {
  const made = document.createElement(kind);
  made.textContent = text;
  return made;
}

const number = (value, places, unit = "") =>
  value === null || value === undefined ? "–" : value.toFixed(places) + unit;
const signed = (value, places) => (value >= 0 ? "+" : "−") + Math.abs(value).toFixed(places);
const put = (box, text) => { if (box.textContent !== text) box.textContent = text; };

function nameOf(id) {
  const leader = model.frame.leader;
  return leader && leader.id === id ? "leader" : String(id);
}

function isSilent() {
  if (!model.connected) return true;
  const comes = model.frame && !model.hello.replay;  // a replay that waits sends nothing
  return Boolean(comes) && performance.now() - model.heardAt > SILENT_MS;
}

function showStatus() {
  const silent = isSilent(), now = model.frame;
  document.body.classList.toggle("lost", silent);
  const status = byId("status"), list = byId("alarms");
  if (silent || !now) {
    status.className = silent ? "lost" : "";
    const lost = model.connected ? "No data from the tool" : "No connection to the tool";
    const text = silent && now ? `${lost}: what you see is old` : silent ? lost : "Waiting for the vehicles";
    put(byId("headline"), text);
    document.title = `${text} – Echowing`;
    list.replaceChildren();
    return;
  }
  status.className = LEVELS[now.level];
  put(byId("headline"), now.alarms.length ? now.alarms[0].text : now.headline);
  document.title = `${byId("headline").textContent} – Echowing`;
  const rest = now.alarms.slice(1, 4).map(alarm => alarm.text);
  if (now.alarms.length > 4) rest.push(`and ${now.alarms.length - 4} more`);
  if (rest.join("|") !== [...list.children].map(item => item.textContent).join("|")) {
    list.replaceChildren(...rest.map(text => element("li", text)));
  }
}

function showVehicles() {
  const now = model.frame;
  if (!now) return;
  put(byId("clock"), clockText(now.t));
  const vehicles = [...(now.leader ? [now.leader] : []), ...now.followers];
  for (const one of vehicles) showVehicle(one, one === now.leader);
  byId("vehicles").classList.toggle("many", now.followers.length > MOST_LINES);
  const known = new Set(vehicles.map(one => String(one.id)));
  for (const card of [...byId("vehicles").children]) {
    if (!known.has(card.dataset.id)) card.remove();
  }
}

function clockText(seconds) {
  const minutes = Math.floor(seconds / 60);
  return `${minutes}:${(seconds - 60 * minutes).toFixed(1).padStart(4, "0")}`;
}

function showVehicle(one, leads) {
  const card = cardOf(one.id, leads);
  const say = (field, text) => put(card.querySelector(`[data-field="${field}"]`), text);
  const level = Math.max(0, ...model.frame.alarms.filter(a => a.id === one.id).map(a => a.level));
  card.className = [leads ? "leader" : "follower", LEVELS[level]].join(" ");
  say("name", leads ? `Leader ${one.id}` : `Follower ${one.id}`);
  say("mode", one.mode);
  say("speed", number(one.speed, 1, " m/s"));
  say("age", number(one.age, 2, " s"));
  say("link", number(one.link, 0, " %"));
  say("battery", one.battery || "–");
  say("gps", one.gps || "–");
  say("switch", one.switch || "");
  card.querySelector(".switch").hidden = !one.switch;
  say("note", noteOf(one.id));
  if (leads) {
    say("height", number(one.height, 1, " m"));
    return;
  }
  say("state", one.state);
  const idle = one.level === 0 && !one.state.startsWith("following");
  card.querySelector('[data-field="state"]').className = idle ? "idle" : LEVELS[one.level];
  say("separation", number(one.separation, 2, " m"));
  const error = one.error === null ? "" : `${signed(one.error, 2)} m of ${number(one.wanted, 2)} m`
    + (one.watches ? ` from ${one.watches}` : "");
  say("wanted", error);
  const range = number(one.sonar.range, 2, " m");
  const {heard, scatter, wrong} = one.sonar;
  const told = [heard === null ? "" : `hears ${number(heard, 0, " %")}`,
    scatter === null ? "" : `± ${number(100 * scatter, 0, " cm")}`,
    wrong === null ? "" : `${number(wrong, 0, " %")} wrong`];
  const parts = [range, one.sonar.state, told.filter(part => part).join(" ")];
  say("sonar", parts.filter(part => part).join(", "));
  say("limit", number(one.limit, 1, " m/s"));
  say("height", `${number(one.height, 1)} / ${number(one.wanted_height, 1, " m")}`);
}

function cardOf(id, leads) {
  const found = byId("vehicles").querySelector(`[data-id="${id}"]`);
  if (found) return found;
  const card = byId("vehicle").content.firstElementChild.cloneNode(true);
  card.dataset.id = id;
  card.querySelector(".dot").classList.add(`c${colourNumber(id, leads)}`);
  byId("vehicles").append(card);
  return card;
}

function noteOf(id) {
  const health = model.frame.health;
  const notes = [];
  const cut = health.cuts.find(one => one.id === id);
  if (cut) notes.push(`Its loss splits: ${cut.parts.map(part => part.map(nameOf).join(", ")).join(" | ")}`);
  if (health.alone.includes(id)) notes.push("Sees nobody");
  return notes.join(". ");
}

// ---- drawing ------------------------------------------------------------------------------------

function colourNumber(id, leads) {
  if (leads) return 0;
  const place = model.frame.followers.findIndex(one => one.id === id);
  return 1 + (Math.max(0, place) % (COLOURS.length - 1));
}

const isLeader = id => Boolean(model.frame.leader) && model.frame.leader.id === id;
const colourOf = id => COLOURS[colourNumber(id, isLeader(id))];
const rad = degrees => degrees * Math.PI / 180;

function redraw() {
  if (drawing) return;
  drawing = true;
  requestAnimationFrame(() => {
    drawing = false;
    showStatus();
    showVehicles();
    showPlace();
    if (model.frame) {
      drawTop(paper("top"));
      drawSeparation(paper("separation"));
      drawSide(paper("side"));
    }
  });
}

// A canvas as large as it is shown, in CSS pixels.
function paper(id) {
  const canvas = byId(id), box = canvas.getBoundingClientRect();
  const scale = window.devicePixelRatio || 1;
  const width = Math.round(box.width * scale), height = Math.round(box.height * scale);
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, box.width, box.height);
  pen.font = "13px system-ui, 'Liberation Sans', sans-serif";
  pen.lineJoin = "round";
  return { pen, width: box.width, height: box.height };
}

function stroke(pen, points, colour, width = 1, dash = []) {
  pen.beginPath();
  points.forEach(([x, y], index) => index ? pen.lineTo(x, y) : pen.moveTo(x, y));
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.setLineDash(dash);
  pen.stroke();
  pen.setLineDash([]);
}

function label(pen, text, x, y, colour = INK, align = "left") {
  pen.textAlign = align;
  pen.lineWidth = 3;
  pen.strokeStyle = "#ffffff";
  pen.strokeText(text, x, y);
  pen.fillStyle = colour;
  pen.fillText(text, x, y);
}

function niceStep(span, most) {
  const rough = span / most, power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map(one => one * power).find(one => one >= rough);
}

// What has to be in the picture; the view follows it in steps, so that a hovering eye keeps its place.
function fitted(box) {
  const now = model.frame, places = [];
  const vehicles = [now.leader, ...now.followers].filter(Boolean);
  for (const one of vehicles) places.push(one.at, one.slot, one.seen && one.seen.at);
  const known = places.filter(Boolean);
  if (!known.length) return { centre: [0, 0], span: 12 };
  const low = [0, 1].map(axis => Math.min(...known.map(place => place[axis])));
  const high = [0, 1].map(axis => Math.max(...known.map(place => place[axis])));
  const wide = box.width / box.height;
  const span = Math.max(12, 1.45 * (high[0] - low[0]) + 3, (1.45 * (high[1] - low[1]) + 3) / wide);
  return { centre: [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2], span };
}

function follow(box) {
  const wanted = fitted(box), ease = 0.15, furthest = 0.1 * wanted.span;
  if (!view.centre) [view.centre, view.span] = [wanted.centre, wanted.span];
  view.centre = view.centre.map((old, axis) => {
    const off = wanted.centre[axis] - old;
    // However few frames come, and however fast a replay goes, they are in the picture.
    return Math.abs(off) > furthest ? wanted.centre[axis] - Math.sign(off) * furthest : old + ease * off;
  });
  view.span = Math.max(view.span + ease * (wanted.span - view.span), 0.8 * wanted.span);
  return box.height / (view.span * view.zoom);
}

function drawTop(box) {
  const { pen } = box;
  const scale = follow(box);
  const at = ([north, east]) => [
    box.width / 2 + (east - view.centre[1]) * scale,
    box.height / 2 - (north - view.centre[0]) * scale,
  ];
  drawn.t = model.frame.t;
  drawn.metresPerPixel = 1 / scale;
  drawn.top = {};
  drawn.slots = {};
  drawGrid(box, scale, at);
  const now = model.frame, few = now.followers.length <= MOST_LINES;
  drawTracks(pen, at);
  if (few) now.followers.forEach(one => drawSeen(pen, one, at, scale));
  now.followers.forEach(one => drawCone(pen, one, at, scale));
  drawEdges(pen, at);
  now.followers.forEach(one => drawSlot(pen, one, at, scale));
  [now.leader, ...now.followers].filter(one => one && one.at).forEach(one => drawVehicle(pen, one, at));
  label(pen, "N", box.width - 16, 18, QUIET, "center");
  stroke(pen, [[box.width - 16, 44], [box.width - 16, 22]], QUIET, 1.5);
  stroke(pen, [[box.width - 20, 28], [box.width - 16, 22], [box.width - 12, 28]], QUIET, 1.5);
}

function drawGrid(box, scale, at) {
  const { pen } = box, step = niceStep(box.width / scale, 9);
  const halves = [box.height / 2 / scale, box.width / 2 / scale];
  for (const axis of [0, 1]) {
    const from = Math.ceil((view.centre[axis] - halves[axis]) / step) * step;
    for (let value = from; value <= view.centre[axis] + halves[axis]; value += step) {
      const [x, y] = at(axis ? [0, value] : [value, 0]);
      stroke(pen, axis ? [[x, 0], [x, box.height]] : [[0, y], [box.width, y]], RULE);
    }
  }
  stroke(pen, [[12, box.height - 12], [12 + step * scale, box.height - 12]], INK, 3);
  label(pen, `${step} m`, 12, box.height - 20, INK);
}

function tracks() {
  const lines = new Map();
  const add = (id, t, place) => {
    if (place) (lines.get(id) || lines.set(id, []).get(id)).push([t, place]);
  };
  for (const glance of model.past) {
    if (glance.leader) add(glance.leader[0], glance.t, glance.leader[1]);
    for (const [id, place] of glance.followers) add(id, glance.t, place);
  }
  return lines;
}

function drawTracks(pen, at) {
  pen.globalAlpha = 0.35;
  for (const [id, line] of tracks()) {
    const now = [model.frame.leader, ...model.frame.followers].find(one => one && one.id === id);
    const places = line.map(([, place]) => at(place));
    if (now && now.at) places.push(at(now.at));
    stroke(pen, places, colourOf(id), 2);
  }
  pen.globalAlpha = 1;
}

function drawSeen(pen, one, at, scale) {
  if (!one.seen) return;
  const [x, y] = at(one.seen.at);
  pen.beginPath();
  pen.ellipse(x, y, one.seen.major * scale, one.seen.minor * scale, rad(one.seen.bearing - 90), 0, 7);
  pen.globalAlpha = 0.1;
  pen.fillStyle = colourOf(one.id);
  pen.fill();
  pen.globalAlpha = 0.6;
  pen.strokeStyle = colourOf(one.id);
  pen.lineWidth = 1;
  pen.stroke();
  stroke(pen, [[x - 5, y], [x + 5, y]], colourOf(one.id), 1.5);
  stroke(pen, [[x, y - 5], [x, y + 5]], colourOf(one.id), 1.5);
  pen.globalAlpha = 1;
}

function drawCone(pen, one, at, scale) {
  const aimed = one.sonar.bearing !== null;  // else a range is drawn about the nose, dashed
  if (!one.at || (!aimed && one.sonar.range === null)) return;
  const [x, y] = at(one.at), { half_deg: half, reach_m: reach } = model.hello;
  const axis = aimed ? one.sonar.bearing : one.heading;
  const from = rad(axis - half - 90), to = rad(axis + half - 90);
  if (aimed) {
    pen.beginPath();
    pen.moveTo(x, y);
    pen.arc(x, y, reach * scale, from, to);
    pen.closePath();
    pen.globalAlpha = 0.16;
    pen.fillStyle = SONAR;
    pen.fill();
    pen.globalAlpha = 1;
  }
  if (one.sonar.range === null) return;
  pen.beginPath();
  pen.arc(x, y, one.sonar.range * scale, from, to);
  pen.strokeStyle = SONAR;
  pen.lineWidth = 3.5;
  pen.setLineDash(aimed ? [] : [5, 4]);
  pen.stroke();
  pen.setLineDash([]);
}

function drawEdges(pen, at) {
  const places = new Map([model.frame.leader, ...model.frame.followers]
    .filter(one => one && one.at).map(one => [one.id, at(one.at)]));
  for (const [a, b, kind] of model.frame.health.edges) {
    if (!places.has(a) || !places.has(b)) continue;
    const ranged = kind === "ranges";
    stroke(pen, [places.get(a), places.get(b)], ranged ? SONAR : QUIET, ranged ? 2 : 1.5, ranged ? [] : [2, 4]);
  }
}

function drawSlot(pen, one, at, scale) {
  if (!one.slot) return;
  const [x, y] = at(one.slot), colour = colourOf(one.id);
  drawn.slots[one.id] = { at: one.slot, px: [x, y] };
  if (one.at) stroke(pen, [at(one.at), [x, y]], colour, 1, [3, 3]);
  pen.beginPath();
  pen.arc(x, y, Math.max(6, Math.min(14, 0.5 * scale)), 0, 7);
  pen.setLineDash([4, 3]);
  pen.strokeStyle = colour;
  pen.lineWidth = 2;
  pen.stroke();
  pen.setLineDash([]);
}

function drawVehicle(pen, one, at) {
  const [x, y] = at(one.at), id = one.id, health = model.frame.health;
  drawn.top[id] = { at: one.at, px: [x, y] };
  const alarm = Math.max(0, ...model.frame.alarms.filter(a => a.id === id).map(a => a.level));
  if (alarm) ring(pen, x, y, 19, LEVEL_COLOURS[alarm], 4);
  if (health.cuts.some(cut => cut.id === id)) diamond(pen, x, y, 17);
  if (health.alone.includes(id)) ring(pen, x, y, 24, INK, 1.5, [2, 4]);
  pen.save();
  pen.translate(x, y);
  pen.rotate(rad(one.heading ?? 0));
  pen.beginPath();
  [[0, -12], [8, 9], [0, 5], [-8, 9]].forEach(([dx, dy], i) => i ? pen.lineTo(dx, dy) : pen.moveTo(dx, dy));
  pen.closePath();
  pen.fillStyle = colourOf(id);
  pen.fill();
  pen.lineWidth = 1.5;
  pen.strokeStyle = "#ffffff";
  pen.stroke();
  pen.restore();
  pen.font = "bold 14px system-ui, 'Liberation Sans', sans-serif";
  const aside = health.cuts.some(cut => cut.id === id) || alarm ? 23 : 14;
  label(pen, isLeader(id) ? `leader ${id}` : String(id), x + aside, y + 5, colourOf(id));
  pen.font = "13px system-ui, 'Liberation Sans', sans-serif";
}

function ring(pen, x, y, radius, colour, width, dash = []) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 7);
  pen.setLineDash(dash);
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.stroke();
  pen.setLineDash([]);
}

function diamond(pen, x, y, half) {
  stroke(pen, [[x, y - half], [x + half, y], [x, y + half], [x - half, y], [x, y - half]], CUT, 2.5);
}

// ---- plots --------------------------------------------------------------------------------------

function axes(box, low, high, unit, places) {
  const { pen } = box, left = 40, bottom = box.height - 20, top = 8;
  const y = value => bottom - (value - low) / (high - low) * (bottom - top);
  const step = niceStep(high - low, 5);
  for (let value = Math.ceil(low / step - 1e-9) * step; value <= high + 1e-9; value += step) {
    stroke(pen, [[left, y(value)], [box.width, y(value)]], RULE);
    label(pen, value.toFixed(step < 1 ? 1 : places), left - 6, y(value) + 4, QUIET, "right");
  }
  label(pen, unit, 2, 12, QUIET);
  return { left, bottom, top, y };
}

function drawSeparation(box) {
  const now = model.frame, few = now.followers.length <= MOST_LINES;
  put(byId("separation-title"), few
    ? `Separation from the ${now.followers.some(f => f.watches) ? "one ahead" : "leader"}, last minute`
    : "Error of the separation, last minute");
  const source = model.hello.source === "sim" ? "in truth" : "by GPS";
  put(byId("separation-legend"), few
    ? `line: ${source}; dots: by sonar; dashed: wanted` : `separation minus wanted separation, ${source}`);
  const shown = f => f[SEPARATION] === null ? null : f[SEPARATION] - (few ? 0 : f[WANTED] ?? 0);
  const all = model.past.flatMap(one => one.followers.flatMap(f => [shown(f), few ? f[WANTED] : null]))
    .filter(value => value !== null);
  const low = few ? Math.max(0, Math.floor(Math.min(...all, 3) - 1)) : Math.floor(Math.min(...all, -1));
  const high = Math.ceil(Math.max(...all, few ? 4 : 1) + (few ? 0.5 : 0));
  const { pen } = box, { left, bottom, y } = axes(box, low, high, "m", 0);
  const x = t => left + (t - now.t + PAST_S) / PAST_S * (box.width - left);
  for (const back of [60, 45, 30, 15]) {
    label(pen, `−${back} s`, Math.max(x(now.t - back), left + 14), box.height - 4, QUIET, "center");
  }
  label(pen, "now", box.width - 2, box.height - 4, QUIET, "right");
  pen.save();
  pen.beginPath();
  pen.rect(left, 0, box.width - left, bottom);
  pen.clip();
  if (!few) stroke(pen, [[left, y(0)], [box.width, y(0)]], INK, 1.5);
  for (const one of now.followers) {
    const colour = colourOf(one.id);
    for (const part of few ? unbroken(one.id, f => f[WANTED]) : []) {
      stroke(pen, part.map(([t, value]) => [x(t), y(value)]), colour, 1.5, [6, 4]);
    }
    for (const part of unbroken(one.id, shown)) {
      stroke(pen, part.map(([t, value]) => [x(t), y(value)]), colour, few ? 2 : 1);
    }
    if (few) dots(pen, one.id, x, y, colour);
  }
  pen.restore();
}

// A follower's line, broken where nothing is known.
function unbroken(id, valueOf) {
  const parts = [[]];
  for (const glance of model.past) {
    const own = glance.followers.find(one => one[0] === id);
    const value = own ? valueOf(own) : null;
    if (value !== null) parts.at(-1).push([glance.t, value]);
    else if (parts.at(-1).length) parts.push([]);
  }
  return parts.filter(part => part.length > 1);
}

function dots(pen, id, x, y, colour) {
  pen.fillStyle = colour;
  for (const glance of model.past) {
    const own = glance.followers.find(one => one[0] === id);
    if (own && own[RANGE] !== null) {
      pen.beginPath();
      pen.arc(x(glance.t), y(own[RANGE]), 2, 0, 7);
      pen.fill();
    }
  }
}

function drawSide(box) {
  const now = model.frame, vehicles = [now.leader, ...now.followers].filter(Boolean);
  const course = courseOf(now.leader);
  const along = place => place[0] * Math.cos(course) + place[1] * Math.sin(course);
  const known = vehicles.filter(one => one.at && one.height !== null);
  drawn.side = {};
  if (!known.length) return;
  const heights = [...known.map(one => one.height),
    ...known.map(one => one.wanted_height).filter(one => one !== null && one !== undefined)];
  const middle = (Math.min(...heights) + Math.max(...heights)) / 2;
  const half = Math.max(3, (Math.max(...heights) - Math.min(...heights)) / 2 + 1.5);
  const { pen } = box;
  const { left, bottom, y } = axes(box, Math.floor(middle - half), Math.ceil(middle + half), "m", 0);
  if (y(0) <= bottom) stroke(pen, [[left, y(0)], [box.width, y(0)]], QUIET, 2);  // the ground
  const spots = known.map(one => along(one.at));
  const centre = (Math.min(...spots) + Math.max(...spots)) / 2;
  const span = Math.max(8, 1.35 * (Math.max(...spots) - Math.min(...spots)));
  const x = metres => left + (box.width - left) * (0.5 + (metres - centre) / span);
  label(pen, "→ flown this way", box.width - 4, box.height - 4, QUIET, "right");
  for (const one of known) {
    const [px, py] = [x(along(one.at)), y(one.height)], colour = colourOf(one.id);
    drawn.side[one.id] = { height: one.height, px: [px, py] };
    if (one.wanted_height !== null && one.wanted_height !== undefined) {
      stroke(pen, [[px - 16, y(one.wanted_height)], [px + 16, y(one.wanted_height)]], colour, 2, [4, 3]);
      stroke(pen, [[px, y(one.wanted_height)], [px, py]], colour, 1);
    }
    pen.beginPath();
    pen.ellipse(px, py, 9, 4.5, 0, 0, 7);
    pen.fillStyle = colour;
    pen.fill();
    const leads = isLeader(one.id);  // under it: a follower may be at the same place of the course
    label(pen, leads ? "leader" : String(one.id), px, py + (leads ? 20 : -9), colour, "center");
  }
}

function courseOf(leader) {
  if (!leader) return 0;
  const [north, east] = leader.velocity || [0, 0];
  return Math.hypot(north, east) > 0.35 ? Math.atan2(east, north) : rad(leader.heading ?? 0);
}

// ---- replay -------------------------------------------------------------------------------------

function showReplay(replay) {
  byId("replay").hidden = !replay;
  document.querySelector(".events").classList.toggle("seeks", Boolean(replay));
  if (!replay) return;
  byId("line").min = replay.from_s;
  byId("line").max = replay.to_s;
}

function showPlace() {
  const now = model.frame;
  if (!now || !now.replay) return;
  if (!byId("line").matches(":active")) byId("line").value = now.t;
  put(byId("place"), `${clockText(now.t)} of ${clockText(model.hello.replay.to_s)}`);
  put(byId("play"), now.replay.paused ? "Play" : "Pause");
  const speed = String(now.replay.speed);
  if (document.activeElement !== byId("speed")) byId("speed").value = speed;
}

byId("play").onclick = () => ask({ paused: !model.frame.replay.paused });
byId("speed").onchange = event => { ask({ speed: Number(event.target.value) }); event.target.blur(); };
byId("line").oninput = event => ask({ seek: Number(event.target.value) });

// ---- the view -----------------------------------------------------------------------------------

const zoomed = factor => () => { view.zoom = Math.min(20, Math.max(0.1, view.zoom * factor)); redraw(); };
byId("nearer").onclick = zoomed(1 / 1.4);
byId("further").onclick = zoomed(1.4);
byId("fit").onclick = () => { view.zoom = 1; view.centre = null; redraw(); };
window.onresize = redraw;
setInterval(() => { if (isSilent()) redraw(); }, 500);
connect();
