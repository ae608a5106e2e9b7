// Hands in WebGL, seen from where the camera stood, or from any side.

const VERTEX_SHADER = `
attribute vec3 place, normal;
attribute float finger;
uniform mat4 clip_from_world;
uniform mat3 view_from_world;
varying vec3 view_normal;
varying float digit;
void main() {
  view_normal = view_from_world * normal;
  digit = finger;
  gl_Position = clip_from_world * vec4(place, 1.0);
}`;

const FRAGMENT_SHADER = `
precision mediump float;
uniform vec3 colour;
uniform float quality[6];
uniform float determined;
uniform bool is_second;
varying vec3 view_normal;
varying float digit;
void main() {
  if (is_second && mod(floor(gl_FragCoord.x) + floor(gl_FragCoord.y), 2.0) < 0.5) discard; // the first one shows through
  vec3 n = normalize(view_normal);
  float light = 0.42 + 0.48 * max(0.0, dot(n, vec3(-0.35, -0.55, -0.76))) + 0.16 * abs(n.z);
  float q = 1.0;
  for (int i = 0; i < 6; i++) if (abs(digit - float(i)) < 0.5) q = quality[i];
  vec3 shown = colour;
  if (q < determined) {
    float stripe = step(0.5, fract((gl_FragCoord.x + gl_FragCoord.y) / 9.0));
    shown = mix(vec3(0.56), vec3(0.82), stripe);
  }
  gl_FragColor = vec4(shown * light, 1.0);
}`;

// A fingertip's band as a disc with a rim: the outline of a ball.
const DISC_VERTEX_SHADER = `
attribute vec3 place;
attribute float radius;
uniform mat4 clip_from_world;
uniform float pixels;
void main() {
  gl_Position = clip_from_world * vec4(place, 1.0);
  gl_PointSize = max(3.0, 2.0 * radius * pixels / gl_Position.w);
}`;

const DISC_FRAGMENT_SHADER = `
precision mediump float;
uniform vec3 colour;
void main() {
  float r = 2.0 * length(gl_PointCoord - 0.5);
  if (r > 1.0) discard;
  gl_FragColor = vec4(colour, r > 0.9 ? 0.75 : 0.16);
}`;

const FIELD = 0.5; // vertical field of view, radians
const HOME = { camera: [0, 0], side: [Math.PI / 2, 0], top: [0, Math.PI / 2] }; // yaw and pitch
const SKIN = [[0.83, 0.62, 0.51], [0.33, 0.55, 0.85], [0.91, 0.56, 0.27]]; // of one hand; of A and of B

function compiled(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}

class Scene {
  // hands: of class Hand. Throws where the browser has no WebGL.
  constructor(canvas, hands) {
    this.canvas = canvas;
    this.hands = hands;
    this.isShown = hands.map(() => false);
    this.rows = hands.map(() => -1);
    this.turn = [...HOME.camera];
    this.zoom = 1;
    this.hasTips = true;
    this.gl = canvas.getContext("webgl", { antialias: true });
    if (!this.gl) throw new Error("WebGL is not to be had");
    const gl = this.gl;
    this.program = compiled(gl, VERTEX_SHADER, FRAGMENT_SHADER);
    this.discs = compiled(gl, DISC_VERTEX_SHADER, DISC_FRAGMENT_SHADER);
    this.buffers = hands.map((hand) => {
      const buffers = { place: gl.createBuffer(), normal: gl.createBuffer(), finger: gl.createBuffer(), faces: gl.createBuffer(), tips: gl.createBuffer() };
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers.finger);
      gl.bufferData(gl.ARRAY_BUFFER, hand.fingers, gl.STATIC_DRAW);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.faces);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, hand.faces, gl.STATIC_DRAW);
      return buffers;
    });
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0, 0, 0, 0);
    this.centre = [0, 0, 0];
    this.size = 0.1;
    this._listen();
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // Shows each hand in a row of its result; -1 shows none.
  show(rows) {
    this.rows = rows;
    this.isShown = this.hands.map((hand, i) => rows[i] >= 0 && hand.pose(rows[i]));
    const shown = this.hands.filter((_, i) => this.isShown[i]);
    if (shown.length) {
      const bones = shown.flatMap((hand) => hand.positions.concat(hand.tips));
      const low = [0, 1, 2].map((i) => Math.min(...bones.map((p) => p[i])));
      const high = [0, 1, 2].map((i) => Math.max(...bones.map((p) => p[i])));
      this.centre = low.map((value, i) => 0.5 * (value + high[i]));
      // The hand is seen at one size, whatever it does: half a hand's length about the middle.
      this.size = Math.max(0.1, shown.length > 1 ? 0.5 * Math.hypot(...low.map((value, i) => high[i] - value)) : 0);
    }
    this.draw();
  }

  see(name) {
    this.turn = [...HOME[name]];
    this.zoom = 1;
    this.draw();
  }

  // view_from_world without the place: the first camera's, turned about the middle of the hand.
  _view() {
    const [yaw, pitch] = this.turn, view = this.hands[0].result.view;
    return product(rotationAbout(1, 0, 0, -pitch), product(rotationAbout(0, 1, 0, yaw), view));
  }

  // Camera's axes: x right, y down, z forward, as OpenCV has them; columns for WebGL.
  _clip(view, aspect) {
    const far = (1.15 * this.size) / (Math.tan(FIELD / 2) * this.zoom * Math.min(1, aspect));
    const f = 1 / Math.tan(FIELD / 2), near = 0.02 * far, end = far + 4 * this.size + 1;
    const shift = turned(view, ...this.centre.map((value) => -value));
    shift[2] += far;
    const a = (end + near) / (end - near), b = (-2 * end * near) / (end - near);
    const rows = [
      [f / aspect * view[0], f / aspect * view[1], f / aspect * view[2], f / aspect * shift[0]],
      [-f * view[3], -f * view[4], -f * view[5], -f * shift[1]],
      [a * view[6], a * view[7], a * view[8], a * shift[2] + b],
      [view[6], view[7], view[8], shift[2]],
    ];
    return new Float32Array([0, 1, 2, 3].flatMap((j) => rows.map((row) => row[j])));
  }

  draw() {
    const { gl, canvas } = this, scale = Math.min(2, window.devicePixelRatio || 1);
    const width = Math.max(1, Math.round(canvas.clientWidth * scale)), height = Math.max(1, Math.round(canvas.clientHeight * scale));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const view = this._view(), clip = this._clip(view, width / height);
    this.hands.forEach((hand, i) => { if (this.isShown[i]) this._drawHand(i, view, clip); });
    if (this.hasTips) this.hands.forEach((_, i) => { if (this.isShown[i]) this._drawTips(i, clip, height); });
  }

  _drawHand(i, view, clip) {
    const { gl, program } = this, hand = this.hands[i], buffers = this.buffers[i];
    gl.useProgram(program);
    for (const [name, values, size] of [["place", hand.vertices, 3], ["normal", hand.normals, 3], ["finger", null, 1]]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
      if (values) gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
      const at = gl.getAttribLocation(program, name);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, size, gl.FLOAT, false, 0, 0);
    }
    gl.uniformMatrix4fv(gl.getUniformLocation(program, "clip_from_world"), false, clip);
    const columns = [0, 3, 6, 1, 4, 7, 2, 5, 8].map((k) => view[k]);
    gl.uniformMatrix3fv(gl.getUniformLocation(program, "view_from_world"), false, columns);
    gl.uniform3fv(gl.getUniformLocation(program, "colour"), SKIN[this.hands.length > 1 ? i + 1 : 0]);
    const quality = [0, 1, 2, 3, 4].map((f) => qualityOf(hand.result, this.rows[i], f) ?? 1);
    gl.uniform1fv(gl.getUniformLocation(program, "quality"), [...quality, 1]);
    gl.uniform1f(gl.getUniformLocation(program, "determined"), hand.result.determined);
    gl.uniform1i(gl.getUniformLocation(program, "is_second"), i);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.faces);
    gl.drawElements(gl.TRIANGLES, hand.faces.length, gl.UNSIGNED_SHORT, 0);
  }

  _drawTips(i, clip, height) {
    const { gl, discs } = this, hand = this.hands[i], values = [];
    hand.tips.forEach((tip, f) => {
      const radius = hand.radii[f];
      if (radius > 0) values.push(...tip, radius);
    });
    gl.useProgram(discs);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[i].tips);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.DYNAMIC_DRAW);
    for (const [name, size, offset] of [["place", 3, 0], ["radius", 1, 12]]) {
      const at = gl.getAttribLocation(discs, name);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, size, gl.FLOAT, false, 16, offset);
    }
    gl.uniformMatrix4fv(gl.getUniformLocation(discs, "clip_from_world"), false, clip);
    gl.uniform1f(gl.getUniformLocation(discs, "pixels"), height / (2 * Math.tan(FIELD / 2)));
    gl.uniform3fv(gl.getUniformLocation(discs, "colour"), SKIN[this.hands.length > 1 ? i + 1 : 0].map((x) => 0.6 * x));
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthMask(false);
    gl.disable(gl.DEPTH_TEST);
    gl.drawArrays(gl.POINTS, 0, values.length / 4);
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
  }

  _listen() {
    const { canvas } = this, pointers = new Map();
    const turnBy = (x, y) => {
      this.turn[0] += x;
      this.turn[1] = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, this.turn[1] + y));
      this.draw();
    };
    const zoomBy = (factor) => { this.zoom = Math.max(0.3, Math.min(6, this.zoom * factor)); this.draw(); };
    canvas.addEventListener("pointerdown", (event) => {
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const others = [...pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const now = [event.clientX, event.clientY];
      if (others.length === 1) {
        const apart = (place) => Math.max(1, Math.hypot(place[0] - others[0][0], place[1] - others[0][1]));
        zoomBy(apart(now) / apart(before));
      } else turnBy(0.01 * (now[0] - before[0]), 0.01 * (now[1] - before[1]));
      pointers.set(event.pointerId, now);
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey) return; // the page scrolls
      event.preventDefault();
      zoomBy(Math.exp(-0.002 * event.deltaY));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const step = 0.12;
      const action = {
        ArrowLeft: () => turnBy(-step, 0), ArrowRight: () => turnBy(step, 0),
        ArrowUp: () => turnBy(0, -step), ArrowDown: () => turnBy(0, step),
        "+": () => zoomBy(1.15), "=": () => zoomBy(1.15), "-": () => zoomBy(1 / 1.15),
      }[event.key];
      if (action) { action(); event.preventDefault(); event.stopPropagation(); }
    });
  }
}

// Probability that a fingertip is right; undefined where nobody tells.
function qualityOf(result, row, finger) {
  if (!result.quality || row < 0) return undefined;
  const value = result.quality[5 * row + finger];
  return Number.isNaN(value) ? undefined : value;
}
