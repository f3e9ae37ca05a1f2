// Draws the clouds of one ".viewer" element with WebGL; no library, nothing fetched. The element holds the controls and
// a JSON block, both written by viewer.py, which says what the fields of the block mean.
(() => {
  "use strict";
  const root = document.currentScript.closest(".viewer");
  const data = JSON.parse(root.querySelector("script[type='application/json']").textContent);
  const stage = root.querySelector(".viewer-stage");
  const canvas = root.querySelector("canvas");
  const form = root.querySelector("form");
  const give = (reason) => {
    root.querySelector(".viewer-missing span").textContent = reason;
    root.querySelector(".viewer-missing").hidden = false;
    for (const part of [stage, form, root.querySelector(".viewer-help")]) part.hidden = true;
  };
  const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true }); // kept: a page is printed later
  if (!gl) return give("this browser has no WebGL, or it is turned off");
  if (typeof DecompressionStream === "undefined") return give("this browser is too old to unpack its points");
  const PAPER = [0.92, 0.925, 0.93]; // gray, so that white walls are seen
  const BARE = [0.72, 0.72, 0.72]; // of points without a color or a number
  const FIELD = 0.7; // radians, vertical angle of view

  // ---- vectors (3) and matrices (16, column by column)
  const add = (a, b, s = 1) => a.map((v, i) => v + s * b[i]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => a.map((v) => v / Math.hypot(...a));
  const product = (A, B) =>
    Array.from({ length: 16 }, (_, k) => [0, 1, 2, 3].reduce((s, i) => s + A[4 * i + (k % 4)] * B[(k & ~3) + i], 0));
  const transposed = (rows) => Array.from({ length: 16 }, (_, k) => rows[k % 4][k >> 2]);

  // ---- the frame of the camera: up, and the two directions that are level
  let up, right, ahead;
  const stand = (direction) => {
    up = unit(direction);
    const level = Math.abs(up[0]) > 0.9 ? [0, 1, 0] : [1, 0, 0];
    right = unit(add(level, up, -dot(level, up)));
    ahead = cross(up, right);
  };
  stand(data.up);
  const VIEWS = { oblique: [-1.0, 0.6], top: [-Math.PI / 2, Math.PI / 2], front: [-Math.PI / 2, 0], side: [0, 0] };
  const camera = { yaw: 0, pitch: 0, distance: 1, center: [0, 0, 0] };

  const shader = (kind, text) => {
    const made = gl.createShader(kind);
    gl.shaderSource(made, text);
    gl.compileShader(made);
    return made;
  };
  const program = (vertex, fragment) => {
    const made = gl.createProgram();
    gl.attachShader(made, shader(gl.VERTEX_SHADER, vertex));
    gl.attachShader(made, shader(gl.FRAGMENT_SHADER, fragment));
    gl.bindAttribLocation(made, 0, "place");
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
    const uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); i++) {
      const name = gl.getActiveUniform(made, i).name;
      uniforms[name] = gl.getUniformLocation(made, name);
    }
    return { made, uniforms };
  };
  const dots = program(
    `attribute vec3 place; attribute vec3 color; uniform vec3 up, across, ramp[${data.palette.length}];
     uniform mat4 pose, view; uniform vec2 heights; uniform float size, least, most, ramped;
     varying vec3 shade; varying float part;
     void main() {
       vec4 world = pose * vec4(place, 1.0);
       gl_Position = view * world;
       gl_PointSize = clamp(size / gl_Position.w, least, most);
       part = dot(world.xyz, across);
       float at = clamp((dot(world.xyz, up) - heights.x) / (heights.y - heights.x), 0.0, 1.0) * ${data.palette.length - 1}.0;
       int i = int(min(at, ${data.palette.length - 2}.0));
       shade = ramped > 0.5 ? mix(ramp[i], ramp[i + 1], at - float(i)) : color;
     }`,
    `precision highp float; uniform vec2 section; varying vec3 shade; varying float part;
     void main() {
       vec2 off = gl_PointCoord - 0.5;
       if (part < section.x || part > section.y || dot(off, off) > 0.25) discard;
       gl_FragColor = vec4(shade, 1.0);
     }`
  );
  const lines = program(
    "attribute vec3 place; uniform mat4 view; void main() { gl_Position = view * vec4(place, 1.0); }",
    "precision mediump float; void main() { gl_FragColor = vec4(0.6, 0.6, 0.6, 1.0); }"
  );

  // ---- the clouds: unpacked from base64, deflated planes of differences, as packed.py has them
  const BLOCK = 4096; // points
  const inflated = async (text) => {
    const raw = Uint8Array.from(atob(text), (mark) => mark.charCodeAt(0));
    const stream = new Blob([raw]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  };
  const places = async (cloud) => {
    const planes = await inflated(cloud.places), made = new Float32Array(3 * cloud.count);
    for (let axis = 0; axis < 3; axis++) {
      for (let k = 0, sum = 0; k < cloud.count; k++) {
        const block = cloud.blocks[Math.floor(k / BLOCK)], at = 2 * axis * cloud.count + k;
        sum = ((k % BLOCK ? sum : 0) + planes[at] + 256 * planes[at + cloud.count]) & 65535;
        made[3 * k + axis] = block[axis] + block[3] * sum;
      }
    }
    return made;
  };
  const channels = async (text, count) => {
    const planes = await inflated(text), width = planes.length / Math.max(count, 1), made = new Uint8Array(planes.length);
    for (let i = 0; i < width; i++) {
      for (let k = 0, sum = 0; k < count; k++) {
        sum = ((k % BLOCK ? sum : 0) + planes[i * count + k]) & 255;
        made[width * k + i] = sum;
      }
    }
    return made;
  };
  const buffer = (content) => {
    const made = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, made);
    gl.bufferData(gl.ARRAY_BUFFER, content, gl.STATIC_DRAW);
    return made;
  };
  const shades = (numbers) => Uint8Array.from({ length: 3 * numbers.length }, (_, k) => {
    const at = (numbers[Math.floor(k / 3)] / 255) * (data.palette.length - 1);
    const i = Math.min(Math.floor(at), data.palette.length - 2);
    return data.palette[i][k % 3] * (i + 1 - at) + data.palette[i + 1][k % 3] * (at - i);
  });
  const clouds = data.clouds.map((cloud) => ({
    ...cloud,
    shown: true,
    place: null, // until it is unpacked
    poses: cloud.poses.map(transposed),
    buffers: { colors: null, scalars: null },
  }));
  const unpack = async (cloud) => {
    const [place, colors, scalars] = await Promise.all([
      places(cloud),
      cloud.colors === null ? null : channels(cloud.colors, cloud.count),
      cloud.scalars === null ? null : channels(cloud.scalars, cloud.count),
    ]);
    cloud.place = buffer(place);
    cloud.buffers = { colors: colors && buffer(colors), scalars: scalars && buffer(shades(scalars)) };
  };
  const colorAt = gl.getAttribLocation(dots.made, "color");
  const frame = gl.createBuffer();

  const choice = (name) => (form.elements[name] === undefined ? null : form.elements[name].value);
  const state = () => data.states[Number(choice("state") ?? data.state)];
  const across = () => (choice("axis") === "up" ? up : [0, 1, 2].map((i) => Number(i === Number(choice("axis")))));
  const section = () => {
    const [low, high] = extent(across()), [from, to] = ["from", "to"].map((name) => Number(form.elements[name].value) / 100);
    const ends = [from <= 0 ? -1e30 : low + from * (high - low), to >= 1 ? 1e30 : low + to * (high - low)];
    const words = [from, to].map((part) => (part * (high - low)).toFixed(high - low < 10 ? 2 : 1));
    root.querySelector("output").textContent = from <= 0 && to >= 1 ? "all" : `${words[0]} to ${words[1]} m`;
    return ends;
  };
  const corners = () =>
    Array.from({ length: 8 }, (_, k) => [0, 1, 2].map((i) => ((k >> i) & 1 ? state().high[i] : state().low[i])));
  const extent = (direction) => {
    const all = corners().map((corner) => dot(corner, direction));
    return [Math.min(...all), Math.max(...all)];
  };

  const fit = () => {
    const { low, high } = state(), { side, top, back } = axesOfCamera();
    camera.center = low.map((v, i) => (v + high[i]) / 2);
    const across = Math.tan(FIELD / 2) * 0.84, ratio = canvas.clientWidth / Math.max(canvas.clientHeight, 1);
    const needed = corners().map((corner) => {
      const from = add(corner, camera.center, -1);
      return dot(from, back) + Math.max(Math.abs(dot(from, top)), Math.abs(dot(from, side)) / ratio) / across;
    });
    camera.distance = Math.max(...needed);
  };
  const look = (name) => {
    [camera.yaw, camera.pitch] = VIEWS[name];
    fit();
    redraw();
  };
  const axesOfCamera = () => {
    const flat = add(right.map((v) => v * Math.cos(camera.yaw)), ahead, Math.sin(camera.yaw));
    const back = add(flat.map((v) => v * Math.cos(camera.pitch)), up, Math.sin(camera.pitch)); // towards the eye
    const side = add(right.map((v) => -v * Math.sin(camera.yaw)), ahead, Math.cos(camera.yaw));
    return { side, top: cross(back, side), back };
  };
  const viewMatrix = () => {
    const { side, top, back } = axesOfCamera();
    const eye = add(camera.center, back, camera.distance);
    const look = [0, 1, 2].flatMap((i) => [side[i], top[i], back[i], 0]);
    look.push(-dot(side, eye), -dot(top, eye), -dot(back, eye), 1);
    const near = camera.distance / 100, far = camera.distance * 4 + 4 * Math.hypot(...add(state().high, state().low, -1));
    const f = 1 / Math.tan(FIELD / 2), ratio = canvas.width / canvas.height;
    const lens = [f / ratio, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0];
    return product(lens, look);
  };

  // ---- the box with its ticks: lines in WebGL, labels as text above the canvas
  const drawBox = (view) => {
    const box = corners(), ends = [];
    for (let k = 0; k < 8; k++) for (let i = 0; i < 3; i++) if (!((k >> i) & 1)) ends.push(...box[k], ...box[k | (1 << i)]);
    gl.useProgram(lines.made);
    gl.uniformMatrix4fv(lines.uniforms.view, false, view);
    gl.bindBuffer(gl.ARRAY_BUFFER, frame);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(ends), gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.disableVertexAttribArray(colorAt);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.drawArrays(gl.LINES, 0, ends.length / 3);
  };
  const onScreen = (view, p) => {
    const [x, y, , w] = [0, 1, 2, 3].map((i) => view[i] * p[0] + view[4 + i] * p[1] + view[8 + i] * p[2] + view[12 + i]);
    return w <= 0 ? null : [(x / w + 1) / 2 * canvas.clientWidth, (1 - y / w) / 2 * canvas.clientHeight];
  };
  const labels = root.querySelector(".viewer-labels");
  let taken = []; // rectangles of the labels of this frame: left, right, top, bottom
  const label = (view, point, away, text, kind) => {
    const at = onScreen(view, point), from = onScreen(view, away);
    if (!at || !from) return;
    const off = [at[0] - from[0], at[1] - from[1]], length = Math.hypot(...off) || 1;
    const half = [3.3 * text.length + 2, 8]; // about the half width and height of the text
    const gap = (kind === "axis" ? 34 : 11) + (half[0] * Math.abs(off[0])) / length;
    const size = [canvas.clientWidth, canvas.clientHeight];
    const place = size.map((most, i) => Math.min(Math.max(at[i] + (off[i] / length) * gap, half[i]), most - half[i]));
    const [left, right] = [place[0] - half[0], place[0] + half[0]], [top, bottom] = [place[1] - half[1], place[1] + half[1]];
    if (taken.some((box) => left < box[1] && right > box[0] && top < box[3] && bottom > box[2])) return;
    taken.push([left, right, top, bottom]);
    const span = document.createElement("span");
    span.className = kind;
    span.textContent = text;
    span.style.left = `${(100 * place[0]) / size[0]}%`; // also right where the canvas has another size, as on paper
    span.style.top = `${(100 * place[1]) / size[1]}%`;
    labels.append(span);
  };
  const edgeOfAxis = (view, axis) => {
    const { low, high } = state(), middle = low.map((v, i) => (v + high[i]) / 2), center = onScreen(view, middle);
    const edges = corners().filter((_, k) => !((k >> axis) & 1)).map((corner) => {
      const half = corner.map((v, i) => (i === axis ? middle[i] : v)), at = onScreen(view, half);
      // the outermost edge, rather below and to the left
      const out = at && center ? Math.hypot(at[0] - center[0], at[1] - center[1]) + 0.3 * (at[1] - at[0]) : -Infinity;
      return { half, out };
    });
    const edge = edges.reduce((best, other) => (other.out > best.out ? other : best)).half;
    const ends = [low, high].map((side) => onScreen(view, edge.map((v, i) => (i === axis ? side[i] : v))));
    const seen = ends[0] && ends[1] ? Math.hypot(ends[0][0] - ends[1][0], ends[0][1] - ends[1][1]) : 0;
    return { axis, edge, middle, low: low[axis], high: high[axis], seen };
  };
  const drawLabels = (view) => {
    labels.replaceChildren();
    taken = [];
    const { low, high } = state();
    const rough = Math.max(...add(high, low, -1)) / 6, power = 10 ** Math.floor(Math.log10(rough));
    const tick = [1, 2, 5, 10].map((k) => k * power).find((v) => v >= rough);
    const edges = [0, 1, 2].map((axis) => edgeOfAxis(view, axis)).filter(({ seen }) => seen > 60); // others: end on
    for (const { axis, edge, middle } of edges) label(view, edge, middle, data.axes[axis], "axis");
    for (const { axis, edge, middle, low, high } of edges) {
      for (let k = Math.ceil(low / tick); k * tick <= high; k++) {
        const [point, inward] = [edge, middle].map((p) => p.map((v, i) => (i === axis ? k * tick : v)));
        label(view, point, inward, String(+(k * tick).toPrecision(6)), "tick");
      }
    }
  };

  const AT_ONCE = 150000; // points of a frame while the view moves: without a graphics card, a fifth of a second
  const draw = (moving) => {
    const scale = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((v) => Math.max(1, Math.round(v * scale)));
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.clearColor(...PAPER, 1);
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const view = viewMatrix(), mode = choice("coloring"), now = Number(choice("state") ?? data.state);
    drawBox(view);
    gl.useProgram(dots.made);
    const points = Number(form.elements.size.value), diagonal = Math.hypot(...add(state().high, state().low, -1));
    gl.uniformMatrix4fv(dots.uniforms.view, false, view);
    gl.uniform3fv(dots.uniforms.up, up);
    gl.uniform3fv(dots.uniforms.across, across());
    gl.uniform2fv(dots.uniforms.section, section());
    gl.uniform2fv(dots.uniforms.heights, extent(up));
    gl.uniform3fv(dots.uniforms["ramp[0]"], data.palette.flat().map((v) => v / 255));
    gl.uniform1f(dots.uniforms.ramped, mode === "height" ? 1 : 0);
    const total = clouds.reduce((sum, cloud) => sum + (cloud.shown ? cloud.count : 0), 0);
    const every = moving ? Math.min(Math.max(Math.ceil(total / AT_ONCE), 1), 20) : 1; // strides end at 255 bytes
    gl.uniform1f(dots.uniforms.size, ((points / 700) * diagonal * height) / (2 * Math.tan(FIELD / 2)));
    gl.uniform1f(dots.uniforms.least, 1.5 * scale);
    gl.uniform1f(dots.uniforms.most, 24 * scale);
    for (const cloud of clouds) {
      if (!cloud.shown || cloud.count === 0 || cloud.place === null) continue;
      gl.uniformMatrix4fv(dots.uniforms.pose, false, cloud.poses[now]);
      gl.bindBuffer(gl.ARRAY_BUFFER, cloud.place);
      gl.enableVertexAttribArray(0);
      gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 12 * every, 0);
      const colors = cloud.buffers[mode];
      if (colors) {
        gl.bindBuffer(gl.ARRAY_BUFFER, colors);
        gl.enableVertexAttribArray(colorAt);
        gl.vertexAttribPointer(colorAt, 3, gl.UNSIGNED_BYTE, true, 3 * every, 0);
      } else {
        gl.disableVertexAttribArray(colorAt);
        gl.vertexAttrib3fv(colorAt, mode in cloud.buffers ? BARE : cloud.color.map((v) => v / 255));
      }
      gl.drawArrays(gl.POINTS, 0, Math.ceil(cloud.count / every));
    }
    drawLabels(view);
    root.dataset.drawn = String(Number(root.dataset.drawn || 0) + 1);
  };
  let waiting = false, still = 0, coarse = false;
  const redraw = (moving = false) => {
    coarse = moving;
    clearTimeout(still);
    if (moving) still = setTimeout(() => redraw(), 250); // then all points
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      draw(coarse);
    });
  };

  // ---- what the reader does
  form.addEventListener("input", (event) => {
    const { name, checked, value } = event.target;
    if (name === "cloud") clouds[Number(value)].shown = checked;
    if (name === "state") fit();
    if (name === "up") {
      stand(value.split(" ").map(Number));
      look("oblique");
    }
    showBars();
    redraw(event.target.type === "range");
  });
  const showBars = () => {
    const [low, high] = extent(up), bars = root.querySelectorAll(".viewer-scale");
    bars.forEach((bar) => (bar.hidden = choice("coloring") !== bar.dataset.coloring));
    const ends = root.querySelectorAll(".viewer-scale[data-coloring=height] .ends span");
    ends.forEach((end, k) => (end.textContent = `${(((high - low) * k) / 2).toFixed(high - low < 10 ? 2 : 1)} m`));
  };
  root.querySelectorAll("[data-show]").forEach((button) => button.addEventListener("click", () => {
    const shown = button.dataset.show === "all";
    for (const cloud of clouds) cloud.shown = shown;
    root.querySelectorAll("input[name=cloud]").forEach((box) => (box.checked = shown));
    redraw();
  }));
  form.addEventListener("submit", (event) => event.preventDefault());
  root.querySelectorAll("[data-view]").forEach((button) => button.addEventListener("click", () => look(button.dataset.view)));

  const turn = (dx, dy) => {
    camera.yaw -= dx;
    camera.pitch = Math.min(Math.PI / 2, Math.max(-Math.PI / 2, camera.pitch + dy));
    redraw(true);
  };
  const shift = (dx, dy) => {
    const { side, top } = axesOfCamera();
    const unitsPerPixel = (2 * Math.tan(FIELD / 2) * camera.distance) / canvas.clientHeight;
    camera.center = add(add(camera.center, side, -dx * unitsPerPixel), top, dy * unitsPerPixel);
    redraw(true);
  };
  const zoom = (factor) => {
    camera.distance *= factor;
    redraw(true);
  };
  const held = new Map(); // pointers that are down, by number: fingers or the mouse
  const spread = () => {
    const [a, b] = [...held.values()];
    return Math.max(Math.hypot(a.x - b.x, a.y - b.y), 1);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = held.get(event.pointerId);
    if (!before) return;
    const dx = event.clientX - before.x, dy = event.clientY - before.y;
    const apart = held.size === 2 ? spread() : 0;
    held.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (held.size === 2) {
      zoom(apart / spread());
      shift(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons > 1) shift(dx, dy);
    else turn(dx / 150, dy / 150);
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => held.delete(event.pointerId));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(Math.sign(event.deltaY) * 0.12));
  }, { passive: false });
  const KEYS = {
    ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1),
    "+": () => zoom(0.9), "-": () => zoom(1 / 0.9),
  };
  canvas.addEventListener("keydown", (event) => {
    if (!(event.key in KEYS)) return;
    event.preventDefault();
    KEYS[event.key]();
  });
  window.addEventListener("resize", () => redraw());
  look("oblique");
  clouds.reduce((before, cloud) => before.then(() => unpack(cloud)).then(() => redraw(true)), Promise.resolve())
    .then(() => (root.dataset.unpacked = "true"), (error) => give(`its points cannot be unpacked (${error.message})`));
})();
