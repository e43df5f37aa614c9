// A panel: a take's name and facts, and its skeleton drawn at an instant.

const TRAIL_SECONDS = 1, FOLLOW_SECONDS = 0.5, SAMPLED_FRAMES = 200;
// Neither those of left and right nor that of frames that were made.
const CURVES = ["#7d8796", "#3a9d5d", "#a05195", "#c9a227", "#d0527a", "#2f9c95"];

const css = getComputedStyle(document.documentElement);
const inks = new Map();
// Read from the style once for each drawing: day may have turned into night.
const colour = (name) => {
  if (!inks.has(name)) inks.set(name, css.getPropertyValue(name).trim());
  return inks.get(name);
};

function element(tag, className, text) {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
}

function prepare(canvas) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  return [pen, width, height];
}

// What the panel draws is measured once: joints that belong to a body, its size, the ground, the path, the speeds.
function measured(data) {
  const joints = unpack(data.positions), count = data.bones.length, frames = data.numFrames;
  const take = { ...data, joints, count, seen: unpackBits(data.seen, frames) };
  take.unevenSeconds = data.unevenSeconds === null ? null : new Float64Array(bytesOf(data.unevenSeconds).buffer);
  const hasBone = new Uint8Array(count);
  data.bones.forEach((above, joint) => { if (above >= 0) hasBone[joint] = hasBone[above] = 1; });
  take.isPoints = !hasBone.includes(1);
  take.body = [...hasBone.keys()].filter((joint) => take.isPoints || hasBone[joint]);
  // Short bones are thin: fingers.
  take.thickness = data.bones.map((above, joint) => (above < 0 ? 0 : Math.hypot(...[0, 1, 2].map((axis) => joints[3 * joint + axis] - joints[3 * above + axis]))));
  const every = Math.max(1, Math.floor(frames / SAMPLED_FRAMES));
  const middles = new Float64Array(3 * frames), speeds = new Float32Array(frames);
  let lowest = Infinity, size = 0;
  const reach = [[Infinity, -Infinity], [Infinity, -Infinity], [Infinity, -Infinity]];
  for (let frame = 0; frame < frames; frame++) {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    let moved = 0;
    for (const joint of take.body) {
      const at = 3 * (frame * count + joint);
      for (let axis = 0; axis < 3; axis++) {
        const value = joints[at + axis];
        if (value < low[axis]) low[axis] = value;
        if (value > high[axis]) high[axis] = value;
        middles[3 * frame + axis] += value / take.body.length;
      }
      if (frame) moved += Math.hypot(joints[at] - joints[at - 3 * count], joints[at + 1] - joints[at + 1 - 3 * count], joints[at + 2] - joints[at + 2 - 3 * count]);
    }
    if (frame) speeds[frame] = moved / take.body.length / (secondsOf(take, frame) - secondsOf(take, frame - 1));
    lowest = Math.min(lowest, low[1]);
    for (let axis = 0; axis < 3; axis++) {
      reach[axis] = [Math.min(reach[axis][0], middles[3 * frame + axis]), Math.max(reach[axis][1], middles[3 * frame + axis])];
      if (frame % every === 0) size = Math.max(size, high[axis] - low[axis]);
    }
  }
  if (frames > 1) speeds[0] = speeds[1];
  size = Math.max(size, 1e-3);
  take.thickness = take.thickness.map((length) => Math.max(0.35, Math.min(1, length / (0.045 * size))));
  // A floor that is a hand's breadth off is a floor; a body whose origin is its hips has it below them.
  const ground = Math.abs(lowest) < 0.15 * size ? 0 : lowest;
  const path = smoothed(middles, frames, Math.round(FOLLOW_SECONDS * data.fps[0] / data.fps[1]));
  const climbs = reach[1][1] - reach[1][0] > 0.75 * size, steady = ground + size * 0.5;
  if (!climbs) for (let frame = 0; frame < frames; frame++) path[3 * frame + 1] = steady;
  return {
    ...take, size, ground, speeds, path,
    still: reach.map(([low, high], axis) => (axis === 1 && !climbs ? steady : (low + high) / 2)),
    span: Math.max(size, ...reach.map(([low, high]) => high - low + 0.7 * size)),
  };
}

// The mean over the frames around each one, so that the camera does not shake with the arms.
function smoothed(values, frames, reach) {
  const sums = new Float64Array(3 * (frames + 1)), result = new Float64Array(3 * frames);
  for (let i = 0; i < 3 * frames; i++) sums[i + 3] = sums[i] + values[i];
  for (let frame = 0; frame < frames; frame++) {
    const half = Math.min(reach, frame, frames - 1 - frame), from = frame - half, to = frame + half + 1;
    for (let axis = 0; axis < 3; axis++) result[3 * frame + axis] = (sums[3 * to + axis] - sums[3 * from + axis]) / (to - from);
  }
  return result;
}

function mixed(values, at, next, part) { return part ? values[at] + part * (values[next] - values[at]) : values[at]; }

const rounded = (value, digits) => value.toLocaleString("en", { maximumFractionDigits: digits });

function makePanel(data, number, isAlone, mark, changed) {
  const take = measured(data), figure = element("figure"), caption = element("figcaption"), canvas = element("canvas");
  const head = element("div", "name"), name = element("button", isAlone ? "alone" : "", take.name), state = element("span", "state");
  const curve = CURVES[number % CURVES.length];
  if (!isAlone) {
    const swatch = element("span", "swatch");
    swatch.style.background = curve;
    swatch.title = "its speed below";
    head.append(swatch);
    name.title = "its frames are stepped through";
  }
  head.append(name, state);
  const fps = take.fps[0] / take.fps[1], exact = take.fps[1] === 1 ? "" : ` (${take.fps.join("/")})`;
  const facts = take.facts || [`${take.unevenSeconds ? "uneven, about " : ""}${rounded(fps, 3)} fps${exact}`, `${rounded(take.numFrames, 0)} frames`,
    `${rounded(endOf(take) - secondsOf(take, 0), 2)} s`, ...take.labels];
  caption.append(head, element("div", "facts", facts.join(" · ")));
  const lines = take.captions.map(([text]) => element("p", "", text));
  if (lines.length) { const box = element("div", "captions"); box.append(...lines); caption.append(box); }
  if (take.details.length) {
    const about = element("details", "about"), list = element("dl");
    for (const [what, value] of take.details) list.append(element("dt", "", what), element("dd", "", value));
    about.append(element("summary", "", "about"), list);
    about.ontoggle = changed;
    caption.append(about);
  }
  const stage = element("div", "stage");
  stage.append(canvas);
  figure.append(caption, stage);
  canvas.setAttribute("aria-label", `${take.name}, a moving skeleton`);
  name.onclick = () => mark(number);
  controlView(canvas, changed);
  return { take, figure, canvas, state, lines, curve };
}

// How far lines of the ground are apart, in metres.
function gridSpacing(size) { return 10 ** Math.round(Math.log10(size / 1.7)); }

function drawGround(pen, project, take, centre, extent, spacing) {
  const half = Math.max(3, Math.min(30, Math.ceil(extent / spacing))) , ox = Math.round(centre[0] / spacing), oz = Math.round(centre[2] / spacing);
  pen.strokeStyle = colour("--grid"); pen.lineWidth = 1; pen.beginPath();
  for (let k = -half; k <= half; k++) {
    const x = (ox + k) * spacing, z = (oz + k) * spacing, y = take.ground;
    pen.moveTo(...project(x, y, (oz - half) * spacing)); pen.lineTo(...project(x, y, (oz + half) * spacing));
    pen.moveTo(...project((ox - half) * spacing, y, z)); pen.lineTo(...project((ox + half) * spacing, y, z));
  }
  pen.stroke();
}

function drawTrails(pen, project, take, frame, colours) {
  const first = frameAt(take, secondsOf(take, frame) - TRAIL_SECONDS).frame, parts = 5;
  for (const joint of take.ends) {
    const places = [];
    for (let at = first; at <= frame; at++) places.push(project(...take.joints.subarray(3 * (at * take.count + joint), 3 * (at * take.count + joint) + 3)));
    pen.strokeStyle = pen.fillStyle = colours(take.sides[joint]);
    pen.lineWidth = 1.2;
    for (let part = 0; part < parts; part++) {
      const from = Math.floor(part * (places.length - 1) / parts), to = Math.floor((part + 1) * (places.length - 1) / parts);
      pen.globalAlpha = 0.15 + 0.6 * (part + 1) / parts;
      pen.beginPath();
      for (let i = from; i <= to; i++) pen.lineTo(places[i][0], places[i][1]);
      pen.stroke();
      pen.beginPath();
      for (let i = from; i <= to; i++) { pen.moveTo(places[i][0] + 1.7, places[i][1]); pen.arc(places[i][0], places[i][1], 1.7, 0, 7); }
      pen.fill();
    }
  }
}

function drawAxes(pen, height, yaw) {
  const cy = Math.cos(yaw), sy = Math.sin(yaw), cp = Math.cos(view.pitch), sp = Math.sin(view.pitch), x0 = 30, y0 = height - 30;
  pen.font = "11px system-ui, sans-serif"; pen.textAlign = "center"; pen.textBaseline = "middle"; pen.lineWidth = 1.5;
  for (const [letter, side, up] of [["x", cy, -sp * sy], ["y", 0, cp], ["z", -sy, -sp * cy]]) {
    pen.strokeStyle = pen.fillStyle = colour("--soft");
    pen.beginPath(); pen.moveTo(x0, y0); pen.lineTo(x0 + 16 * side, y0 - 16 * up); pen.stroke();
    pen.fillText(letter, x0 + 23 * side, y0 - 23 * up);
  }
}

// The place that the camera follows.
function placeAt(take, seconds, linear) {
  const { frame, part } = frameAt(take, seconds), next = Math.min(frame + 1, take.numFrames - 1);
  return [0, 1, 2].map((axis) => mixed(take.path, 3 * frame + axis, 3 * next + axis, linear ? part : 0));
}

function drawPanel(panel, seconds, settings, commonSize) {
  const { take, canvas } = panel, [pen, width, height] = prepare(canvas);
  const held = frameAt(take, seconds), frame = held.frame, part = settings.linear ? held.part : 0;
  const next = Math.min(frame + 1, take.numFrames - 1), size = commonSize || take.size;
  // Where the camera is goes by the take itself, or for all by one.
  const leader = settings.leader || take, yaw = view.yaw + leader.yaw, centre = settings.follow ? placeAt(leader, settings.leader ? settings.leaderSeconds : seconds, settings.linear) : leader.still;
  const project = projection(width, height, centre, settings.follow ? size : Math.max(size, leader.span), yaw);
  const spacing = gridSpacing(size);
  drawGround(pen, project, take, centre, settings.follow ? 2.4 * size / Math.min(1, view.zoom) : 0.6 * leader.span + size, spacing);
  const isSeen = !take.seen || take.seen[frame] === 1;
  const colours = (side) => colour(!side ? "--ink" : side < 0 ? "--left" : "--right");
  pen.lineCap = "round"; pen.lineJoin = "round";
  const places = [], shadows = [];
  for (let joint = 0; joint < take.count; joint++) {
    const at = 3 * (frame * take.count + joint), to = 3 * (next * take.count + joint);
    const x = mixed(take.joints, at, to, part), y = mixed(take.joints, at + 1, to + 1, part), z = mixed(take.joints, at + 2, to + 2, part);
    places.push(project(x, y, z)); shadows.push(project(x, take.ground, z));
  }
  const unit = project.scale * size, bones = take.body.filter((joint) => take.bones[joint] >= 0);
  pen.strokeStyle = colour("--shadow"); pen.lineWidth = Math.max(1.5, 0.02 * unit); pen.beginPath();
  for (const joint of bones) { pen.moveTo(shadows[joint][0], shadows[joint][1]); pen.lineTo(shadows[take.bones[joint]][0], shadows[take.bones[joint]][1]); }
  pen.stroke();
  pen.globalAlpha = held.state ? 0.25 : 1;
  if (settings.trails) drawTrails(pen, project, take, frame, colours);
  pen.globalAlpha = held.state ? 0.25 : isSeen ? 1 : 0.4;
  bones.sort((a, b) => places[a][2] - places[b][2]);
  const wide = Math.max(1.6, Math.min(9, 0.017 * unit));
  for (const joint of bones) {
    const [x, y, near] = places[joint], [x0, y0] = places[take.bones[joint]];
    pen.strokeStyle = pen.fillStyle = colours(take.sides[joint]); pen.lineWidth = wide * take.thickness[joint] * near;
    pen.beginPath(); pen.moveTo(x0, y0); pen.lineTo(x, y); pen.stroke();
    pen.beginPath(); pen.arc(x, y, 0.75 * wide * take.thickness[joint] * near, 0, 7); pen.fill();
  }
  if (take.isPoints) for (const joint of take.body) {
    pen.fillStyle = colours(take.sides[joint]); pen.beginPath(); pen.arc(places[joint][0], places[joint][1], wide * places[joint][2], 0, 7); pen.fill();
  }
  if (take.head >= 0) {
    pen.fillStyle = colours(0); pen.beginPath();
    pen.arc(places[take.head][0], places[take.head][1], 0.05 * unit * places[take.head][2], 0, 7); pen.fill();
  }
  pen.globalAlpha = 1;
  if (settings.plain) return;
  drawAxes(pen, height, yaw);
  pen.fillStyle = colour("--soft"); pen.textAlign = "right"; pen.textBaseline = "alphabetic"; pen.font = "12px system-ui, sans-serif";
  const level = take.ground ? `, drawn at y = ${take.ground.toFixed(2)} m` : "";
  pen.fillText(`grid ${rounded(spacing, 6)} m${level}`, width - 8, height - 8);
  tell(panel, held, isSeen, part);
}

function tell(panel, held, isSeen, part) {
  const { take, state } = panel, first = secondsOf(take, held.frame);
  const kind = held.state < 0 ? "begins later" : held.state > 0 ? "is over" : !isSeen ? "lost" : "";
  state.textContent = `${kind ? kind + " · " : ""}frame ${take.firstFrame + held.frame}${part ? " +" + part.toFixed(2) : ""}`;
  take.captions.forEach(([, start, end], number) => {
    panel.lines[number].className = !held.state && first >= start - SAME_SECONDS && (end === null || first < end) ? "now" : "";
  });
}
