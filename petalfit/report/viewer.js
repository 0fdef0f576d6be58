"use strict";
// Surfaces and points in 3-D, seen by an orthographic camera, by WebGL alone.

const DECODED = { position: Uint16Array, normal: Int8Array, value: Int8Array };

function decoded(kind, text) {
  return new DECODED[kind](Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
}

// Places about `centre`: each coordinate was written as a fraction of its range, in 65535ths.
function places(part, centre) {
  const { low, size, data } = part.position;
  return Float32Array.from(decoded("position", data), (q, i) =>
    low[i % 3] - centre[i % 3] + (q / 65535) * size[i % 3]);
}

// One colour a point: from the middle of the scale to either end of it, or the same for all.
function dotColours(part, colours) {
  const count = part.count, found = new Float32Array(3 * count);
  const values = part.value && decoded("value", part.value);
  for (let i = 0; i < count; i++) {
    const t = values ? values[i] / 127 : 0, end = t < 0 ? colours.negative : colours.positive;
    for (let k = 0; k < 3; k++) {
      const zero = colours.zero[k];
      found[3 * i + k] = values ? zero + Math.abs(t) * (end[k] - zero) : colours.ignored[k];
    }
  }
  return found;
}

// Vertices of a grid whose v runs fastest: its triangles, every `step`th of its lines, and where those cross.
function gridIndices([rows, columns], step) {
  const at = (i, j) => i * columns + j, triangles = [], lines = [], crossings = [];
  for (let i = 0; i < rows; i++) {
    for (let j = 0; j < columns; j++) {
      const down = i + 1 < rows, right = j + 1 < columns;
      if (down && right) {
        triangles.push(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j), at(i + 1, j + 1), at(i, j + 1));
      }
      if (down && j % step === 0) lines.push(at(i, j), at(i + 1, j));
      if (right && i % step === 0) lines.push(at(i, j), at(i, j + 1));
      if (i % step === 0 && j % step === 0) crossings.push(at(i, j));
    }
  }
  return { triangles: Uint16Array.from(triangles), lines: Uint16Array.from(lines), crossings };
}

const PLACE = `
  attribute vec3 position;
  uniform mat3 turn; uniform vec2 middle; uniform vec3 scale; uniform float lift;
  vec4 place() {
    vec3 seen = turn * position;
    return vec4((seen.xy - middle) * scale.xy, -(seen.z + lift) * scale.z, 1.0);
  }`;
const SHEET = [`${PLACE}
  attribute vec3 normal; varying vec3 facing;
  void main() { facing = turn * normal; gl_Position = place(); }`, `
  precision mediump float;
  uniform vec3 front, rear, light; varying vec3 facing;
  void main() {
    vec3 n = normalize(facing);
    float lit = max(dot(n.z < 0.0 ? -n : n, light), 0.0);
    gl_FragColor = vec4((n.z < 0.0 ? rear : front) * (0.46 + 0.54 * lit) + 0.1 * pow(lit, 12.0), 1.0);
  }`];
const FLAT = [`${PLACE}
  attribute vec3 colour; uniform float size; varying vec3 paint;
  void main() { paint = colour; gl_PointSize = size; gl_Position = place(); }`, `
  precision mediump float;
  uniform bool disc; uniform float rim; varying vec3 paint;
  void main() {
    float radius = disc ? 2.0 * length(gl_PointCoord - 0.5) : 0.0;
    if (radius > 1.0) discard;
    gl_FragColor = vec4(mix(paint, 0.3 * paint + 0.7, rim * smoothstep(0.6, 0.75, radius)), 1.0);
  }`];

function program(gl, sources) {
  const made = gl.createProgram();
  [gl.VERTEX_SHADER, gl.FRAGMENT_SHADER].forEach((kind, i) => {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, sources[i]);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  });
  gl.bindAttribLocation(made, 0, "position");
  gl.bindAttribLocation(made, 1, sources === SHEET ? "normal" : "colour");
  gl.linkProgram(made);
  const uniforms = {};
  for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); i++) {
    const { name } = gl.getActiveUniform(made, i);
    uniforms[name] = gl.getUniformLocation(made, name);
  }
  return { made, uniforms };
}

function buffer(gl, content, kind = gl.ARRAY_BUFFER) {
  const made = gl.createBuffer();
  gl.bindBuffer(kind, made);
  gl.bufferData(kind, content, gl.STATIC_DRAW);
  return made;
}

// Everything that is drawn, by the name of its switch: functions of an already set view.
function drawings(gl, scene, centre, radius) {
  const sheet = program(gl, SHEET), flat = program(gl, FLAT), { colours, light } = scene, found = [];
  const bind = (slot, made, offset = 0) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, made);
    gl.enableVertexAttribArray(slot);
    gl.vertexAttribPointer(slot, 3, gl.FLOAT, false, 0, offset);
  };
  const paint = (colour) => {
    gl.disableVertexAttribArray(1);
    gl.vertexAttrib3fv(1, colour);
  };
  for (const part of scene.parts) {
    const position = places(part, centre), at = buffer(gl, position);
    if (!part.grid) {
      const colour = buffer(gl, dotColours(part, colours));
      found.push({ name: part.name, lift: 0.02 * radius, ...flat, draw(set, view) {
        bind(0, at);
        bind(1, colour);
        set("disc", 1);
        const dot = Math.min(Math.max(0.3 * part.spacing * view.scale, 1.3), 4); // its radius in pixels
        set("size", 2 * dot * view.ratio);
        set("rim", Math.min(Math.max(dot - 1.6, 0), 1));
        gl.drawArrays(gl.POINTS, 0, part.count);
      } });
      continue;
    }
    const [rows, columns] = part.grid, each = rows * columns, sheets = position.length / (3 * each);
    const normal = Float32Array.from(decoded("normal", part.normal), (n) => n / 127);
    const { triangles, lines, crossings } = gridIndices(part.grid, Math.max(1, (rows - 1) >> 4));
    const facing = buffer(gl, normal);
    const faces = buffer(gl, triangles, gl.ELEMENT_ARRAY_BUFFER), mesh = buffer(gl, lines, gl.ELEMENT_ARRAY_BUFFER);
    const needles = [];
    for (let k = 0; k < sheets; k++) {
      for (const i of crossings) {
        const from = 3 * (k * each + i), axes = [0, 1, 2];
        needles.push(...axes.map((a) => position[from + a]),
          ...axes.map((a) => position[from + a] + 0.06 * radius * normal[from + a]));
      }
    }
    const spines = buffer(gl, Float32Array.from(needles));
    found.push({ name: part.name, lift: 0, ...sheet, draw(set) {
      set("front", colours.front);
      set("rear", colours.rear);
      set("light", light);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, faces);
      for (let k = 0; k < sheets; k++) {
        bind(0, at, 12 * k * each);
        bind(1, facing, 12 * k * each);
        gl.drawElements(gl.TRIANGLES, triangles.length, gl.UNSIGNED_SHORT, 0);
      }
    } }, { name: "grid lines", lift: 0.01 * radius, ...flat, draw(set, view) {
      set("disc", 0);
      paint(view.ink);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh);
      for (let k = 0; k < sheets; k++) {
        bind(0, at, 12 * k * each);
        gl.drawElements(gl.LINES, lines.length, gl.UNSIGNED_SHORT, 0);
      }
    } }, { name: "normals", lift: 0.01 * radius, ...flat, draw(set, view) {
      set("disc", 0);
      paint(view.accent);
      bind(0, spines);
      gl.drawArrays(gl.LINES, 0, needles.length / 3);
    } });
  }
  return found;
}

// The distance of the farthest of some places.
function reach(position) {
  let most = 0;
  for (let i = 0; i < position.length; i += 3) most = Math.max(most, Math.hypot(...position.subarray(i, i + 3)));
  return most;
}

// Makes `root` a viewer of `scene`, and shows it; without WebGL it leaves everything as it is.
function petalfitViewer(root, scene) {
  const canvas = root.querySelector("canvas"), gl = canvas.getContext("webgl", { antialias: true });
  if (!gl) return;
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  const framed = scene.parts.filter(({ grid, value }) => grid || value);
  for (const { position } of framed) {
    position.low.forEach((least, i) => {
      low[i] = Math.min(low[i], least);
      high[i] = Math.max(high[i], least + position.size[i]);
    });
  }
  const centre = low.map((least, i) => 0.5 * (least + high[i]));
  const radius = Math.max(...framed.map((part) => reach(places(part, centre)))) || 1;
  const drawn = drawings(gl, scene, centre, radius);
  const depth = Math.max(...scene.parts.map((part) => reach(places(part, centre))), radius);
  let axes, middle, zoom, pending = false;

  const pixels = () => (zoom * 0.48 * Math.min(canvas.clientWidth, canvas.clientHeight)) / radius; // per unit
  const refresh = () => {
    if (!pending) requestAnimationFrame(draw);
    pending = true;
  };
  const look = (rows) => {
    axes = rows.map((row) => [...row]);
    middle = [0, 0];
    zoom = 1;
    refresh();
  };
  const mix = (one, other, angle) => {
    const [a, b] = [axes[one], axes[other]], [c, s] = [Math.cos(angle), Math.sin(angle)];
    axes[one] = a.map((x, i) => c * x + s * b[i]);
    axes[other] = b.map((x, i) => c * x - s * a[i]);
    refresh();
  };
  const orbit = (right, down) => {
    mix(0, 2, right);
    mix(1, 2, -down);
  };
  const move = (right, down) => {
    middle = [middle[0] - right / pixels(), middle[1] + down / pixels()];
    refresh();
  };
  const enlarge = (factor, x = 0, y = 0) => { // about a place, in pixels from the middle
    const before = pixels(), after = Math.min(Math.max(zoom * factor, 0.1), 100);
    zoom = after;
    middle = [middle[0] + x / before - x / pixels(), middle[1] - y / before + y / pixels()];
    refresh();
  };

  const shown = (name) => [...root.querySelectorAll("input")].find((input) => input.name === name).checked;
  const rgb = (css) => css.match(/[\d.]+/g).slice(0, 3).map((x) => x / 255);
  function draw() {
    pending = false;
    const { clientWidth: width, clientHeight: height } = canvas, ratio = window.devicePixelRatio || 1;
    if (!width || !height) return;
    const sides = [Math.round(ratio * width), Math.round(ratio * height)];
    if (canvas.width !== sides[0]) canvas.width = sides[0];
    if (canvas.height !== sides[1]) canvas.height = sides[1];
    gl.viewport(0, 0, ...sides);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const scale = [(2 * pixels()) / width, (2 * pixels()) / height, 0.9 / depth];
    const turn = [0, 1, 2].flatMap((i) => axes.map((row) => row[i]));
    const style = getComputedStyle(canvas); // lines take the page's colours, light or dark
    const view = { ink: rgb(style.color), accent: rgb(style.caretColor), ratio, scale: pixels() };
    for (const { name, made, uniforms, lift, draw: render } of drawn) {
      if (!shown(name)) continue;
      gl.useProgram(made);
      gl.uniformMatrix3fv(uniforms.turn, false, turn);
      gl.uniform2fv(uniforms.middle, middle);
      gl.uniform3fv(uniforms.scale, scale);
      gl.uniform1f(uniforms.lift, lift);
      const set = (key, x) => (Array.isArray(x) ? gl.uniform3fv(uniforms[key], x) : gl.uniform1f(uniforms[key], x));
      render(set, view);
    }
    annotate(width);
  }
  function annotate(width) {
    root.querySelectorAll(".gizmo g").forEach((axis, i) => {
      const x = 24 * axes[0][i], y = -24 * axes[1][i], [line, label] = axis.children;
      line.setAttribute("x2", x);
      line.setAttribute("y2", y);
      label.setAttribute("x", 1.4 * x);
      label.setAttribute("y", 1.4 * y);
      axis.style.opacity = Math.hypot(x, y) < 8 ? 0 : 1;
    });
    const most = Math.min(0.25 * width, 140) / pixels(), power = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].find((m) => m * power <= most * (1 + 1e-9)) * power;
    const bar = root.querySelector(".scale");
    bar.style.width = `${length * pixels()}px`;
    bar.textContent = Number(length.toPrecision(1));
  }

  const fingers = new Map();
  const fromMiddle = (x, y) => {
    const box = canvas.getBoundingClientRect();
    return [x - (box.left + box.right) / 2, y - (box.top + box.bottom) / 2];
  };
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button) return;
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId), now = [event.clientX, event.clientY];
    if (!before) return;
    const step = [now[0] - before[0], now[1] - before[1]];
    const other = [...fingers].find(([id]) => id !== event.pointerId);
    fingers.set(event.pointerId, now);
    if (other) {
      const [x, y] = other[1];
      const factor = Math.hypot(now[0] - x, now[1] - y) / Math.max(Math.hypot(before[0] - x, before[1] - y), 1);
      move(step[0] / 2, step[1] / 2);
      enlarge(factor, ...fromMiddle((now[0] + x) / 2, (now[1] + y) / 2));
    } else if (event.shiftKey) move(...step);
    else orbit(0.01 * step[0], 0.01 * step[1]);
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("wheel", (event) => {
    // A page that scrolls under the pointer is not held up: the wheel is ours once the picture was clicked.
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    const down = event.deltaY * (event.deltaMode === 1 ? 30 : 1); // lines, or pixels
    enlarge(Math.exp(-0.0015 * down), ...fromMiddle(event.clientX, event.clientY));
  }, { passive: false });
  const home = () => look(scene.views[0].axes), turned = 0.1;
  const keys = {
    ArrowLeft: () => orbit(-turned, 0), ArrowRight: () => orbit(turned, 0),
    ArrowUp: () => orbit(0, -turned), ArrowDown: () => orbit(0, turned),
    "+": () => enlarge(1.2), "=": () => enlarge(1.2), "-": () => enlarge(1 / 1.2), 0: home,
  };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in keys)) return;
    event.preventDefault();
    keys[event.key]();
  });
  canvas.addEventListener("dblclick", home);
  const buttons = { nearer: () => enlarge(1.4), farther: () => enlarge(1 / 1.4), reset: home };
  root.addEventListener("click", ({ target }) => {
    if (target.value in buttons) buttons[target.value]();
    else if (target.matches("button")) look(scene.views[target.value].axes);
  });
  root.addEventListener("input", refresh);
  canvas.addEventListener("webglcontextlost", () => { root.hidden = true; });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", refresh);
  root.hidden = false;
  home();
  new ResizeObserver(refresh).observe(canvas);
}
