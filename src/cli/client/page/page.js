"use strict";
// The page of `retroflex page`: draws the frames of the service and sends commands while they are current.

const LOST_MS = 800; // without a frame for this long the picture is old, and nothing is sent
const SEND_MS = 100; // least time between two bends of a drag
const STOP_TRIES = 20;
const WINDOW_S = 30;
const SPEED_DEG_S = 30; // of every bend of this page
const NEAR_DEG = 10; // a press nearer to the target than this counts at once
const HOLD_MS = 300; // a press farther away counts after this long, or once it is a drag
const DRAG_PX = 8;
const $ = (id) => document.getElementById(id);
const RAD = Math.PI / 180;

let source = null; // stream of events
let page = null; // number of this page at the server; commands carry it
let frame = null, status = {}, reach = null;
let lastMs = -Infinity; // when the last frame came
let delayMs = 0, leastMs = Infinity; // by how much frames come later than the quickest one
let gone = "waiting for the first picture";
let aim = { x: 0, y: 0 }; // wanted bend vector, degrees; x towards direction 0, y towards 90
let aiming = false; // the operator is choosing
let dragging = false;
let press = null; // where the drag began, and whether it counts
let wanted = null, sending = false, sentMs = -Infinity;
let errors = []; // [time, error or null]

// ---------------------------------------------------------------- connection

function connect() {
  disconnect();
  if (document.hidden) return;
  source = new EventSource("frames");
  const on = (name, handle) => source.addEventListener(name, (event) => handle(JSON.parse(event.data)));
  on("hello", (number) => { page = number; leastMs = Infinity; });
  on("frame", take);
  on("status", (value) => { status = value; words(); });
  on("reach", (value) => { reach = value; });
  on("gone", (why) => { gone = `No service: ${why}`; lastMs = -Infinity; judge(); });
  source.onerror = () => { lose("the page server does not answer"); setTimeout(connect, 500); };
}

function disconnect() {
  if (source) { source.onerror = null; source.close(); }
  source = null;
}

// Nothing that was meant for an old picture is sent later.
function lose(why) {
  disconnect();
  page = null;
  lastMs = -Infinity;
  gone = why;
  judge();
}

function take(next) {
  const now = performance.now();
  if (frame && next.t < frame.t) { leastMs = Infinity; errors = []; }
  const late = now - next.t * 1000;
  // the clocks of tablet and service may differ by 1 % in speed
  leastMs = Math.min(late, leastMs + 0.01 * Math.min(1000, now - lastMs));
  delayMs = late - leastMs;
  frame = next;
  lastMs = now;
  const error = frame.target && frame.estimate ? distance(frame.setpoint, frame.estimate) : null;
  errors.push([frame.t, error]);
  while (errors[0][0] < frame.t - WINDOW_S) errors.shift();
  judge();
  requestDraw();
}

const age = () => Math.max(performance.now() - lastMs, delayMs);
const live = () => page !== null && frame !== null && !document.hidden && age() < LOST_MS;

// Shows whether the picture is current.
function judge() {
  const is_live = live();
  if (!is_live) { wanted = null; aiming = false; dragging = false; }
  document.body.classList.toggle("lost", !is_live);
  $("lost").hidden = is_live;
  const seconds = age() / 1000;
  $("lost-title").textContent = gone.startsWith("No service") && page !== null ? "No service" : "No connection";
  $("lost-why").textContent = Number.isFinite(seconds) ? `The last frame is ${seconds.toFixed(0)} s old.` : gone.replace("No service: ", "");
  $("link").textContent = is_live ? "live" : "not connected";
  if (!is_live) mode("not connected", "bad");
  if (is_live) gone = "the frames have ceased";
  buttons();
}

function mode(text, kind) {
  if ($("mode").textContent !== text) $("mode").textContent = text;
  $("mode").className = kind;
}

document.addEventListener("visibilitychange", () => (document.hidden ? lose("the page was hidden") : connect()));
addEventListener("pagehide", () => lose("the page was left"));
addEventListener("pageshow", (event) => event.persisted && connect());
setInterval(judge, 100);

// ---------------------------------------------------------------- commands

async function post(path, body, wait) {
  const headers = { "content-type": "application/json", "x-retroflex-page": page ?? "0" };
  const reply = await fetch(path, { method: "POST", headers, body, signal: AbortSignal.timeout(wait) });
  if (!reply.ok) throw new Error(`the page server answered ${reply.status}`);
  return reply.json();
}

function say(text, bad = false) {
  $("said").textContent = text;
  $("said").classList.toggle("bad", bad);
}

async function command(request) {
  if (!live()) return;
  try {
    const reply = await post("command", JSON.stringify(request), 3500);
    say(reply.ok ? "" : `Refused: ${reply.error}`, !reply.ok);
  } catch (e) {
    say(`${request.cmd.replace("_", " ")}: no answer (${e.message})`, true);
  }
}

async function stop() {
  wanted = null;
  aiming = false;
  dragging = false;
  $("stop").classList.add("sent");
  const began = performance.now();
  say("Stopping …");
  for (let attempt = 0; attempt < STOP_TRIES; attempt += 1) {
    try {
      const reply = await post("stop", null, 1500);
      if (reply.ok) {
        status = { ...status, stopped: true };
        words();
        say(`Stopped: the service answered after ${(performance.now() - began).toFixed(0)} ms. Arm allows motion again.`);
        break;
      }
      say(`NOT STOPPED: ${reply.error}. Use the emergency stop.`, true);
    } catch (e) {
      say(`NO ANSWER to stop (${e.message}). Use the emergency stop.`, true);
      await new Promise((resume) => setTimeout(resume, 100));
    }
  }
  $("stop").classList.remove("sent");
}

// Sends the newest wanted bend, one at a time.
async function pump() {
  if (sending || !wanted || !live()) return;
  sending = true;
  await new Promise((resume) => setTimeout(resume, Math.max(0, sentMs + SEND_MS - performance.now())));
  const bend = wanted;
  wanted = null;
  if (bend) {
    sentMs = performance.now();
    await command({ cmd: "bend", bend_deg: Math.hypot(bend.x, bend.y), dir_deg: Math.atan2(bend.y, bend.x) / RAD, speed_deg_s: SPEED_DEG_S });
  }
  sending = false;
  pump();
}

const bends = () => live() && !status.stopped && ["holding", "tracking"].includes(frame.mode);

function buttons() {
  const now = live() ? frame.mode : "";
  const may = {
    arm: now === "disarmed" || (now !== "" && status.stopped === true),
    hold: now === "tracking" && !status.stopped,
    relax: ["disarmed", "holding", "tracking", "faulted", "lost"].includes(now) && !status.stopped,
    reset_fault: now === "faulted",
  };
  document.querySelectorAll("[data-command]").forEach((button) => { button.disabled = !may[button.dataset.command]; });
  $("pad").setAttribute("aria-disabled", String(!bends()));
}

$("stop").addEventListener("click", stop);
// the keyboard's press counts, not its release
addEventListener("keydown", (event) => {
  if ((event.key !== " " && event.key !== "Escape") || event.repeat) return;
  event.preventDefault();
  stop();
}, true);
addEventListener("keyup", (event) => { if (event.key === " ") event.preventDefault(); }, true);
document.querySelectorAll("[data-command]").forEach((button) => {
  button.addEventListener("click", () => command({ cmd: button.dataset.command }));
});

// ---------------------------------------------------------------- bend pad

const vector = (pose) => ({ x: pose.bend_deg * Math.cos(pose.dir_deg * RAD), y: pose.bend_deg * Math.sin(pose.dir_deg * RAD) });
const distance = (a, b) => Math.hypot(vector(a).x - vector(b).x, vector(a).y - vector(b).y);
const polar = (v) => `${Math.hypot(v.x, v.y).toFixed(1)}° at ${Math.round(Math.atan2(v.y, v.x) / RAD) || 0}°`;

// The largest bend in a direction, degrees, slightly less than the service accepts.
function largest(angle) {
  if (!reach) return 0;
  const n = reach.bend_deg.length, at = (((angle / (2 * Math.PI)) % 1 + 1) % 1) * n, k = Math.floor(at);
  return Math.min(reach.bend_deg[k % n], reach.bend_deg[(k + 1) % n]) - 0.3;
}

function aimAt(x, y) {
  const bend = Math.hypot(x, y), most = largest(Math.atan2(y, x)), share = bend > most ? most / bend : 1;
  aim = { x: x * share, y: y * share };
  aiming = true;
  requestDraw();
}

function padScale() {
  const box = $("pad").getBoundingClientRect();
  const most = reach ? Math.max(...reach.bend_deg) : 90;
  return { box, k: (Math.min(box.width, box.height) / 2 - 20) / most, cx: box.width / 2, cy: box.height / 2 };
}

// Draws the target; the tip follows once the press counts.
function drag(event) {
  const { box, k, cx, cy } = padScale();
  aimAt((event.clientX - box.left - cx) / k, (cy - (event.clientY - box.top)) / k);
  const from = vector(frame.target ?? frame.setpoint);
  press ??= { x: event.clientX, y: event.clientY, counts: Math.hypot(aim.x - from.x, aim.y - from.y) < NEAR_DEG };
  press.counts ||= Math.hypot(event.clientX - press.x, event.clientY - press.y) > DRAG_PX;
  if (press.counts) follow();
}

function follow() {
  wanted = { ...aim };
  pump();
}

$("pad").addEventListener("pointerdown", (event) => {
  if (!bends()) return say(live() ? "Not armed: press Arm first." : "Not connected.", true);
  $("pad").setPointerCapture(event.pointerId);
  dragging = true;
  press = null;
  drag(event);
  const begun = press;
  setTimeout(() => {
    if (press !== begun || press.counts || !dragging || !bends()) return;
    press.counts = true;
    follow();
  }, HOLD_MS);
});
// a drag that was interrupted by a stop or a loss does not go on without another press
$("pad").addEventListener("pointermove", (event) => {
  if (dragging && bends()) drag(event);
});
for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
  $("pad").addEventListener(end, () => {
    if (!dragging) return;
    dragging = false;
    aiming = !press.counts;
    if (aiming) say("Nothing moves yet: press longer, drag, or press Enter to bend there.");
    requestDraw();
  });
}
$("pad").addEventListener("keydown", (event) => {
  const step = event.shiftKey ? 0.5 : 2;
  const move = { ArrowRight: [step, 0], ArrowLeft: [-step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] }[event.key];
  if (!move && event.key !== "Enter") return;
  event.preventDefault();
  if (!bends()) return say(live() ? "Not armed: press Arm first." : "Not connected.", true);
  if (move) {
    if (!aiming && frame.target) aim = vector(frame.target);
    return aimAt(aim.x + move[0], aim.y + move[1]);
  }
  wanted = { ...aim };
  aiming = false;
  pump();
});

// ---------------------------------------------------------------- words

function words() {
  const rows = [];
  const add = (kind, name, text) => { if (text) rows.push([kind, name ? `${name}: ${text}` : text]); };
  add("fault", "Fault", status.fault);
  add("fault", "Alarm", status.alarm);
  if (status.emergency_stop) add("fault", "", "The emergency stop is pressed.");
  if (status.stopped) add("note", "", "Stopped: nothing moves until Arm.");
  add("note", "Limit", status.shortfall);
  add("note", "Suspected", status.suspicion);
  add("note", "Base", status.base);
  add("note", "World", status.world);
  for (const advice of status.sensor?.advice ?? []) add("note", "Sensor", advice);
  if (status.unverified) add("note", "Zero", "stated by the operator; no measurement has confirmed it");
  add("note", "Memory", status.memory?.error);
  add("", "Running", status.calibrating);
  add("", "Recording", status.recording?.path);
  if (!rows.some(([kind]) => kind !== "")) rows.unshift(["", "No fault, nothing suspected."]);
  const text = JSON.stringify(rows);
  if ($("words").dataset.text === text) return;
  $("words").dataset.text = text;
  $("words").replaceChildren(...rows.map(([kind, line]) => {
    const item = document.createElement("li");
    item.className = kind;
    item.textContent = line;
    return item;
  }));
}

async function diagnosis() {
  const found = await fetch("diagnosis").then((reply) => reply.json()).catch(() => null);
  if (!found?.verdict) return;
  const gap = (key) => found.gap?.[key]?.toFixed(1) ?? "–";
  const named = found.verdict.names.map((name) => {
    const effect = (found.effects ?? []).find((e) => e.name === name) ?? {};
    const lines = [...new Set((effect.params ?? []).map((p) => p.channel).filter(Boolean))];
    const line = lines.length === 1 ? ` of line ${lines[0]}` : "";
    return name.replace(/_/g, " ") + line + (effect.probability === undefined ? "" : ` (probability ${effect.probability.toFixed(2)})`);
  });
  const kind = { none: "The nominal model suffices.", unknown: "A gap remains that no known effect explains." }[found.verdict.kind] ?? "";
  const causes = named.length ? `Found: ${named.join(", ")}. ` : "";
  $("diagnosis").textContent = `${causes}${kind} Gap ${gap("recalibrated_deg")}°, with what was found ${gap("explained_deg")}°.`;
}

// ---------------------------------------------------------------- drawing

let palette = {}, drawing = false;

function readPalette() {
  const style = getComputedStyle(document.documentElement);
  const names = ["card", "ink", "soft", "rule", "grid", "line1", "line2", "line3", "target", "stop", "key", "metal", "metal-edge"];
  palette = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

function requestDraw() {
  if (drawing) return;
  drawing = true;
  requestAnimationFrame(() => { drawing = false; draw(); });
}

// A canvas in CSS pixels; null while it has no size.
function sheet(id) {
  const canvas = $(id), box = canvas.getBoundingClientRect(), ratio = devicePixelRatio || 1;
  const [w, h] = [Math.round(box.width * ratio), Math.round(box.height * ratio)];
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  if (!w || !h) return null;
  const g = canvas.getContext("2d");
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, box.width, box.height);
  g.font = "13px system-ui, sans-serif";
  g.lineJoin = "round";
  return { g, w: box.width, h: box.height };
}

function trace(g, points, close = false) {
  g.beginPath();
  points.forEach(([x, y], k) => (k ? g.lineTo(x, y) : g.moveTo(x, y)));
  if (close) g.closePath();
}

// Place and orientation at the share `s` of the arc: Eq. 6 and 7 of the paper, base frame, mm.
function along(beta, delta, length, s) {
  const theta = beta * s, l = length * s, small = Math.abs(theta) < 1e-6;
  const across = small ? (l * theta) / 2 : (l * (1 - Math.cos(theta))) / theta;
  const p = [across * Math.cos(delta), -across * Math.sin(delta), small ? l : (l * Math.sin(theta)) / theta];
  const a = [Math.sin(delta), Math.cos(delta), 0], c = Math.cos(theta), n = Math.sin(theta);
  const turn = (v) => { // Rodrigues
    const dot = a[0] * v[0] + a[1] * v[1], cross = [a[1] * v[2], -a[0] * v[2], a[0] * v[1] - a[1] * v[0]];
    return [0, 1, 2].map((i) => v[i] * c + cross[i] * n + a[i] * dot * (1 - c) + p[i]);
  };
  return turn;
}

const YAW = -18 * RAD, PITCH = 24 * RAD, EYE = 160;

// Base frame to the screen: x to the right, y towards the operator, z down, seen slightly from above.
function camera(w, h, length) {
  const k = Math.min(w / (2.5 * length), h / (1.95 * length));
  return ([x, y, z]) => {
    const u = x * Math.cos(YAW) + y * Math.sin(YAW), depth = y * Math.cos(YAW) - x * Math.sin(YAW), up = 0.6 * length - z;
    const far = depth * Math.cos(PITCH) + up * Math.sin(PITCH), v = up * Math.cos(PITCH) - depth * Math.sin(PITCH);
    const scale = (k * EYE) / (EYE - far);
    return [w / 2 + u * scale, h / 2 - (v + 0.11 * length) * scale, far];
  };
}

const circle = (turn, x, y, radius, n = 24) =>
  Array.from({ length: n }, (_, k) => turn([x + radius * Math.cos((k * 2 * Math.PI) / n), y + radius * Math.sin((k * 2 * Math.PI) / n), 0]));

function drawTip() {
  const on = sheet("tip");
  if (!on || !frame) return;
  const { g, w, h } = on, length = frame.length_mm, rest = reach?.rest_length_mm ?? 20, r = reach?.r_mm ?? 4.04;
  const see = camera(w, h, rest), ring = (points) => points.map(see);
  // floor with directions, for depth
  const floor = ([x, y]) => [x, y, 1.22 * rest], flat = (radius) => circle(floor, 0, 0, radius, 60);
  g.lineWidth = 1;
  g.strokeStyle = palette.rule;
  for (const radius of [0.45 * rest, 0.9 * rest]) { trace(g, ring(flat(radius)), true); g.stroke(); }
  g.fillStyle = palette.soft;
  g.textAlign = "center";
  g.textBaseline = "middle";
  for (let k = 0; k < 4; k += 1) {
    const [c, s] = [Math.cos((k * Math.PI) / 2), -Math.sin((k * Math.PI) / 2)];
    trace(g, [see(floor([0, 0])), see(floor([0.9 * rest * c, 0.9 * rest * s]))]);
    g.stroke();
    const [x, y] = see(floor([1.02 * rest * c, 1.02 * rest * s]));
    g.fillText(`${k * 90}°`, x, y);
  }
  const shape = (pose) => [pose.bend_deg * RAD, pose.dir_deg * RAD, length];
  const estimate = frame.estimate ? shape(frame.estimate) : null;
  if (estimate) {
    const tip = along(...estimate, 1)([0, 0, 0]);
    g.setLineDash([2, 4]);
    trace(g, [see(tip), see(floor(tip))]);
    g.stroke();
    g.setLineDash([]);
    g.beginPath();
    g.arc(...see(floor(tip)).slice(0, 2), 3, 0, 7);
    g.fill();
  }
  const plate = (turn, radius, fill) => {
    trace(g, ring(circle(turn, 0, 0, radius, 40)), true);
    g.fillStyle = fill;
    g.fill();
    g.strokeStyle = palette["metal-edge"];
    g.lineWidth = 1.2;
    g.stroke();
  };
  if (estimate) drawBellows(g, see, estimate, r);
  g.globalAlpha = 0.55;
  plate(along(0, 0, length, 0), r + 4.2, palette.metal);
  g.globalAlpha = 1;
  if (frame.target) drawWanted(g, see, shape(frame.target), r);
}

// Rings of three bellows and the end of the tip, the farthest first.
function drawBellows(g, see, pose, r) {
  const RINGS = 16, parts = [];
  for (let i = 0; i < 3; i += 1) {
    const [x, y] = [r * Math.cos((i * 2 * Math.PI) / 3), r * Math.sin((i * 2 * Math.PI) / 3)];
    for (let k = 0; k <= 2 * RINGS; k += 1) {
      const points = circle(along(...pose, k / (2 * RINGS)), x, y, k % 2 ? 3.0 : 2.4).map(see);
      parts.push({ far: points.reduce((sum, p) => sum + p[2], 0) / points.length, points, color: palette[`line${i + 1}`], fold: k % 2 });
    }
  }
  const end = along(...pose, 1), cap = circle(end, 0, 0, r + 3.2, 40).map(see), lens = circle(end, 0, 0, 1.6).map(see);
  const [centre, ahead] = [see(end([0, 0, 0])), see(end([0, 0, 5]))];
  const faces = ahead[2] > centre[2];
  parts.push({ far: centre[2] + (faces ? 3 : -0.5), cap: true });
  parts.sort((a, b) => a.far - b.far);
  for (const part of parts) {
    trace(g, part.cap ? cap : part.points, true);
    g.fillStyle = part.cap ? palette.metal : part.color;
    g.fill();
    g.lineWidth = part.cap ? 1.4 : 0.8;
    g.strokeStyle = part.cap ? palette["metal-edge"] : palette.card;
    if (part.cap || part.fold) g.stroke();
    if (!part.cap) continue;
    if (faces) { trace(g, lens, true); g.fillStyle = palette.ink; g.fill(); }
  }
  // the axis of the tip
  g.strokeStyle = palette.ink;
  g.lineWidth = 2;
  trace(g, [centre, see(end([0, 0, 4]))]);
  g.stroke();
}

function drawWanted(g, see, pose, r) {
  const points = Array.from({ length: 25 }, (_, k) => see(along(...pose, k / 24)([0, 0, 0])));
  g.strokeStyle = palette.target;
  g.lineWidth = 2;
  g.setLineDash([6, 4]);
  trace(g, points);
  g.stroke();
  trace(g, circle(along(...pose, 1), 0, 0, r + 3.2, 40).map(see), true);
  g.stroke();
  g.setLineDash([]);
}

function drawPad() {
  const on = sheet("pad");
  if (!on) return;
  const { g } = on, { k, cx, cy } = padScale(), at = (v) => [cx + v.x * k, cy - v.y * k];
  const most = reach ? Math.max(...reach.bend_deg) : 90;
  g.textAlign = "left";
  g.textBaseline = "alphabetic";
  if (reach) {
    const edge = reach.bend_deg.map((bend, n) => at(vector({ bend_deg: bend, dir_deg: (n * 360) / reach.bend_deg.length })));
    trace(g, edge, true);
    g.fillStyle = palette.grid;
    g.globalAlpha = bends() ? 1 : 0.5;
    g.fill();
    g.globalAlpha = 1;
    g.strokeStyle = palette.key;
    g.lineWidth = 2;
    g.stroke();
  }
  g.strokeStyle = palette.rule;
  g.fillStyle = palette.soft;
  g.lineWidth = 1;
  for (let ring = 30; ring <= most + 1; ring += 30) {
    g.beginPath();
    g.arc(cx, cy, ring * k, 0, 7);
    g.stroke();
    g.fillText(`${ring}°`, cx + 3, cy - ring * k - 3);
  }
  trace(g, [[cx - most * k, cy], [cx + most * k, cy]]);
  g.stroke();
  trace(g, [[cx, cy - most * k], [cx, cy + most * k]]);
  g.stroke();
  if (!frame) return;
  if (frame.target || aiming) {
    const [x, y] = at(aiming ? aim : vector(frame.target));
    g.strokeStyle = palette.target;
    g.lineWidth = 2;
    g.setLineDash([5, 3]);
    g.beginPath();
    g.arc(x, y, 13, 0, 7);
    g.stroke();
    g.setLineDash([]);
    trace(g, [[x - 19, y], [x + 19, y]]);
    g.stroke();
    trace(g, [[x, y - 19], [x, y + 19]]);
    g.stroke();
  }
  if (frame.estimate) {
    g.fillStyle = palette.ink;
    g.beginPath();
    g.arc(...at(vector(frame.estimate)), 6, 0, 7);
    g.fill();
  }
}

function drawChart() {
  const on = sheet("chart");
  if (!on || !frame) return;
  const { g, w, h } = on, left = 34, bottom = h - 20, top = 6, now = frame.t;
  const most = Math.max(...errors.map(([, e]) => e ?? 0), 0.4);
  const high = [0.5, 1, 2, 5, 10, 20, 50, 100].find((y) => y >= most) ?? 200;
  const at = (t, e) => [left + (w - left - 4) * (1 - (now - t) / WINDOW_S), bottom - ((bottom - top) * e) / high];
  g.strokeStyle = palette.grid;
  g.fillStyle = palette.soft;
  g.lineWidth = 1;
  g.textAlign = "right";
  g.textBaseline = "middle";
  for (const share of [0, 0.5, 1]) {
    trace(g, [at(now - WINDOW_S, high * share), at(now, high * share)]);
    g.stroke();
    g.fillText(`${+(high * share).toFixed(2)}°`, left - 5, at(now, high * share)[1]);
  }
  g.textBaseline = "top";
  for (let s = 0; s <= WINDOW_S; s += 10) {
    g.textAlign = s === 0 ? "right" : s === WINDOW_S ? "left" : "center";
    g.fillText(s ? `−${s} s` : "now", at(now - s, 0)[0], bottom + 5);
  }
  g.strokeStyle = palette.line1;
  g.lineWidth = 2;
  g.beginPath();
  let pen = false;
  for (const [t, e] of errors) {
    if (e === null) { pen = false; continue; }
    const [x, y] = at(t, e);
    if (pen) g.lineTo(x, y); else g.moveTo(x, y);
    pen = true;
  }
  g.stroke();
}

function figure(id, main, small) {
  const note = document.createElement("small");
  note.textContent = ` ${small}`;
  $(id).replaceChildren(main, note);
}

function draw() {
  drawTip();
  drawPad();
  drawChart();
  if (!frame) return;
  const now = status.stopped ? "stopped" : frame.mode;
  if (live()) mode(now, ["faulted", "stopped", "lost"].includes(now) ? "bad" : frame.energised ? "on" : "");
  const estimate = frame.estimate ? polar(vector(frame.estimate)) : "no estimate";
  figure("figures", estimate, `length ${frame.length_mm.toFixed(1)} mm, pistons ${frame.piston_mm.map((p) => p.toFixed(1)).join(" / ")} mm`);
  if (aiming) figure("aim", polar(aim), dragging ? "target" : "Enter bends");
  else if (frame.target) figure("aim", polar(vector(frame.target)), "target");
  else figure("aim", "–", frame.mode === "disarmed" ? "Arm, then drag to bend" : "no target");
  const error = errors.at(-1)?.[1];
  figure("error-now", error === null || error === undefined ? "–" : `${error.toFixed(2)}°`, error === null ? "only while commanded" : "");
}

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { readPalette(); requestDraw(); });
addEventListener("resize", requestDraw);
// the cookie has the token now
if (location.search) history.replaceState(null, "", location.pathname);
readPalette();
words();
diagnosis();
connect();
requestDraw();
