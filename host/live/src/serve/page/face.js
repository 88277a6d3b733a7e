/**
 * The face: pictures that lipstream draws of a recording whose mouth says what is streamed. They come as JPEG, and each is shown in its own time by the clock of the
 * frames: it covers half a picture's time on either side of its sample.
 *
 * @typedef {{width: number, height: number, fps: number}} Face  what the hello says of it
 * @typedef {{sample: number, arrived: number, heard: number, bitmap: ImageBitmap}} Picture
 */

/** Pictures that wait for their time; of more the oldest are let go. */
const MOST_WAITING = 8;
/** Pictures over which the least delay is taken: a second or so. */
const LOOKS = 25;
/** By so little, in milliseconds, a picture may be late beside its sound. */
const EASY_MS = 10;

export class FaceView {
  /** @type {Face | null} */
  face = null;
  /** @type {Picture[]} in the order of their samples */
  waiting = [];
  /** The sample whose picture is on the screen. */
  sample = -Infinity;
  drawn = 0;
  late = 0;
  /** By how much the last pictures were late, the least of them, milliseconds. */
  recent = { count: 0, least: Infinity };
  /** Pictures of an earlier run are unpacked for nothing. */
  run = 0;

  /** @param {HTMLCanvasElement} canvas @param {() => void} seen called when a picture has been unpacked, so that the next may come */
  constructor(canvas, seen) {
    Object.assign(this, { canvas, seen, context: canvas.getContext("2d", { alpha: false }) });
  }

  /** A stream begins; the last picture stays until the next. @param {Face | null} face @param {number} rate samples a second */
  begin(face, rate) {
    this.run++;
    for (const { bitmap } of this.waiting) bitmap.close();
    Object.assign(this, { face, rate, waiting: [], sample: -Infinity, recent: { count: 0, least: Infinity } });
    if (!face) return;
    this.half = rate / face.fps / 2;
    const { canvas } = this;
    if (canvas.width !== face.width || canvas.height !== face.height) Object.assign(canvas, { width: face.width, height: face.height });
  }

  /** @param {import("./link.js").Head} head @param {Uint8Array} jpeg */
  async push({ sample, arrived, heard }, jpeg) {
    const { run } = this;
    let bitmap;
    try {
      bitmap = await createImageBitmap(new Blob([jpeg], { type: "image/jpeg" }));
    } catch (error) {
      console.warn(`A picture of the face cannot be unpacked: ${error.message}`);
      return;
    } finally {
      this.seen();
    }
    if (run !== this.run || sample <= this.sample) return bitmap.close();
    // Two that are unpacked at the same time may be ready in another order.
    const after = this.waiting.findLastIndex(other => other.sample < sample) + 1;
    this.waiting.splice(after, 0, { sample, arrived, heard, bitmap });
    if (this.waiting.length > MOST_WAITING) this.waiting.shift().bitmap.close();
  }

  /** Draws the last picture that is due. @param {number} position the sample that is due now @returns {Picture | null} if it is another one than before */
  draw(position) {
    let due = null;
    while (this.waiting.length && this.waiting[0].sample - this.half <= position) {
      due?.bitmap.close();
      due = this.waiting.shift();
    }
    if (!due) return null;
    this.context.drawImage(due.bitmap, 0, 0, this.canvas.width, this.canvas.height);
    due.bitmap.close();
    this.sample = due.sample;
    this.drawn++;
    if (position > due.sample + this.half) this.late++;
    this.recent.count++;
    this.recent.least = Math.min(this.recent.least, (position - due.sample + this.half) * 1000 / this.rate);
    return due;
  }

  /** By how many milliseconds everything has to wait longer, so that the pictures are beside their sound; 0 if they are. */
  takeLag() {
    const { count, least } = this.recent;
    if (count < LOOKS) return 0;
    this.recent = { count: 0, least: Infinity };
    return least > EASY_MS ? least : 0;
  }

  /** A part of the picture on the screen, as RGBA. @param {number} x @param {number} y @param {number} width @param {number} height */
  pixels(x, y, width, height) {
    return Array.from(this.context.getImageData(x, y, width, height).data);
  }
}
