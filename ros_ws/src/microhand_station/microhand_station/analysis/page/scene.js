// SPDX-License-Identifier: Apache-2.0
// The object and the three tips in space, at the time of the player. Lengths in µm, z upwards.

const FINGERS = 3;
const FORCE_LENGTH_UM = 2; // of an arrow, per µN
const ARROW_UM = 0.55; // radius of its shaft
const TRAIL_S = 1.5;
const UP = new libraries.Vector3(0, 1, 0);

function colourOf(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

// Place of a time among samples: the sample before, and the share of the way to the next.
function placeOf(times, time) {
  const before = Math.min(Math.max(lastBefore(times, time), 0), times.length - 1);
  const after = Math.min(before + 1, times.length - 1);
  const gap = times[after] - times[before];
  return [before, after, gap > 0 ? Math.min(Math.max((time - times[before]) / gap, 0), 1) : 0];
}

function between(values, width, column, [before, after, share]) {
  const first = values[before * width + column];
  return first + share * (values[after * width + column] - first);
}

class Body {
  // The mesh of the object with its axes, at a recorded pose.
  constructor(parent, poses, times, colour, opacity) {
    const { Group, Quaternion } = libraries;
    this.poses = poses;
    this.times = times;
    this.group = new Group();
    this.turns = [new Quaternion(), new Quaternion()];
    this.colour = colour;
    this.material = new libraries.MeshStandardMaterial({
      roughness: 0.55, metalness: 0.05, transparent: opacity < 1, opacity, depthWrite: opacity === 1,
      // where both surfaces are one, the solid one is seen
      polygonOffset: opacity < 1, polygonOffsetFactor: 2, polygonOffsetUnits: 2,
    });
    if (run.mesh !== null) this.group.add(new libraries.Mesh(Body.surface(), this.material));
    this.group.add(Body.axes(opacity));
    parent.add(this.group);
  }

  static surface() {
    if (Body.made === undefined) {
      const plain = new libraries.BufferGeometry();
      plain.setAttribute('position', new libraries.BufferAttribute(run.mesh.vertices, 3));
      plain.setIndex(new libraries.BufferAttribute(run.mesh.faces, 1));
      Body.made = libraries.toCreasedNormals(plain, 0.5);
      Body.made.computeBoundingSphere();
    }
    return Body.made;
  }

  static size() {
    return run.mesh === null ? 10 : Body.surface().boundingSphere.radius;
  }

  static axes(opacity) {
    const lines = new libraries.Group();
    const length = 1.35 * Body.size();
    ['x', 'y', 'z'].forEach((name, axis) => {
      const end = [0, 0, 0];
      end[axis] = length;
      const geometry = new libraries.BufferGeometry();
      geometry.setAttribute('position', new libraries.BufferAttribute(new Float32Array([0, 0, 0, ...end]), 3));
      const material = new libraries.LineBasicMaterial({ transparent: true, opacity: opacity < 1 ? 0.6 : 1 });
      const line = new libraries.Line(geometry, material);
      line.userData.colour = name;
      lines.add(line);
    });
    return lines;
  }

  show(time) {
    const place = placeOf(this.times, time);
    const at = (column) => between(this.poses.position, 3, column, place);
    this.group.position.set(at(0), at(1), at(2));
    place.slice(0, 2).forEach((row, i) => {
      const [w, x, y, z] = this.poses.quaternion.subarray(4 * row, 4 * row + 4);
      this.turns[i].set(x, y, z, w);
    });
    this.group.quaternion.slerpQuaternions(this.turns[0], this.turns[1], place[2]);
  }

  paint() {
    this.material.color.set(colourOf(this.colour));
    this.group.traverse((part) => {
      if (part.userData.colour) part.material.color.set(colourOf(part.userData.colour));
    });
  }
}

class Tip {
  // One spherical tip, the way that it came, and the force with which it presses.
  constructor(parent, finger, scene) {
    this.finger = finger;
    this.scene = scene;
    const radius = run.radius === null ? 4.5 : run.radius;
    this.material = new libraries.MeshStandardMaterial({ roughness: 0.4, metalness: 0.1 });
    this.ball = new libraries.Mesh(new libraries.SphereGeometry(radius, 40, 24), this.material);
    this.trail = new libraries.Line(new libraries.BufferGeometry(), new libraries.LineBasicMaterial());
    this.trail.frustumCulled = false;
    this.radius = radius;
    this.arrow = new libraries.Group();
    // along y, which is turned into the force; the head has a fixed length, the shaft does not
    this.shaft = new libraries.Mesh(new libraries.CylinderGeometry(ARROW_UM, ARROW_UM, 1, 20), this.material);
    this.head = new libraries.Mesh(new libraries.ConeGeometry(2.6 * ARROW_UM, 5 * ARROW_UM, 24), this.material);
    this.arrow.add(this.shaft, this.head);
    parent.add(this.ball, this.trail, this.arrow);
    this.label = document.createElement('span');
    this.label.textContent = String(finger + 1);
    this.label.className = `finger${finger + 1}`;
    element('labels').append(this.label);
  }

  show(time) {
    const place = placeOf(this.scene.time, time);
    const at = (values) => [0, 1, 2].map((axis) => between(values, 9, 3 * this.finger + axis, place));
    this.ball.position.set(...at(this.scene.tips));
    const first = Math.max(lastBefore(this.scene.time, time - TRAIL_S), 0);
    const points = new Float32Array(3 * (place[0] - first + 2));
    for (let row = first; row <= place[0]; row += 1) {
      for (let axis = 0; axis < 3; axis += 1) {
        points[3 * (row - first) + axis] = this.scene.tips[9 * row + 3 * this.finger + axis];
      }
    }
    points.set(this.ball.position.toArray(), points.length - 3);
    this.trail.geometry.dispose();
    this.trail.geometry = new libraries.BufferGeometry();
    this.trail.geometry.setAttribute('position', new libraries.BufferAttribute(points, 3));
    const force = new libraries.Vector3(...(this.scene.force ? at(this.scene.force) : [0, 0, 0]));
    const size = force.length();
    this.arrow.visible = size > 0.02;
    if (!this.arrow.visible) return;
    const length = FORCE_LENGTH_UM * size;
    const head = Math.min(5 * ARROW_UM, length);
    const direction = force.normalize();
    // it ends at the back of the tip, where it is seen
    this.arrow.position.copy(this.ball.position).addScaledVector(direction, -this.radius - length);
    this.arrow.quaternion.setFromUnitVectors(UP, direction);
    this.shaft.scale.y = Math.max(length - head, 0.001);
    this.shaft.position.y = (length - head) / 2;
    this.head.scale.setScalar(head / (5 * ARROW_UM));
    this.head.position.y = length - head / 2;
  }

  paint() {
    const colour = colourOf(`finger${this.finger + 1}`);
    this.material.color.set(colour);
    this.trail.material.color.set(colour);
  }
}

function startScene() {
  const box = element('scene');
  const recorded = run.scene;
  const problem = (text) => {
    element('scene-note').hidden = false;
    element('scene-note').textContent = text;
    box.classList.add('empty');
  };
  if (!recorded.object && !recorded.tips && !recorded.plan) {
    problem('There is nothing to show here: neither object nor tips are in the record.');
    return;
  }
  let renderer;
  try {
    renderer = new libraries.WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
  } catch (error) {
    problem('This browser draws nothing in space (no WebGL). Everything else is here.');
    return;
  }
  box.prepend(renderer.domElement);
  renderer.domElement.setAttribute('role', 'img');
  renderer.domElement.setAttribute('aria-label', 'Object and fingers; drag to turn, scroll or pinch to zoom');

  const scene = new libraries.Scene();
  const camera = new libraries.PerspectiveCamera(35, 1, 1, 4000);
  camera.up.set(0, 0, 1);
  const sky = new libraries.HemisphereLight(0xffffff, 0x8890a0, 1.6);
  sky.position.set(0, 0, 1);
  const lamp = new libraries.DirectionalLight(0xffffff, 1.8);
  scene.add(sky, camera, lamp, lamp.target);
  const grid = new libraries.GridHelper(120, 12);
  grid.rotation.x = Math.PI / 2;
  grid.position.z = -2.4 * Body.size();
  grid.material.transparent = true;
  grid.material.opacity = 0.35;
  scene.add(grid);

  const things = [];
  const keys = [];
  if (recorded.object) {
    things.push(new Body(scene, recorded.object, recorded.time, 'object', 1));
    keys.push(['object', run.mesh === null ? 'object (no mesh: its axes)' : 'object']);
  }
  const ghost = run.other !== null && run.other.object ? run.other : null;
  if (ghost !== null) {
    things.push(new Body(scene, ghost.object, ghost.time, 'other', 0.35));
    keys.push(['other', `object of ${ghost.name}`]);
  } else if (recorded.plan) {
    things.push(new Body(scene, recorded.plan, recorded.time, 'plan', 0.3));
    keys.push(['plan', 'where the plan has it']);
  }
  const tips = [];
  if (recorded.tips) {
    for (let finger = 0; finger < FINGERS; finger += 1) tips.push(new Tip(scene, finger, recorded));
    things.push(...tips);
    keys.push(['finger1', '1'], ['finger2', '2'], ['finger3', '3']);
    if (recorded.force) keys.push([null, 'arrows: forces']);
  }
  element('keys').innerHTML = '';
  for (const [colour, text] of keys) {
    const key = document.createElement('span');
    key.textContent = text;
    if (colour !== null) key.className = `key ${colour}`;
    element('keys').append(key);
  }

  const controls = new libraries.OrbitControls(camera, renderer.domElement);
  controls.minDistance = 1.5 * Body.size();
  controls.maxDistance = 40 * Body.size();
  const resetView = () => {
    const far = 8.5 * Body.size();
    camera.position.set(0.62 * far, -0.68 * far, 0.42 * far);
    controls.target.set(0, 0, 0);
    controls.update();
    draw();
  };

  function draw() {
    lamp.position.copy(camera.position).add(new libraries.Vector3(0, 0, 2 * Body.size()));
    renderer.render(scene, camera);
    for (const tip of tips) {
      const at = tip.ball.position.clone().project(camera);
      const inside = at.z < 1 && Math.abs(at.x) < 1 && Math.abs(at.y) < 1;
      tip.label.hidden = !inside;
      tip.label.style.transform = `translate(${50 * (1 + at.x) * box.clientWidth / 100}px, ${50 * (1 - at.y) * box.clientHeight / 100}px)`;
    }
  }
  function paint() {
    grid.material.color.set(colourOf('line'));
    for (const thing of things) thing.paint();
    draw();
  }
  const fit = () => {
    const { clientWidth: width, clientHeight: height } = box;
    if (width === 0 || height === 0) return;
    renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    draw();
  };

  grid.material.vertexColors = false;
  for (const thing of things) thing.show(0);
  controls.addEventListener('change', draw);
  element('reset-view').addEventListener('click', resetView);
  new ResizeObserver(fit).observe(box);
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', paint);
  player.listen((time) => {
    for (const thing of things) thing.show(time);
    draw();
  });
  fit();
  resetView();
  paint();
}
