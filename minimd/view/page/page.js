// The page: a scene drawn by NGL, and its controls.

const $ = (id) => document.getElementById(id);
const read = (id) => Uint8Array.from(atob($(id).textContent), (letter) => letter.charCodeAt(0)).buffer;
const MARKED = "#ff2d95", BOND = 0.25, GHOST = 0.25; // radius of a bond beside that of an atom, opacity of atoms that are not marked
const MARGIN = 1.08; // size of the scene beside that of what is in it

const rgb = (color) => [1, 3, 5].map((at) => parseInt(color.slice(at, at + 2), 16) / 255); // NGL.Color would make it linear, and darker on the screen

class Scene {
  constructor(element, motion) {
    this.motion = motion;
    this.stage = new NGL.Stage(element, { impostor: true, clipDist: 0, fogNear: 60, fogFar: 110, tooltip: false, lightIntensity: 1.35, ambientIntensity: 0.4, cameraType: "orthographic" });
    this.stage.mouseControls.remove("hoverPick");
    this.marked = motion.about.marked;
    this.positions = new Float32Array(3 * motion.nAtoms);
    this.addAtoms();
    if (motion.bonds.length) this.addBonds();
    this.addCell();
    if (this.marked.length) this.addMarks();
  }

  add(buffer, parameters = {}) {
    const shape = new NGL.Shape("shape");
    shape.addBuffer(buffer);
    return this.stage.addComponentFromObject(shape).addRepresentation("buffer", parameters);
  }

  colorsOf(atoms) {
    const known = this.motion.about.colors.map(rgb);
    return Float32Array.from(atoms, (i) => this.motion.species[i]).reduce((all, kind, k) => (all.set(known[kind], 3 * k), all), new Float32Array(3 * atoms.length));
  }

  radiiOf(size) {
    return Float32Array.from(this.motion.species, (kind) => size * this.motion.about.radii[kind]);
  }

  addAtoms() {
    const atoms = Array.from({ length: this.motion.nAtoms }, (_, i) => i);
    this.motion.positions(0, this.positions);
    this.atoms = new NGL.SphereBuffer({ position: this.positions, color: this.colorsOf(atoms), radius: this.radiiOf(1) });
    this.atomsShown = this.add(this.atoms);
  }

  addBonds() {
    const ends = this.motion.bonds, color = this.colorsOf(ends);
    this.start = new Float32Array(3 * ends.length);
    this.end = new Float32Array(3 * ends.length);
    this.motion.halves(0, this.positions, this.start, this.end);
    const radius = new Float32Array(ends.length).fill(BOND * Math.min(...this.motion.about.radii));
    this.bonds = new NGL.CylinderBuffer({ position1: this.start, position2: this.end, color, color2: color, radius }, { openEnded: true, disableImpostor: true, radialSegments: 10 }); // flat ones are not drawn by every graphics driver
    this.bondsShown = this.add(this.bonds);
  }

  addCell() {
    const lines = edgesOf(this.motion.about.box);
    if (!lines.length) return;
    const color = new Float32Array(3 * lines.length).fill(0.5);
    const [position1, position2] = [0, 1].map((side) => Float32Array.from(lines.flatMap((line) => line[side])));
    this.cellShown = this.add(new NGL.WidelineBuffer({ position1, position2, color, color2: color }, { linewidth: 2 }));
  }

  addMarks() {
    const n = this.marked.length, color = new Float32Array(3 * n), pink = rgb(MARKED);
    for (let k = 0; k < n; k++) color.set(pink, 3 * k);
    const radius = Float32Array.from(this.marked, (i) => this.motion.about.radii[this.motion.species[i]]);
    this.marks = new NGL.SphereBuffer({ position: new Float32Array(3 * n), color, radius });
    this.marksShown = this.add(this.marks);
    const position = new Float32Array(3 * n), size = radius.map((r) => 1.4 * r);
    this.labels = new NGL.TextBuffer({ position, size, color, text: this.motion.about.names }, { attachment: "bottom-left", zOffset: 4 * radius[0], showBackground: true, backgroundColor: "white" });
    this.add(this.labels);
    if (n === 2) {
      this.line = new NGL.WidelineBuffer({ position1: new Float32Array(3), position2: new Float32Array(3), color: color.slice(0, 3), color2: color.slice(0, 3) }, { linewidth: 4 });
      this.add(this.line);
    }
  }

  show(frame) {
    this.motion.positions(frame, this.positions);
    this.atoms.setAttributes({ position: this.positions });
    if (this.bonds) {
      this.motion.halves(frame, this.positions, this.start, this.end);
      this.bonds.setAttributes({ position: this.start, position1: this.start, position2: this.end });
    }
    if (this.marks) this.showMarks(frame);
    this.stage.viewer.requestRender();
  }

  /** The second atom of a pair is drawn where its nearest image is. */
  showMarks(frame) {
    const [i, j] = this.marked, first = Array.from(this.positions.slice(3 * i, 3 * i + 3));
    const points = [first];
    if (j !== undefined) points.push(this.motion.separation(frame, i, j).map((x, d) => x + first[d]));
    const position = Float32Array.from(points.flat());
    this.marks.setAttributes({ position });
    this.labels.setAttributes({ position });
    if (this.line) this.line.setAttributes({ position: position.slice(0, 3), position1: position.slice(0, 3), position2: position.slice(3) });
    this.target = points[0].map((x, d) => points.reduce((sum, point) => sum + point[d], 0) / points.length);
  }

  setSize(size) {
    this.atoms.setAttributes({ radius: this.radiiOf(size) });
    this.stage.viewer.requestRender();
  }

  /** Turned a little, and everything in it: as wide and as high as it then is. */
  showAll() {
    const turn = new NGL.Quaternion().setFromEuler(new NGL.Euler(0.45, -0.35, 0));
    const points = [...edgesOf(this.motion.about.box).flat()];
    for (let i = 0; i < this.positions.length; i += 3) points.push(this.positions.subarray(i, i + 3));
    const turned = points.map((point) => new NGL.Vector3(...point).applyQuaternion(turn).toArray());
    const bounds = (d, best) => turned.reduce((found, point) => best(found, point[d]), turned[0][d]);
    const [low, high] = [Math.min, Math.max].map((best) => [0, 1, 2].map((d) => bounds(d, best)));
    const diameter = 2 * Math.max(...this.motion.about.radii);
    const [wide, tall, deep] = low.map((x, d) => high[d] - x + diameter);
    const { width, height, perspectiveCamera } = this.stage.viewer;
    const size = Math.max(tall, (wide * height) / width, 0.7 * deep); // nearer, the camera would be inside
    const center = new NGL.Vector3(...low.map((x, d) => (x + high[d]) / 2)).applyQuaternion(turn.clone().invert());
    this.stage.viewerControls.rotate(turn);
    this.stage.animationControls.zoomMove(center, (-0.5 * MARGIN * size) / Math.tan((perspectiveCamera.fov * Math.PI) / 360), 0);
  }

  goToMarks() {
    this.lookAt(this.target, 12 * Math.max(...this.motion.about.radii));
  }

  /** Bring a cube of that size about a point onto the screen. */
  lookAt(point, size) {
    const center = new NGL.Vector3(...point), half = 0.5 * size;
    const box = new NGL.Box3(center.clone().subScalar(half), center.clone().addScalar(half));
    this.stage.animationControls.zoomMove(center, this.stage.getZoomForBox(box), 0);
  }
}

/** The edges of the parallelepiped, parallelogram or line of up to three vectors, from the origin: pairs of points. */
function edgesOf(vectors) {
  const lines = [];
  for (let corner = 0; corner < 1 << vectors.length; corner++) {
    const point = [0, 1, 2].map((d) => vectors.reduce((sum, vector, k) => sum + ((corner >> k) & 1 ? vector[d] : 0), 0));
    vectors.forEach((vector, k) => (corner >> k) & 1 || lines.push([point, point.map((x, d) => x + vector[d])]));
  }
  return lines;
}

class Player {
  constructor(motion, show) {
    Object.assign(this, { motion, show, frame: 0, isPlaying: false });
    $("frame").max = motion.nFrames - 1;
    const controls = { first: () => this.stop(0), back: () => this.stop(this.frame - 1), forward: () => this.stop(this.frame + 1), last: () => this.stop(motion.nFrames - 1) };
    for (const [id, act] of Object.entries(controls)) $(id).onclick = act;
    $("play").onclick = () => (this.isPlaying ? this.stop(this.frame) : this.start());
    $("frame").oninput = () => this.stop(Number($("frame").value));
  }

  go(frame) {
    this.frame = Math.max(0, Math.min(this.motion.nFrames - 1, frame));
    this.show(this.frame);
    $("frame").value = this.frame;
    $("time").textContent = this.words();
    $("frame").setAttribute("aria-valuetext", this.words());
  }

  words() {
    const { steps, times, temperatures, units } = this.motion.about, k = this.frame;
    const heat = temperatures[k] === null ? "" : `, T = ${Number(temperatures[k].toPrecision(4))} ${units.temperature}`;
    return `frame ${k + 1} of ${this.motion.nFrames}: step ${steps[k]}, t = ${Number(times[k].toPrecision(6))} ${units.time}${heat}`;
  }

  stop(frame) {
    this.isPlaying = false;
    $("play").textContent = "Play";
    this.go(frame);
  }

  start() {
    this.isPlaying = true;
    $("play").textContent = "Pause";
    if (this.frame === this.motion.nFrames - 1) this.go(0);
    this.due = performance.now() + 1000 / Number($("speed").value);
    requestAnimationFrame((now) => this.tick(now));
  }

  tick(now) {
    if (!this.isPlaying) return;
    if (now >= this.due) {
      this.due = now + 1000 / Number($("speed").value);
      const isLast = this.frame === this.motion.nFrames - 1;
      if (isLast && !$("repeat").checked) return this.stop(this.frame);
      this.go(isLast ? 0 : this.frame + 1);
    }
    requestAnimationFrame((next) => this.tick(next));
  }
}

function connectScene(scene) {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const paint = () => scene.stage.setParameters({ backgroundColor: dark.matches ? "#16191d" : "#ffffff" });
  dark.onchange = paint;
  paint();
  const toggle = (id, shown, label) => {
    $(label || id).closest("label").hidden = !shown;
    if (shown) $(id).onchange = () => shown.setVisibility($(id).checked);
  };
  toggle("cell", scene.cellShown);
  toggle("bonds", scene.bondsShown);
  $("others-label").hidden = $("pair").hidden = !scene.marks;
  $("others").onchange = () => scene.atomsShown.setVisibility($("others").checked);
  $("size").value = scene.bonds ? 0.55 : 0.8;
  $("size").oninput = () => scene.setSize(Number($("size").value));
  $("reset").onclick = () => scene.showAll();
  $("pair").onclick = () => scene.goToMarks();
  $("scene").onkeydown = (event) => {
    const turn = { ArrowLeft: [0, -1, 0], ArrowRight: [0, 1, 0], ArrowUp: [-1, 0, 0], ArrowDown: [1, 0, 0] }[event.key];
    if (turn) scene.stage.viewerControls.spin(turn, 0.1);
    else if (event.key === "+" || event.key === "=") scene.stage.viewerControls.zoom(0.1);
    else if (event.key === "-") scene.stage.viewerControls.zoom(-0.1);
    else if (event.key === "Home") scene.showAll();
    else return;
    event.preventDefault();
  };
  new ResizeObserver(() => scene.stage.handleResize()).observe($("scene"));
  scene.setSize(Number($("size").value));
}

function connectPictures() {
  let zoom = 1;
  const set = (value) => {
    zoom = Math.max(0.5, Math.min(8, value));
    $("picture").style.width = `${100 * zoom}%`;
    $("pictures").style.maxHeight = zoom > 1 ? "90vh" : "none";
    $("zoom").textContent = `${Math.round(100 * zoom)} %`;
  };
  $("smaller").onclick = () => set(zoom / 1.25);
  $("larger").onclick = () => set(zoom * 1.25);
  $("fit").onclick = () => set(1);
  $("picture").ondblclick = () => set(zoom > 1 ? 1 : 2.5);
}

function begin() {
  const about = JSON.parse($("about").textContent);
  const motion = new Motion(about, new Uint16Array(read("counts")), new Uint32Array(read("species")), new Uint32Array(read("bond-pairs")));
  connectPictures();
  let scene = null;
  const player = new Player(motion, (frame) => scene && scene.show(frame));
  globalThis.minimd = { motion, player };
  if (document.createElement("canvas").getContext("webgl2")) globalThis.minimd.scene = scene = new Scene($("scene"), motion);
  else {
    $("scene").hidden = $("shown").hidden = true;
    $("scene-error").hidden = false;
  }
  player.go(about.marked.length ? motion.nFrames - 1 : 0);
  if (!scene) return;
  connectScene(scene);
  scene.showAll();
  if (scene.marks) {
    scene.atomsShown.setParameters({ opacity: GHOST });
    scene.goToMarks();
  }
}

begin();
