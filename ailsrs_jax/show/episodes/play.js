// Follows MuJoCo's module in the same script, so that loadMujoco is known.
const $ = (id) => document.getElementById(id);
const scene = JSON.parse($("scene").textContent);
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const sum = (numbers) => numbers.reduce((total, x) => total + x, 0);
const dot = (a, b) => sum(a.map((x, i) => x * b[i]));
const cross = ([a, b, c], [d, e, f]) => [b * f - c * e, c * d - a * f, a * e - b * d];

const REST = 1.5; // [s] of limp motion between two episodes
const PUSH_TIME = 0.1; // [s]
const PULL = { stiffness: 60, damping: 12 }; // [1/s²], [1/s] for the whole mass

// ---- the simulation -----------------------------------------------------------------------------

async function load() {
  const zipped = Uint8Array.from(atob($("program").textContent), (c) => c.charCodeAt(0));
  const program = new Blob([zipped]).stream().pipeThrough(new DecompressionStream("gzip"));
  const wasmBinary = new Uint8Array(await new Response(program).arrayBuffer());
  // What it says, for example that a model is outdated, is for developers.
  return loadMujoco({ wasmBinary, print: console.debug, printErr: console.debug });
}

const mujoco = await load().catch((error) => {
  $("state").textContent = `MuJoCo cannot run in this browser: ${error.message}`;
  $("state").classList.add("bad");
  throw error;
});
const model = mujoco.MjModel.from_xml_string(scene.xml);
const data = new mujoco.MjData(model);
const option = model.opt;
const dt = option.timestep * scene.frame_skip;
const mass = sum([...model.body_mass]);
const trained = {
  gravity: option.gravity[2],
  friction: [...model.geom_friction],
  viscosity: option.viscosity,
  density: option.density,
};
const TORSO = 1;
const senses = scene.observed.some(({ field }) => !["qpos", "qvel"].includes(field));

const policies = structuredClone(scene.policies); // the weights of these can be changed
let policy = policies[0];
let episode = {};
let push = { impulse: 0, left: -1 }; // [N s] along x, and for how long [s]
let pull = null; // a body, and where it is pulled to

const read = ({ field, first, end }) => Array.from(data[field].subarray(first, end));
const position = () => data[scene.position.field][scene.position.at];
const point = (array, index) => Array.from(array.subarray(3 * index, 3 * index + 3));

function observe() {
  return scene.observed.flatMap((part) => read(part).map((x) => clamp(x, part.low, part.high)));
}

function act({ mean, std, low, high, layers }, observation) {
  let hidden = observation.map((x, i) => (x - mean[i]) / std[i]);
  layers.forEach(({ weights, biases }, layer) => {
    if (layer) hidden = hidden.map(Math.tanh);
    hidden = weights.map((row, i) => dot(row, hidden) + biases[i]);
  });
  return hidden.map((x, i) => clamp(x, low[i], high[i]));
}

function begin(start) {
  const { qpos, qvel } = scene.starts[start];
  mujoco.mj_resetData(model, data);
  data.qpos.set(qpos);
  data.qvel.set(qvel);
  mujoco.mj_forward(model, data);
  push.left = -1;
  episode = { start, steps: 0, return: 0, speed: 0, distance: 0, over: "", trail: [] };
  episode.first = position();
}

function beginNext() {
  begin((episode.start + 1) % scene.starts.length);
}

function reward(speed, action, healthy) {
  const { forward, control, healthy: alive, contact } = scene.reward;
  const forces = contact ? [...data.cfrc_ext].map((x) => clamp(x, contact.low, contact.high)) : [];
  const costs = control * dot(action, action) + (contact ? contact.weight * dot(forces, forces) : 0);
  return forward * speed + alive * healthy - costs;
}

function applyForces() {
  const forces = data.xfrc_applied;
  forces.fill(0);
  if (push.left > 0) forces[6 * TORSO] += push.impulse / PUSH_TIME;
  push.left -= dt;
  if (!pull) return;
  const at = point(data.xipos, pull.body);
  const speed = at.map((x, i) => (x - (pull.before ?? at)[i]) / dt);
  pull.before = at;
  const { stiffness, damping } = PULL;
  pull.offset.forEach((x, i) => {
    forces[6 * pull.body + i] += mass * (stiffness * x - damping * speed[i]);
  });
}

// One step of the environment. After the end of an episode the robot is limp.
function step() {
  const before = position(), time = data.time;
  const action = episode.over ? policy.low.map(() => 0) : act(policy, observe());
  data.ctrl.set(action);
  applyForces();
  for (let i = 0; i < scene.frame_skip; i++) mujoco.mj_step(model, data);
  if (senses) mujoco.mj_rnePostConstraint(model, data);
  const isUnstable = data.time < time; // MuJoCo has begun again
  episode.speed = isUnstable ? 0 : (position() - before) / dt;
  episode.trail.push(point(data.xpos, TORSO));
  if (episode.trail.length > 3 / dt) episode.trail.shift();
  if (episode.over) return;
  const healthy = scene.limits.every((part) => read(part).every((x) => part.low < x && x < part.high));
  episode.steps += 1;
  if (isUnstable) episode.over = "the simulation was unstable";
  else {
    episode.return += reward(episode.speed, action, healthy);
    episode.distance = position() - episode.first;
    if (!healthy) episode.over = "fallen";
    else if (episode.steps >= scene.episode_length) episode.over = "time is over";
  }
  if (!episode.over) return;
  episode.rest = REST;
  $("last").textContent = `${episode.return.toFixed(0)} in ${(episode.steps * dt).toFixed(1)} s`;
}

// ---- the picture --------------------------------------------------------------------------------

const canvas = $("canvas"), pen = canvas.getContext("2d");
const isSide = scene.view === "side";
const { right, toward } = {
  side: { right: [1, 0, 0], toward: [0, -1, 0] },
  top: { right: [1, 0, 0], toward: [0, 0, 1] },
  oblique: turned(0.35, 0.5),
}[scene.view];
const up = cross(toward, right);
const HORIZON = { side: 0.84, top: 0.5, oblique: 0.62 }[scene.view]; // of the height, from above
const { mjGEOM_SPHERE, mjGEOM_CAPSULE } = mujoco.mjtGeom;
const geoms = Array.from({ length: model.ngeom }, (_, i) => i).filter(
  (i) =>
    model.geom_bodyid[i] > 0 &&
    [mjGEOM_SPHERE.value, mjGEOM_CAPSULE.value].includes(model.geom_type[i]),
);
const limbs = [...model.body_parentid].flatMap((parent, i) => (parent === TORSO ? [i] : []));
let colors, width, height, scale, focus = [0, 0, 0];

function turned(azimuth, elevation) {
  const [s, c] = [Math.sin(azimuth), Math.cos(azimuth)];
  const [se, ce] = [Math.sin(elevation), Math.cos(elevation)];
  return { right: [c, -s, 0], toward: [-s * ce, -c * ce, se] };
}

function color(name) {
  return (colors[name] ??= getComputedStyle(document.documentElement).getPropertyValue(`--${name}`));
}

function colorOf(body) {
  while (body > TORSO && !limbs.includes(body)) body = model.body_parentid[body];
  return color(body > TORSO ? `limb-${limbs.indexOf(body) % 4}` : "body");
}

// Orthographic, so the outline of a capsule is a line with round ends.
function project(p) {
  const from = p.map((x, i) => x - focus[i]);
  return [width / 2 + scale * dot(from, right), HORIZON * height - scale * dot(from, up)];
}

function ends(geom) {
  const center = point(data.geom_xpos, geom);
  if (model.geom_type[geom] === mjGEOM_SPHERE.value) return [center, center];
  const half = model.geom_size[3 * geom + 1];
  const axis = [2, 5, 8].map((i) => half * data.geom_xmat[9 * geom + i]);
  return [center.map((x, i) => x - axis[i]), center.map((x, i) => x + axis[i])];
}

function fit() {
  colors = {};
  const density = window.devicePixelRatio || 1;
  ({ width, height } = canvas.getBoundingClientRect());
  canvas.width = width * density;
  canvas.height = height * density;
  pen.setTransform(density, 0, 0, density, 0, 0);
  const span = (axis) => {
    const along = geoms.flatMap((geom) =>
      ends(geom).flatMap((end) => {
        const [at, radius] = [dot(end, axis), model.geom_size[3 * geom]];
        return [at - radius, at + radius];
      }),
    );
    return Math.max(...along) - Math.min(...along);
  };
  const [wide, high] = [span(right), span(up)];
  scale = Math.min(height / (1.7 * Math.max(high, wide / 2)), width / (1.8 * wide));
}

function line(points, thick, style, alpha = 1) {
  pen.beginPath();
  points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  pen.lineTo(points.at(-1)[0] + 0.01, points.at(-1)[1]); // a line without a length is not drawn
  Object.assign(pen, { lineWidth: thick, strokeStyle: style, globalAlpha: alpha });
  Object.assign(pen, { lineCap: "round", lineJoin: "round" });
  pen.stroke();
  pen.globalAlpha = 1;
}

function write(text, x, y) {
  Object.assign(pen, { font: "12px system-ui, sans-serif", textAlign: "center" });
  pen.fillStyle = color("soft");
  pen.fillText(text, x, y);
}

function drawGround() {
  pen.fillStyle = color("sky");
  pen.fillRect(0, 0, width, height);
  const reach = Math.ceil((width + height) / scale) + 1;
  const [x0, y0] = [Math.floor(focus[0]), Math.floor(focus[1])];
  const meters = Array.from({ length: 2 * reach + 1 }, (_, i) => i - reach);
  if (isSide) {
    const ground = HORIZON * height;
    pen.fillStyle = color("ground");
    pen.fillRect(0, ground, width, height);
    for (const x of meters.map((m) => x0 + m)) {
      const [left] = project([x, 0, 0]);
      pen.fillStyle = color("stripe");
      if (x % 2 === 0) pen.fillRect(left, ground, scale, height);
      line([[left, ground], [left, ground + 8]], 1.5, color("pale"));
      write(`${x} m`, left, ground + 26);
    }
    line([[0, ground], [width, ground]], 2, color("pale"));
    return;
  }
  for (const m of meters) {
    const [x, y] = [x0 + m, y0 + m];
    line([project([x, y0 - reach, 0]), project([x, y0 + reach, 0])], x % 5 ? 1 : 2, color("line"));
    line([project([x0 - reach, y, 0]), project([x0 + reach, y, 0])], y % 5 ? 1 : 2, color("line"));
  }
  for (const x of meters.map((m) => x0 + m)) {
    const [left, top] = project([x, y0 - 1, 0]);
    write(`${x} m`, left, Math.min(top - 4, height - 10));
  }
}

function drawRobot() {
  const order = geoms.map((geom) => [dot(point(data.geom_xpos, geom), toward), geom]);
  order.sort(([a], [b]) => a - b);
  if (scene.view === "oblique") {
    for (const [, geom] of order) {
      const shadow = ends(geom).map(([x, y]) => project([x, y, 0]));
      line(shadow, 2 * scale * model.geom_size[3 * geom], color("stripe"));
    }
  }
  for (const [, geom] of order) {
    const line2d = ends(geom).map(project), radius = scale * model.geom_size[3 * geom];
    line(line2d, 2 * radius + 3, color("sky"));
    line(line2d, 2 * radius, colorOf(model.geom_bodyid[geom]));
    const lit = line2d.map(([x, y]) => [x - 0.3 * radius, y - 0.35 * radius]);
    line(lit, 0.5 * radius, "#fff", 0.22);
  }
}

function drawForces() {
  const arrow = ([x, y], [dx, dy], style) => {
    const [ux, uy] = [dx, dy].map((d) => (12 * d) / (Math.hypot(dx, dy) || 1));
    const end = [x + dx, y + dy];
    const barb = (side) => [end[0] - ux - (side * uy) / 2, end[1] - uy + (side * ux) / 2];
    line([[x, y], end], 4, style);
    line([barb(1), end, barb(-1)], 4, style);
  };
  if (pull) {
    const at = project(point(data.xipos, pull.body));
    arrow(at, [pull.to[0] - at[0], pull.to[1] - at[1]], color("plus"));
  }
  if (push.left > -0.25) {
    arrow(project(point(data.xipos, TORSO)), [70 * Math.sign(push.impulse), 0], color("plus"));
  }
}

function draw() {
  const at = point(data.xpos, TORSO);
  focus = isSide ? [at[0], 0, 0] : [at[0], at[1], 0];
  drawGround();
  const trail = episode.trail.map(project);
  if (trail.length > 1) line(trail, 2, color("accent"), 0.45);
  drawRobot();
  drawForces();
  $("time").textContent = `${(episode.steps * dt).toFixed(1)} s`;
  $("distance").textContent = `${episode.distance.toFixed(1)} m`;
  $("speed").textContent = `${(speed += 0.1 * (episode.speed - speed)).toFixed(1)} m/s`;
  $("return").textContent = episode.return.toFixed(0);
  $("state").textContent = episode.over || (isPaused ? "paused" : "running");
  $("state").classList.toggle("bad", episode.over === "fallen");
}

let isPaused = false, last = performance.now(), lag = 0, speed = 0;

function frame(now) {
  const elapsed = Math.min((now - last) / 1000, 0.1) * $("pace").value;
  last = now;
  if (!isPaused) {
    for (lag += elapsed; lag >= dt; lag -= dt) step();
    if (episode.over && (episode.rest -= elapsed) < 0) beginNext();
  }
  draw();
  requestAnimationFrame(frame);
}

// ---- the controls -------------------------------------------------------------------------------

const PHYSICS = ["gravity", "friction", "viscosity"];
const trainedLayers = () => scene.policies[policies.indexOf(policy)].layers;
const isLinear = ({ layers }) => layers.length === 1;
const sees = ({ layers }, entry) => layers[0].weights.some((row) => row[entry] !== 0);
let cell = [0, 0]; // the weight that the slider changes: an action and an entry

function choose(index) {
  policy = policies[index];
  $("policy").value = index;
  begin(episode.start ?? 0);
  showWeights();
}

function setPause(paused) {
  isPaused = paused;
  $("pause").textContent = paused ? "go on" : "pause";
}

function setPhysics() {
  const [gravity, friction, viscosity] = PHYSICS.map((id) => Number($(id).value));
  option.gravity.set([0, 0, -gravity]);
  model.geom_friction.set(trained.friction.map((x) => friction * x));
  option.viscosity = viscosity * trained.viscosity;
  option.density = viscosity * trained.density;
  $("gravity-value").textContent = `${gravity.toFixed(1)} m/s²`;
  $("friction-value").textContent = `× ${friction.toFixed(2)}`;
  $("viscosity-value").textContent = `× ${viscosity.toFixed(2)}`;
  $("push-value").textContent = `${(mass * $("push").value).toFixed(1)} N s`;
  $("pace-value").textContent = $("pace").value === "1" ? "in real time" : `× ${$("pace").value}`;
}

function restorePhysics() {
  [-trained.gravity, 1, 1].forEach((value, i) => ($(PHYSICS[i]).value = value));
  setPhysics();
}

function pushRobot(direction) {
  push = { impulse: direction * mass * $("push").value, left: PUSH_TIME };
}

function shade(button, weight) {
  const { weights } = trainedLayers()[0];
  const largest = Math.max(...weights.flat().map(Math.abs)) || 1;
  button.textContent = weight.toFixed(2);
  button.style.setProperty("--sign", weight < 0 ? "var(--minus)" : "var(--plus)");
  button.style.setProperty("--size", clamp(Math.abs(weight) / largest, 0, 1).toFixed(3));
}

function showWeights() {
  const table = $("weights");
  table.replaceChildren();
  $("editor").hidden = !isLinear(policy);
  $("weights-note").textContent = isLinear(policy)
    ? "A number is what one standard deviation of an entry of the observation adds to an action. " +
      "Click on one to change it while the robot moves."
    : "This policy is a network, so it has no table of single weights.";
  if (!isLinear(policy)) return;
  const { weights } = policy.layers[0];
  const head = table.createTHead().insertRow();
  const title = (row, text) => {
    row.append(Object.assign(document.createElement("th"), { textContent: text }));
  };
  ["", ...scene.actions].forEach((name) => title(head, name));
  const body = table.createTBody();
  scene.entries.forEach((name, entry) => {
    if (scene.policies.filter(isLinear).every((each) => !sees(each, entry))) return;
    const row = body.insertRow();
    title(row, name);
    scene.actions.forEach((_, action) => {
      const button = Object.assign(document.createElement("button"), { type: "button" });
      button.dataset.at = `${action} ${entry}`;
      button.onclick = () => select(action, entry);
      shade(button, weights[action][entry]);
      row.insertCell().append(button);
    });
  });
  select(...cell);
}

function select(action, entry) {
  cell = [action, entry];
  for (const button of $("weights").querySelectorAll("button")) {
    button.ariaPressed = button.dataset.at === cell.join(" ");
  }
  const { weights } = trainedLayers()[0];
  const reach = 1.5 * Math.max(...weights.flat().map(Math.abs)) || 1;
  Object.assign($("weight"), { min: -reach, max: reach });
  $("weight-name").textContent = `${scene.entries[entry]} → ${scene.actions[action]}`;
  edit(policy.layers[0].weights[action][entry]);
}

function edit(weight) {
  const [action, entry] = cell;
  policy.layers[0].weights[action][entry] = weight;
  $("weight").value = weight;
  const was = trainedLayers()[0].weights[action][entry];
  const trainedAs = weight === was ? "" : `, trained ${was.toFixed(3)}`;
  $("weight-value").textContent = weight.toFixed(3) + trainedAs;
  shade($("weights").querySelector(`[data-at="${action} ${entry}"]`), weight);
}

function restoreWeights() {
  policy.layers = structuredClone(trainedLayers());
  showWeights();
}

function place(event) {
  const box = canvas.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}

function pullTo(event) {
  pull.to = place(event);
  const at = project(point(data.xipos, pull.body));
  const [a, b] = [(pull.to[0] - at[0]) / scale, (at[1] - pull.to[1]) / scale];
  pull.offset = right.map((x, i) => a * x + b * up[i]); // [m]
}

canvas.onpointerdown = (event) => {
  canvas.setPointerCapture(event.pointerId);
  const to = place(event);
  const away = (body) => Math.hypot(...project(point(data.xipos, body)).map((x, i) => x - to[i]));
  const bodies = geoms.map((geom) => model.geom_bodyid[geom]);
  pull = { body: bodies.reduce((best, body) => (away(body) < away(best) ? body : best)) };
  pullTo(event);
};
canvas.onpointermove = (event) => pull && pullTo(event);
canvas.onpointerup = canvas.onpointercancel = () => (pull = null);

scene.policies.forEach(({ name }, index) => $("policy").add(new Option(name, index)));
$("policy").onchange = (event) => choose(Number(event.target.value));
$("pause").onclick = () => setPause(!isPaused);
$("again").onclick = beginNext;
$("left").onclick = () => pushRobot(-1);
$("right").onclick = () => pushRobot(1);
for (const id of [...PHYSICS, "push", "pace"]) $(id).oninput = setPhysics;
$("restore").onclick = restorePhysics;
$("weight").oninput = (event) => edit(Number(event.target.value));
$("restore-weight").onclick = () => edit(trainedLayers()[0].weights[cell[0]][cell[1]]);
$("restore-weights").onclick = restoreWeights;
const isSwimming = trained.density > 0;
for (const id of PHYSICS) $(id).parentElement.hidden = isSwimming !== (id === "viscosity");

const first = scene.policies.find(isLinear)?.layers[0].weights.flat().map(Math.abs);
if (first) {
  const largest = first.indexOf(Math.max(...first));
  cell = [Math.floor(largest / scene.entries.length), largest % scene.entries.length];
}
restorePhysics();
choose(0);
fit();
addEventListener("resize", fit);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", fit);
requestAnimationFrame(frame);
// For the console, and for tests.
globalThis.play = { scene, model, data, begin, step, choose, setPause, episode: () => episode };
