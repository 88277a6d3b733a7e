/**
 * Where sound comes from: a microphone as it hears, or a decoded file that is played.
 */

/** Runs in the sound's own thread: averages the channels and hands over pieces of about 10 ms. */
const EAR = `
registerProcessor("ear", class extends AudioWorkletProcessor {
  constructor() {
    super();
    this.piece = new Float32Array(Math.ceil(sampleRate / 100));
    this.filled = 0;
  }
  process([channels]) {
    const count = channels.length ? channels[0].length : 0;
    for (let k = 0; k < count; k++) {
      let sum = 0;
      for (const channel of channels) sum += channel[k];
      this.piece[this.filled++] = sum / channels.length;
      if (this.filled === this.piece.length) {
        this.port.postMessage(this.piece);
        this.filled = 0;
      }
    }
    return true;
  }
});`;

/** What a browser's refusal means for the person in front of it. */
const REFUSALS = {
  NotAllowedError: "The microphone was refused. Allow it for this page (the browser has a sign for it beside the address), then press Microphone again.",
  NotFoundError: "There is no microphone: connect one, or choose a sound file.",
  NotReadableError: "The microphone cannot be opened: another program may be using it.",
  OverconstrainedError: "There is no microphone that this page can use: choose a sound file.",
};

export class Microphone {
  /**
   * Asks for a microphone; `hear` gets its pieces, `gone` is called when it is taken away.
   * @param {(sound: Float32Array) => void} hear @param {() => void} gone
   */
  static async open(hear, gone) {
    if (!navigator.mediaDevices?.getUserMedia || !window.AudioWorkletNode) {
      throw new Error("This browser lets no page under this address hear a microphone: open it over https, from localhost or as a file.");
    }
    // What makes a voice pleasant for a telephone takes away what the model listens for.
    const audio = { channelCount: 1, echoCancellation: false, noiseSuppression: false, autoGainControl: false };
    let tracks;
    try {
      tracks = await navigator.mediaDevices.getUserMedia({ audio });
    } catch (error) {
      throw new Error(REFUSALS[error.name] ?? `The microphone cannot be opened (${error.name}: ${error.message}).`);
    }
    const microphone = new Microphone();
    microphone.tracks = tracks;
    microphone.hear = hear;
    for (const track of tracks.getTracks()) track.addEventListener("ended", gone);
    try {
      await microphone.connect();
    } catch (error) {
      microphone.close();
      throw error;
    }
    return microphone;
  }

  /** Samples a second. */
  get rate() {
    return this.context.sampleRate;
  }

  async connect() {
    const context = this.context = new AudioContext({ latencyHint: "interactive" });
    // Of a page that was opened as a file, Chromium loads no other kind of address here.
    await context.audioWorklet.addModule(`data:text/javascript;base64,${btoa(EAR)}`);
    await context.resume();
  }

  /** Pieces come from now on. */
  listen() {
    const { context } = this;
    this.node = new AudioWorkletNode(context, "ear", { numberOfOutputs: 0 });
    this.node.port.onmessage = ({ data }) => this.hear(data);
    context.createMediaStreamSource(this.tracks).connect(this.node);
  }

  close() {
    if (this.node) this.node.port.onmessage = null;
    for (const track of this.tracks.getTracks()) track.stop();
    this.context?.close();
  }
}

/** A sound that is heard from its beginning. */
export class Playing {
  /** @param {Int16Array} samples @param {number} rate @param {() => void} ended */
  constructor(samples, rate, ended) {
    const context = this.context = new AudioContext({ latencyHint: "interactive" });
    const buffer = context.createBuffer(1, samples.length, rate), sound = buffer.getChannelData(0);
    for (let k = 0; k < samples.length; k++) sound[k] = samples[k] / 32768;
    Object.assign(this, { rate, source: context.createBufferSource(), begun: NaN });
    this.source.buffer = buffer;
    this.source.connect(context.destination);
    this.source.onended = ended;
  }

  async start() {
    await this.context.resume();
    this.begun = this.context.currentTime + 0.05;
    this.source.start(this.begun);
  }

  /** The sample that is heard now, by the sound card's own clock. */
  position() {
    const { context } = this;
    return (context.currentTime - (context.outputLatency || context.baseLatency || 0) - this.begun) * this.rate;
  }

  close() {
    this.source.onended = null;
    this.context.close();
  }
}
