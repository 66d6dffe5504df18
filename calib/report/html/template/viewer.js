"use strict";
// The viewer: the model in space and, one at a time, mode shapes that move or dots with names. It draws only when
// something has changed.

const PERIOD = 2000;  // of a mode shape, in milliseconds
const NEAR = 4;  // pixels from the edge of a dot within which it is pointed at
const MOST = 8;  // names at one place
const DARK = "#1a1a1a";

// Whole multiples of a step, 16 bits each.
function unpacked(pack) {
  const bytes = atob(pack.numbers);
  return Float32Array.from({ length: bytes.length / 2 }, (_, k) => {
    const count = bytes.charCodeAt(2 * k) | (bytes.charCodeAt(2 * k + 1) << 8);
    return ((count << 16) >> 16) * pack.step;
  });
}

function moved(points, motion, factor) {
  return motion ? points.map((x, k) => x + factor * motion[k]) : points;
}

function some(points, numbers) {
  return Float32Array.from({ length: 3 * numbers.length }, (_, k) => points[3 * numbers[(k / 3) | 0] + (k % 3)]);
}

function joined(a, b) {
  const both = new Float32Array(a.length + b.length);
  both.set(a);
  both.set(b, a.length);
  return both;
}

// Lines of one colour and a width in pixels, from pairs of points.
class Lines extends THREE.LineSegments2 {
  constructor(pairs, colour, width) {
    const ends = new Float32Array(3 * pairs.length);
    super(new THREE.LineSegmentsGeometry().setPositions(ends), new THREE.LineMaterial({ color: colour, linewidth: width }));
    Object.assign(this, { pairs, ends, frustumCulled: false });
  }

  place(points) {
    this.ends.set(some(points, this.pairs));
    this.geometry.attributes.instanceStart.data.needsUpdate = true;
    this.visible = this.pairs.length > 0 && points.length > 0;
  }
}

function pointsGeometry(count) {
  const at = new THREE.BufferAttribute(new Float32Array(3 * count), 3).setUsage(THREE.DynamicDrawUsage);
  return new THREE.BufferGeometry().setAttribute("position", at);
}

// Round dots with a dark rim, of sizes in pixels; one that comes later lies over those before it.
class Dots extends THREE.Points {
  constructor(sizes, colours, names) {
    const geometry = pointsGeometry(sizes.length);
    const shades = colours.flatMap((colour) => new THREE.Color(colour).toArray());
    geometry.setAttribute("size", new THREE.BufferAttribute(Float32Array.from(sizes), 1));
    geometry.setAttribute("shade", new THREE.BufferAttribute(Float32Array.from(shades), 3));
    super(geometry, new THREE.ShaderMaterial({
      uniforms: { ratio: { value: 1 }, rim: { value: new THREE.Color(DARK) } },
      vertexShader: `
        attribute float size; attribute vec3 shade; uniform float ratio; varying vec3 colour; varying float across;
        void main() {
          colour = shade;
          across = size * ratio;
          gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
          gl_PointSize = across;
        }`,
      fragmentShader: `
        uniform float ratio; uniform vec3 rim; varying vec3 colour; varying float across;
        void main() {
          float inside = across * (0.5 - length(gl_PointCoord - 0.5));
          if (inside <= 0.0) discard;
          float edge = 0.8 * ratio;
          gl_FragColor = vec4(mix(rim, colour, smoothstep(edge - 0.5, edge + 0.5, inside)), min(inside, 1.0));
        }`,
      transparent: true, depthTest: false, depthWrite: false,
    }));
    Object.assign(this, { sizes, largest: sizes.reduce((a, b) => Math.max(a, b), 0), names, frustumCulled: false, renderOrder: 2 });
  }

  place(points) {
    this.geometry.attributes.position.array.set(points);
    this.geometry.attributes.position.needsUpdate = true;
    this.visible = points.length > 0;
  }

  // The dots at the place of one, which lies under or over them.
  together(number) {
    const at = this.geometry.attributes.position.array, same = (k) => [0, 1, 2].every((i) => at[3 * k + i] === at[3 * number + i]);
    return this.names.map((_, k) => k).filter(same);
  }

  // The nearest dot under a ray, or -1; `size` is that of a pixel in metres.
  pointed(ray, size) {
    ray.params.Points.threshold = (this.largest / 2 + NEAR) * size;
    this.geometry.computeBoundingSphere();
    const room = (hit) => hit.distanceToRay / size - this.sizes[hit.index] / 2;
    const hits = ray.intersectObject(this).filter((hit) => room(hit) <= NEAR);
    return hits.length ? hits.reduce((a, b) => (room(b) < room(a) ? b : a)).index : -1;
  }
}

// Translucent faces of four points each, shaded by their direction.
class Faces extends THREE.Mesh {
  constructor(count, corners, colour) {
    const geometry = pointsGeometry(count), triangles = [];
    for (let k = 0; k < corners.length; k += 4) {
      const [a, b, c, d] = corners.slice(k, k + 4);
      triangles.push(a, b, c, a, c, d);
    }
    geometry.setIndex(triangles);
    super(geometry, new THREE.ShaderMaterial({
      uniforms: { colour: { value: new THREE.Color(colour) } },
      vertexShader: `
        varying vec3 place;
        void main() {
          place = (modelViewMatrix * vec4(position, 1.0)).xyz;
          gl_Position = projectionMatrix * vec4(place, 1.0);
        }`,
      fragmentShader: `
        uniform vec3 colour; varying vec3 place;
        void main() {
          vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
          gl_FragColor = vec4(colour * (0.5 + 0.5 * abs(dot(normal, vec3(0.2, 0.7, 0.69)))), 0.22);
        }`,
      transparent: true, depthWrite: false, side: THREE.DoubleSide,
    }));
    Object.assign(this, { frustumCulled: false, renderOrder: 1, triangles });
  }

  place(points) {
    this.geometry.attributes.position.array.set(points);
    this.geometry.attributes.position.needsUpdate = true;
    this.visible = this.triangles.length > 0;
  }
}

// Everything that stands in the scene, and what of it a layer, a stage and a mode show.
class Model {
  constructor(content) {
    const { colours } = content;
    this.content = content;
    this.scene = new THREE.Scene();
    this.rest = unpacked(content.points);
    this.sites = unpacked(content.sites.points);
    const count = this.rest.length / 3, lone = content.lone.map(() => 5);
    const add = (part) => (this.scene.add(part), part);
    this.still = [
      add(new Faces(count, content.faces, colours.rest)), add(new Lines(content.lines, colours.rest, 1.2)),
    ];
    this.stillDots = add(new Dots(lone, lone.map(() => colours.rest), []));
    this.still.forEach((part) => part.place(this.rest));
    this.stillDots.place(some(this.rest, content.lone));
    this.moving = [
      add(new Faces(count, content.faces, colours.model)), add(new Lines(content.lines, colours.model, 2)),
    ];
    this.movingDots = add(new Dots(lone, lone.map(() => colours.model), []));
    this.shown = [];
  }

  // Show a layer of dots.
  layer(layer) {
    this.clear();
    const dots = unpacked(layer.points), feet = layer.feet && unpacked(layer.feet);
    this.dots = this.add(new Dots(layer.sizes, layer.colours, layer.names));
    this.dots.place(dots);
    if (feet) {
      const sticks = this.add(new Lines(layer.names.flatMap((_, k) => [k, k + layer.names.length]), DARK, 1.2));
      sticks.place(joined(feet, dots));
    }
    this.still[0].visible = this.still[0].triangles.length > 0;
    this.move = () => {};
  }

  // Show a mode shape; `move` then shows it at a part of its largest motion.
  mode(mode) {
    this.clear();
    const { measured: red } = this.content.colours;
    const motion = mode.motion && unpacked(mode.motion), measured = unpacked(mode.measured), at = some(this.sites, mode.at);
    const names = mode.at.map((k) => this.content.sites.words[k]);
    this.dots = this.add(new Dots(names.map(() => 8), names.map(() => red), names));
    const sticks = this.add(new Lines(names.flatMap((_, k) => [k, k + names.length]), red, 1.6));
    this.still[0].visible = false;
    this.move = (phase) => {
      const factor = phase * mode.scale, tips = moved(at, measured, factor);
      this.dots.place(tips);
      sticks.place(joined(at, tips));
      if (!motion) return;
      const shape = moved(this.rest, motion, factor);
      this.moving.forEach((part) => part.place(shape));
      this.movingDots.place(some(shape, this.content.lone));
    };
  }

  add(part) {
    this.scene.add(part);
    this.shown.push(part);
    return part;
  }

  clear() {
    for (const part of this.shown) {
      this.scene.remove(part);
      part.geometry.dispose();
      part.material.dispose();
    }
    this.shown = [];
    for (const part of [...this.moving, this.movingDots]) part.visible = false;
  }
}

// The directions of the axes, in a corner of the picture.
class Corner {
  constructor(colour) {
    this.size = 84;
    this.scene = new THREE.Scene();
    this.camera = new THREE.OrthographicCamera(-1.5, 1.5, 1.5, -1.5, 0.1, 10);
    const arrows = new Lines([0, 1, 0, 2, 0, 3], colour, 1.5);
    arrows.place(Float32Array.of(0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1));
    this.scene.add(arrows);
    ["x", "y", "z"].forEach((name, k) => {
      const place = document.createElement("canvas");
      place.width = place.height = 64;
      const pen = place.getContext("2d");
      Object.assign(pen, { font: "44px system-ui, sans-serif", textAlign: "center", textBaseline: "middle", fillStyle: colour });
      pen.fillText(name, 32, 32);
      const label = new THREE.Sprite(new THREE.SpriteMaterial({ map: new THREE.CanvasTexture(place), depthTest: false }));
      label.position.setComponent(k, 1.25);
      label.scale.setScalar(0.6);
      this.scene.add(label);
    });
  }

  draw(renderer, camera) {
    this.camera.position.copy(camera.getWorldDirection(new THREE.Vector3())).multiplyScalar(-5);
    this.camera.quaternion.copy(camera.quaternion);
    renderer.setViewport(0, 0, this.size, this.size);
    renderer.clearDepth();
    renderer.render(this.scene, this.camera);
  }
}

// The picture in an element of the page: camera, mouse and keys.
class Stage {
  constructor(place, content, context) {
    THREE.ColorManagement.enabled = false;
    this.place = place;
    this.view = content.view;
    this.model = new Model(content);
    this.corner = new Corner(content.colours.axes);
    this.renderer = new THREE.WebGLRenderer({ canvas: context.canvas, context, antialias: true });
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    this.renderer.setClearColor("#ffffff");
    this.renderer.autoClear = false;
    this.canvas = context.canvas;
    place.append(this.canvas);
    this.tip = document.createElement("div");
    this.tip.className = "tip";
    this.tip.setAttribute("aria-live", "polite");
    place.append(this.tip);
    const { centre, eye, up, radius } = content.view;
    this.camera = new THREE.OrthographicCamera();
    this.camera.up.set(...up);  // before the controls, which turn about it
    this.camera.position.set(...centre.map((x, k) => x + 4 * radius * eye[k]));
    Object.assign(this.camera, { near: 0.01 * radius, far: 8 * radius });
    this.controls = new THREE.OrbitControls(this.camera, this.canvas);
    this.controls.target.set(...centre);
    Object.assign(this.controls, { minZoom: 0.3, maxZoom: 30, zoomToCursor: true });
    this.canvas.style.touchAction = "pan-y";  // a finger that moves up or down scrolls the page
    this.controls.update();
    this.controls.saveState();
    this.named = -1;
    this.due = 0;
    this.listen();
    new ResizeObserver(() => this.resize()).observe(place);
    this.resize();
  }

  resize() {
    const [wide, high] = [this.place.clientWidth, this.place.clientHeight];
    if (!wide || !high) return;
    const [across, up] = this.view.size, half = 0.54 * Math.max(up, across * high / wide);
    Object.assign(this.camera, { left: -half * wide / high, right: half * wide / high, top: half, bottom: -half });
    this.camera.updateProjectionMatrix();
    this.renderer.setPixelRatio(window.devicePixelRatio);
    this.renderer.setSize(wide, high);
    this.size = [wide, high];
    this.draw();
  }

  listen() {
    const { canvas, place, controls } = this;
    controls.addEventListener("change", () => this.ask());
    // The page scrolls unless the viewer is meant.
    place.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey && document.activeElement !== place) event.stopPropagation();
    }, { capture: true });
    canvas.addEventListener("dblclick", () => controls.reset());
    canvas.addEventListener("pointermove", (event) => { if (!event.buttons) this.point(event); });
    canvas.addEventListener("pointerdown", (event) => this.point(event));
    canvas.addEventListener("pointerleave", () => this.name(-1));
    canvas.addEventListener("webglcontextrestored", () => this.ask());
    place.addEventListener("blur", () => this.name(-1));
    const turn = Math.PI / 24;
    const keys = {
      ArrowLeft: () => controls.rotateLeft(turn), ArrowRight: () => controls.rotateLeft(-turn),
      ArrowUp: () => controls.rotateUp(turn), ArrowDown: () => controls.rotateUp(-turn),
      "+": () => controls.dollyIn(1 / 1.2), "=": () => controls.dollyIn(1 / 1.2), "-": () => controls.dollyOut(1 / 1.2),
      Home: () => controls.reset(), Escape: () => place.blur(),
      n: () => this.next(1), p: () => this.next(-1),
    };
    place.addEventListener("keydown", (event) => {
      const act = keys[event.key] || keys[event.key.toLowerCase()];
      if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      act();
    });
  }

  point(event) {
    const box = this.canvas.getBoundingClientRect(), ray = new THREE.Raycaster();
    const [x, y] = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    ray.setFromCamera(new THREE.Vector2(2 * x - 1, 1 - 2 * y), this.camera);
    this.name(this.model.dots.pointed(ray, (this.camera.top - this.camera.bottom) / this.camera.zoom / box.height));
  }

  // Write the names of all dots at the place of one beside it; -1 for none.
  name(number) {
    const { dots } = this.model, all = number < 0 ? [] : dots.together(number).map((k) => dots.names[k]);
    const more = all.length - MOST;
    this.named = number;
    this.tip.textContent = [...all.slice(0, MOST), ...(more > 0 ? [`and ${more} more`] : [])].join("\n");
    this.ask();
  }

  // Name the dots at the next place, or at the previous one.
  next(side) {
    const { dots } = this.model, firsts = dots.names.map((_, k) => k).filter((k) => dots.together(k)[0] === k);
    const now = this.named < 0 ? -1 : firsts.indexOf(dots.together(this.named)[0]);
    const start = now < 0 && side < 0 ? 0 : now;
    if (firsts.length) this.name(firsts[(start + side + firsts.length) % firsts.length]);
  }

  follow() {
    this.tip.hidden = !this.tip.textContent;
    if (this.tip.hidden) return;
    const at = new THREE.Vector3().fromBufferAttribute(this.model.dots.geometry.attributes.position, this.named);
    at.project(this.camera);
    const [x, y] = [(1 + at.x) / 2 * this.size[0], (1 - at.y) / 2 * this.size[1]];
    this.tip.style.left = `${Math.min(x + 12, this.size[0] - this.tip.offsetWidth)}px`;
    this.tip.style.top = `${Math.max(Math.min(y - 32, this.size[1] - this.tip.offsetHeight), 0)}px`;
  }

  ask() {
    this.due ||= requestAnimationFrame(() => this.draw());
  }

  draw() {
    cancelAnimationFrame(this.due);
    this.due = 0;
    if (!this.size) return;
    const { renderer, scene = this.model.scene, camera } = this;
    scene.traverse((part) => { if (part.isPoints) part.material.uniforms.ratio.value = renderer.getPixelRatio(); });
    renderer.setViewport(0, 0, ...this.size);
    renderer.clear();
    renderer.render(scene, camera);
    this.corner.draw(renderer, camera);
    this.follow();
    if (this.drawn) this.drawn();
  }
}

function drawViewer(figure, content) {
  const part = (name) => figure.querySelector(name);
  const place = part(".drawing"), play = part(".play"), key = part(".key"), facts = part(".facts"), paper = part(".paper");
  const layers = part("select.layer"), modes = part("select.mode"), stages = part("select.stage");
  const context = document.createElement("canvas").getContext("webgl2", { antialias: true });
  if (!context) {
    part(".controls").hidden = true;
    paper.remove();
    place.textContent = "This browser cannot draw in space (WebGL); the other figures show the same results.";
    place.classList.add("missing");
    return;
  }
  const stage = new Stage(place, content, context);
  if (content.stages.length) layers.add(new Option("Mode shapes", "modes"));
  content.layers.forEach((layer) => layers.add(new Option(layer.title, layer.name)));
  content.stages.forEach(({ name }, k) => stages.add(new Option(name, k)));
  content.stages.slice(0, 1).forEach((first) => first.modes.forEach(({ name }) => modes.add(new Option(name, name))));
  let request = 0, started = null, saving = 0;

  const chosen = () => content.stages[stages.value].modes.find(({ name }) => name === modes.value);
  const keyOf = (entries) => entries.map(({ colour, words }) => {
    const entry = document.createElement("span"), swatch = document.createElement("i");
    swatch.style.background = colour;
    entry.append(swatch, words);
    return entry;
  });
  const choose = () => {
    const moving = layers.value === "modes", { colours } = content;
    for (const control of [modes.parentElement, stages.parentElement, play]) control.hidden = !moving;
    if (moving) {
      const mode = chosen();
      stage.model.mode(mode);
      stage.model.move(1);
      facts.textContent = mode.words;
      place.setAttribute("aria-label", `Mode shape ${content.stages[stages.value].name}: ${mode.words}`);
      const entries = { rest: "model at rest", model: "model", measured: "measured" };
      key.replaceChildren(...keyOf(Object.entries(entries).map(([name, words]) => ({ colour: colours[name], words }))));
    } else {
      pause();
      const layer = content.layers.find(({ name }) => name === layers.value);
      stage.model.layer(layer);
      facts.textContent = layer.words;
      place.setAttribute("aria-label", `${layer.title}: ${layer.words}`);
      key.replaceChildren(...keyOf(layer.key));
    }
    stage.name(-1);
    stage.draw();
  };
  const step = (now) => {
    request = requestAnimationFrame(step);
    started ??= now;
    stage.model.move(Math.cos(2 * Math.PI * (now - started) / PERIOD));
    stage.draw();
  };
  function pause() {
    cancelAnimationFrame(request);
    request = 0;
    started = null;
    play.textContent = "Play";
    play.setAttribute("aria-pressed", "false");
  }
  // WebGL does not print: an image of what is shown, once it is still, stands in for it on paper.
  const keep = () => {
    stage.draw();  // a picture can be read in the same task only
    clearTimeout(saving);
    paper.src = stage.canvas.toDataURL("image/png");
    paper.alt = place.getAttribute("aria-label");
  };
  stage.drawn = () => {
    clearTimeout(saving);
    if (!request) saving = setTimeout(keep, 400);
  };

  layers.addEventListener("change", choose);
  for (const choice of [modes, stages]) choice.addEventListener("change", choose);
  part(".reset").addEventListener("click", () => stage.controls.reset());
  play.addEventListener("click", () => {
    if (request) {
      pause();
      stage.ask();
      return;
    }
    play.textContent = "Pause";
    play.setAttribute("aria-pressed", "true");
    request = requestAnimationFrame(step);
  });
  document.addEventListener("visibilitychange", () => { if (document.hidden) pause(); });
  window.addEventListener("beforeprint", () => {
    pause();
    keep();
  });
  choose();
  keep();
}

for (const figure of document.querySelectorAll("figure.viewer")) {
  drawViewer(figure, JSON.parse(figure.querySelector("script[type='application/json']").textContent));
  figure.dataset.drawn = "yes";
}
