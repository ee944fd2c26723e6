// The second part of the page's script: what the canvas shows.
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
const style = getComputedStyle(document.documentElement);
let colors, spans, width, height, scale, focus = [0, 0, 0];

function turned(azimuth, elevation) {
  const [s, c] = [Math.sin(azimuth), Math.cos(azimuth)];
  const [se, ce] = [Math.sin(elevation), Math.cos(elevation)];
  return { right: [c, -s, 0], toward: [-s * ce, -c * ce, se] };
}

function color(name) {
  return (colors[name] ??= style.getPropertyValue(`--${name}`));
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

// From the point `at` to a place on the canvas, in the plane of the picture [m].
function wayTo(place, at) {
  const [x, y] = project(at).map((here, i) => (place[i] - here) / scale);
  return right.map((_, i) => x * right[i] - y * up[i]);
}

function ends(geom) {
  const center = point(data.geom_xpos, geom);
  if (model.geom_type[geom] === mjGEOM_SPHERE.value) return [center, center];
  const half = model.geom_size[3 * geom + 1];
  const axis = [2, 5, 8].map((i) => half * data.geom_xmat[9 * geom + i]);
  return [center.map((x, i) => x - axis[i]), center.map((x, i) => x + axis[i])];
}

function span(axis) {
  const along = geoms.flatMap((geom) =>
    ends(geom).flatMap((end) => {
      const [at, radius] = [dot(end, axis), model.geom_size[3 * geom]];
      return [at - radius, at + radius];
    }),
  );
  return Math.max(...along) - Math.min(...along);
}

function fit() {
  colors = {};
  const density = window.devicePixelRatio || 1;
  ({ width, height } = canvas.getBoundingClientRect());
  canvas.width = width * density;
  canvas.height = height * density;
  pen.setTransform(density, 0, 0, density, 0, 0);
  const [wide, high] = (spans ??= [right, up].map(span)); // those of the first pose
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
      write(`${show(x, 0)} m`, left, ground + 26);
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
    write(`${show(x, 0)} m`, left, Math.min(top - 4, height - 10));
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
    arrow(at, [pull.place[0] - at[0], pull.place[1] - at[1]], color("plus"));
  }
  if (push && push.steps > -PUSH_STEPS) { // long enough to be seen
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
  $("time").textContent = `${show(episode.steps * dt, 1)} s`;
  $("distance").textContent = `${show(episode.distance, 1)} m`;
  speed += 0.1 * (episode.speed - speed); // that of a single step is too restless to read
  $("speed").textContent = `${show(speed, 1)} m/s`;
  $("return").textContent = show(episode.return, 0);
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
