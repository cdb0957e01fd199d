// The viewer: draws what psmpc_cli/report/view.py packed, at one time for all its parts. SI units, angles in rad.
"use strict";
(() => {
const $ = (id) => document.getElementById(id);
const element = (parent, tag, className = "", text = "") => {
  const made = document.createElement(tag);
  made.className = className;
  made.textContent = text;
  return parent.appendChild(made);
};
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

// ---- the data

const runs = JSON.parse($("data").textContent, (key, value) => { // packed arrays as rows of numbers
  if (value?.data === undefined) return value;
  const bytes = Uint8Array.from(atob(value.data), (char) => char.charCodeAt(0));
  const array = new (value.type === "f8" ? Float64Array : Float32Array)(bytes.buffer), { shape } = value, size = shape.slice(1).reduce((a, b) => a * b, 1);
  return { array, shape, row: (i) => array.subarray(i * size, (i + 1) * size) };
});

function before(times, t) { // the last row at or before t
  let low = 0, high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= t + 1e-9) low = middle; else high = middle - 1;
  }
  return low;
}

function interpolated(times, rows, t, quaternion = -1) { // a row of numbers at a time; a quaternion from one column on
  const i = before(times, t), j = Math.min(i + 1, times.length - 1), gap = times[j] - times[i];
  const s = gap > 0 ? clamp((t - times[i]) / gap, 0, 1) : 0, a = rows(i), b = rows(j);
  const found = Array.from(a, (x, k) => x + s * (b[k] - x)), turn = (row) => new THREE.Quaternion().fromArray(row, quaternion);
  if (quaternion >= 0) turn(a).slerp(turn(b), s).toArray(found, quaternion); // in any order of its numbers
  return found;
}
const attitudeAt = (run) => (run.robot.spatial ? 3 : -1);
const coordinates = (run, t) => interpolated(run.time.array, (i) => run.Q.row(i), t, attitudeAt(run));
const endOf = (run) => run.time.array.at(-1);
const sampleAt = (run, t) => before(run.samples.array, t);

function planned(run, t) { // the stages that are to end, and when, as the sample at or before t planned it
  return Array.from(run.instants.row(sampleAt(run, t)), (time, s) => [s, time]).filter(([, time]) => time >= t - 1e-9);
}

// ---- robots in three dimensions

const material = (color, opacity) => new THREE.MeshLambertMaterial({ color, transparent: opacity < 1, opacity, depthWrite: opacity > 0.5, polygonOffset: opacity < 1, polygonOffsetFactor: 2, polygonOffsetUnits: 2 });
const EDGE = 0x3a4046, INK = 0x1b1f24, OVERLAP = 0xc01818, AXES = ["#d62728", "#2a9d3a", "#1f4fd8"];

function mesh(parent, geometry, color, opacity, outlined = false) {
  const made = new THREE.Mesh(geometry, material(color, opacity));
  if (outlined) made.add(new THREE.LineSegments(new THREE.EdgesGeometry(geometry), new THREE.LineBasicMaterial({ color: EDGE, transparent: true, opacity })));
  parent.add(made);
  return made;
}

function put(object, { position, quaternion }) { // where the data have it
  object.position.set(...position);
  object.quaternion.set(...quaternion);
  return object;
}

function capsule(parent, [from, to], radius, color, opacity, detail = 1) {
  const start = new THREE.Vector3(...from), line = new THREE.Vector3(...to).sub(start);
  const made = mesh(parent, new THREE.CapsuleGeometry(radius, line.length(), 6 * detail, 16 * detail), color, opacity);
  made.position.copy(start).addScaledVector(line, 0.5);
  made.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), line.normalize());
  return made;
}

function turned(profile, segments = 24) { // a solid of revolution about y, from points [radius, y] upwards
  const corners = [], at = ([radius, y], k) => [radius * Math.cos((2 * Math.PI * k) / segments), y, radius * Math.sin((2 * Math.PI * k) / segments)];
  for (let k = 0; k < segments; k++) {
    profile.slice(1).forEach((to, i) => corners.push(at(profile[i], k), at(to, k), at(to, k + 1), at(profile[i], k), at(to, k + 1), at(profile[i], k + 1)));
  }
  const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(corners.flat()), 3));
  geometry.computeVertexNormals();
  return geometry;
}

function triad(parent, length, thick) { // axes of a frame, seen through what lies before them
  return AXES.map((emissive, axis) => {
    const sizes = [0, 1, 2].map((k) => (k === axis ? length : thick)), look = { color: 0, emissive, transparent: true, depthTest: false };
    const made = new THREE.Mesh(new THREE.BoxGeometry(...sizes), new THREE.MeshLambertMaterial(look));
    made.position.setComponent(axis, length / 2);
    parent.add(made);
    return made;
  });
}

class Robot { // a tree of groups, one for each body, then one for each end-effector
  constructor(run, opacity = 1, tint = null) {
    const { bodies, tools, box, colors, radius, coverColor } = run.robot;
    const covered = opacity > 0.3 ? bodies : []; // ghosts and probes do without
    this.run = run;
    this.group = new THREE.Group();
    this.bodies = bodies.map((body) => put(new THREE.Group(), body));
    bodies.forEach((body, i) => {
      const group = this.bodies[i], color = tint || colors[body.part];
      (i ? this.bodies[body.body] : this.group).add(group);
      for (const line of body.capsules) capsule(group, line, radius, color, opacity);
      if (i && !body.prismatic) mesh(group, new THREE.SphereGeometry(1.45 * radius, 20, 14), tint || EDGE, opacity);
    });
    put(mesh(this.bodies[0], new THREE.BoxGeometry(...box.half.map((x) => 2 * x)), tint || colors[0], opacity, true), box);
    this.tools = tools.map((tool) => {
      const group = put(new THREE.Group(), tool), carrier = this.bodies[tool.body], color = tint || colors[bodies[tool.body].part];
      for (let i = 0; i < 3; i++) capsule(carrier, tool.gripper.slice(i, i + 2), 0.45 * radius, color, opacity);
      carrier.add(group);
      return group;
    });
    this.covers = covered.flatMap((body, i) => body.covers.map((cover) => capsule(this.bodies[i], cover.ends, cover.radius, coverColor, 0.22, 2)));
    this.triads = opacity > 0.3 ? this.frames.flatMap((frame) => triad(frame, 4 * radius, 0.55 * radius)) : [];
    if (run.object && opacity > 0.3) this.object = mesh(this.group, new THREE.BoxGeometry(...run.object.size), run.robot.objectColor, opacity, true);
  }

  place(Q) {
    const { bodies, spatial } = this.run.robot;
    if (spatial) put(this.bodies[0], { position: Q.slice(0, 3), quaternion: [Q[4], Q[5], Q[6], Q[3]] });
    else put(this.bodies[0], { position: [Q[0], Q[1], 0], quaternion: [0, 0, Math.sin(Q[2] / 2), Math.cos(Q[2] / 2)] });
    bodies.slice(1).forEach((body, i) => {
      const q = Q[i + (spatial ? 7 : 3)], axis = new THREE.Vector3(...body.axis), group = put(this.bodies[i + 1], body);
      if (body.prismatic) group.position.addScaledVector(axis.applyQuaternion(group.quaternion), q);
      else group.quaternion.multiply(new THREE.Quaternion().setFromAxisAngle(axis, q));
    });
    this.group.updateMatrixWorld(true);
    return this;
  }

  placeAt(t) {
    const { run } = this;
    this.place(coordinates(run, t));
    if (this.object) {
      const pose = interpolated(run.time.array, (i) => run.object.pose.row(i), t, 3);
      put(this.object, { position: pose.slice(0, 3), quaternion: pose.slice(3) });
      this.object.material.opacity = run.object.lost !== null && t >= run.object.lost ? 0.3 : 1;
      this.object.material.transparent = true;
    }
    return this;
  }

  get frames() { // the base and the end-effectors
    return [this.bodies[0], ...this.tools];
  }

  blocks(project) { // rectangles around its parts as they are seen: left, top, right, bottom
    const { bodies, box, radius } = this.run.robot, found = [];
    const add = (points) => {
      const seen = points.map(project), [xs, ys] = [0, 1].map((k) => seen.map((point) => point[k]));
      found.push([Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)]);
    };
    const around = (at) => [-1, 1].flatMap((x) => [-1, 1].flatMap((y) => [-1, 1].map((z) => at.clone().add(new THREE.Vector3(x, y, z).multiplyScalar(radius)))));
    bodies.forEach((body, i) => {
      for (const line of body.capsules) {
        const [from, to] = line.map((end) => this.bodies[i].localToWorld(new THREE.Vector3(...end)));
        for (let k = 0; k <= 8; k++) add(around(from.clone().lerp(to, k / 8)));
      }
    });
    for (const tool of this.tools) add(around(new THREE.Vector3().setFromMatrixPosition(tool.matrixWorld)));
    const boxed = (frame, half) => [-1, 1].flatMap((x) => [-1, 1].flatMap((y) => [-1, 1].map((z) => frame.localToWorld(new THREE.Vector3(x * half[0], y * half[1], z * half[2])))));
    const base = put(new THREE.Group(), box);
    this.bodies[0].add(base);
    base.updateWorldMatrix(true, false);
    add(boxed(base, box.half));
    this.bodies[0].remove(base);
    if (this.object) add(boxed(this.object, this.run.object.size.map((edge) => edge / 2)));
    return found;
  }

  positions() {
    return this.frames.map((frame) => new THREE.Vector3().setFromMatrixPosition(frame.matrixWorld));
  }
}

class Track { // polylines of base and end-effectors
  constructor(parent, colors, radius, dashed, faint) {
    this.lines = colors.map((color) => {
      const look = { color, transparent: faint, opacity: faint ? 0.45 : 1, linewidth: dashed ? 2 : 2.2, dashed, dashSize: 2.4 * radius, gapSize: 1.8 * radius };
      const line = new THREE.Line2(new THREE.LineGeometry(), new THREE.LineMaterial(look));
      line.frustumCulled = false;
      parent.add(line);
      return line;
    });
  }

  set(points) { // by time, then by frame
    this.lines.forEach((line, f) => {
      line.geometry.dispose();
      line.geometry = new THREE.LineGeometry().setPositions(points.flatMap((row) => row[f].toArray()));
      line.computeLineDistances();
    });
  }
}

class Obstacle { // in uniform motion from where it is at the start
  constructor(parent, { name, position, quaternion, velocity, box, ends, radius, opacity }, color) {
    Object.assign(this, { name, start: new THREE.Vector3(...position), velocity: new THREE.Vector3(...velocity) });
    this.group = put(new THREE.Group(), { position, quaternion });
    if (box) mesh(this.group, new THREE.BoxGeometry(...box), color, opacity, true);
    else capsule(this.group, ends, radius, color, opacity, 3);
    parent.add(this.group);
  }

  placeAt(t) {
    this.group.position.copy(this.start).addScaledVector(this.velocity, t);
  }
}

class Nearest { // the two parts that are nearest to each other at a sample: a line between their points
  constructor(parent, run) {
    this.run = run;
    this.group = new THREE.Group();
    const look = { color: 0, depthTest: false, transparent: true }; // seen through what lies before it
    this.line = new THREE.Line2(new THREE.LineGeometry(), new THREE.LineMaterial({ ...look, linewidth: 3 }));
    this.line.frustumCulled = false;
    this.ends = [0, 1].map(() => new THREE.Mesh(new THREE.SphereGeometry(0.35 * run.robot.radius, 12, 8), new THREE.MeshLambertMaterial(look)));
    this.group.add(this.line, ...this.ends);
    this.group.renderOrder = 1;
    parent.add(this.group);
  }

  seek(t) {
    const { time, distance, points, pair, names } = this.run.nearest, k = before(time.array, t), ends = points.row(k);
    this.distance = distance.array[k];
    this.group.visible = $("show-nearest").checked && Number.isFinite(this.distance);
    if (!this.group.visible) return;
    this.text = `${(1e3 * this.distance).toFixed(0)} mm, ${names[pair[k]]}`;
    this.line.geometry.dispose();
    this.line.geometry = new THREE.LineGeometry().setPositions(Array.from(ends));
    this.ends.forEach((end, i) => end.position.set(...ends.subarray(3 * i, 3 * i + 3)));
    const color = this.distance < 0 ? OVERLAP : INK;
    this.line.material.color.set(color);
    for (const end of this.ends) end.material.emissive.set(color);
  }

  get captions() { // text, where, look
    if (!this.group.visible) return [];
    return [[this.text, this.ends[0].position.clone().lerp(this.ends[1].position, 0.5), this.distance < 0 ? "near overlap" : "near"]];
  }
}

const SHUT = 0xc01818, NOZZLE = 0x3a4046, FLAME = 0xff8a1f, FILLED = [0x1b7f79, 0xf4f4f4, 0x7b2d8b]; // wheels: full one way, empty, full the other way

class Thrusters { // on the base: nozzles, and flames as long as their thrust
  constructor(base, { robot, thrusters }) {
    const { radius, box } = robot, full = 0.7 * Math.max(...box.half) + 6 * radius;
    this.data = thrusters;
    this.group = new THREE.Group();
    this.each = thrusters.nozzles.map((nozzle, i) => {
      const group = new THREE.Group(), at = new THREE.Vector3(...nozzle);
      group.position.copy(at);
      group.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), new THREE.Vector3(...thrusters.axes[i]));
      const bell = mesh(group, turned([[0, -1.2 * radius], [0.35 * radius, -1.2 * radius], [0.9 * radius, 0.3 * radius], [0, 0.3 * radius]]), NOZZLE, 1);
      const flame = mesh(group, turned([[0, 0], [1, 0.25], [0, 1]]), FLAME, 0.85);
      for (const part of [bell, flame]) Object.assign(part.material, { depthTest: false, transparent: true });
      flame.renderOrder = 1;
      bell.renderOrder = 2;
      this.group.add(group);
      return { group, bell, flame, size: (share) => flame.scale.set((0.5 + share) * radius, Math.max(share * full, 1e-6), (0.5 + share) * radius) };
    });
    base.add(this.group);
  }

  seek(t) {
    const k = before(this.data.time.array, t), share = this.data.share.row(k), shut = this.data.shut?.row(k);
    this.group.visible = $("show-thrusters").checked;
    this.each.forEach(({ bell, flame, size }, i) => {
      size(share[i]);
      flame.visible = share[i] > 0;
      bell.material.color.set(shut?.[i] > 0 ? SHUT : NOZZLE);
    });
  }
}

class Wheels { // on the base: discs across their axes, in the colour of what they store
  constructor(base, { robot, wheels }) {
    const { radius, box, spatial } = robot, size = 0.3 * Math.max(...box.half), outward = (along) => Math.min(...box.half.map((half, k) => half / Math.max(Math.abs(along.getComponent(k)), 1e-6)));
    this.data = wheels;
    this.group = new THREE.Group();
    this.discs = wheels.axes.map((axis, i) => {
      const along = new THREE.Vector3(...axis), disc = mesh(this.group, turned([[0, -0.4 * radius], [size, -0.4 * radius], [size, 0.4 * radius], [0, 0.4 * radius]], 32), FILLED[1], 1, true);
      disc.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), along);
      disc.position.set(...box.position);
      if (spatial) disc.position.addScaledVector(along, outward(along) + size); // outside of the box: a robot's file does not say where they are
      else disc.position.add(new THREE.Vector3(2.4 * size * (i - (wheels.axes.length - 1) / 2), 0, box.half[2] + radius));
      return disc;
    });
    base.add(this.group);
  }

  seek(t) {
    const share = interpolated(this.data.time.array, (i) => this.data.share.row(i), t);
    this.group.visible = $("show-wheels").checked;
    this.discs.forEach((disc, i) => {
      const [low, none, high] = FILLED.map((color) => disc.material.color.clone().set(color));
      disc.material.color.copy(none).lerp(share[i] < 0 ? low : high, Math.min(Math.abs(share[i]), 1));
    });
  }
}

class Actor { // one run in the scene: robot, object, obstacles, path so far, plan from here, targets, nearest parts
  constructor(run, faint) {
    this.run = run;
    this.group = new THREE.Group();
    const frames = [run.robot.baseColor, ...run.robot.tools.map((tool) => run.robot.colors[run.robot.bodies[tool.body].part])];
    this.robot = new Robot(run, faint ? 0.5 : 1);
    this.probe = new Robot(run, 0);
    this.path = new Track(this.group, frames, run.robot.radius, false, faint);
    this.plan = new THREE.Group();
    this.future = new Track(this.plan, frames, run.robot.radius, true, faint);
    this.ghosts = run.plans ? [...run.stages.map((stage) => stage.color), "#9AA3AB"].map((color) => new Robot(run, 0.28, color)) : [];
    this.targets = new THREE.Group();
    this.marks = run.stages.map(() => frames.map((color) => {
      const mark = mesh(this.targets, new THREE.SphereGeometry(1.2 * run.robot.radius, 20, 14), color, 1);
      mark.axes = triad(mark, 8 * run.robot.radius, 0.3 * run.robot.radius);
      return mark;
    }));
    this.tracked = Array.from(run.time.array, (t) => this.probe.place(coordinates(run, t)).positions());
    this.obstacles = run.obstacles.map((each) => new Obstacle(this.group, each, run.robot.obstacleColor));
    this.nearest = run.nearest && new Nearest(this.group, run);
    this.thrusters = run.thrusters && new Thrusters(this.robot.bodies[0], run);
    this.wheels = run.wheels && new Wheels(this.robot.bodies[0], run);
    this.group.add(this.robot.group, this.plan, this.targets);
    for (const ghost of this.ghosts) this.plan.add(ghost.group);
  }

  seek(now) {
    const { run } = this, t = clamp(now, run.time.array[0], endOf(run)), here = before(run.time.array, t);
    this.robot.placeAt(t);
    this.path.set([...this.tracked.slice(0, here + 1), this.robot.positions()]);
    for (const obstacle of this.obstacles) obstacle.placeAt(t);
    for (const cover of this.robot.covers) cover.visible = $("show-covers").checked;
    for (const part of [this.nearest, this.thrusters, this.wheels]) part?.seek(t);
    this.plan.visible = $("show-plan").checked && this.ghosts.length > 0;
    this.path.lines.forEach((line) => { line.visible = $("show-paths").checked; });
    for (const each of [this.targets, ...this.robot.triads]) each.visible = $("show-targets").checked;
    const aims = run.targets.row(here);
    this.marks.flat().forEach((mark, i) => {
      const pose = aims.subarray(7 * i, 7 * i + 7);
      mark.visible = Number.isFinite(pose[0]);
      mark.position.set(...pose.slice(0, 3));
      const turned = Number.isFinite(pose[3]); // a point has no attitude
      if (turned) mark.quaternion.set(...pose.slice(3));
      mark.axes.forEach((axis) => { axis.visible = turned; });
    });
    if (this.plan.visible) this.seekPlan(t);
  }

  seekPlan(t) {
    const { run } = this, k = sampleAt(run, t), times = run.plans.time.row(k), nq = run.plans.Q.shape[2], Q = run.plans.Q.row(k);
    const at = (time) => interpolated(times, (i) => Q.subarray(i * nq, (i + 1) * nq), time, attitudeAt(run));
    this.future.set([t, ...times.filter((each) => each > t)].map((each) => this.probe.place(at(each)).positions()));
    this.ghosts.forEach((ghost) => { ghost.group.visible = false; });
    this.captions = [];
    const show = (ghost, time, caption) => {
      ghost.place(at(time)).group.visible = true;
      this.captions.push([caption, ghost.positions()[0]]);
    };
    for (const [s, time] of planned(run, t)) show(this.ghosts[s], time, `planned: ${run.stages[s].name} ends, ${time.toFixed(1)} s`);
    const end = times.at(-1);
    if (end > t + 1e-6) show(this.ghosts.at(-1), end, `end of the plan, ${end.toFixed(1)} s`);
  }

  balls() { // around what its robot, its object, obstacles and targets are and will be: centres and radii
    const { object, obstacles, targets, robot: { box: { half }, radius } } = this.run, every = Math.ceil(this.tracked.length / 60), found = [];
    for (const point of obstacles.flatMap((each) => each.around.flat())) found.push([new THREE.Vector3(...point), 0]);
    for (let i = 0; i < this.tracked.length; i += every) {
      this.tracked[i].forEach((p, f) => found.push([p, f ? 4 * radius : Math.hypot(...half)]));
      if (object) found.push([new THREE.Vector3().fromArray(object.pose.row(i)), Math.hypot(...object.size) / 2]);
      const aims = targets.row(i);
      for (let k = 0; k < aims.length; k += 7) if (Number.isFinite(aims[k])) found.push([new THREE.Vector3().fromArray(aims, k), 4 * radius]);
    }
    return found;
  }
}

// ---- the scene

let actors = [], chosen = runs.slice(0, 2), now = 0, dirty = true, world = null; // an actor for each run that is chosen
const several = () => chosen.length > 1, named = (run, text) => (several() ? `${run.name}: ${text}` : text);
const beside = () => several() && !$("overlay").checked;

function openWorld() {
  const canvas = $("canvas"), scene = new THREE.Scene();
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
  renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
  const camera = new THREE.PerspectiveCamera(30, 1, 0.01, 1000);
  camera.up.set(0, 0, 1);
  const controls = new THREE.OrbitControls(camera, canvas);
  controls.addEventListener("change", () => { dirty = true; });
  controls.addEventListener("start", () => { world.moved = true; });
  scene.add(new THREE.HemisphereLight(0xffffff, 0xd5dbe2, 2.3));
  const sun = new THREE.DirectionalLight(0xffffff, 1.3);
  sun.position.set(-2, -3, 6);
  scene.add(sun);
  return { scene, renderer, camera, controls, moved: false, ground: null, axes: [] };
}

function frameMission(tilted) {
  const balls = actors.flatMap((actor) => actor.balls()), [low, high] = [balls[0][0].clone(), balls[0][0].clone()];
  balls.forEach(([point, room]) => { low.min(point.clone().subScalar(room)); high.max(point.clone().addScalar(room)); });
  Object.assign(world, { low, high, tilted, moved: false });
  const { camera, controls } = world, center = low.clone().lerp(high, 0.5);
  const { spatial } = chosen[0].robot;
  const from = tilted ? new THREE.Vector3(spatial ? 0.7 : 0.25, -1, spatial ? 0.75 : 1.05) : new THREE.Vector3(0, -1e-4, 1);
  camera.position.copy(center).add(from.normalize());
  controls.target.copy(center);
  camera.lookAt(center);
  camera.updateMatrixWorld();
  const right = new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, 0), up = new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, 1);
  const tall = Math.tan((camera.fov * Math.PI) / 360), wide = tall * camera.aspect;
  let distance = 0.1;
  for (const [point, room] of balls) {
    const p = point.clone().sub(center);
    distance = Math.max(distance, p.dot(from) + 1.06 * Math.max((Math.abs(p.dot(right)) + room) / wide, (1.12 * (Math.abs(p.dot(up)) + room)) / tall));
  }
  camera.position.copy(center).addScaledVector(from, distance);
  controls.maxDistance = 12 * distance;
  controls.update();
  $("above").setAttribute("aria-pressed", String(!tilted));
  $("tilted").setAttribute("aria-pressed", String(tilted));
  dirty = true;
}

function drawGround() { // squares of a round length below the mission, and the axes of the inertial frame
  world.scene.remove(world.ground);
  const { low, high } = world, step = [0.1, 0.25, 0.5, 1, 2, 5, 10].find((s) => (high.x - low.x + high.y - low.y) / s < 26) || 25;
  const round = (x, up) => step * (up ? Math.ceil(x / step + 0.5) : Math.floor(x / step - 0.5));
  const [x0, x1, y0, y1] = [round(low.x), round(high.x, true), round(low.y), round(high.y, true)], z = low.z - 0.02, points = [];
  for (let x = x0; x <= x1 + step / 2; x += step) points.push(x, y0, z, x, y1, z);
  for (let y = y0; y <= y1 + step / 2; y += step) points.push(x0, y, z, x1, y, z);
  const lines = (numbers, color) => new THREE.LineSegments(new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(numbers), 3)), new THREE.LineBasicMaterial({ color }));
  world.ground = new THREE.Group();
  const { spatial } = chosen[0].robot, inside = [low.x, low.y].map((x) => step * Math.ceil(x / step));
  const corner = [...(spatial ? [x1, y1] : inside), z + 0.01 * step], L = (spatial ? 1 : 0.5) * step;
  const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) => axis.map((x, i) => corner[i] + L * x));
  world.ground.add(lines(points, 0xdde2e7), ...axes.map((axis) => lines([...corner, ...axis], 0x6b7480)));
  const scale = new THREE.Vector3(corner[0] + (spatial ? -5 : 1.1) * step, corner[1], z);
  world.axes = [...axes.map((axis, i) => ["xyz"[i], new THREE.Vector3(...axis)]), [`squares of ${step} m`, scale]];
  world.scene.add(world.ground);
}

function render() {
  const { renderer, scene, camera } = world, canvas = $("canvas");
  const width = canvas.clientWidth, height = canvas.clientHeight, columns = beside() ? actors.length : 1;
  renderer.setScissorTest(true);
  $("labels").replaceChildren();
  world.labels = [];
  world.blocks = [];
  for (let column = 0; column < columns; column++) {
    const left = (column * width) / columns;
    renderer.setViewport(left, 0, width / columns, height);
    renderer.setScissor(left, 0, width / columns, height);
    actors.forEach((actor, i) => { actor.group.visible = columns === 1 || i === column; });
    renderer.render(scene, camera);
    camera.updateMatrixWorld();
    const project = (point) => {
      const p = point.clone().project(camera);
      return [left + ((p.x + 1) / 2) * (width / columns), ((1 - p.y) / 2) * height];
    };
    const shown = actors.filter((actor) => actor.group.visible), planned = shown.filter((actor) => actor.plan.visible);
    const robots = [...shown.map((actor) => actor.robot), ...planned.flatMap((actor) => actor.ghosts.filter((ghost) => ghost.group.visible))];
    world.blocks.push(...robots.flatMap((robot) => robot.blocks(project)));
    const buttons = $("camera"), { offsetLeft, offsetTop, offsetWidth, offsetHeight } = buttons;
    world.blocks.push([offsetLeft, offsetTop, offsetLeft + offsetWidth, offsetTop + offsetHeight]);
    if (several()) world.blocks.push([left, 0, left + 200, 28]);
    for (const [name, at] of world.axes) label(name, at, left, width / columns, height, name.length > 1 ? "ground" : "");
    const seen = actors.filter((actor) => actor.group.visible && actor.plan.visible && width / columns > 480);
    for (const [name, at] of seen.flatMap((actor) => actor.captions)) label(name, at, left, width / columns, height, "planned");
    const drawn = actors.filter((actor) => actor.group.visible);
    for (const { name, group } of drawn.flatMap((actor) => actor.obstacles)) label(name, group.position, left, width / columns, height, "ground");
    for (const [name, at, look] of drawn.flatMap((actor) => actor.nearest?.captions ?? [])) label(name, at, left, width / columns, height, look);
    if (several()) element($("labels"), "span", "caption", columns > 1 ? chosen[column].name : `${chosen[0].name}; paler: ${chosen[1].name}`).style.transform = `translate(${left + 10}px, 6px)`;
  }
}

const DIRECTIONS = [[1, 0], [1, -1], [1, 1], [0, -1], [0, 1], [-1, -1], [-1, 1], [-1, 0]];

function label(name, at, left, width, height, look = "") { // beside its point, or as near to it as it covers neither robot nor label
  const p = at.clone().project(world.camera), x = left + ((p.x + 1) / 2) * width, y = ((1 - p.y) / 2) * height;
  if (Math.abs(p.x) > 1 || Math.abs(p.y) > 1 || p.z > 1) return;
  const text = element($("labels"), "span", look, name), wide = text.offsetWidth, high = text.offsetHeight;
  const taken = [...world.blocks, ...world.labels], box = (cx, cy) => [cx - wide / 2, cy - high / 2, cx + wide / 2, cy + high / 2];
  const isFree = ([x0, y0, x1, y1]) => x0 >= left && x1 <= left + width && y0 >= 0 && y1 <= height
    && taken.every(([a0, b0, a1, b1]) => x1 <= a0 || a1 <= x0 || y1 <= b0 || b1 <= y0);
  let place = null;
  for (let away = 4; !place && away < Math.max(width, height); away += 8) {
    const tried = DIRECTIONS.map(([dx, dy]) => box(x + dx * (away + wide / 2), y + dy * (away + high / 2)));
    place = tried.find(isFree);
  }
  if (!place) return text.remove(); // the scene is full: a label over the robot would hide it
  world.labels.push(place);
  text.style.transform = `translate(${place[0]}px, ${place[1]}px)`;
  const end = [clamp(x, place[0], place[2]), clamp(y, place[1], place[3])], length = Math.hypot(end[0] - x, end[1] - y);
  if (length < 14) return;
  const leader = element($("labels"), "i", "leader");
  Object.assign(leader.style, { width: `${length}px`, transform: `translate(${x}px, ${y}px) rotate(${Math.atan2(end[1] - y, end[0] - x)}rad)` });
}

function resize() {
  const canvas = $("canvas"), { clientWidth, clientHeight } = canvas;
  world.renderer.setSize(clientWidth, clientHeight, false);
  world.camera.aspect = clientWidth / (beside() ? 2 : 1) / clientHeight;
  world.camera.updateProjectionMatrix();
  if (!world.moved) frameMission(world.tilted);
  dirty = true;
}

// ---- plots

let plots = [], tab = runs[0].plots[0].name;
const panelsOf = (run) => (run.plots.find((each) => each.name === tab) || { panels: [] }).panels;
const values = (packed, log) => Array.from(packed.array, (x) => (Number.isFinite(x) && (!log || x > 0) ? x : null));

function openPlots() {
  for (const button of $("tabs").children) button.setAttribute("aria-selected", String(button.textContent === tab));
  plots.forEach((plot) => plot.destroy());
  const host = $("panels");
  host.replaceChildren();
  const names = chosen.map(panelsOf).sort((a, b) => b.length - a.length)[0];
  const legends = names.reduce((sum, panel) => sum + Math.ceil(panel.series.length / 3), 0);
  const height = clamp(Math.floor((host.clientHeight - 36 - 16 * legends) / names.length) - 3, 100, 230);
  plots = names.map((panel, p) => {
    const series = [{ label: "t (s)", value: () => "" }], tables = [];
    chosen.forEach((run, r) => {
      const found = panelsOf(run)[p];
      if (!found) return;
      tables.push([Array.from(found.time.array), ...found.series.map((each) => values(each.values, found.log))]);
      found.series.forEach((each) => series.push({
        label: each.label + (r ? ` (${run.name})` : ""),
        stroke: each.color,
        width: each.limit ? 1 : 1.6,
        dash: each.limit ? [5, 4] : each.repeats ? [2, 2 * each.repeats] : r ? [6, 2.5] : undefined,
        paths: found.stepped ? uPlot.paths.stepped({ align: 1 }) : undefined,
        points: { show: false },
        value: (u, x) => (x === null || x === undefined ? "–" : Math.abs(x) >= 1e-3 || x === 0 ? x.toFixed(3) : x.toExponential(1)),
      }));
    });
    const look = { stroke: "#57606a", font: "11px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif", labelSize: 16, grid: { stroke: "#0000000d", width: 1 }, ticks: { stroke: "#d0d7de", size: 4 }, gap: 3 };
    const last = p === names.length - 1;
    const options = {
      width: host.clientWidth - 4, height: height + (last ? 16 : 0), padding: [6, 12, 0, 0],
      series,
      scales: { x: { time: false, range: () => [0, span()] }, y: { distr: panel.log ? 3 : 1 } },
      axes: [
        { ...look, size: last ? 34 : 18, label: last ? "time (s)" : undefined },
        { ...look, size: 50, space: 20, label: panel.label, values: panel.log ? (u, ticks) => ticks.map((x) => (x !== null && Math.abs(Math.log10(x) % 1) < 1e-6 ? String(Number(x.toPrecision(1))) : "")) : undefined },
      ],
      cursor: { y: false, points: { size: 5 }, drag: { x: false, y: false }, bind: { mousemove: () => null, mouseleave: () => null, mousedown: () => null, mouseup: () => null, dblclick: () => null, mouseenter: () => null } },
      legend: { live: true },
      hooks: { drawClear: [(u) => shadeStages(u, chosen[0])] },
    };
    const plot = new uPlot(options, tables.length > 1 ? uPlot.join(tables) : tables[0], host);
    dragging(plot.over, (x) => seek(plot.posToVal(x, "x")));
    return plot;
  });
  dirty = true; // a plot can take its cursor once it is drawn
}

function shadeStages(u, run) {
  const { ctx, bbox } = u, at = (t) => u.valToPos(t, "x", true);
  ctx.save();
  for (const stage of run.spans) {
    ctx.globalAlpha = 0.22;
    ctx.fillStyle = stage.color;
    ctx.fillRect(at(stage.start), bbox.top, at(stage.end) - at(stage.start), bbox.height);
    if (stage.early === null) continue;
    ctx.globalAlpha = 0.9;
    ctx.strokeStyle = "#1b1f24";
    ctx.setLineDash([2, 4]);
    ctx.beginPath();
    ctx.moveTo(at(stage.early), bbox.top);
    ctx.lineTo(at(stage.early), bbox.top + bbox.height);
    ctx.stroke();
  }
  ctx.restore();
}

// ---- time

const span = () => Math.max(...chosen.map(endOf));
const percent = (t) => `${(100 * t) / span()}%`;
let markers = [];

function dragging(target, seekTo) {
  const move = (event) => seekTo(event.clientX - target.getBoundingClientRect().left);
  target.addEventListener("pointerdown", (event) => {
    play(false);
    target.setPointerCapture(event.pointerId);
    move(event);
  });
  target.addEventListener("pointermove", (event) => { if (event.buttons) move(event); });
}

function openTimeline() {
  const line = $("timeline");
  line.replaceChildren();
  line.setAttribute("aria-valuemax", span().toFixed(1));
  markers = chosen.map((run, r) => {
    const row = element(line, "div", "row");
    if (!r) {
      const step = [1, 2, 5, 10, 20, 50, 100].find((s) => span() / s <= 12) || 500;
      for (let t = 0; t <= span() - step / 3; t += step) element(row, "span", "tick", String(t)).style.left = percent(t);
    }
    for (const { name, start, end, early, color } of run.spans) {
      if (end > start) {
        const band = element(row, "div", "band", name);
        Object.assign(band.style, { left: percent(start), width: percent(end - start), background: color });
        band.title = `${name}: ${start.toFixed(2)} to ${end.toFixed(2)} s`;
      }
      if (early === null) continue;
      const acting = element(row, "div", "early");
      acting.title = `${name} already acts from ${early.toFixed(1)} s`;
      Object.assign(acting.style, { left: percent(early), width: percent(start - early), background: `repeating-linear-gradient(135deg, ${color} 0 4px, #fff9 4px 7px), ${color}` });
    }
    return run.stages.map(() => element(row, "div", "switch"));
  });
  element(line, "div").id = "cursor";
}

function describe(run, t) {
  const current = run.spans.filter((stage) => stage.start <= t + 1e-9 && stage.end > stage.start).pop();
  const early = run.spans.filter((stage) => stage.early !== null && stage.early <= t + 1e-9 && t < stage.start - 1e-9);
  const ends = planned(run, t).map(([s, time]) => `${run.stages[s].name} to end at ${time.toFixed(2)} s`);
  const lost = run.object && run.object.lost !== null && t >= run.object.lost ? ["object lost"] : [];
  return [current && current.name, ...early.map((stage) => `${stage.name} already acts`), ...ends, ...lost].filter(Boolean).join(" · ");
}

function seek(t) {
  now = clamp(t, 0, span());
  dirty = true;
}

function update() { // all parts at the present time
  $("cursor").style.left = percent(now);
  $("time").textContent = `${now.toFixed(2)} s of ${span().toFixed(1)} s`;
  $("now").textContent = chosen.map((run) => named(run, describe(run, Math.min(now, endOf(run))))).join(" | ");
  $("timeline").setAttribute("aria-valuenow", now.toFixed(2));
  $("timeline").setAttribute("aria-valuetext", `${now.toFixed(2)} s, ${$("now").textContent}`);
  chosen.forEach((run, r) => {
    markers[r].forEach((mark) => { mark.hidden = true; });
    for (const [s, time] of planned(run, Math.min(now, endOf(run)))) {
      const title = `planned end of ${run.stages[s].name}: ${time.toFixed(2)} s`;
      Object.assign(markers[r][s], { title, hidden: false }).style.left = percent(Math.min(time, span()));
    }
  });
  plots.forEach((plot) => plot.setCursor({ left: plot.valToPos(now, "x"), top: 0 }, false));
  if (!world) return;
  actors.forEach((actor) => actor.seek(now));
  render();
}

let playing = false, clock = 0;
function play(on) {
  if (on && now >= span() - 1e-6) seek(0);
  playing = on;
  $("play").textContent = on ? "❚❚" : "▶";
  $("play").setAttribute("aria-label", on ? "pause" : "play");
}
const toggle = () => play(!playing);
function frame(instant) {
  if (playing) {
    seek(now + (Math.min(instant - clock, 200) / 1000) * Number($("speed").value));
    if (now >= span()) play(false);
  }
  clock = instant;
  if (dirty) {
    dirty = false;
    update();
  }
  requestAnimationFrame(frame);
}

// ---- what is chosen

function choose() {
  const first = runs[$("first").selectedIndex], second = runs[$("second").selectedIndex - 1];
  chosen = second && second !== first ? [first, second] : [first];
  if (!several()) $("second").selectedIndex = 0;
  $("together").hidden = !several();
  $("mission").textContent = chosen.map((run) => `${run.name}: ${run.mission}`).join(" | ");
  $("notes").replaceChildren();
  for (const run of chosen) for (const note of run.notes) element($("notes"), "li", "", named(run, note));
  $("show-plan").parentElement.hidden = !chosen.some((run) => run.plans);
  $("nearest").hidden = !chosen.some((run) => run.nearest);
  $("thrusters").hidden = !chosen.some((run) => run.thrusters);
  $("shut").hidden = !chosen.some((run) => run.thrusters?.shut);
  $("wheels").hidden = !chosen.some((run) => run.wheels);
  $("covers").hidden = !chosen.some((run) => run.robot.bodies.some((body) => body.covers.length));
  $("parts").replaceChildren();
  const { parts, colors, objectColor, obstacleColor } = first.robot, others = [];
  if (first.object) others.push(["object", objectColor]);
  if (first.obstacles.length) others.push(["obstacles", obstacleColor]);
  [...parts.map((part, i) => [part, colors[i]]), ...others].forEach(([part, color]) => {
    const entry = element($("parts"), "span");
    Object.assign(element(entry, "i").style, { background: color, border: "1px solid #3a4046" });
    element(entry, "span", "", part);
  });
  openTimeline();
  openPlots();
  if (world) {
    world.scene.remove(...actors.map((actor) => actor.group));
    actors = chosen.map((run, r) => new Actor(run, r === 1 && $("overlay").checked));
    world.scene.add(...actors.map((actor) => actor.group));
    resize();
    drawGround();
  }
  seek(now);
}

for (const list of [$("first"), $("second")]) list.append(...runs.map((run) => new Option(run.name)));
$("second").prepend(new Option("none"));
$("second").selectedIndex = runs.length > 1 ? 2 : 0;
for (const id of ["first", "second", "overlay"]) $(id).onchange = choose;
for (const name of new Set(runs.flatMap((run) => run.plots.map((each) => each.name)))) {
  const button = element($("tabs"), "button", "", name);
  Object.assign(button, { type: "button", onclick: () => { tab = name; openPlots(); } });
  button.setAttribute("role", "tab");
}
$("overlay").checked = window.innerWidth < 700;
for (const id of ["show-plan", "show-targets", "show-paths", "show-nearest", "show-thrusters", "show-wheels", "show-covers"]) $(id).onchange = () => seek(now);
$("play").onclick = toggle;
$("above").onclick = () => frameMission(false);
$("tilted").onclick = () => frameMission(true);
dragging($("timeline"), (x) => seek((x / $("timeline").clientWidth) * span()));
document.addEventListener("keydown", (event) => {
  if (["SELECT", "INPUT", "TEXTAREA"].includes(event.target.tagName) && event.key !== " ") return;
  const times = chosen[0].time.array, step = event.shiftKey ? 1 : times.length > 1 ? times[1] - times[0] : 0.1;
  const actions = { " ": toggle, ArrowLeft: () => { play(false); seek(now - step); }, ArrowRight: () => { play(false); seek(now + step); }, Home: () => seek(0), End: () => seek(span()) };
  if (!(event.key in actions) || (event.key === " " && ["SELECT", "INPUT", "BUTTON"].includes(event.target.tagName))) return;
  event.preventDefault();
  actions[event.key]();
});

try {
  world = openWorld();
  world.tilted = runs[0].robot.spatial;
} catch (error) {
  $("no-webgl").hidden = false;
  $("layers").hidden = $("camera").hidden = true;
}
choose();
let pending = 0;
new ResizeObserver(() => {
  cancelAnimationFrame(pending);
  pending = requestAnimationFrame(() => { if (world) resize(); openPlots(); seek(now); });
}).observe($("scene"));
requestAnimationFrame(frame);

// for scripts and tests: the time, and positions and quaternions (x, y, z, w) of what is drawn
window.psmpc = {
  seek: (t) => { seek(t); dirty = false; update(); },
  get time() { return now; },
  labels: () => [...$("labels").querySelectorAll("span")].map((text) => ({ text: text.textContent, ...text.getBoundingClientRect().toJSON() })),
  camera: () => ({ position: world.camera.position.toArray(), target: world.controls.target.toArray() }),
  poses: (which = 0) => {
    const { robot, marks, obstacles, nearest, thrusters, wheels } = actors[which];
    const of = (group) => [...group.getWorldPosition(new THREE.Vector3()), ...group.getWorldQuaternion(new THREE.Quaternion())];
    const targets = marks.map((stage) => stage.map((mark) => (mark.visible ? of(mark) : null)));
    return { bodies: robot.bodies.map(of), tools: robot.tools.map(of), object: robot.object ? of(robot.object) : null, targets, obstacles: obstacles.map((each) => of(each.group)), covers: robot.covers.map((each) => (each.visible ? of(each) : null)), nearest: nearest?.group.visible ? [nearest.text, ...nearest.ends.map(of)] : null,
      flames: thrusters?.group.visible ? thrusters.each.map(({ group, bell, flame }) => ({ pose: of(group), length: flame.visible ? flame.scale.y : 0, color: bell.material.color.getHex() })) : null,
      wheels: wheels?.group.visible ? wheels.discs.map((disc) => ({ pose: of(disc), color: disc.material.color.getHexString() })) : null };
  },
};
})();
