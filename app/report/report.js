'use strict';
// Paper cannot be clicked: what is closed is printed open.
(() => {
  let closed = [];
  addEventListener('beforeprint', () => {
    closed = [...document.querySelectorAll('details:not([open])')];
    closed.forEach((part) => part.open = true);
  });
  addEventListener('afterprint', () => closed.forEach((part) => part.open = false));
})();
// The surface as a grid of heights, drawn with WebGL alone. The address may preset the view:
// report.html#turn=40&tilt=30&exaggeration=2&drape=heights
(() => {
  const byId = (id) => document.getElementById(id);
  const canvas = byId('view'), needle = byId('needle'), drape = byId('drape'), slider = byId('exaggeration');
  const grid = JSON.parse(byId('grid').textContent);
  // The picture stays for print, which asks for it long after it was drawn.
  const gl = grid.width > 1 && grid.height > 1 && canvas.getContext('webgl', {preserveDrawingBuffer: true});
  const give_up = () => document.body.classList.add('no-webgl');
  if (!gl) return give_up();

  const wanted = new URLSearchParams(location.hash.slice(1));
  const number = (name, otherwise) => (wanted.has(name) && isFinite(+wanted.get(name)) ? +wanted.get(name) : otherwise);
  const clamp = (x, low, high) => Math.min(high, Math.max(low, x));
  const start = {turn: 25, tilt: 40, near: 1, exaggeration: 1};
  const state = {
    turn: number('turn', start.turn), tilt: clamp(number('tilt', start.tilt), 5, 90), near: number('near', start.near),
    exaggeration: clamp(number('exaggeration', start.exaggeration), 0.5, 5)
  };

  // --- the grid: [0, 65534] is low to high, 65535 is unknown ---------------------------------------------------------
  const W = grid.width, H = grid.height, kUnknown = 65535;
  const bytes = Uint8Array.from(atob(grid.heights), (c) => c.charCodeAt(0));
  const quantised = new Uint16Array(W * H);
  for (let i = 0; i < W * H; ++i) quantised[i] = bytes[2 * i] | (bytes[2 * i + 1] << 8);
  const known = (i) => quantised[i] !== kUnknown;
  const z = (i) => grid.low + (grid.high - grid.low) * quantised[i] / 65534;
  const dx = grid.east / W, dy = grid.north / H, unit = 2 / Math.hypot(grid.east, grid.north);
  // It turns about the middle of what is known of it.
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  let count = 0;
  for (let i = 0; i < W * H; ++i) {
    if (!known(i)) continue;
    ++count;
    [(i % W + 0.5) * dx, -(Math.floor(i / W) + 0.5) * dy, z(i)].forEach((x, k) => {
      low[k] = Math.min(low[k], x);
      high[k] = Math.max(high[k], x);
    });
  }
  if (count === 0) return give_up();
  const [east, north, middle] = low.map((x, k) => (x + high[k]) / 2);

  const vertices = new Float32Array(W * H * 7);  // x y z, slope east and north, place in the picture
  const height_near = (i, j, other) => (i >= 0 && i < H && j >= 0 && j < W && known(i * W + j) ? z(i * W + j) : other);
  for (let i = 0; i < H; ++i)
    for (let j = 0; j < W; ++j) {
      const at = i * W + j, here = known(at) ? z(at) : middle;
      vertices.set([
        ((j + 0.5) * dx - east) * unit, (-(i + 0.5) * dy - north) * unit, (here - middle) * unit,
        (height_near(i, j + 1, here) - height_near(i, j - 1, here)) / (2 * dx),
        (height_near(i - 1, j, here) - height_near(i + 1, j, here)) / (2 * dy),
        (j + 0.5) / W, (i + 0.5) / H
      ], 7 * at);
    }
  const corners = [];
  for (let i = 0; i + 1 < H; ++i)
    for (let j = 0; j + 1 < W; ++j) {
      const a = i * W + j, b = a + 1, c = a + W, d = c + 1;
      if (known(a) && known(b) && known(c)) corners.push(a, c, b);
      if (known(b) && known(c) && known(d)) corners.push(b, c, d);
    }
  const triangles = new Uint16Array(corners);

  // --- the program ---------------------------------------------------------------------------------------------------
  const shader = (type, source) => {
    const made = gl.createShader(type);
    gl.shaderSource(made, source);
    gl.compileShader(made);
    if (!gl.getShaderParameter(made, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(made));
    return made;
  };
  const program = gl.createProgram();
  try {
    gl.attachShader(program, shader(gl.VERTEX_SHADER, `
      attribute vec3 place;
      attribute vec2 slope, picture;
      uniform mat4 camera;
      uniform float exaggeration;
      varying vec2 at;
      varying vec2 steep;
      void main() {
        at = picture;
        steep = slope * exaggeration;
        gl_Position = camera * vec4(place.xy, place.z * exaggeration, 1.0);
      }`));
    gl.attachShader(program, shader(gl.FRAGMENT_SHADER, `
      precision mediump float;
      varying vec2 at;
      varying vec2 steep;
      uniform sampler2D colours;
      uniform float shade;
      void main() {
        vec3 normal = normalize(vec3(-steep, 1.0));
        float lit = max(dot(normal, vec3(-0.5, 0.5, 0.7071)), 0.0);  // from the north-west, 45 degrees high
        gl_FragColor = vec4(texture2D(colours, at).rgb * mix(1.0, 0.35 + 0.92 * lit, shade), 1.0);
      }`));
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  } catch (error) {
    console.error(error);
    return give_up();
  }
  gl.useProgram(program);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, vertices, gl.STATIC_DRAW);
  [['place', 3, 0], ['slope', 2, 12], ['picture', 2, 20]].forEach(([name, size, offset]) => {
    const where = gl.getAttribLocation(program, name);
    gl.enableVertexAttribArray(where);
    gl.vertexAttribPointer(where, size, gl.FLOAT, false, 28, offset);
  });
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, triangles, gl.STATIC_DRAW);
  gl.enable(gl.DEPTH_TEST);
  const uniform = (name) => gl.getUniformLocation(program, name);
  const camera_at = uniform('camera'), exaggeration_at = uniform('exaggeration'), shade_at = uniform('shade');

  // --- what lies on it: the maps of this page ------------------------------------------------------------------------
  const maps = [...document.querySelectorAll('img[data-drape]')];
  maps.forEach((map) => drape.add(new Option(map.dataset.drape, map.id)));
  if (maps.some((map) => map.id === 'map-' + wanted.get('drape'))) drape.value = 'map-' + wanted.get('drape');
  const texture = gl.createTexture();
  const put_on = () => {
    const map = byId(drape.value);
    map.decode().then(() => {
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, map);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
      redraw();
    }, give_up);
  };

  // --- drawing -------------------------------------------------------------------------------------------------------
  // Turned about the vertical and tilted towards the eye: what x, y and z become.
  const turned = ({turn, tilt}) => {
    const a = turn * Math.PI / 180, b = (tilt - 90) * Math.PI / 180;
    const c = Math.cos(a), s = Math.sin(a), C = Math.cos(b), S = Math.sin(b);
    return [[c, C * s, S * s], [-s, C * c, S * c], [0, -S, C]];
  };
  const focal = 2.6;
  const places = [];  // some thousand points of the surface
  for (let i = 0, every = Math.ceil(count / 4000), n = 0; i < W * H; ++i)
    if (known(i) && n++ % every === 0) places.push(vertices.subarray(7 * i, 7 * i + 3));
  // How far away the eye is, and by how much the picture is moved in the window, so that the surface as it is first
  // seen fills the window; turned it keeps this, for nothing shall swell and shrink while it turns.
  let opening = {turn: state.turn, tilt: state.tilt};
  const fit = (aspect) => {
    const [X, Y, Z] = turned(opening), fx = focal / aspect, kFilled = 0.92;
    const seen = places.map(([x, y, height]) => {
      const up = height * state.exaggeration;
      return [0, 1, 2].map((k) => X[k] * x + Y[k] * y + Z[k] * up);
    });
    const extent = (far) => {
      const box = [Infinity, -Infinity, Infinity, -Infinity];
      for (const [x, y, depth] of seen) {
        const u = fx * x / (far - depth), v = focal * y / (far - depth);
        box[0] = Math.min(box[0], u), box[1] = Math.max(box[1], u), box[2] = Math.min(box[2], v), box[3] = Math.max(box[3], v);
      }
      return box;
    };
    let near = Math.max(...seen.map((p) => p[2])) + 0.1, far = near + 40;
    for (let step = 0; step < 24; ++step) {
      const tried = (near + far) / 2, [left, right, bottom, top] = extent(tried);
      if (Math.max(right - left, top - bottom) / 2 <= kFilled) far = tried;
      else near = tried;
    }
    const [left, right, bottom, top] = extent(far);
    return {far, aside: -(left + right) / 2, lift: -(bottom + top) / 2};
  };
  let fitted = {for: ''};
  // Moved away, in perspective; by columns, as WebGL has matrices.
  const camera = (aspect) => {
    const wish = [aspect, state.exaggeration, opening.turn, opening.tilt].join();
    if (fitted.for !== wish) fitted = {for: wish, ...fit(aspect)};
    const far = fitted.far / state.near, front = 0.02, back = far + 8;
    const fx = focal / aspect, p = (back + front) / (front - back), q = 2 * back * front / (front - back);
    const column = (x, y, depth, w) =>
        [fx * x - fitted.aside * depth, focal * y - fitted.lift * depth, p * depth + q * w, -depth];
    const [x, y, height] = turned(state);
    return new Float32Array(
        [...column(...x, 0), ...column(...y, 0), ...column(...height, 0), ...column(0, 0, -far, 1)]);
  };
  let asked = false;
  const draw = () => {
    asked = false;
    const scale = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.round(canvas.clientWidth * scale), height = Math.round(canvas.clientHeight * scale);
    if (width === 0 || height === 0) return;
    if (canvas.width !== width || canvas.height !== height) canvas.width = width, canvas.height = height;
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(camera_at, false, camera(width / height));
    gl.uniform1f(exaggeration_at, state.exaggeration);
    gl.uniform1f(shade_at, {'map-ortho': 0.45, 'map-hillshade': 0}[drape.value] ?? 0.9);
    gl.drawElements(gl.TRIANGLES, triangles.length, gl.UNSIGNED_SHORT, 0);
    needle.style.transform = `rotate(${-state.turn}deg)`;
    slider.value = state.exaggeration;
    byId('times').textContent = (+state.exaggeration).toFixed(1);
    canvas.dataset.drawn = '';
  };
  const redraw = () => {  // the state is told at once, the picture follows with the browser's next frame
    canvas.dataset.turn = Math.round(state.turn);
    canvas.dataset.tilt = Math.round(state.tilt);
    canvas.dataset.near = state.near.toFixed(2);
    if (!asked) asked = true, requestAnimationFrame(draw);
  };
  const move = (turn, tilt, near = 1) => {
    state.turn = (((state.turn + turn + 180) % 360) + 360) % 360 - 180;
    state.tilt = clamp(state.tilt + tilt, 5, 90);
    state.near = clamp(state.near * near, 0.5, 12);
    redraw();
  };

  // --- mouse, fingers, keys ------------------------------------------------------------------------------------------
  const fingers = new Map();
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return Math.hypot(a.x - b.x, a.y - b.y);
  };
  canvas.addEventListener('pointerdown', (event) => {
    fingers.set(event.pointerId, {x: event.clientX, y: event.clientY});
    try {
      canvas.setPointerCapture(event.pointerId);
    } catch (ignored) {  // gone again already
    }
    canvas.focus({preventScroll: true});
  });
  canvas.addEventListener('pointermove', (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const wide = fingers.size === 2 ? spread() : 0;
    fingers.set(event.pointerId, {x: event.clientX, y: event.clientY});
    if (fingers.size === 1) move((event.clientX - before.x) * 0.4, (event.clientY - before.y) * 0.3);
    if (fingers.size === 2 && wide > 0) move(0, 0, spread() / wide);
  });
  ['pointerup', 'pointercancel'].forEach(
      (name) => canvas.addEventListener(name, (event) => fingers.delete(event.pointerId)));
  canvas.addEventListener('wheel', (event) => {
    if (document.activeElement !== canvas) return;  // whoever scrolls past does not want to come nearer
    event.preventDefault();
    move(0, 0, Math.exp(-0.0015 * event.deltaY));
  }, {passive: false});
  canvas.addEventListener('keydown', (event) => {
    const step = {
      ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, -5], ArrowDown: [0, 5], '+': [0, 0, 1.15], '-': [0, 0, 1 / 1.15]
    }[event.key];
    if (!step) return;
    event.preventDefault();
    move(...step);
  });
  drape.addEventListener('change', put_on);
  slider.addEventListener('input', () => {
    state.exaggeration = +slider.value;
    redraw();
  });
  byId('reset').addEventListener('click', () => {
    Object.assign(state, start);
    opening = {turn: start.turn, tilt: start.tilt};
    redraw();
  });
  canvas.addEventListener('webglcontextlost', give_up);
  if (window.ResizeObserver) new ResizeObserver(redraw).observe(canvas);
  window.addEventListener('resize', redraw);
  put_on();
})();
