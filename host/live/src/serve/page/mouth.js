/**
 * The mouth's picture from its parameters: mean plus eigenmouths times weights, clipped, enlarged. WebGL 2 where there is one; else
 * in plain JavaScript on a 2D canvas.
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

// The first layer is the mean, the others are eigenmouths. The target has bytes, which clip to 0..255 as the video does.
const EXPAND = size => `#version 300 es
precision highp float;
precision highp sampler2DArray;
uniform sampler2DArray layers;
uniform vec4 weights[${Math.ceil(size / 4)}];
out vec4 colour;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec3 sum = texelFetch(layers, ivec3(at, 0), 0).rgb;
  for (int k = 0; k < ${size}; k++) sum += weights[k >> 2][k & 3] * texelFetch(layers, ivec3(at, k + 1), 0).rgb;
  colour = vec4(sum / 255.0, 1.0);
}`;

// Catmull-Rom along one axis; two passes need 8 pixels where one of both axes needs 16. Pictures have their first row on
// top, WebGL's screen has it below.
const ENLARGE = `#version 300 es
precision highp float;
uniform sampler2D picture;
uniform vec2 size;
uniform int axis;
out vec4 colour;
void main() {
  ivec2 limit = textureSize(picture, 0) - 1;
  vec2 here = gl_FragCoord.xy;
  if (axis == 1) here.y = size.y - here.y;
  float place = here[axis] * float(limit[axis] + 1) / size[axis] - 0.5, t = fract(place);
  vec4 weight = vec4(((2.0 - t) * t - 1.0) * t, (3.0 * t - 5.0) * t * t + 2.0, ((4.0 - 3.0 * t) * t + 1.0) * t, (t - 1.0) * t * t);
  ivec2 at = ivec2(here);
  vec3 sum = vec3(0.0);
  for (int k = 0; k < 4; k++) {
    at[axis] = clamp(int(floor(place)) + k - 1, 0, limit[axis]);
    sum += 0.5 * weight[k] * texelFetch(picture, at, 0).rgb;
  }
  colour = vec4(sum, 1.0);
}`;

class GlPainter {
  /** @param {HTMLCanvasElement} canvas @param {MouthSpace} space */
  constructor(canvas, space) {
    const options = { alpha: false, antialias: false, depth: false, powerPreference: "low-power" };
    const gl = this.gl = canvas.getContext("webgl2", options);
    if (!gl || gl.isContextLost()) throw new Error("no WebGL 2");
    const { width, height, size } = space;
    this.canvas = canvas;
    this.space = space;
    this.unit = space.deviation.map(d => d > 0 ? d : 1);
    this.weights = new Float32Array(4 * Math.ceil(size / 4));
    this.expand = this.program(EXPAND(size));
    this.enlarge = this.program(ENLARGE);
    this.at = {
      weights: gl.getUniformLocation(this.expand, "weights"),
      size: gl.getUniformLocation(this.enlarge, "size"),
      axis: gl.getUniformLocation(this.enlarge, "axis"),
    };
    // Halves have 11 bits: times its deviation every eigenmouth uses them alike.
    const layers = new Float32Array(4 * width * height * (size + 1));
    for (let layer = 0, to = 0; layer <= size; layer++) {
      const from = layer ? space.basis.subarray((layer - 1) * space.mean.length) : space.mean;
      for (let p = 0; p < space.mean.length; p += 3, to += 4) {
        for (let c = 0; c < 3; c++) layers[to + c] = from[p + c] * (layer ? this.unit[layer - 1] : 1);
      }
    }
    this.layers = this.texture(gl.TEXTURE_2D_ARRAY);
    gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, gl.RGBA16F, width, height, size + 1, 0, gl.RGBA, gl.FLOAT, layers);
    this.native = this.target(width, height);
    this.wide = null;
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
    return program;
  }

  /** @param {number} kind */
  texture(kind) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(kind, texture);
    gl.texParameteri(kind, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(kind, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    return texture;
  }

  /** A picture to draw into. @param {number} width @param {number} height */
  target(width, height) {
    const { gl } = this, texture = this.texture(gl.TEXTURE_2D), buffer = gl.createFramebuffer();
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    return { texture, buffer, width, height };
  }

  /** @param {{texture: WebGLTexture, buffer: WebGLFramebuffer} | null} target */
  drop(target) {
    if (!target) return;
    this.gl.deleteTexture(target.texture);
    this.gl.deleteFramebuffer(target.buffer);
  }

  free() {
    this.drop(this.native);
    this.drop(this.wide);
    this.gl.deleteTexture(this.layers);
    this.gl.deleteProgram(this.expand);
    this.gl.deleteProgram(this.enlarge);
  }

  /** @param {Float32Array} parameters @param {number} from the first of the mouth's */
  draw(parameters, from) {
    const { gl, canvas, native, weights } = this;
    if (this.wide?.width !== canvas.width) {
      this.drop(this.wide);
      this.wide = this.target(canvas.width, native.height);
    }
    for (let k = 0; k < this.space.size; k++) weights[k] = (parameters[from + k] || 0) / this.unit[k];
    gl.useProgram(this.expand);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.layers);
    gl.uniform4fv(this.at.weights, weights);
    this.pass(native.buffer, native.width, native.height);
    gl.useProgram(this.enlarge);
    gl.uniform1i(this.at.axis, 0);
    gl.uniform2f(this.at.size, this.wide.width, this.wide.height);
    gl.bindTexture(gl.TEXTURE_2D, native.texture);
    this.pass(this.wide.buffer, this.wide.width, this.wide.height);
    gl.uniform1i(this.at.axis, 1);
    gl.uniform2f(this.at.size, canvas.width, canvas.height);
    gl.bindTexture(gl.TEXTURE_2D, this.wide.texture);
    this.pass(null, canvas.width, canvas.height);
  }

  /** @param {WebGLFramebuffer | null} buffer @param {number} width @param {number} height */
  pass(buffer, width, height) {
    this.gl.bindFramebuffer(this.gl.FRAMEBUFFER, buffer);
    this.gl.viewport(0, 0, width, height);
    this.gl.drawArrays(this.gl.TRIANGLES, 0, 3);
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
    this.canvas = canvas;
    this.space = space;
    this.context = canvas.getContext("2d", { alpha: false });
    this.native = document.createElement("canvas");
    this.native.width = space.width;
    this.native.height = space.height;
    this.nativeContext = this.native.getContext("2d", { willReadFrequently: true });
    this.image = this.nativeContext.createImageData(space.width, space.height);
    this.image.data.fill(255);
    this.sum = new Float32Array(space.mean.length);
  }

  free() {}

  /** @param {Float32Array} parameters @param {number} from the first of the mouth's */
  draw(parameters, from) {
    const { sum, space, canvas, context } = this, { data } = this.image, { basis } = space, pixels = sum.length;
    sum.set(space.mean);
    for (let k = 0; k < space.size; k++) {
      const weight = parameters[from + k] || 0, row = k * pixels;
      for (let p = 0; p < pixels; p++) sum[p] += weight * basis[row + p];
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
  /** @param {HTMLElement} box @param {boolean} plain whether to do without WebGL */
  constructor(box, plain) {
    this.box = box;
    this.plain = plain;
    /** @type {MouthSpace | null} */
    this.space = null;
    this.painter = null;
    /** Whether the picture has to be drawn although its parameters have not changed. */
    this.dirty = true;
    this.width = this.height = 1;
    this.gl = document.createElement("canvas");
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
    if (space && !this.plain) {
      try {
        this.painter = new GlPainter(this.gl, space);
      } catch (error) {
        console.info(`The mouth is drawn without WebGL: ${error.message}`);
      }
    }
    if (space && !this.painter) this.painter = new CanvasPainter(document.createElement("canvas"), space);
    this.box.replaceChildren(...(this.painter ? [this.painter.canvas] : []));
    this.resize();
  }

  resize() {
    if (this.painter) {
      this.painter.canvas.width = this.width;
      this.painter.canvas.height = this.height;
    }
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
