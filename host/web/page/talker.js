/**
 * A model that runs in this page: `host/web`'s WebAssembly module, one instance for every stream of sound.
 *
 * @typedef {object} About  what the model is
 * @property {string} model
 * @property {number} parameters  of a frame
 * @property {number} visemes  of a frame; 0 where the model has none
 * @property {{name: string, size: number}[]} groups
 * @property {number} sample_rate_hz
 * @property {number} delay_samples  from the centre of a frame's window to the last sample that it waits for
 *
 * @typedef {object} Frames  as long as the next call; `[frames, parameters]`, `[frames, visemes]`, `[frames]`
 * @property {number} count
 * @property {Float32Array} parameters
 * @property {Uint8Array} visemes
 * @property {Uint32Array} centres  of the frames' windows, in samples
 */

const PROFILES = ["live", "standard", "studio"];
/** Most samples that a microphone hands over at a time. */
const MOST_AT_ONCE = 16_384;

export class Talker {
  /** @param {WebAssembly.Module} module @param {Uint8Array} tables @param {string} profile @param {number} rate samples a second of what it will hear */
  constructor(module, tables, profile, rate) {
    this.calls = new WebAssembly.Instance(module).exports;
    const at = this.keep(tables);
    this.stream = this.calls.lipstream_open(at, tables.length, PROFILES.indexOf(profile), rate);
    if (!this.stream) throw new Error(this.text());
    /** @type {About} */
    this.about = JSON.parse(this.text());
    this.ear = this.calls.lipstream_room(4 * MOST_AT_ONCE);
  }

  /** Views are made anew for every call: memory that grows leaves old ones empty. */
  get memory() {
    return this.calls.memory.buffer;
  }

  text() {
    const { calls } = this;
    return new TextDecoder().decode(new Uint8Array(this.memory, calls.lipstream_text(), calls.lipstream_text_bytes()));
  }

  /** Puts bytes into the module's memory for good. @param {Uint8Array} bytes @returns {number} */
  keep(bytes) {
    const at = this.calls.lipstream_room(bytes.length);
    new Uint8Array(this.memory, at, bytes.length).set(bytes);
    return at;
  }

  /** @param {number} count what a call gave @returns {Frames} */
  frames(count) {
    if (count < 0) throw new Error(this.text());
    const { calls, stream, memory, about } = this;
    return {
      count,
      parameters: new Float32Array(memory, calls.lipstream_parameters(stream), count * about.parameters),
      visemes: new Uint8Array(memory, calls.lipstream_visemes(stream), count * about.visemes),
      centres: new Uint32Array(memory, calls.lipstream_centres(stream), count),
    };
  }

  /** Sound of a microphone, mono, ±1. @param {Float32Array} sound @returns {Frames} */
  hear(sound) {
    if (sound.length > MOST_AT_ONCE) throw new Error(`${sound.length} samples are more than ${MOST_AT_ONCE}`);
    new Float32Array(this.memory, this.ear, sound.length).set(sound);
    return this.frames(this.calls.lipstream_hear(this.stream, this.ear, sound.length));
  }

  /** Decodes a sound file. @param {Uint8Array} file @returns {number} its samples */
  decode(file) {
    const count = this.calls.lipstream_decode(this.stream, this.keep(file), file.length);
    if (count < 0) throw new Error(this.text());
    return count;
  }

  /** Converts part of the file that was decoded. @param {number} from @param {number} to @returns {Frames} */
  convert(from, to) {
    return this.frames(this.calls.lipstream_convert(this.stream, from, to));
  }

  /** What is still owed when the sound has ended. @returns {Frames} */
  finish() {
    return this.frames(this.calls.lipstream_finish(this.stream));
  }

  /** The decoded file, or what the last piece of a microphone became; 16 kHz. */
  samples() {
    return new Int16Array(this.memory, this.calls.lipstream_samples(this.stream), this.calls.lipstream_sample_count(this.stream));
  }
}
