/**
 * The sound, heard when the mouth of the same sample is shown.
 *
 * Every message becomes a piece for WebAudio, laid end to end with the one before. How far that end is from where the clock of the
 * frames wants it decides how fast the next piece is played: by 0.5 % at most, between samples, without a click.
 *
 * @typedef {import("./clock.js").FrameClock} FrameClock
 */
import { RecentLeast } from "./clock.js";

/** WebAudio needs a piece so long before it is heard. */
const MARGIN_S = 0.02;
/** A piece that would be off by more than this is laid where it belongs, after a pause. */
const JUMP_S = 0.08;
/** Pieces too late, not counting bursts and long ago ones, after which everything waits longer. */
const MOST_LATE = 5;
const MOST_EXTRA_MS = 600;
/** The first differences of two clocks are too great. */
const SETTLE_MS = 300;
const FADE_S = 0.004;

export class SoundPlayer {
  on = false;
  /** By how much the sound is behind the mouth, in milliseconds. */
  error = 0;
  speed = 1;
  breaks = 0;
  /** @type {AudioContext | null} */
  context = null;
  /** The sample that the next message should begin with. */
  next = NaN;
  late = 0;
  lateAt = -Infinity;
  /** By how much the least of them was late, in seconds. */
  least = Infinity;
  /** The three samples before a message, for interpolation, then its own. */
  samples = new Float32Array(3);

  /** @param {number} rate samples a second */
  constructor(rate) {
    this.rate = rate;
  }

  /** To be called after a click only: browsers play nothing before. @param {boolean} on */
  async turn(on) {
    this.on = on;
    this.next = this.since = NaN;
    // At the sound's own rate pieces meet without a seam; the browser converts the whole.
    if (on) this.context ??= new AudioContext({ sampleRate: this.rate, latencyHint: "interactive" });
    /** Page time of the context's second 0. That time advances in steps, so the least difference is right. */
    this.zero = new RecentLeast();
    await (on ? this.context.resume() : this.context?.suspend());
  }

  /** @param {Int16Array} piece @param {number} first number of its first sample @param {FrameClock} clock @param {number} now */
  push(piece, first, clock, now) {
    const { context } = this;
    if (!this.on || context?.state !== "running" || !clock.ready || !piece.length) return;
    const latency = (context.outputLatency || context.baseLatency || 0) * 1000;
    const zero = this.zero.add(now - context.currentTime * 1000, now) + latency, soonest = context.currentTime + MARGIN_S;
    if (Number.isNaN(this.since)) this.since = now;
    if (now - this.since < SETTLE_MS) return;
    // Where in this message the next output lies.
    if (first !== this.next) this.at = 0;
    const want = (clock.due(first + this.at) - zero) / 1000;
    if (first !== this.next || Math.abs(this.end - want) > JUMP_S || this.end < soonest - MARGIN_S / 2) {
      if (want < soonest) return this.drop(soonest - want, clock, now);
      this.begin(want);
    }
    this.late *= 0.995;
    this.error += 0.05 * ((this.end - want) * 1000 - this.error);
    this.speed = 1 + Math.max(-0.005, Math.min(0.005, this.error / 2000));
    this.lay(piece);
    this.next = first + piece.length;
  }

  /** A piece that comes too late is not heard. When many do, the mouth has to wait for the sound. */
  drop(short, clock, now) {
    this.next = NaN;
    this.late += Math.min(1, (now - this.lateAt) / 20);
    this.lateAt = now;
    this.least = Math.min(this.least, short);
    if (this.late < MOST_LATE) return;
    clock.extra = Math.min(MOST_EXTRA_MS, clock.extra + this.least * 1000 + 10);
    this.late = 0;
    this.least = Infinity;
  }

  /** Begins after silence. What is still laid fades away, since it may reach beyond `start`. @param {number} start */
  begin(start) {
    const { context } = this;
    this.gain?.gain.setTargetAtTime(0, context.currentTime, FADE_S / 4);
    this.gain = context.createGain();
    this.gain.connect(context.destination);
    this.end = Math.round(start * this.rate) / this.rate;
    this.gain.gain.setValueAtTime(0, 0);
    this.gain.gain.setTargetAtTime(1, this.end, FADE_S / 4);
    this.fade = Infinity;
    this.samples.fill(0);
    this.error = 0;
    this.breaks++;
  }

  /** Lays a piece at the end of what has been laid. */
  lay(piece) {
    const { context, rate, speed } = this, count = piece.length, last = this.samples.subarray(-3);
    if (this.samples.length !== count + 3) this.samples = new Float32Array(count + 3);
    const x = this.samples, length = Math.ceil((count - 2 - this.at) / speed);
    x.set(last);
    for (let k = 0; k < count; k++) x[k + 3] = piece[k] / 32768;
    if (length > 0) {
      const buffer = context.createBuffer(1, length, rate), out = buffer.getChannelData(0), source = context.createBufferSource();
      for (let k = 0; k < length; k++) {
        const at = this.at + k * speed, i = Math.floor(at) + 3, t = at + 3 - i, a = x[i - 1], b = x[i], c = x[i + 1], d = x[i + 2];
        out[k] = b + 0.5 * t * (c - a + t * (2 * a - 5 * b + 4 * c - d + t * (3 * (b - c) + d - a)));
      }
      source.buffer = buffer;
      source.connect(this.gain);
      source.start(this.end);
      this.end += length / rate;
      // Should the next piece not come, this one fades.
      this.gain.gain.cancelScheduledValues(this.fade);
      this.gain.gain.setTargetAtTime(0, this.fade = this.end - FADE_S, FADE_S / 4);
      this.at += length * speed;
    }
    this.at -= count;
  }
}
