/**
 * The last seconds as running plots on one canvas: visemes, the first parameters, the level of the sound.
 *
 * A column of pixels is painted once, when its time has come, into a strip that runs in a circle; a picture copies the strip.
 *
 * @typedef {import("./clock.js").FrameRing} FrameRing
 * @typedef {object} Tracks
 * @property {FrameRing} frames
 * @property {FrameRing | null} levels  of the sound, 0 to 1
 * @property {string[]} names  of the first parameters
 * @property {ArrayLike<number>} units  what counts as one deviation of each
 * @property {number} rate  samples a second
 */

const SECONDS = 5;
const LEFT = 84;
const GAP = 10;
/** Deviations from the middle of a row to its edge. */
const REACH = 3;
/** Rest is grey, vowels are warm, consonants cold, in the order of X&L table 1. */
const COLOURS = ["#8a857d", "#c8452f", "#ee7f2d", "#e8b62f", "#d9709f", "#9aa524", "#57a639", "#1f9e76", "#22a7b8", "#2f6fd0", "#6a5ad6",
  "#a25bc9", "#7f5f45"];

/** @param {number} viseme */
export const colourOf = viseme => COLOURS[viseme % COLOURS.length];

/** The place in a circle of `count`. @param {number} column @param {number} count */
const around = (column, count) => ((column % count) + count) % count;

export class Plots {
  /** @type {Tracks | null} */
  tracks = null;
  strip = document.createElement("canvas");
  ink = this.strip.getContext("2d");

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    new ResizeObserver(() => this.fit()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.fit());
  }

  /** @param {Tracks} tracks */
  show(tracks) {
    this.tracks = tracks;
    this.fit();
  }

  /** Lays out the rows and begins the strip anew. */
  fit() {
    const { canvas, context, tracks } = this, scale = this.scale = devicePixelRatio || 1;
    if (!tracks) return;
    canvas.width = Math.max(1, Math.round(canvas.clientWidth * scale));
    canvas.height = this.strip.height = Math.max(1, Math.round(canvas.clientHeight * scale));
    this.left = Math.round(LEFT * scale);
    this.width = this.strip.width = Math.max(1, canvas.width - this.left);
    /** The column painted last, counted from sample 0. */
    this.painted = NaN;
    this.known = this.near = this.nearLevel = 0;
    this.newest = Infinity;

    const style = getComputedStyle(canvas), colour = name => style.getPropertyValue(name).trim();
    [this.trace, this.wave, this.line] = ["--bar", "--wave", "--line"].map(colour);
    // The visemes' row is as tall as two others.
    const rows = tracks.names.length + (tracks.frames.visemes ? 2 : 0) + (tracks.levels ? 1 : 0);
    const unit = (canvas.height - GAP * scale * 2) / Math.max(1, rows);
    Object.assign(context, { font: `${12 * scale}px system-ui, sans-serif`, textBaseline: "middle", textAlign: "right" });
    context.fillStyle = colour("--faint");
    let y = 0;
    const row = (words, height) => {
      context.fillText(words, this.left - 8 * scale, y + height / 2, this.left - 10 * scale);
      y += height;
      return { from: y - height, height };
    };
    this.visemes = tracks.frames.visemes ? row("visemes", 2 * unit) : null;
    y += GAP * scale;
    this.rows = tracks.names.map(name => row(name, unit));
    y += GAP * scale;
    this.level = tracks.levels ? row("sound", unit) : null;
  }

  /** @param {number} position the sample that is on the screen */
  draw(position) {
    const { tracks, context, strip, left, width } = this;
    if (!tracks) return;
    const { frames } = tracks, step = SECONDS * tracks.rate / width, column = Math.floor(position / step);
    // Columns painted before their frames came are painted again.
    if (frames.count > this.known) {
      this.painted = Math.min(this.painted, Math.floor(this.newest / step));
      this.known = frames.count;
      this.newest = frames.sample(frames.count - 1);
    }
    // Time that went back or far ahead: the whole strip is another.
    if (!(column >= this.painted && column < this.painted + width)) {
      this.painted = column - width;
      this.near = this.nearLevel = 0;
    }
    while (this.painted < column) this.paint(++this.painted, step);
    const seam = around(column + 1, width);
    context.clearRect(left, 0, width, strip.height);
    context.drawImage(strip, seam, 0, width - seam, strip.height, left, 0, width - seam, strip.height);
    if (seam) context.drawImage(strip, 0, 0, seam, strip.height, left + width - seam, 0, seam, strip.height);
  }

  /** @param {number} column @param {number} step samples a column */
  paint(column, step) {
    const { ink, scale } = this, { frames, levels, units } = this.tracks, x = around(column, this.width), at = column * step;
    ink.clearRect(x, 0, 1, this.strip.height);
    ink.fillStyle = this.line;
    for (const { from, height } of this.rows) ink.fillRect(x, from + height / 2, 1, scale);
    const near = frames.find(at, this.near);
    if (near >= 0 && at - frames.sample(near) < frames.blend) {
      this.near = near;
      this.paintVisemes(x, near);
      const part = frames.part(near, at), before = Math.max(0, frames.find(at - step, near)), partBefore = frames.part(before, at - step);
      ink.fillStyle = this.trace;
      for (let k = 0; k < this.rows.length; k++) {
        const { from, height } = this.rows[k], scaled = 1 / (REACH * (units[k] || 1));
        const a = Math.max(-1, Math.min(1, frames.parameter(before, partBefore, k) * scaled));
        const b = Math.max(-1, Math.min(1, frames.parameter(near, part, k) * scaled));
        ink.fillRect(x, from + height / 2 * (1 - Math.max(a, b)) - 0.7 * scale, 1, height / 2 * Math.abs(a - b) + 1.4 * scale);
      }
    }
    const nearLevel = levels ? levels.find(at, this.nearLevel) : -1;
    if (nearLevel >= 0 && at - levels.sample(nearLevel) < levels.blend) {
      this.nearLevel = nearLevel;
      const { from, height } = this.level, tall = Math.max(scale, height * levels.parameter(nearLevel, 0, 0));
      ink.fillStyle = this.wave;
      ink.fillRect(x, from + (height - tall) / 2, 1, tall);
    }
  }

  /** The visemes' shares of one column. @param {number} x @param {number} frame */
  paintVisemes(x, frame) {
    const { frames } = this.tracks;
    let sum = 0;
    for (let v = 0; v < frames.visemes; v++) sum += frames.weight(frame, v);
    for (let v = 0, y = 0; sum && v < frames.visemes; v++) {
      const height = frames.weight(frame, v) / sum * this.visemes.height;
      this.ink.fillStyle = colourOf(v);
      if (height) this.ink.fillRect(x, this.visemes.from + y, 1, height);
      y += height;
    }
  }
}
