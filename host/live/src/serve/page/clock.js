/**
 * When a frame is shown. Nothing here touches the page, so that the tests can run it in Node.
 *
 * Times are milliseconds: of the page's clock (`performance.now()`) unless a name says `host`. Samples are numbers of sound
 * samples, counted by the device.
 *
 * @typedef {{median: number, worst: number, count: number}} Delays  in milliseconds; NaN where `count` is 0
 */

/** Frames further off than this from where the clock expects them mean another beginning, not jitter. */
const JUMP_MS = 200;
/** What comes in less time than this is one burst: only its end tells where the clock stands. */
const BURST_MS = 20;
/** So long after a beginning the clock believes every earlier arrival at once. */
const SETTLE_MS = 1000;
/** Crystals differ by 0.01 %; this is faster than any drift and slower than an eye notices. */
const MOST_SLEW = 0.02;

/** The least of the values of the last three seconds, kept in buckets of a quarter of one. */
export class RecentLeast {
  buckets = new Float64Array(12).fill(Infinity);
  current = -Infinity;
  value = Infinity;

  /** @param {number} value @param {number} now */
  add(value, now) {
    const count = this.buckets.length, bucket = Math.floor(now / 250);
    if (bucket > this.current) {
      for (let b = Math.max(this.current + 1, bucket - count + 1); b <= bucket; b++) this.buckets[b % count] = Infinity;
      this.current = bucket;
    }
    const at = this.current % count;
    this.buckets[at] = Math.min(this.buckets[at], value);
    return this.value = Math.min(...this.buckets);
  }
}

/** The clock of the samples: which of them is due at which moment. */
export class FrameClock {
  /** Page time of sample 0 by the frames that came soonest: jitter only ever delays. */
  offset = NaN;
  /** What the sound needs on top, so that it can be heard together with the mouth. */
  extra = 0;
  late = 0;
  resyncs = -1;
  /** Frames one after another that came much too late. */
  run = { count: 0, start: 0, least: Infinity };

  /** @param {number} rate samples a second @param {number} buffer milliseconds by which everything waits for jitter */
  constructor(rate, buffer) {
    this.rate = rate;
    this.buffer = buffer;
  }

  get ready() {
    return !Number.isNaN(this.offset);
  }

  /** When `sample` is shown and heard. @param {number} sample */
  due(sample) {
    return this.offset + sample * 1000 / this.rate + this.buffer + this.extra;
  }

  /** The sample, not a whole number, that is due at `now`. @param {number} now */
  position(now) {
    return (now - this.offset - this.buffer - this.extra) * this.rate / 1000;
  }

  /** @param {number} offset @param {number} now */
  restart(offset, now) {
    this.resyncs++;
    this.offset = offset;
    this.since = this.moved = now;
    this.run.count = 0;
    this.recent = new RecentLeast();
    this.recent.add(offset, now);
  }

  /** Learns that the frame of `sample` came at `now`. @param {number} sample @param {number} now */
  arrived(sample, now) {
    const offset = now - sample * 1000 / this.rate, behind = offset - this.offset, run = this.run;
    if (!this.ready || behind < -JUMP_MS) return this.restart(offset, now);
    if (behind > JUMP_MS) {
      // Either a burst after a stall of the line, which ends in time, or a device that rested: then the clock begins anew.
      if (run.count++ === 0) Object.assign(run, { start: now, least: Infinity });
      run.least = Math.min(run.least, offset);
      if (now - run.start >= BURST_MS) this.restart(run.least, now);
      return;
    }
    this.late += run.count + Number(now > this.due(sample));
    run.count = 0;
    const least = this.recent.add(offset, now), away = least - this.offset, step = now - this.moved;
    this.moved = now;
    if (away < 0 && now - this.since < SETTLE_MS) this.offset = least;
    else this.offset += Math.max(-MOST_SLEW, Math.min(MOST_SLEW, away / 1000)) * step;
  }
}

/** The last frames in arrays that never grow. A frame's number, counted from 0, stays the same for ever. */
export class FrameRing {
  count = 0;

  /** @param {number} size parameters @param {number} visemes @param {number} rate samples a second @param {number} hz frames a second */
  constructor(size, visemes, rate, hz, capacity = 1024) {
    Object.assign(this, { size, visemes, capacity });
    /** Samples over which two neighbours are blended; in a longer gap the mouth waits before it moves. */
    this.blend = rate * Math.max(0.1, 2.5 / hz);
    this.samples = new Float64Array(capacity);
    this.arrived = new Float64Array(capacity);
    this.heard = new Float64Array(capacity);
    this.parameters = new Float32Array(capacity * size);
    this.weights = new Uint8Array(capacity * visemes);
  }

  /** Times are the host's. @param {number} sample @param {number} arrived @param {number} heard
   *  @param {ArrayLike<number>} parameters @param {ArrayLike<number>} weights */
  push(sample, arrived, heard, parameters, weights) {
    const at = this.count++ % this.capacity;
    this.samples[at] = sample;
    this.arrived[at] = arrived;
    this.heard[at] = heard;
    this.parameters.set(parameters, at * this.size);
    this.weights.set(weights, at * this.visemes);
  }

  /** @param {number} frame */
  sample(frame) {
    return this.samples[frame % this.capacity];
  }

  /** The last frame not after `position`, or -1. @param {number} position @param {number} near where to look first */
  find(position, near) {
    const oldest = Math.max(0, this.count - this.capacity);
    let frame = Math.max(oldest, Math.min(near, this.count - 1));
    while (frame + 1 < this.count && this.sample(frame + 1) <= position) frame++;
    while (frame >= oldest && this.sample(frame) > position) frame--;
    return this.count && frame >= oldest ? frame : -1;
  }

  /** How far, 0 to 1, `position` is from `frame` to its next. @param {number} frame @param {number} position */
  part(frame, position) {
    if (frame + 1 >= this.count) return 0;
    const to = this.sample(frame + 1), from = Math.max(this.sample(frame), to - this.blend);
    return Math.max(0, Math.min(1, (position - from) / (to - from)));
  }

  /** Parameter `k` at `part` after `frame`. @param {number} frame @param {number} part @param {number} k */
  parameter(frame, part, k) {
    const a = this.parameters[frame % this.capacity * this.size + k];
    return part > 0 ? a + part * (this.parameters[(frame + 1) % this.capacity * this.size + k] - a) : a;
  }

  /** Weight of viseme `v`, 0 to 255. @param {number} frame @param {number} v */
  weight(frame, v) {
    return this.weights[frame % this.capacity * this.visemes + v];
  }
}

/** The host's clock, from pings: the quickest answer of the last sixteen is off by half its way at most. */
export class HostClock {
  ways = new Float64Array(16).fill(Infinity);
  offsets = new Float64Array(16);
  count = 0;
  offset = NaN;
  way = Infinity;

  /** @param {number} sent @param {number} host what the answer says @param {number} now */
  pong(sent, host, now) {
    const at = this.count++ % this.ways.length;
    this.ways[at] = now - sent;
    this.offsets[at] = host - (sent + now) / 2;
    this.way = Math.min(...this.ways);
    this.offset = this.offsets[this.ways.indexOf(this.way)];
  }
}

/** Delays of the last five seconds. */
export class RecentDelays {
  times = new Float64Array(1024).fill(-Infinity);
  values = new Float64Array(1024);
  sorted = new Float64Array(1024);
  added = 0;

  /** @param {number} value @param {number} now */
  add(value, now) {
    const at = this.added++ % this.times.length;
    this.times[at] = now;
    this.values[at] = value;
  }

  /** @param {number} now @returns {Delays} */
  stats(now) {
    let count = 0;
    this.times.forEach((time, at) => { if (now - time <= 5000) this.sorted[count++] = this.values[at]; });
    const sorted = this.sorted.subarray(0, count).sort();
    return { median: count ? sorted[count >> 1] : NaN, worst: count ? sorted[count - 1] : NaN, count };
  }
}
