// The third part of the page's script: what its reader can do, and the beginning.
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
  push = { impulse: direction * mass * $("push").value, steps: PUSH_STEPS };
}

function shade(button, weight) {
  const { weights } = trainedLayers()[0];
  const largest = Math.max(...weights.flat().map(Math.abs)) || 1;
  button.textContent = show(weight, 2);
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
  const trainedAs = weight === was ? "" : `, trained ${show(was, 3)}`;
  $("weight-value").textContent = show(weight, 3) + trainedAs;
  shade($("weights").querySelector(`[data-at="${action} ${entry}"]`), weight);
}

function restoreWeights() {
  policy.layers = structuredClone(trainedLayers());
  showWeights();
}

function placeOf(event) {
  const box = canvas.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}

canvas.onpointerdown = (event) => {
  canvas.setPointerCapture(event.pointerId);
  const place = placeOf(event);
  const away = (body) => Math.hypot(...wayTo(place, point(data.xipos, body)));
  const bodies = geoms.map((geom) => model.geom_bodyid[geom]);
  const body = bodies.reduce((best, each) => (away(each) < away(best) ? each : best));
  pull = { body, place };
};
canvas.onpointermove = (event) => pull && (pull.place = placeOf(event));
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
