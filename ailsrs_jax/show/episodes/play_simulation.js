// The first part of the page's script: the task and its episodes. The script begins with MuJoCo's
// module, which defines loadMujoco.
const $ = (id) => document.getElementById(id);
const scene = JSON.parse($("scene").textContent);
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const sum = (numbers) => numbers.reduce((total, x) => total + x, 0);
const dot = (a, b) => sum(a.map((x, i) => x * b[i]));
const cross = ([a, b, c], [d, e, f]) => [b * f - c * e, c * d - a * f, a * e - b * d];
// With a real minus sign, and without one for zero.
const show = (x, digits) => x.toFixed(digits).replace(/^-(?=[0.]*$)/, "").replace("-", "−");

const REST = 1.5; // [s] of limp motion between two episodes
const PULL = { stiffness: 60, damping: 12 }; // [1/s²], [1/s] for the whole mass

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
const PUSH_STEPS = Math.round(0.1 / dt); // a push takes about 0.1 s
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
let push = null; // an impulse along x [N s], and for how many steps it still acts
let pull = null; // a body, and the place on the canvas to which a spring pulls it

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
  push = pull = null;
  episode = { start, steps: 0, return: 0, speed: 0, distance: 0, over: "", trail: [] };
  episode.first = position();
}

function beginNext() {
  begin((episode.start + 1) % scene.starts.length);
}

function reward(speed, action, healthy) {
  const { forward, control, healthy: alive, contact } = scene.reward;
  const forces = contact ? [...data.cfrc_ext].map((x) => clamp(x, contact.low, contact.high)) : [];
  const touch = contact ? contact.weight * dot(forces, forces) : 0;
  const costs = control * dot(action, action) + touch;
  return forward * speed + alive * healthy - costs;
}

function applyForces() {
  const forces = data.xfrc_applied;
  forces.fill(0);
  if (push && push.steps-- > 0) forces[6 * TORSO] += push.impulse / (PUSH_STEPS * dt);
  if (!pull) return;
  const at = point(data.xipos, pull.body), way = wayTo(pull.place, at);
  const speed = at.map((x, i) => (x - (pull.before ?? at)[i]) / dt);
  pull.before = at;
  const { stiffness, damping } = PULL;
  way.forEach((x, i) => {
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
  const isWithin = (part) => read(part).every((x) => part.low < x && x < part.high);
  const healthy = scene.limits.every(isWithin);
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
  $("last").textContent = `${show(episode.return, 0)} in ${show(episode.steps * dt, 1)} s`;
}
