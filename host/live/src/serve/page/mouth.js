/**
 * The mouth's picture from its parameters: mean plus eigenmouths times weights, clipped, enlarged. WebGL 2 where a graphics card
 * draws it; else in plain JavaScript on a 2D canvas.
 *
 * @typedef {object} MouthSpace
 * @property {number} width  pixels
 * @property {number} height
 * @property {number} size  eigenmouths
 * @property {number[]} deviation  of each weight
 * @property {Float32Array} mean  rows of red, green, blue in 0..255
 * @property {Float32Array} basis  one picture for each eigenmouth
 */

/** Wider pictures than this cost time and show no more. */
const MAX_WIDTH = 1600;

/** Reads what the server sends at `/mouth`. @param {ArrayBuffer} bytes @returns {MouthSpace} */
export function parseMouth(bytes) {
  const length = new DataView(bytes).getUint32(0, true);
  const about = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length)));
  const { width, height, size, deviation } = about, pixels = width * height * 3, from = Math.ceil((4 + length) / 4) * 4;
  if (!(pixels > 0) || deviation.length !== size || bytes.byteLength !== from + 4 * pixels * (1 + size)) {
    throw new Error(`the mouth's ${bytes.byteLength} bytes are not ${size} eigenmouths of ${width}×${height} pixels`);
  }
  const mean = new Float32Array(bytes, from, pixels), basis = new Float32Array(bytes, from + 4 * pixels, size * pixels);
  return { width, height, size, deviation, mean, basis };
}

// One triangle that covers everything.
const VERTICES = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;

// The first layer is the mean, the others are eigenmouths, four at a time. The target has bytes, which clip to 0..255 as the
// video does.
const EXPAND = quads => `#version 300 es
precision highp float;
precision highp sampler2DArray;
uniform sampler2DArray layers;
uniform vec4 weights[${quads}];
out vec4 colour;
ivec2 at;
vec3 layer(int k) { return texelFetch(layers, ivec3(at, k), 0).rgb; }
void main() {
  at = ivec2(gl_FragCoord.xy);
  vec3 sum = layer(0);
  for (int q = 0, k = 1; q < ${quads}; q++, k += 4) {
    vec4 w = weights[q];
    sum += w.x * layer(k) + w.y * layer(k + 1) + w.z * layer(k + 2) + w.w * layer(k + 3);
  }
  colour = vec4(sum / 255.0, 1.0);
}`;

// Catmull-Rom along one axis: two passes need 8 pixels where one of both axes needs 16. Pictures have their first row on top,
// WebGL's screen has it below. Nothing is indexed by a variable, which is slow without a graphics card.
const ENLARGE = `#version 300 es
precision highp float;
uniform sampler2D picture;
uniform vec2 size;
uniform ivec2 axis;
out vec4 colour;
ivec2 across;
int cell, last;
vec3 pixel(int k) { return texelFetch(picture, across + axis * clamp(cell + k, 0, last), 0).rgb; }
void main() {
  vec2 here = vec2(gl_FragCoord.x, axis.y == 1 ? size.y - gl_FragCoord.y : gl_FragCoord.y);
  ivec2 from = textureSize(picture, 0);
  across = ivec2(here) * axis.yx;
  float place = dot(here * vec2(from) / size, vec2(axis)) - 0.5, t = fract(place);
  cell = int(floor(place));
  last = (axis.x == 1 ? from.x : from.y) - 1;
  colour = vec4(0.5 * (((2.0 - t) * t - 1.0) * t * pixel(-1) + ((3.0 * t - 5.0) * t * t + 2.0) * pixel(0)
    + ((4.0 - 3.0 * t) * t + 1.0) * t * pixel(1) + (t - 1.0) * t * t * pixel(2)), 1.0);
}`;

/** What WebGL calls itself where the processor draws: several times slower than adding up the picture in JavaScript. */
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** @param {WebGL2RenderingContext} gl */
function isSoftware(gl) {
  const about = gl.getExtension("WEBGL_debug_renderer_info");
  return SOFTWARE.test(String(gl.getParameter(about ? about.UNMASKED_RENDERER_WEBGL : gl.RENDERER)));
}

class GlPainter {
  /** What has to be given back. @type {(() => void)[]} */
  made = [];

  /** @param {HTMLCanvasElement} canvas @param {MouthSpace} space @param {boolean} anyhow also where the processor draws */
  constructor(canvas, space, anyhow) {
    const options = { alpha: false, antialias: false, depth: false, powerPreference: "low-power", failIfMajorPerformanceCaveat: !anyhow };
    const gl = this.gl = canvas.getContext("webgl2", options);
    if (!gl || gl.isContextLost()) throw new Error("there is no WebGL 2");
    // Not every browser that is asked to refuse does.
    if (!anyhow && isSoftware(gl)) throw new Error("the processor would have to play the graphics card");
    const { width, height, size, mean, basis, deviation } = space, quads = Math.ceil(size / 4);
    Object.assign(this, { canvas, size, wide: null, weights: new Float32Array(4 * quads), unit: deviation.map(d => d > 0 ? d : 1) });
    this.expand = this.program(EXPAND(quads));
    this.enlarge = this.program(ENLARGE);
    this.atWeights = gl.getUniformLocation(this.expand, "weights");
    this.atSize = gl.getUniformLocation(this.enlarge, "size");
    this.atAxis = gl.getUniformLocation(this.enlarge, "axis");
    // Halves have 11 bits: times its deviation every eigenmouth uses them alike.
    const layers = new Float32Array(4 * width * height * (4 * quads + 1));
    for (let layer = 0, to = 0; layer <= size; layer++) {
      const from = layer ? basis.subarray((layer - 1) * mean.length) : mean, times = layer ? this.unit[layer - 1] : 1;
      for (let p = 0; p < mean.length; p += 3, to += 4) for (let c = 0; c < 3; c++) layers[to + c] = from[p + c] * times;
    }
    this.layers = this.texture(gl.TEXTURE_2D_ARRAY);
    gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, gl.RGBA16F, width, height, 4 * quads + 1, 0, gl.RGBA, gl.FLOAT, layers);
    this.native = this.target(width, height);
    if (gl.getError() !== gl.NO_ERROR) throw new Error("WebGL 2 cannot hold the mouth");
  }

  /** @param {string} fragments */
  program(fragments) {
    const { gl } = this, program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTICES], [gl.FRAGMENT_SHADER, fragments]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      gl.deleteShader(shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(`WebGL 2: ${gl.getProgramInfoLog(program)}`);
    this.made.push(() => gl.deleteProgram(program));
    return program;
  }

  /** @param {number} kind */
  texture(kind) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(kind, texture);
    gl.texParameteri(kind, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(kind, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    this.made.push(() => gl.deleteTexture(texture));
    return texture;
  }

  /** Something to draw a picture into. @param {number} width @param {number} height */
  target(width, height) {
    const { gl } = this, texture = this.texture(gl.TEXTURE_2D), buffer = gl.createFramebuffer();
    this.made.push(() => gl.deleteFramebuffer(buffer));
    gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    return this.resized({ texture, buffer, width, height }, width, height);
  }

  /** @param {ReturnType<GlPainter["target"]>} target @param {number} width @param {number} height */
  resized(target, width, height) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, target.texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
    return Object.assign(target, { width, height });
  }

  free() {
    for (const give of this.made) give();
  }

  /** @param {Float32Array} parameters @param {number} from the first of the mouth's */
  draw(parameters, from) {
    const { gl, canvas, native, weights, unit } = this, wide = this.wide ??= this.target(canvas.width, native.height);
    if (wide.width !== canvas.width) this.resized(wide, canvas.width, native.height);
    for (let k = 0; k < this.size; k++) weights[k] = (parameters[from + k] || 0) / unit[k];
    gl.useProgram(this.expand);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.layers);
    gl.uniform4fv(this.atWeights, weights);
    this.pass(native.buffer, native.width, native.height);
    gl.useProgram(this.enlarge);
    gl.uniform2i(this.atAxis, 1, 0);
    gl.uniform2f(this.atSize, wide.width, wide.height);
    gl.bindTexture(gl.TEXTURE_2D, native.texture);
    this.pass(wide.buffer, wide.width, wide.height);
    gl.uniform2i(this.atAxis, 0, 1);
    gl.uniform2f(this.atSize, canvas.width, canvas.height);
    gl.bindTexture(gl.TEXTURE_2D, wide.texture);
    this.pass(null, canvas.width, canvas.height);
  }

  /** @param {WebGLFramebuffer | null} buffer @param {number} width @param {number} height */
  pass(buffer, width, height) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
    gl.viewport(0, 0, width, height);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  pixels() {
    const { gl, native } = this, bytes = new Uint8Array(4 * native.width * native.height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, native.buffer);
    gl.readPixels(0, 0, native.width, native.height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    return bytes;
  }
}

class CanvasPainter {
  /** @param {HTMLCanvasElement} canvas @param {MouthSpace} space */
  constructor(canvas, space) {
    const native = document.createElement("canvas"), context = canvas.getContext("2d", { alpha: false });
    Object.assign(this, { canvas, context, space, native, sum: new Float32Array(space.mean.length) });
    native.width = space.width;
    native.height = space.height;
    this.nativeContext = native.getContext("2d");
    this.image = this.nativeContext.createImageData(space.width, space.height);
    this.image.data.fill(255);
  }

  free() {}

  /** @param {Float32Array} parameters @param {number} from the first of the mouth's */
  draw(parameters, from) {
    const { sum, space, canvas, context } = this, { data } = this.image, { basis } = space, pixels = sum.length;
    sum.set(space.mean);
    // Two eigenmouths at a time, since reading and writing the sum is half of the work.
    for (let k = 0; k < space.size; k += 2) {
      const a = parameters[from + k] || 0, rowA = k * pixels, two = k + 1 < space.size;
      const b = two && parameters[from + k + 1] || 0, rowB = two ? rowA + pixels : rowA;
      for (let p = 0; p < pixels; p++) sum[p] += a * basis[rowA + p] + b * basis[rowB + p];
    }
    // The image's array rounds and clips by itself.
    for (let p = 0, q = 0; p < pixels; p += 3, q += 4) {
      data[q] = sum[p];
      data[q + 1] = sum[p + 1];
      data[q + 2] = sum[p + 2];
    }
    this.nativeContext.putImageData(this.image, 0, 0);
    context.imageSmoothingQuality = "high";
    context.drawImage(this.native, 0, 0, canvas.width, canvas.height);
  }

  pixels() {
    return this.image.data;
  }
}

/** The box on the page with the mouth in it. */
export class MouthView {
  /** @type {MouthSpace | null} */
  space = null;
  /** @type {GlPainter | CanvasPainter | null} */
  painter = null;
  /** Whether the picture has to be drawn although its parameters have not changed. */
  dirty = true;
  width = 1;
  height = 1;
  /** A canvas is for WebGL or for 2D for ever: this one is kept for when a lost context comes back. */
  gl = document.createElement("canvas");

  /** @param {HTMLElement} box @param {"canvas" | "webgl" | null} by what draws; null chooses by what there is */
  constructor(box, by) {
    this.box = box;
    this.by = by;
    this.gl.addEventListener("webglcontextlost", event => {
      // Without this the browser would not give the context back.
      event.preventDefault();
      this.build();
    });
    this.gl.addEventListener("webglcontextrestored", () => this.build());
    const observer = new ResizeObserver(([entry]) => {
      const exact = entry.devicePixelContentBoxSize?.[0], scale = exact ? 1 : devicePixelRatio;
      const { inlineSize, blockSize } = exact ?? entry.contentBoxSize[0];
      const shrink = Math.min(1, MAX_WIDTH / (inlineSize * scale));
      this.width = Math.max(1, Math.round(inlineSize * scale * shrink));
      this.height = Math.max(1, Math.round(blockSize * scale * shrink));
      this.resize();
    });
    try {
      observer.observe(box, { box: "device-pixel-content-box" });
    } catch {
      observer.observe(box);
    }
  }

  get renderer() {
    return this.painter instanceof GlPainter ? "webgl" : "canvas";
  }

  /** @param {MouthSpace | null} space */
  show(space) {
    this.space = space;
    if (space) this.box.style.aspectRatio = `${space.width} / ${space.height}`;
    this.build();
  }

  build() {
    this.painter?.free();
    this.painter = null;
    const { space } = this;
    if (space && this.by !== "canvas") {
      try {
        this.painter = new GlPainter(this.gl, space, this.by === "webgl");
      } catch (error) {
        console.info(`The mouth is drawn without WebGL: ${error.message}`);
      }
    }
    if (space && !this.painter) this.painter = new CanvasPainter(document.createElement("canvas"), space);
    this.box.replaceChildren(...this.painter ? [this.painter.canvas] : []);
    this.resize();
  }

  resize() {
    if (this.painter) Object.assign(this.painter.canvas, { width: this.width, height: this.height });
    this.dirty = true;
  }

  /** @param {Float32Array} parameters @param {number} from the first of the mouth's */
  draw(parameters, from) {
    this.painter?.draw(parameters, from);
    this.dirty = false;
  }

  /** The picture at its own size, as RGBA. @returns {number[]} */
  pixels() {
    return Array.from(this.painter?.pixels() ?? []);
  }
}
