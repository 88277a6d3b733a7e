/** The page of `cargo xtask site`: a microphone or a file moves the mouth, in this page alone. */
import { FrameClock, FrameRing } from "./clock.js";
import { MouthView, parseMouth } from "./mouth.js";
import { Plots, colourOf } from "./plots.js";
import { Microphone, Playing } from "./sources.js";
import { Talker } from "./talker.js";

const HZ = 100;
/** The resampler gives blocks of 20 to 40 ms, and a browser hands sound over in pieces: everything waits for so long. */
const BUFFER_MS = 60;
const MOST_TRACES = 6;
/** A file is converted so many samples at a time, so that the page stays alive: some milliseconds of work. */
const PART = 16_000;
/** A viseme's bar is the mean of so many frames: single ones flicker. */
const BAR_FRAMES = 15;

const $ = id => document.getElementById(id);
const data = JSON.parse($("data").textContent);
const bytesOf = base64 => Uint8Array.from(atob(base64), c => c.charCodeAt(0));
const asked = new URLSearchParams(location.search);
const view = new MouthView($("mouth"), ["canvas", "webgl"].find(by => asked.has(by)) ?? null);
const plots = new Plots($("plots"));
const tables = bytesOf(data.tables), space = parseMouth(bytesOf(data.mouth).buffer);
const bars = data.visemes.map((words, v) => {
  const item = $("visemes").appendChild(document.createElement("li")), bar = document.createElement("i");
  item.append(words, bar);
  bar.style.background = colourOf(v);
  return bar;
});
let module = null;

/** What runs now: its frames, and `position`, the sample that is due. Null where nothing runs. */
let stream = null;
/** The frames of what began last, also after it has ended. @type {FrameRing | null} */
let last = null;
/** Which start is the last: whoever waited for a microphone or a file while another was asked for gives up. */
let turn = 0;

/** @param {HTMLElement} element @param {string} words */
function say(element, words) {
  if (element.textContent !== words) element.textContent = words;
}

/** @param {string} words */
function state(words) {
  say($("state"), words);
  $("state").classList.toggle("good", Boolean(stream));
  $("stop").disabled = !stream;
  $("microphone").setAttribute("aria-pressed", Boolean(stream?.microphone));
}

/** Shows what is wrong until something begins. @param {unknown} error */
function complain(error) {
  stop("Nothing is playing.");
  // A module that fails in the middle has no words for it.
  const words = error instanceof WebAssembly.RuntimeError ? "This sound makes the decoder fail: convert it to WAV with another program." : error.message;
  say($("banner"), words);
  $("banner").hidden = false;
}

/** @param {string} words */
function stop(words) {
  turn++;
  stream?.close();
  stream = null;
  view.dirty = true;
  state(words);
}

/** The first parameter of the mouth among all. @param {import("./talker.js").About} about */
function mouthFrom(about) {
  let from = 0;
  for (const { name, size } of about.groups) {
    if (name === "mouth") return from;
    from += size;
  }
  return 0;
}

/** Room for so many frames, and their plots. @param {import("./talker.js").About} about @param {number} [frames] */
function room(about, frames) {
  const rate = about.sample_rate_hz, from = mouthFrom(about);
  const ring = new FrameRing(about.parameters, about.visemes, rate, HZ, frames), levels = new FrameRing(1, 0, rate, HZ, frames);
  const traces = Array.from({ length: Math.min(MOST_TRACES, space.size) }, (_, k) => k);
  plots.show({ frames: ring, levels, names: traces.map(k => `mouth ${k + 1}`), units: traces.map(k => space.deviation[k]), rate });
  return { ring, levels, from, rate, shown: new Float32Array(about.parameters), base: -1, close() {} };
}

/** @param {import("./talker.js").Frames} said @param {FrameRing} ring @param {import("./talker.js").About} about */
function add(said, ring, { parameters, visemes }) {
  for (let k = 0; k < said.count; k++) {
    ring.push(said.centres[k], NaN, NaN, said.parameters.subarray(k * parameters, (k + 1) * parameters), said.visemes.subarray(k * visemes, (k + 1) * visemes));
  }
}

/** The loudness of samples, 0 to 1: from 60 dB below the loudest, which is silence, to the loudest. @param {Int16Array} samples */
function level(samples) {
  let power = 0;
  for (const sample of samples) power += (sample / 32768) ** 2;
  return [Math.max(0, 1 + Math.log10(power / samples.length + 1e-9) / 6)];
}

/** Listens to the microphone. */
async function listen() {
  stop("Waiting for the microphone …");
  $("banner").hidden = true;
  const mine = turn;
  let talker, clock, made, heard = 0;
  const hear = sound => {
    try {
      const said = talker.hear(sound), now = performance.now(), samples = talker.samples();
      if (samples.length) made.levels.push(heard, NaN, NaN, level(samples), []);
      heard += samples.length;
      add(said, made.ring, talker.about);
      if (said.count) clock.arrived(made.ring.sample(made.ring.count - 1), now);
    } catch (error) {
      complain(error);
    }
  };
  const microphone = await Microphone.open(hear, () => complain(new Error("The microphone has been taken away.")));
  if (mine !== turn) return microphone.close();
  talker = new Talker(module, tables, $("profile").value, microphone.rate);
  made = room(talker.about);
  last = made.ring;
  clock = new FrameClock(made.rate, BUFFER_MS);
  stream = Object.assign(made, { microphone, position: now => clock.ready ? clock.position(now) : NaN, close: () => microphone.close() });
  microphone.listen();
  state(`Listening at ${microphone.rate} Hz.`);
}

/** Converts a sound file and plays it. @param {string} name @param {Uint8Array} file */
async function play(name, file) {
  stop(`Converting ${name} …`);
  $("banner").hidden = true;
  const mine = turn;
  // The words are on the screen before the work begins.
  await new Promise(resolve => setTimeout(resolve));
  last = null;
  const begun = performance.now(), talker = new Talker(module, tables, $("profile").value, 16_000);
  let count;
  try {
    count = talker.decode(file);
  } catch (error) {
    if (error instanceof WebAssembly.RuntimeError) throw error;
    throw new Error(`${name} cannot be read: ${error.message}.`);
  }
  const { about } = talker, hop = about.sample_rate_hz / HZ, made = room(about, Math.ceil(count / hop) + 1);
  for (let from = 0; from < count; from += PART) {
    add(talker.convert(from, from + PART), made.ring, about);
    say($("state"), `Converting ${name}: ${Math.round(100 * from / count)} %`);
    await new Promise(resolve => setTimeout(resolve));
    if (mine !== turn) return;
  }
  add(talker.finish(), made.ring, about);
  const took = (performance.now() - begun) / 1000, samples = talker.samples();
  for (let from = 0; from < count; from += hop) made.levels.push(from, NaN, NaN, level(samples.subarray(from, from + hop)), []);
  const playing = new Playing(samples, made.rate, () => stop(`${name} has ended.`));
  await playing.start();
  if (mine !== turn) return playing.close();
  last = made.ring;
  stream = Object.assign(made, { position: () => playing.position(), close: () => playing.close() });
  state(`${name}: ${(count / made.rate).toFixed(1)} s, converted in ${took.toFixed(1)} s.`);
}

/** Draws what is due. @param {number} stamp */
function screen(stamp) {
  requestAnimationFrame(screen);
  if (!module || document.hidden) return;
  if (!stream) {
    // At rest: the mean of all mouths.
    if (view.dirty) view.draw(new Float32Array(space.size), 0);
    return;
  }
  const { ring, shown, from } = stream, position = stream.position(stamp), base = ring.find(position, stream.base);
  if (!(position >= 0) || base < 0) return;
  const part = ring.part(base, position);
  for (let k = 0; k < shown.length; k++) shown[k] = ring.parameter(base, part, k);
  stream.base = base;
  pictures++;
  view.draw(shown, from);
  plots.draw(position);
  const first = Math.max(0, ring.count - ring.capacity, base - BAR_FRAMES + 1);
  bars.slice(0, ring.visemes).forEach((bar, v) => {
    let sum = 0;
    for (let f = first; f <= base; f++) sum += ring.weight(f, v);
    bar.style.transform = `scaleX(${sum / (base - first + 1) / 255})`;
  });
}
let pictures = 0;

$("microphone").addEventListener("click", () => stream?.microphone ? stop("The microphone is off.") : listen().catch(complain));
$("example").addEventListener("click", () => play("the example", bytesOf(data.example)).catch(complain));
$("stop").addEventListener("click", () => stop("Stopped."));
$("choose").addEventListener("click", () => $("file").click());
$("file").addEventListener("change", async () => {
  const [file] = $("file").files;
  // The same file may be chosen again.
  if (file) await file.arrayBuffer().then(bytes => play(file.name, new Uint8Array(bytes))).catch(complain);
  $("file").value = "";
});

/** For tests. */
window.lipstream = {
  stats: () => ({ ready: Boolean(module), pictures, frames: last?.count ?? 0, base: stream?.base ?? -1, renderer: view.renderer, rate: stream?.microphone?.rate ?? null }),
  pixels: () => view.pixels(),
  /** Parameters and viseme weights of what began last, all of a file's and a microphone's first 1024. */
  frames() {
    const count = Math.min(last.count, last.capacity);
    return { parameters: [...last.parameters.subarray(0, count * last.size)], visemes: [...last.weights.subarray(0, count * last.visemes)] };
  },
  frameAtShown: () => stream && stream.base >= 0 ? { position: stream.position(performance.now()), parameters: [...stream.shown] } : null,
};

try {
  module = await WebAssembly.compile(bytesOf(data.module));
  view.show(space);
  for (const id of ["microphone", "example", "choose"]) $(id).disabled = false;
  state("Ready.");
} catch (error) {
  complain(new Error(`This browser cannot run the model: ${error.message}.`));
}
requestAnimationFrame(screen);
