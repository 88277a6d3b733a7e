/**
 * `lipstream view` in the browser: ties link, clock, mouth, plots and sound together and keeps the page's words up to date.
 *
 * @typedef {object} Hello  what the server says about the device; everything begins anew with it
 * @property {number} protocol
 * @property {string} source
 * @property {string} model
 * @property {number} rate_hz
 * @property {number} sample_rate_hz
 * @property {number} lag_samples
 * @property {{name: string, size: number}[]} groups
 * @property {{name: string, words: string}[]} visemes
 * @property {boolean} mouth
 * @property {import("./face.js").Face | null} face
 * @property {boolean} sound
 * @property {string | null} profile
 * @property {string[]} can
 * @property {number} buffer_ms
 * @property {boolean} running
 * @property {string | null} recording
 */
import { FrameClock, FrameRing, RecentDelays } from "./clock.js";
import { FaceView } from "./face.js";
import { Link, address } from "./link.js";
import { MouthView, parseMouth } from "./mouth.js";
import { Plots, colourOf } from "./plots.js";
import { SoundPlayer } from "./sound.js";

const PROTOCOL = 1;
const STALE_MS = 500;
/** Words change five times a second at most. */
const WORDS_MS = 200;
/** Half of the pictures are enough for what only runs by. */
const PLOTS_MS = 25;
/** Frames and pictures a second are counted over so many changes of the words. */
const RATE_STEPS = 10;
const BANNER_MS = 10_000;
const MOST_NOTICES = 100;
/** Everything waits for the face by no more than this. */
const MOST_EXTRA_MS = 300;
const MOST_TRACES = 6;
const MOST_BARS = 4;
/** A viseme's bar is the mean of so many frames: single ones flicker. */
const BAR_FRAMES = 15;

const $ = id => document.getElementById(id);
const asked = new URLSearchParams(location.search);
const view = new MouthView($("mouth"), ["canvas", "webgl"].find(by => asked.has(by)) ?? null);
const face = new FaceView($("picture"), () => link.send({ type: "seen" }));
const plots = new Plots($("plots"));
const delays = new RecentDelays();
const count = { received: 0, shown: 0, pictures: 0, late: 0, missing: 0 };
const notices = [], counts = [];

/** What belongs to the current hello; nothing before the first. */
let stream = null;
let player = null, status = null, ended = "", noticedAt = -Infinity;
/** The model whose mouth is here or on its way, and the words for why there is none. */
let mouthOf = null, mouthless = "";
let guessed = false, plottedAt = 0, wordsAt = 0;
/** Whether the face is shown where there is one. */
let faced = true;

/** @param {Hello} hello */
function begin(hello) {
  const { sample_rate_hz: rate, rate_hz: hz, groups, visemes } = hello, traces = [];
  let size = 0, from = 0;
  for (const group of groups) {
    if (group.name === "mouth") from = size;
    for (let k = 1; k <= group.size && traces.length < MOST_TRACES; k++) traces.push(`${group.name} ${k}`);
    size += group.size;
  }
  count.late += stream?.clock.late ?? 0;
  stream = {
    hello, from, traces, units: new Float32Array(MOST_TRACES),
    clock: new FrameClock(rate, hello.buffer_ms),
    frames: new FrameRing(size, visemes.length, rate, hz),
    levels: hello.sound ? new FrameRing(1, 0, rate, hz) : null,
    // What is on the screen: `part` after the frame `base`; `counted` is the last frame that has been on it.
    shown: new Float32Array(size), base: -1, part: 0, position: NaN, counted: -1,
    sequence: NaN, came: performance.now(),
  };
  ended = "";
  if (hello.protocol !== PROTOCOL) notice("warning", "lipstream is of another version than this page: load the page again.");
  if (player?.rate !== rate) {
    player?.turn(false);
    player = new SoundPlayer(rate);
  }
  loadMouth(hello);
  showTracks();
  face.begin(hello.face ?? null, rate);
  watchFace();
  showHello();
}

const showsFace = () => faced && face.face !== null;

/** Asks for the face's pictures as long as somebody looks at them. */
function watchFace() {
  link.send({ type: "face", on: showsFace() && !document.hidden });
}
document.addEventListener("visibilitychange", watchFace);

/** @param {Hello} hello */
async function loadMouth({ model, mouth }) {
  if (mouth && mouthOf === model) return;
  mouthOf = mouth ? model : null;
  mouthless = mouth ? "Loading the mouth …" : `No mouth can be drawn: lipstream has no model file for the device's model ${model}.`;
  view.show(null);
  if (!mouth) return;
  try {
    const answer = await fetch(address("/mouth"));
    if (!answer.ok) throw new Error(answer.status === 404 ? `there is no model file for ${model}` : `error ${answer.status}`);
    const space = parseMouth(await answer.arrayBuffer());
    if (mouthOf !== model) return;
    mouthless = "";
    view.show(space);
    showTracks();
  } catch (error) {
    if (mouthOf !== model) return;
    // The next hello tries again.
    mouthOf = null;
    mouthless = `No mouth can be drawn: ${error.message}.`;
  }
}

function showTracks() {
  const { frames, levels, traces, units, from, hello } = stream;
  units.forEach((_, k) => units[k] = view.space?.deviation[k - from] ?? 0);
  plots.show({ frames, levels, names: traces, units, rate: hello.sample_rate_hz });
}

/** @param {import("./link.js").Head} head @param {Float32Array} parameters @param {Uint8Array} weights @param {number} now */
function frame(head, parameters, weights, now) {
  if (!stream || head.count !== stream.frames.size || head.visemes !== stream.frames.visemes) return;
  const { clock, frames, units, traces } = stream, last = frames.count ? frames.sample(frames.count - 1) : -Infinity;
  if (head.sample <= last) {
    // The same frame once more; or a count that began anew without a hello.
    if (last - head.sample < clock.rate) return;
    begin(stream.hello);
    return frame(head, parameters, weights, now);
  }
  count.received++;
  const gap = (head.sequence - stream.sequence - 1) >>> 0;
  if (!Number.isNaN(stream.sequence) && gap < 2 ** 31) count.missing += gap;
  stream.sequence = head.sequence;
  stream.came = now;
  clock.arrived(head.sample, now);
  frames.push(head.sample, head.arrived, head.heard, parameters, weights);
  // Without a model nobody knows the deviations: half of the greatest value so far looks the same.
  if (!view.space) traces.forEach((_, k) => units[k] = Math.max(units[k], Math.abs(parameters[k]) / 2));
}

/** @param {import("./link.js").Head} head @param {Int16Array} samples @param {number} now */
function sound(head, samples, now) {
  if (!stream?.levels) return;
  let power = 0;
  for (let k = 0; k < samples.length; k++) power += (samples[k] / 32768) ** 2;
  // From 60 dB below the loudest, which is silence, to the loudest.
  stream.levels.push(head.sample, NaN, NaN, [Math.max(0, 1 + Math.log10(power / samples.length + 1e-9) / 6)], []);
  player.push(samples, head.sample, stream.clock, now);
}

/** @param {import("./link.js").Head} head @param {Uint8Array} jpeg @param {number} now */
function picture(head, jpeg, now) {
  // A picture of the stream before may still have been on its way: its samples lie far ahead.
  if (stream?.clock.ready && head.sample - stream.clock.position(now) < stream.clock.rate) return face.push(head, jpeg);
  link.send({ type: "seen" });
}

function text(message) {
  if (message.type === "hello") begin(message);
  else if (message.type === "notice") notice(message.level, message.text);
  else if (message.type === "end") notice("info", ended = message.text || "The source has ended.");
  else if (message.type === "status") {
    status = message;
    // A server may tell of these without a hello, with which everything would begin anew.
    const changed = ["running", "recording", "profile"].filter(name => name in message && stream && message[name] !== stream.hello[name]);
    for (const name of changed) stream.hello[name] = message[name];
    if (changed.length) showHello();
  }
}
const link = new Link({ text, frame, sound, picture });

const stale = now => !link.connected || !stream || now - stream.came > STALE_MS;
const late = () => count.late + (stream?.clock.late ?? 0);

/** Draws what is due. @param {number} stamp when the browser began this picture @param {number} now */
function draw(stamp, now) {
  const { clock, frames, shown } = stream, position = clock.position(stamp), base = frames.find(position, stream.base);
  if (base < 0) return;
  const part = frames.part(base, position);
  if (showsFace()) drawFace(position, now);
  else if (!stale(now)) measure(base, base === frames.count - 1 ? frames.sample(base) : position, now);
  if (stamp - plottedAt > PLOTS_MS) {
    plottedAt = stamp;
    plots.draw(position);
  }
  if (base === stream.base && part === stream.part && !view.dirty) return;
  for (let k = 0; k < shown.length; k++) shown[k] = frames.parameter(base, part, k);
  if (!showsFace()) {
    view.draw(shown, stream.from);
    count.pictures++;
  }
  const last = part > 0 ? base + 1 : base;
  count.shown += Math.max(0, last - Math.max(stream.counted, base - 1));
  stream.counted = Math.max(stream.counted, last);
  stream.base = base;
  stream.part = part;
  stream.position = position;
}

/** Draws the face's picture that is due. @param {number} position @param {number} now */
function drawFace(position, now) {
  const { clock } = stream, due = face.draw(position);
  if (!due) return;
  count.pictures++;
  // It stands for its own time: the middle of that is what is measured.
  measureFrom(due.heard, due.arrived, now + face.half * 1000 / clock.rate, now);
  // Without sound nothing is gained by waiting; with it the mouth must not be seen after it.
  const lag = face.takeLag();
  if (player.on && lag) clock.extra = Math.min(MOST_EXTRA_MS, clock.extra + lag);
}

/** How long ago `sample`, which is now on the screen, was heard. @param {number} base @param {number} sample @param {number} now */
function measure(base, sample, now) {
  const { frames, clock } = stream, at = base % frames.capacity;
  measureFrom(frames.heard[at], frames.arrived[at], now - (sample - frames.sample(base)) * 1000 / clock.rate, now);
}

/** What is on the screen at `shown` was heard or, where nobody knows, arrived then. @param {number} heard @param {number} arrived @param {number} shown @param {number} now */
function measureFrom(heard, arrived, shown, now) {
  guessed = Number.isNaN(heard);
  const delay = shown + link.host.offset - (guessed ? arrived - stream.hello.lag_samples * 1000 / stream.clock.rate : heard);
  if (!Number.isNaN(delay)) delays.add(delay, now);
}

/** @param {number} stamp */
function screen(stamp) {
  requestAnimationFrame(screen);
  if (document.hidden) return;
  const now = performance.now();
  if (stream?.frames.count) draw(stamp, now);
  if (now - wordsAt >= WORDS_MS) words(now);
}

/** @param {HTMLElement} element @param {string} words */
function say(element, words) {
  if (element.textContent !== words) element.textContent = words;
}

/** @param {HTMLElement} parent @param {string} name @param {string} words */
function add(parent, name, words = "") {
  const element = parent.appendChild(document.createElement(name));
  element.textContent = words;
  return element;
}

const ms = value => Number.isFinite(value) ? `${Math.round(value)} ms` : "not known";
const number = value => String(value ?? "not known");
const list = (id, rows) => rows.map(([words, value]) => (add($(id), "dt", words), { element: add($(id), "dd"), value }));
const rows = [
  ...list("times", [
    ["From sound to picture, median", state => ms(state.delay.median)],
    ["From sound to picture, worst", state => ms(state.delay.worst)],
    ["Pictures drawn a second", state => state.pictures.toFixed(0)],
    ["Frames received a second", state => state.frames.toFixed(0)],
    ["Device's load", () => status?.load_permille ? `${Math.round(status.load_permille / 10)} %` : "not known"],
    ["Drawn with", () => showsFace() ? `lipstream, ${face.face.width}×${face.face.height}`
      : view.space ? { webgl: "WebGL", canvas: "Canvas 2D" }[view.renderer] : "no mouth"],
    ["Pages like this one", () => number(status?.clients)],
  ]),
  ...list("losses", [
    ["Frames lost on the line", () => number(status?.losses?.frames)],
    ["Damaged messages, dropped", () => number(status?.losses?.damaged)],
    ["Messages of an unknown kind, skipped", () => number(status?.losses?.unknown)],
    ["Frames that came before the device said what they mean", () => number(status?.losses?.unread)],
    ["Restarts of the device", () => number(status?.losses?.restarts)],
    ["Sound the device missed, in pieces of 10 ms", () => number(status?.overruns)],
    ["Frames the device dropped because the line was full", () => number(status?.dropped)],
    ["Frames computed with a narrowed search, to keep up", () => number(status?.narrowed)],
    ["Frames missing here, of those numbered by the device", () => number(count.missing)],
    ["Frames that came here too late to be shown in time", () => number(late())],
    ["Pictures of the face that came too late", () => number(face.face ? face.late : undefined)],
  ]),
];
const bars = Array.from({ length: MOST_BARS }, () => {
  const item = add($("bars"), "li");
  return { word: add(item, "span"), share: add(item, "output"), bar: add(item, "i") };
});

/** Brings all words up to date. @param {number} now */
function words(now) {
  // After a pause of the page's own, frames are waiting to be taken: they are not missing.
  const old = stale(now) && (now - wordsAt < 2 * WORDS_MS || !link.connected);
  wordsAt = now;
  counts.push({ now, received: count.received, pictures: count.pictures });
  if (counts.length > RATE_STEPS + 1) counts.shift();
  const seconds = (now - counts[0].now) / 1000 || Infinity;
  const state = { delay: delays.stats(now), frames: (count.received - counts[0].received) / seconds,
    pictures: (count.pictures - counts[0].pictures) / seconds };
  for (const { element, value } of rows) say(element, value(state));
  say($("how"), guessed
    ? "Nobody knows when a sample was heard: counted are the device's own delay and the time since the frame came from the line."
    : "From when a sample was heard until it was drawn, over 5 seconds. The screen adds its own delay.");
  const wait = Math.max(0, Math.ceil((link.retryAt - now) / 1000));
  say($("state"), link.connected ? "connected" : `not connected to lipstream; next try in ${wait} s`);
  $("state").classList.toggle("good", link.connected);
  for (const id of ["mouth", "picture"]) $(id).classList.toggle("stale", old);
  say($("caption"), caption(now, old));
  $("banner").hidden = !notices.length || (!old && now - noticedAt > BANNER_MS);
  if (stream?.base >= 0 && stream.hello.visemes.length) showBars();
}

/** @param {number} now @param {boolean} old */
function caption(now, old) {
  if (!link.connected) return "The connection to lipstream is lost; it is tried again by itself.";
  if (ended) return ended;
  if (old && stream?.frames.count) return `No frames for ${((now - stream.came) / 1000).toFixed(0)} s: this is the last mouth.`;
  if (old) return stream && !stream.hello.running ? "The device is stopped." : "Waiting for the first frame …";
  return showsFace() ? "" : mouthless;
}

function showBars() {
  const { frames, hello, base } = stream, first = Math.max(0, frames.count - frames.capacity, base - BAR_FRAMES + 1);
  const shares = hello.visemes.map((viseme, v) => {
    let sum = 0;
    for (let f = first; f <= base; f++) sum += frames.weight(f, v);
    return { v, share: sum / (base - first + 1) / 255, words: viseme.words || viseme.name };
  }).sort((a, b) => b.share - a.share);
  bars.forEach(({ word, share, bar }, k) => {
    const one = shares[k] ?? { v: 0, share: 0, words: "" };
    say(word, one.words);
    say(share, `${Math.round(100 * one.share)} %`);
    bar.style.background = colourOf(one.v);
    bar.style.transform = `scaleX(${one.share})`;
  });
}

/** What the hello says, in words and buttons. */
function showHello() {
  const { hello } = stream, recording = hello.recording !== null;
  say($("source"), `${hello.source} · model ${hello.model}`);
  for (const name of ["start", "stop", "record", "demo", "profile"]) $(`can-${name}`).hidden = !hello.can.includes(name);
  $("sound").hidden = !hello.sound;
  $("can-face").hidden = !face.face;
  $("can-face").setAttribute("aria-pressed", faced);
  $("face").hidden = !showsFace();
  $("mouth").hidden = showsFace();
  $("sound").setAttribute("aria-pressed", player.on);
  $("can-start").disabled = hello.running;
  $("can-stop").disabled = !hello.running;
  $("profile").value = hello.profile ?? "";
  $("can-record").setAttribute("aria-pressed", recording);
  say($("can-record"), recording ? "Stop recording" : "Record");
  say($("recording"), hello.recording ? `recording ${hello.recording}` : "");
  $("now").hidden = !hello.visemes.length;
  $("legend").replaceChildren();
  hello.visemes.forEach((viseme, v) => {
    const item = add($("legend"), "li");
    add(item, "i").style.background = colourOf(v);
    item.append(viseme.words || viseme.name);
  });
}

/** @param {"info" | "warning" | "error"} level @param {string} words */
function notice(level, words) {
  const time = new Date().toLocaleTimeString(), item = document.createElement("li");
  noticedAt = performance.now();
  notices.push(words);
  add(item, "time", time);
  item.append(words);
  $("notices").prepend(item);
  if (notices.length > MOST_NOTICES) {
    notices.shift();
    $("notices").lastElementChild.remove();
  }
  // A class must never be any text that comes.
  item.className = ["warning", "error"].includes(level) ? level : "info";
  $("banner").className = `banner ${item.className}`;
  say($("banner"), `${time} ${words}`);
  $("quiet").hidden = true;
}

/** Tells the server, and shows at once what its next hello will say. @param {object} message @param {object} soon */
function ask(message, soon = {}) {
  if (link.connected) {
    link.send(message);
    Object.assign(stream.hello, soon);
  }
  showHello();
}
const recorded = () => stream.hello.recording === null;
const clicks = {
  "can-start": () => ask({ type: "start" }, { running: true }),
  "can-stop": () => ask({ type: "stop" }, { running: false }),
  "can-demo": () => ask({ type: "demo" }),
  "can-record": (on = recorded()) => ask({ type: "record", on }, { recording: on ? "" : null }),
  "can-face"() {
    faced = !faced;
    watchFace();
    showHello();
  },
  sound() {
    // What the sound needed, the mouth need not wait for any more.
    if (player.on) stream.clock.extra = 0;
    player.turn(!player.on);
    showHello();
  },
};
for (const [id, act] of Object.entries(clicks)) $(id).addEventListener("click", () => act());
$("profile").addEventListener("change", () => ask({ type: "profile", profile: $("profile").value }));

/** For tests. */
window.lipstream = {
  stats() {
    const now = performance.now(), { frames, clock, hello } = stream ?? {};
    return {
      connected: link.connected, framesReceived: count.received, framesShown: count.shown, late: late(), pictures: count.pictures,
      renderer: view.renderer, delayMs: delays.stats(now), lastSample: frames?.count ? frames.sample(frames.count - 1) : null,
      model: hello?.model ?? null, notices: [...notices], stale: stale(now), missing: count.missing, resyncs: clock?.resyncs ?? 0,
      extraMs: clock?.extra ?? 0, pingMs: link.host.way,
      face: face.face && { shown: showsFace(), sample: face.sample, drawn: face.drawn, late: face.late },
      sound: player && { on: player.on, errorMs: player.error, speed: player.speed, breaks: player.breaks },
    };
  },
  pixels: () => view.pixels(),
  facePixels: (x, y, width, height) => face.pixels(x, y, width, height),
  /** Draws the mouth that is shown once more. */
  draw: () => view.draw(stream.shown, stream.from),
  /** What is on the screen: `part` of the way from the frame of `sample` to its next. */
  frameAtShown() {
    if (!stream || stream.base < 0) return null;
    const { frames, base, part, position, shown, hello } = stream;
    return { sample: frames.sample(base), part, position, parameters: [...shown], visemes: hello.visemes.map((_, v) => frames.weight(base, v)) };
  },
};
requestAnimationFrame(screen);
