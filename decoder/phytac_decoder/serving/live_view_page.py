"""The live view's page: one file, nothing from the network."""

PAGE = r"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>PhyTac live</title>
<style>
* { box-sizing: border-box; }
body { margin: 0; font: 14px/1.4 system-ui, sans-serif; color: #1d2733; background: #f3f5f7; }
header { display: flex; gap: 24px; align-items: baseline; padding: 10px 16px; background: #fff;
  border-bottom: 1px solid #d8dee4; }
h1 { font-size: 17px; margin: 0; }
#total { font-size: 22px; font-weight: 600; font-variant-numeric: tabular-nums; margin-left: auto; }
#state { color: #57606a; font-variant-numeric: tabular-nums; }
main { display: grid; gap: 12px; padding: 12px; height: calc(100vh - 54px);
  grid-template-columns: 1fr 1fr 300px; grid-template-rows: 1.35fr 1fr; }
section { background: #fff; border: 1px solid #d8dee4; border-radius: 6px; position: relative;
  min-width: 0; min-height: 0; overflow: hidden; display: flex; flex-direction: column; }
h2 { font-size: 12px; font-weight: 600; color: #57606a; margin: 8px 10px 0; }
canvas { flex: 1; width: 100%; min-height: 0; display: block; }
#curves { grid-column: 1 / 3; }
#side { grid-row: 1 / 3; grid-column: 3; overflow: auto; padding-bottom: 8px; }
table { border-collapse: collapse; margin: 4px 10px; font-variant-numeric: tabular-nums; }
td, th { text-align: right; padding: 2px 6px; font-size: 13px; }
th { font-weight: 500; color: #57606a; border-bottom: 1px solid #d8dee4; }
td:first-child, th:first-child { text-align: left; }
.key { display: inline-block; width: 10px; height: 10px; border-radius: 2px; margin-right: 6px; }
#warnings { margin: 4px 10px 0; padding: 0; list-style: none; font-size: 13px; }
#warnings li { background: #fff4d6; border-left: 3px solid #d9920a; padding: 4px 8px;
  margin-bottom: 4px; overflow-wrap: anywhere; }
#warnings li.bad { background: #ffe3e0; border-color: #c62f22; }
#warnings li.fixed { background: #eef1f4; border-color: #aab4bf; color: #57606a; }
#turn { touch-action: none; cursor: grab; }
</style>
</head>
<body>
<header>
  <h1 id="design">PhyTac</h1><span id="state">waiting for the sensor</span><span id="total"></span>
</header>
<main>
  <section><h2>Unrolled</h2><canvas id="flat"></canvas></section>
  <section><h2>On the sensor (drag to turn)</h2><canvas id="turn"></canvas></section>
  <section id="curves"><h2>Force over time</h2><canvas id="curve"></canvas></section>
  <section id="side">
    <h2>Contacts</h2><table id="contacts"></table>
    <h2 id="regionsHead" hidden>Regions</h2><table id="regions"></table>
    <h2>Warnings</h2><ul id="warnings"></ul>
  </section>
</main>
<script>
"use strict";
const $ = id => document.getElementById(id);
const SPAN_S = 8, COLOURS = ["#1d2733", "#2f6fde", "#1f9d55", "#d9620a", "#8e44ad", "#c62f22",
  "#0e8c9b", "#a67c00", "#7a5195", "#5b6b7a"];
const number = (x, digits) => (x < 0 && x > -0.05 ? 0 : x).toFixed(digits);
let hello = null, frame = null, points = [], most = 1, yaw = 0.6, pitch = -0.35, dirty = false;

function heat(share) {
  const stops = [[222, 228, 234], [255, 214, 102], [240, 110, 40], [176, 20, 40]];
  const at = Math.min(Math.max(share, 0), 1) * (stops.length - 1), k = Math.min(at | 0, 2);
  const mix = stops[k].map((a, i) => Math.round(a + (at - k) * (stops[k + 1][i] - a)));
  return `rgb(${mix})`;
}

function sheet(canvas) {
  const box = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width; canvas.height = height;
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, box.width, box.height);
  return [pen, box.width, box.height];
}

function forces() {
  const out = new Float64Array(hello.markers);
  if (frame) frame.koi.forEach((marker, k) => { out[marker] = frame.forces_N[k]; });
  return out;
}

function bounds(places) {
  const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
  for (const p of places) for (const k of [0, 1]) {
    low[k] = Math.min(low[k], p[k]); high[k] = Math.max(high[k], p[k]);
  }
  return [low, high];
}

function drawFlat(force) {
  const [pen, width, height] = sheet($("flat")), places = hello.unrolled_mm;
  const [low, high] = bounds(places), pad = 22;
  const scale = Math.min((width - 2 * pad) / Math.max(high[0] - low[0], 1),
    (height - 2 * pad) / Math.max(high[1] - low[1], 1));
  const left = (width - scale * (high[0] - low[0])) / 2, top = (height + scale *
    (high[1] - low[1])) / 2;
  const at = p => [left + scale * (p[0] - low[0]), top - scale * (p[1] - low[1])];
  const area = scale * scale * (high[0] - low[0]) * (high[1] - low[1]);
  const radius = Math.max(0.38 * Math.sqrt(area / places.length), 2);
  places.forEach((p, k) => disc(pen, ...at(p), radius, force[k]));
  if (!frame) return;
  for (const contact of frame.contacts) {
    const [x, y] = at(places[strongest(contact, force)]);
    label(pen, x, y - radius - 5, `${number(contact.force_N, 1)} N`);
  }
}

function strongest(contact, force) {
  // A contact that was found by motion alone has no switch: the marker beside it.
  const at = contact.position_mm, away = k =>
    Math.hypot(...hello.positions_mm[k].map((x, i) => x - at[i]));
  return contact.markers.length
    ? contact.markers.reduce((a, b) => force[b] > force[a] ? b : a)
    : hello.positions_mm.reduce((near, _, k) => away(k) < away(near) ? k : near, 0);
}

function disc(pen, x, y, radius, force) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  pen.fillStyle = heat(force > 0 ? 0.15 + 0.85 * force / most : 0);
  pen.fill();
  if (force > 0) { pen.strokeStyle = "#1d2733"; pen.lineWidth = 1; pen.stroke(); }
}

function label(pen, x, y, text) {
  pen.font = "600 12px system-ui, sans-serif";
  pen.textAlign = "center";
  pen.lineWidth = 3; pen.strokeStyle = "#fff"; pen.strokeText(text, x, y);
  pen.fillStyle = "#1d2733"; pen.fillText(text, x, y);
}

function drawTurned(force) {
  const [pen, width, height] = sheet($("turn")), places = hello.positions_mm;
  const middle = [0, 1, 2].map(k => (Math.min(...places.map(p => p[k])) +
    Math.max(...places.map(p => p[k]))) / 2);
  const reach = Math.max(...places.map(p => Math.hypot(...p.map((x, k) => x - middle[k]))), 1);
  const scale = 0.46 * Math.min(width, height) / reach;
  const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  // The sensor's axis (z) stands upright; x to the right, depth grows towards the viewer.
  const turned = p => {
    const [x, y, z] = p.map((c, k) => c - middle[k]);
    const right = cy * x + sy * y, back = -sy * x + cy * y;
    return [width / 2 + scale * right, height / 2 - scale * (cp * z - sp * back),
      -(cp * back + sp * z)];
  };
  const seen = places.map((p, k) => [...turned(p), k]).sort((a, b) => a[2] - b[2]);
  const radius = Math.max(0.8 * scale * reach / Math.sqrt(places.length), 2);
  for (const [x, y, depth, k] of seen) {
    pen.globalAlpha = 0.35 + 0.65 * Math.min(Math.max(0.5 + depth / reach, 0), 1);
    disc(pen, x, y, radius * (1 + 0.15 * depth / reach), force[k]);
  }
  pen.globalAlpha = 1;
  if (!frame) return;
  for (const contact of frame.contacts) {
    const [x, y] = turned(contact.position_mm);
    label(pen, x, y - radius - 4, `${number(contact.force_N, 1)} N`);
  }
}

function drawCurve() {
  const [pen, width, height] = sheet($("curve"));
  if (!points.length) return;
  const names = ["total", ...(hello.regions || []).map(region => region.name)];
  const end = points[points.length - 1][0], start = Math.max(end - SPAN_S, points[0][0]);
  const span = Math.max(end - start, 0.05), left = 44, right = 12, top = 10, bottom = 24;
  let high = 1;
  for (const p of points) for (const f of p.slice(1)) high = Math.max(high, f);
  const step = [1, 2, 5, 10, 20, 50, 100, 200, 500].find(s => high / s <= 5) || 1000;
  high = Math.ceil(high / step) * step;
  const x = t => left + (width - left - right) * (t - start) / span;
  const y = f => height - bottom - (height - top - bottom) * Math.max(f, 0) / high;
  pen.font = "11px system-ui, sans-serif"; pen.fillStyle = "#57606a"; pen.lineWidth = 1;
  pen.textAlign = "right"; pen.strokeStyle = "#e5e9ee";
  for (let f = 0; f <= high; f += step) {
    pen.beginPath(); pen.moveTo(left, y(f)); pen.lineTo(width - right, y(f)); pen.stroke();
    pen.fillText(`${f} N`, left - 6, y(f) + 4);
  }
  pen.textAlign = "center";
  const tick = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2].find(s => span / s <= 8) || 2;
  const digits = Math.max(0, -Math.floor(Math.log10(tick)));
  for (let t = Math.ceil(start / tick) * tick; t <= end + 1e-9; t += tick) {
    pen.fillText(`${t.toFixed(digits)} s`, x(t), height - 8);
  }
  names.forEach((name, k) => {
    pen.strokeStyle = COLOURS[k % COLOURS.length];
    pen.lineWidth = k ? 1.5 : 2.2;
    pen.beginPath();
    for (const p of points) if (p[0] >= start) pen.lineTo(x(p[0]), y(p[k + 1]));
    pen.stroke();
  });
  pen.textAlign = "left";
  let at = left + 8;
  names.forEach((name, k) => {
    pen.fillStyle = COLOURS[k % COLOURS.length];
    pen.fillRect(at, top, 10, 10);
    pen.fillText(name, at + 14, top + 9);
    at += 30 + pen.measureText(name).width;
  });
}

function rows(table, head, lines) {
  table.replaceChildren(...[head, ...lines].map((cells, k) => {
    const row = document.createElement("tr");
    for (const text of cells) {
      const cell = document.createElement(k ? "td" : "th");
      cell.textContent = text;
      row.append(cell);
    }
    return row;
  }));
}

function drawSide() {
  const wide = frame.contacts.some(contact => contact.region);
  const sure = frame.contacts.some(contact => "sd_N" in contact);
  rows($("contacts"), ["id", "N", ...(sure ? ["\u00b1"] : []), "mm wide", "since s",
    ...(wide ? ["in"] : [])],
    frame.contacts.map(c => [c.id, number(c.force_N, 2), ...(sure ? [number(c.sd_N, 2)] : []),
      number(c.size_mm, 0), number(c.since_s, 2), ...(wide ? [c.region] : [])]));
  if (frame.regions) {
    $("regionsHead").hidden = false;
    rows($("regions"), ["", "N"], frame.regions.map(r => [r.name, number(r.force_N, 2)]));
  }
  const items = [...frame.warnings.map(text => [text, frame.valid ? "" : "bad"]),
    ...hello.limits.map(text => [text, "fixed"])];
  $("warnings").replaceChildren(...items.map(([text, kind]) => {
    const item = document.createElement("li");
    item.textContent = text; item.className = kind;
    return item;
  }));
  $("total").textContent = frame.valid ? `${number(frame.total_N, 1)} N` : "not valid";
  $("state").textContent = `frame ${frame.sequence}, ${number(frame.timestamp_s, 2)} s, ` +
    `${number(frame.latency_ms, 1)} ms to forces` +
    (frame.missed ? `, ${frame.missed} missed` : "");
}

function draw() {
  dirty = false;
  if (!hello) return;
  const force = forces();
  for (const f of force) most = Math.max(most, f);
  if (frame) drawSide();
  drawFlat(force); drawTurned(force); drawCurve();
}

function soon() {
  if (!dirty) { dirty = true; requestAnimationFrame(draw); }
}

const events = new EventSource("/events");
events.onmessage = event => {
  const message = JSON.parse(event.data);
  if (message.type === "hello") {
    hello = message; frame = null; points = [];
    $("design").textContent = `${hello.design}, ${hello.estimator}`;
    document.title = `${hello.design} live`;
  } else if (message.type === "frame") {
    frame = message;
    for (const p of message.curve) {
      if (points.length && p[0] < points[points.length - 1][0]) points = [];
      points.push(p);
    }
    const since = points[points.length - 1][0] - SPAN_S;
    while (points.length > 2 && points[1][0] < since) points.shift();
  } else if (message.type === "end") {
    events.close();
    $("state").textContent = `ended: ${message.reason}`;
    return;
  }
  soon();
};
events.onerror = () => { $("state").textContent = "the sensor's program has gone"; };
let held = null;
$("turn").onpointerdown = event => {
  held = [event.clientX, event.clientY]; $("turn").setPointerCapture(event.pointerId);
};
$("turn").onpointermove = event => {
  if (!held) return;
  yaw += 0.01 * (event.clientX - held[0]);
  pitch = Math.min(Math.max(pitch + 0.01 * (event.clientY - held[1]), -1.57), 1.57);
  held = [event.clientX, event.clientY];
  soon();
};
$("turn").onpointerup = $("turn").onpointercancel = () => { held = null; };
window.onresize = soon;
</script>
</body>
</html>
"""
