/**
 * The connection to `lipstream view`: opens itself again, keeps the host's clock, takes messages apart.
 *
 * @typedef {{count: number, visemes: number, sequence: number, sample: number, arrived: number, heard: number}} Head
 * @typedef {object} Listener
 * @property {(message: object) => void} text  a JSON message
 * @property {(head: Head, parameters: Float32Array, weights: Uint8Array, now: number) => void} frame
 * @property {(head: Head, samples: Int16Array, now: number) => void} sound
 * @property {(head: Head, jpeg: Uint8Array, now: number) => void} picture
 */
import { HostClock } from "./clock.js";

const HEAD_BYTES = 32;
const PING_MS = 1000;
/** A server answers pings: one that says nothing for so long is gone, whatever the socket believes. */
const SILENCE_MS = 5000;

/** A path of the server with the token that this page was opened with. @param {string} path */
export function address(path) {
  const url = new URL(path, location.href), token = new URLSearchParams(location.search).get("token");
  if (token !== null) url.searchParams.set("token", token);
  return url;
}

export class Link {
  host = new HostClock();
  connected = false;
  /** When the next try begins, while there is no connection. */
  retryAt = 0;
  tries = 0;
  /** One object for all messages, since more than a hundred come every second. @type {Head} */
  head = { count: 0, visemes: 0, sequence: 0, sample: 0, arrived: 0, heard: 0 };

  /** @param {Listener} listener */
  constructor(listener) {
    this.listener = listener;
    setInterval(() => this.check(), PING_MS);
    this.open();
  }

  open() {
    const url = address("/live?as=binary");
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    const socket = this.socket = new WebSocket(url);
    this.heardAt = performance.now();
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.connected = true;
      this.host = new HostClock();
      // The first answers may be slow ones: a few in a row find a quick one.
      for (let k = 0; k < 5; k++) setTimeout(() => this.ping(), k * 100);
    };
    socket.onmessage = ({ data }) => {
      this.heardAt = performance.now();
      this.tries = 0;
      if (typeof data === "string") this.text(JSON.parse(data), this.heardAt);
      else if (data.byteLength >= HEAD_BYTES) this.binary(data, this.heardAt);
    };
    socket.onclose = () => this.lost();
  }

  lost() {
    // A dead socket closes late: what it says then is no news.
    this.socket.onclose = this.socket.onmessage = this.socket.onopen = null;
    this.socket.close();
    this.connected = false;
    const wait = Math.min(10_000, 500 * 2 ** this.tries++) * (0.75 + Math.random() / 2);
    this.retryAt = performance.now() + wait;
    setTimeout(() => this.open(), wait);
  }

  check() {
    const silent = performance.now() - this.heardAt > SILENCE_MS;
    if (silent && this.socket.onclose) this.lost();
    else this.ping();
  }

  ping() {
    this.send({ type: "ping", t: performance.now() });
  }

  /** @param {object} message */
  send(message) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  /** @param {object} message @param {number} now */
  text(message, now) {
    if (message.type === "pong") this.host.pong(message.t, message.now_ms, now);
    else this.listener.text(message);
  }

  /** @param {ArrayBuffer} bytes @param {number} now */
  binary(bytes, now) {
    const view = new DataView(bytes), kind = view.getUint8(0), { head, listener } = this, size = bytes.byteLength - HEAD_BYTES;
    const count = head.count = view.getUint16(2, true), visemes = head.visemes = view.getUint8(1);
    head.sequence = view.getUint32(4, true);
    head.sample = view.getFloat64(8, true);
    head.arrived = view.getFloat64(16, true);
    head.heard = view.getFloat64(24, true);
    // Every machine with a browser stores numbers low byte first, as the messages do.
    if (kind === 1 && size >= 4 * count + visemes) {
      listener.frame(head, new Float32Array(bytes, HEAD_BYTES, count), new Uint8Array(bytes, HEAD_BYTES + 4 * count, visemes), now);
    } else if (kind === 2 && size >= 2 * count) {
      listener.sound(head, new Int16Array(bytes, HEAD_BYTES, count), now);
    } else if (kind === 3) {
      listener.picture(head, new Uint8Array(bytes, HEAD_BYTES), now);
    }
  }
}
