/**
 * `lipstream view` in the browser: ties link, clock, mouth, plots and sound together and keeps the page's words up to date.
 *
 * @typedef {object} Hello
 * @property {number} protocol
 * @property {string} source
 * @property {string} model
 * @property {number} rate_hz
 * @property {number} sample_rate_hz
 * @property {number} lag_samples
 * @property {{name: string, size: number}[]} groups
 * @property {{name: string, words: string}[]} visemes
 * @property {boolean} mouth
 * @property {boolean} sound
 * @property {string | null} profile
 * @property {string[]} can
 * @property {number} buffer_ms
 * @property {boolean} running
 * @property {string | null} recording
 */
import { FrameClock, FrameRing, RecentDelays } from "./clock.js";
import { Link, address } from "./link.js";
import { MouthView, parseMouth } from "./mouth.js";
import { Plots, colourOf } from "./plots.js";
import { SoundPlayer } from "./sound.js";

const PROTOCOL = 1;
const STALE_MS = 500;
/** Words change five times a second at most. */
const WORDS_MS = 200;
/** Frames and pictures a second are counted over so many of those changes. */
const RATE_STEPS = 10;
const MOST_NOTICES = 100;
const MOST_TRACES = 6;
const MOST_BARS = 4;
/** A viseme's bar is the mean of so many frames: single ones flicker. */
const BAR_FRAMES = 15;

const $ = id => document.getElementById(id);
const view = new MouthView($("mouth"), new URLSearchParams(location.search).has("canvas"));
const plots = new Plots($("plots"));
const delays = new RecentDelays();
const count = { received: 0, shown: 0, pictures: 0, late: 0, missing: 0 };

/** What belongs to the current hello; nothing before the first. */
let stream = null;
let player = null;
let status = null;
let ended = "";
/** The model whose mouth is here or on its way, and why there is none. */
let mouthOf = null, mouthless = "";
let guessed = false;
let lastNotice = null;
const notices = [];

/** Begins anew: samples count from 0 again, and everything about the device may be another. @param {Hello} hello */
function begin(hello) {
  const { sample_rate_hz: rate, rate_hz: hz, groups, visemes } = hello;
  const size = groups.reduce((sum, group) => sum + group.size, 0);
  const before = groups.findIndex(group => group.name === "mouth");
  if (stream) count.late += stream.clock.late;
  stream = {
    hello,
    clock: new FrameClock(rate, hello.buffer_ms),
    frames: new FrameRing(size, visemes.length, rate, hz),
    levels: hello.sound ? new FrameRing(1, 0, rate, hz) : null,
    /** Where the mouth's parameters begin. */
    from: groups.slice(0, Math.max(0, before)).reduce((sum, group) => sum + group.size, 0),
    names: groups.flatMap(group => Array.from({ length: group.size }, (_, k) => `${group.name} ${k + 1}`)).slice(0, MOST_TRACES),
    units: new Float32Array(MOST_TRACES),
    shown: new Float32Array(size),
    level: new Float32Array(1),
    base: -1, part: 0, position: NaN, counted: -1, sequence: null, came: performance.now(),
  };
  ended = "";
  if (hello.protocol !== PROTOCOL) notice("warning", "lipstream is of another version than this page: load the page again.");
  if (player && player.rate !== rate) player.turn(player.on = false);
  if (player?.rate !== rate) player = new SoundPlayer(rate);
  player.restart();
  loadMouth(hello);
  showTracks();
  showHello();
}

/** @param {Hello} hello */
async function loadMouth({ model, mouth }) {
  if (mouth && mouthOf === model) return;
  mouthOf = mouth ? model : null;
  mouthless = mouth ? "Loading the mouth …" : `No mouth can be drawn: lipstream has no model file for the device's model ${model}.`;
  view.show(null);
  if (!mouth) return;
  try {
    const answer = await fetch(address("/mouth"));
    if (!answer.ok) throw new Error(answer.status === 404 ? `there is no model file for model ${model}` : `error ${answer.status}`);
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
  const { frames, levels, names, units, from, hello } = stream, deviation = view.space?.deviation ?? [];
  units.forEach((_, k) => units[k] = deviation[k - from] ?? 0);
  plots.show({ frames, levels, names, units, rate: hello.sample_rate_hz });
}

/** @param {import("./link.js").Head} head @param {Float32Array} parameters @param {Uint8Array} weights @param {number} now */
function frame(head, parameters, weights, now) {
  if (!stream || head.count !== stream.frames.size || head.visemes !== stream.frames.visemes) return;
  const { clock, frames, units } = stream, last = frames.count ? frames.sample(frames.count - 1) : -Infinity;
  if (head.sample <= last) {
    // The same frame once more; or a count that began anew without a hello.
    if (last - head.sample < clock.rate) return;
    begin(stream.hello);
    return frame(head, parameters, weights, now);
  }
  count.received++;
  const gap = stream.sequence === null ? 0 : (head.sequence - stream.sequence - 1) >>> 0;
  if (gap < 2 ** 31) count.missing += gap;
  stream.sequence = head.sequence;
  stream.came = now;
  clock.arrived(head.sample, now);
  frames.push(head.sample, head.arrived, head.heard, parameters, weights);
  // Without a model nobody knows the deviations: half of the greatest value so far looks the same.
  if (!view.space) for (let k = 0; k < stream.names.length; k++) units[k] = Math.max(units[k], Math.abs(parameters[k]) / 2);
}

/** @param {import("./link.js").Head} head @param {Int16Array} samples @param {number} now */
function sound(head, samples, now) {
  if (!stream?.levels) return;
  let power = 0;
  for (let k = 0; k < samples.length; k++) power += (samples[k] / 32768) ** 2;
  // From 60 dB below the loudest, which is silence, to the loudest.
  stream.level[0] = Math.max(0, 1 + Math.log10(power / samples.length + 1e-9) / 6);
  stream.levels.push(head.sample, NaN, NaN, stream.level, []);
  player.push(samples, head.sample, stream.clock, now);
}

const listener = {
  frame, sound,
  text(message) {
    if (message.type === "hello") begin(message);
    else if (message.type === "notice") notice(message.level, message.text);
    else if (message.type === "end") notice("info", ended = message.text || "The source has ended.");
    else if (message.type === "status") {
      status = message;
      // A server may tell such a change without a hello, which would begin anew.
      if (stream && ["running", "recording", "profile"].some(name => name in message && message[name] !== stream.hello[name])) {
        for (const name of ["running", "recording", "profile"]) if (name in message) stream.hello[name] = message[name];
        showHello();
      }
    }
  },
};
const link = new Link(listener);

/** Draws what is due. @param {number} stamp when the browser began this picture @param {number} now */
function draw(stamp, now) {
  const { clock, frames, shown, hello, from } = stream, position = clock.position(stamp);
  const base = frames.find(position, stream.base);
  if (base < 0) return;
  const part = frames.part(base, position);
  if (!stale(now)) measure(base, base === frames.count - 1 ? frames.sample(base) : position, now);
  plots.draw(position);
  if (base === stream.base && part === stream.part && !view.dirty) return;
  for (let k = 0; k < shown.length; k++) shown[k] = frames.parameter(base, part, k);
  view.draw(shown, from);
  const last = part > 0 ? base + 1 : base;
  if (last > stream.counted) {
    count.shown += last - Math.max(stream.counted, base - 1);
    stream.counted = last;
  }
  count.pictures++;
  stream.base = base;
  stream.part = part;
  stream.position = hello.sample_rate_hz ? position : NaN;
}

/** How long ago `sample`, now on the screen, was heard. @param {number} base @param {number} sample @param {number} now */
function measure(base, sample, now) {
  const { frames, hello, clock } = stream, at = base % frames.capacity, shown = now + link.host.offset;
  guessed = Number.isNaN(frames.heard[at]);
  const after = (sample - frames.sample(base)) * 1000 / clock.rate;
  const heard = guessed ? frames.arrived[at] - hello.lag_samples * 1000 / clock.rate : frames.heard[at];
  const delay = shown - heard - after;
  if (!Number.isNaN(delay)) delays.add(delay, now);
}

const stale = now => !link.connected || !stream || now - stream.came > STALE_MS;
const late = () => count.late + (stream?.clock.late ?? 0);

/** @param {number} stamp */
function picture(stamp) {
  requestAnimationFrame(picture);
  if (document.hidden) return;
  const now = performance.now();
  if (stream?.frames.count) draw(stamp, now);
  if (now - words.at >= WORDS_MS) words(now);
}

/** @param {HTMLElement} element @param {string} text */
function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** @param {string} name @param {string} text @param {HTMLElement} parent */
function add(name, text, parent) {
  const element = parent.appendChild(document.createElement(name));
  element.textContent = text;
  return element;
}

const ms = value => Number.isFinite(value) ? `${Math.round(value)} ms` : "not known";
const number = value => value === undefined || value === null ? "not known" : String(value);
const list = (id, rows) => rows.map(([text, value]) => (add("dt", text, $(id)), [add("dd", "", $(id)), value]));
const rows = [
  ...list("times", [
    ["From sound to picture, median", state => ms(state.delay.median)],
    ["From sound to picture, worst", state => ms(state.delay.worst)],
    ["Pictures drawn a second", state => state.rates[1].toFixed(0)],
    ["Frames received a second", state => state.rates[0].toFixed(0)],
    ["Device's load", () => status && status.load_permille !== null ? `${(status.load_permille / 10).toFixed(0)} %` : "not known"],
    ["Drawn with", () => view.space ? { webgl: "WebGL", canvas: "Canvas 2D" }[view.renderer] : "no mouth"],
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
  ]),
];
const bars = Array.from({ length: MOST_BARS }, () => {
  const item = $("bars").appendChild(document.createElement("li"));
  return { word: add("span", "", item), share: add("output", "", item), bar: add("i", "", item) };
});
/** Received and drawn at each of the last changes of the words. */
const counts = [];

/** Brings all words up to date. @param {number} now */
function words(now) {
  words.at = now;
  counts.push([now, count.received, count.pictures]);
  if (counts.length > RATE_STEPS + 1) counts.shift();
  const seconds = (now - counts[0][0]) / 1000 || Infinity;
  const state = { delay: delays.stats(now), rates: [1, 2].map(k => (counts.at(-1)[k] - counts[0][k]) / seconds) };
  for (const [element, value] of rows) say(element, value(state));
  say($("how"), guessed
    ? "Nobody knows when a sample was heard: counted are the device's own delay and the time since the frame came from the line."
    : "From when the sample was heard until it was drawn, over 5 seconds. The screen adds its own delay.");
  say($("state"), link.connected ? "connected" : `not connected to lipstream; next try in ${Math.max(0, Math.ceil((link.retryAt - now) / 1000))} s`);
  $("state").classList.toggle("good", link.connected);
  const old = stale(now);
  $("mouth").classList.toggle("stale", old);
  say($("caption"), caption(now, old));
  $("banner").hidden = !lastNotice || (!old && now - lastNotice.at > 10_000);
  if (stream?.base >= 0 && stream.hello.visemes.length) showBars();
}
words.at = -Infinity;

/** @param {number} now @param {boolean} old */
function caption(now, old) {
  if (!link.connected) return "The connection to lipstream is lost; it is tried again by itself.";
  if (ended) return ended;
  if (old && stream?.frames.count) return `No frames for ${((now - stream.came) / 1000).toFixed(0)} s: this is the last mouth.`;
  if (old) return stream && !stream.hello.running ? "The device is stopped." : "Waiting for the first frame …";
  return mouthless;
}

function showBars() {
  const { frames, hello, base } = stream, first = Math.max(0, frames.count - frames.capacity, base - BAR_FRAMES + 1);
  const shares = hello.visemes.map((viseme, v) => {
    let sum = 0;
    for (let f = first; f <= base; f++) sum += frames.weight(f, v);
    return { v, share: sum / (base - first + 1) / 255, words: viseme.words || viseme.name };
  }).sort((a, b) => b.share - a.share);
  bars.forEach(({ word, share, bar }, k) => {
    say(word, shares[k]?.words ?? "");
    say(share, shares[k] ? `${Math.round(100 * shares[k].share)} %` : "");
    bar.style.background = colourOf(shares[k]?.v ?? 0);
    bar.style.transform = `scaleX(${shares[k]?.share ?? 0})`;
  });
}

/** What the hello says, in words and buttons. */
function showHello() {
  const { hello } = stream, can = new Set(hello.can);
  say($("source"), `${hello.source} · model ${hello.model}`);
  for (const id of ["start", "stop", "record", "demo"]) $(id).hidden = !can.has(id);
  $("profiles").hidden = !can.has("profile");
  $("sound").hidden = !hello.sound;
  $("sound").setAttribute("aria-pressed", player.on);
  $("start").disabled = hello.running;
  $("stop").disabled = !hello.running;
  $("profile").value = hello.profile ?? "";
  const recording = hello.recording !== null;
  $("record").setAttribute("aria-pressed", recording);
  say($("record"), recording ? "Stop recording" : "Record");
  say($("recording"), recording && hello.recording ? `recording ${hello.recording}` : "");
  $("now").hidden = $("legend").hidden = !hello.visemes.length;
  $("legend").replaceChildren();
  hello.visemes.forEach(({ name, words: text }, v) => {
    const item = add("li", "", $("legend"));
    add("i", "", item).style.background = colourOf(v);
    item.append(text || name);
  });
}

/** @param {"info" | "warning" | "error"} level @param {string} text */
function notice(level, text) {
  const time = new Date().toLocaleTimeString();
  lastNotice = { at: performance.now() };
  notices.push(text);
  if (notices.length > MOST_NOTICES) notices.shift();
  $("quiet").hidden = true;
  const item = document.createElement("li");
  add("time", time, item);
  item.append(text);
  $("notices").prepend(item);
  if ($("notices").childElementCount > MOST_NOTICES) $("notices").lastElementChild.remove();
  // Only these levels have a colour; a class must never be a server's text.
  const known = ["info", "warning", "error"].includes(level) ? level : "info";
  item.className = known;
  $("banner").className = `banner ${known}`;
  say($("banner"), `${time} ${text}`);
}

/** Tells the server, and shows at once what it will say in its next hello. @param {object} message @param {object} soon */
function ask(message, soon = {}) {
  if (link.connected) {
    link.send(message);
    Object.assign(stream.hello, soon);
  }
  showHello();
}
$("start").addEventListener("click", () => ask({ type: "start" }, { running: true }));
$("stop").addEventListener("click", () => ask({ type: "stop" }, { running: false }));
$("demo").addEventListener("click", () => ask({ type: "demo" }));
$("record").addEventListener("click", () => {
  const on = stream.hello.recording === null;
  ask({ type: "record", on }, { recording: on ? "" : null });
});
$("profile").addEventListener("change", () => ask({ type: "profile", profile: $("profile").value }));
$("sound").addEventListener("click", async () => {
  const on = !player.on;
  $("sound").setAttribute("aria-pressed", on);
  // What the sound needed, the mouth need not wait for any more.
  if (!on) stream.clock.extra = 0;
  await player.turn(on);
});

window.lipstream = {
  stats() {
    const now = performance.now(), { frames, clock, hello } = stream ?? {};
    return {
      connected: link.connected, framesReceived: count.received, framesShown: count.shown, late: late(), pictures: count.pictures,
      renderer: view.renderer, delayMs: delays.stats(now), lastSample: frames?.count ? frames.sample(frames.count - 1) : null,
      model: hello?.model ?? null, notices: [...notices], stale: stale(now), missing: count.missing, resyncs: clock?.resyncs ?? 0,
      extraMs: clock?.extra ?? 0, pingMs: link.host.way, running: hello?.running ?? false,
      sound: { on: Boolean(player?.on), errorMs: player?.error ?? 0, speed: player?.speed ?? 1, breaks: player?.breaks ?? 0 },
    };
  },
  pixels: () => view.pixels(),
  /** The frame from which the current picture was drawn, and what was drawn. */
  frameAtShown() {
    if (!stream || stream.base < 0) return null;
    const { frames, base, part, position, shown } = stream, weights = [];
    for (let v = 0; v < frames.visemes; v++) weights.push(frames.weight(base, v));
    return { sample: frames.sample(base), part, position, parameters: [...shown], visemes: weights };
  },
};
requestAnimationFrame(picture);
