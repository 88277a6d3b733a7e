/**
 * The sound, heard when the mouth of the same sample is shown.
 *
 * Every message becomes a piece of sound for WebAudio, laid end to end with the one before. How far the end is from where the clock
 * of the frames wants it decides how fast the next piece is played: by 0.5 % at most, between samples, without a click.
 *
 * @typedef {import("./clock.js").FrameClock} FrameClock
 */
import { RecentLeast } from "./clock.js";

/** WebAudio needs a piece so long before it is heard. */
const MARGIN_S = 0.02;
/** A piece that would be off by more than this is laid where it belongs, after a pause. */
const JUMP_S = 0.08;
/** After so much sound without a piece in time, everything waits longer. */
const LATE_MS = 250;
const MOST_EXTRA_MS = 600;
const FADE_S = 0.004;

export class SoundPlayer {
  /** @param {number} rate samples a second */
  constructor(rate) {
    this.rate = rate;
    this.on = false;
    /** @type {AudioContext | null} */
    this.context = null;
    /** By how much the sound is behind the mouth, in milliseconds. */
    this.error = 0;
    this.speed = 1;
    this.breaks = 0;
    this.restart();
  }

  /** Forgets what has been laid: the next piece begins anew. */
  restart() {
    /** The sample that the next message should begin with. */
    this.next = NaN;
    this.lateSince = NaN;
  }

  /** Only after a click: browsers play nothing before. @param {boolean} on */
  async turn(on) {
    this.on = on;
    this.restart();
    if (!this.context) {
      // At the sound's own rate pieces meet without a seam; the browser converts the whole.
      this.context = new AudioContext({ sampleRate: this.rate, latencyHint: "interactive" });
      this.gain = this.context.createGain();
      this.gain.connect(this.context.destination);
      /** The three samples before a message, for interpolation, then its own. */
      this.samples = new Float32Array(3);
    }
    /** Page time of the context's second 0: the context's time advances in steps, so the least difference is right. */
    this.zero = new RecentLeast();
    this.onSince = NaN;
    await (on ? this.context.resume() : this.context.suspend());
  }

  /** @param {Int16Array} piece @param {number} first number of its first sample @param {FrameClock} clock @param {number} now */
  push(piece, first, clock, now) {
    const { context, rate } = this, count = piece.length;
    if (!this.on || context?.state !== "running" || !clock.ready || !count) return;
    const latency = (context.outputLatency || context.baseLatency || 0) * 1000;
    const zero = this.zero.add(now - context.currentTime * 1000, now) + latency;
    if (Number.isNaN(this.onSince)) this.onSince = now;
    // The first differences are too great.
    if (now - this.onSince < 300) return;

    let anew = first !== this.next;
    if (anew) {
      this.samples.fill(0);
      /** Where in this message the next output lies. */
      this.at = 0;
    }
    const want = (clock.due(first + this.at) - zero) / 1000;
    if (!anew && (Math.abs(this.end - want) > JUMP_S || this.end < context.currentTime + MARGIN_S / 2)) anew = true;
    if (anew) {
      const short = context.currentTime + MARGIN_S - want;
      if (short > 0) {
        // One piece too late is dropped. When all are, the mouth has to wait for the sound.
        if (Number.isNaN(this.lateSince)) {
          this.lateSince = now;
          this.least = Infinity;
        }
        this.least = Math.min(this.least, short);
        if (now - this.lateSince > LATE_MS) {
          clock.extra = Math.min(MOST_EXTRA_MS, clock.extra + this.least * 1000 + 10);
          this.lateSince = NaN;
        }
        this.next = NaN;
        return;
      }
      this.breaks++;
      this.end = Math.round(want * rate) / rate;
      this.error = 0;
    }
    this.lateSince = NaN;
    this.error += 0.05 * ((this.end - want) * 1000 - this.error);
    this.speed = 1 + Math.max(-0.005, Math.min(0.005, this.error / 2000));
    this.lay(piece, anew);
    this.next = first + count;
  }

  /** @param {Int16Array} piece @param {boolean} anew whether it follows silence */
  lay(piece, anew) {
    const { context, rate, speed } = this, count = piece.length, gain = this.gain.gain;
    if (this.samples.length !== count + 3) {
      const before = this.samples.slice(-3);
      this.samples = new Float32Array(count + 3);
      this.samples.set(before, count);
    }
    const x = this.samples;
    x.copyWithin(0, count);
    for (let k = 0; k < count; k++) x[k + 3] = piece[k] / 32768;
    const length = Math.ceil((count - 2 - this.at) / speed);
    if (length > 0) {
      const buffer = context.createBuffer(1, length, rate), out = buffer.getChannelData(0);
      for (let k = 0; k < length; k++) {
        const at = this.at + k * speed, whole = Math.floor(at), t = at - whole, i = whole + 3;
        const a = x[i - 1], b = x[i], c = x[i + 1], d = x[i + 2];
        out[k] = b + 0.5 * t * (c - a + t * (2 * a - 5 * b + 4 * c - d + t * (3 * (b - c) + d - a)));
      }
      const source = context.createBufferSource();
      source.buffer = buffer;
      source.connect(this.gain);
      source.start(this.end);
      if (anew) {
        gain.setValueAtTime(0, this.end);
        gain.setTargetAtTime(1, this.end, FADE_S / 4);
      } else {
        gain.cancelScheduledValues(this.fade);
      }
      this.end += length / rate;
      // Should the next piece not come, this one fades.
      this.fade = this.end - FADE_S;
      gain.setTargetAtTime(0, this.fade, FADE_S / 4);
      this.at += length * speed;
    }
    this.at -= count;
  }
}
