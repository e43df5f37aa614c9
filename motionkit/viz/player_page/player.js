// What holds it together: the takes, the clock, the keys.

const find = (id) => document.getElementById(id);
const data = JSON.parse(find("data").textContent);
const SPEEDS = [...find("speed").options].map((option) => option.value);
const NARROWEST_PANEL = 300;
const page = { start: 0, end: 0 };
const panels = data.takes.map((take, number) => makePanel(take, number, data.takes.length === 1, mark, refresh));
page.start = Math.min(...panels.map(({ take }) => secondsOf(take, 0)));
page.end = Math.max(...panels.map(({ take }) => endOf(take)));
const sizes = panels.map(({ take }) => take.size);
// One scale for all, so that sizes compare, unless a unit is another.
const commonSize = Math.max(...sizes) < 3 * Math.min(...sizes) ? Math.max(...sizes) : 0;

// Marked at first: the first of those with the highest framerate.
let marked = 0, seconds = page.start, playing = true, last = null, waiting = false;
panels.forEach(({ take }, number) => {
  const best = panels[marked].take;
  if (take.fps[0] * best.fps[1] > best.fps[0] * take.fps[1]) marked = number;
});

// Of motions of unequal length each may begin again at its own end.
function instantOf(take) { return find("again").checked ? againAt(take, seconds) : seconds; }

function show() {
  waiting = false;
  inks.clear();
  const settings = { linear: find("between").value === "linear", follow: find("follow").checked, trails: find("trails").checked,
    leader: find("shared").checked ? panels[marked].take : null, leaderSeconds: instantOf(panels[marked].take) };
  for (const panel of panels) drawPanel(panel, instantOf(panel.take), settings, commonSize);
  drawTimeline(panels, marked, seconds);
  const { take } = panels[marked], held = frameAt(take, instantOf(take)), input = find("frame");
  if (document.activeElement !== input || playing) input.value = take.firstFrame + held.frame;
  find("clock").replaceChildren(`${seconds.toFixed(3)} s`, element("span", "word", ` of ${page.end.toFixed(2)}`));
  timeline.canvas.setAttribute("aria-valuenow", seconds.toFixed(3));
  timeline.canvas.setAttribute("aria-valuetext", `${seconds.toFixed(2)} seconds`);
}

// Draws at the next occasion, once.
function refresh() {
  if (!waiting) { waiting = true; requestAnimationFrame(show); }
}

function seek(to) { seconds = Math.max(page.start, Math.min(page.end - 2 * SAME_SECONDS, to)); refresh(); }

function setPlaying(yes) {
  playing = yes; last = null;
  find("play").textContent = playing ? "Pause" : "Play";
  if (playing) requestAnimationFrame(tick);
}

function tick(now) {
  if (!playing) return;
  if (last !== null) {
    seconds += (now - last) / 1000 * Number(find("speed").value);
    if (seconds >= page.end) seconds = page.start;
    show();
  }
  last = now;
  requestAnimationFrame(tick);
}

// To a frame of the marked take, by its own number; it stands still there.
function goToFrame(frame) {
  const { take } = panels[marked];
  setPlaying(false);
  seek(secondsOf(take, Math.max(0, Math.min(take.numFrames - 1, frame))));
}

function step(frames) { const { take } = panels[marked]; goToFrame(frameAt(take, instantOf(take)).frame + frames); }

function mark(number) {
  marked = number;
  panels.forEach((panel, each) => panel.figure.classList.toggle("marked", each === marked && panels.length > 1));
  const { take } = panels[marked], input = find("frame");
  input.min = take.firstFrame; input.max = take.firstFrame + take.numFrames - 1;
  timeline.canvas.style.setProperty("--below", `${heightBelow(take)}px`);
  input.title = `of ${take.name}: ${input.min} … ${input.max}`;
  refresh();
}

function changeSpeed(by) {
  const at = SPEEDS.indexOf(find("speed").value) + by;
  find("speed").value = SPEEDS[Math.max(0, Math.min(SPEEDS.length - 1, at))];
}

// A single motion says its name itself.
document.querySelector("h1").textContent = panels.length > 1 ? data.title : "";
find("note").textContent = data.note;
find("shared-label").hidden = panels.length === 1;
find("again-label").hidden = panels.every(({ take }) => endOf(take) >= page.end - SAME_SECONDS);
find("panels").append(...panels.map((panel) => panel.figure));
find("panels").classList.toggle("many", panels.length > 2);
timeline.canvas.setAttribute("aria-valuemin", page.start.toFixed(3));
timeline.canvas.setAttribute("aria-valuemax", page.end.toFixed(3));

find("play").onclick = () => setPlaying(!playing);
find("back").onclick = () => step(-1);
find("next").onclick = () => step(1);
find("frame").onfocus = () => setPlaying(false);
find("frame").oninput = (event) => { if (event.target.value !== "") goToFrame(Number(event.target.value) - panels[marked].take.firstFrame); };
find("reset").onclick = () => { Object.assign(view, FIRST_VIEW); refresh(); };
for (const id of ["between", "follow", "trails", "shared", "again"]) find(id).onchange = refresh;

const scrub = (event) => {
  const box = timeline.canvas.getBoundingClientRect();
  setPlaying(false);
  seek(instantAt(event.clientX - box.left, box.width));
};
timeline.canvas.onpointerdown = (event) => { scrub(event); timeline.canvas.setPointerCapture(event.pointerId); };
timeline.canvas.onpointermove = (event) => { if (event.buttons) scrub(event); };

const toggle = (id) => { find(id).checked = !find(id).checked; refresh(); };
const KEYS = {
  " ": () => setPlaying(!playing),
  ArrowLeft: (event) => step(event.shiftKey ? -10 : -1),
  ArrowRight: (event) => step(event.shiftKey ? 10 : 1),
  ArrowUp: () => changeSpeed(1),
  ArrowDown: () => changeSpeed(-1),
  Home: () => goToFrame(0),
  End: () => goToFrame(Infinity),
  f: () => toggle("follow"),
  c: () => toggle("shared"),
  t: () => toggle("trails"),
  l: () => toggle("again"),
  i: () => { find("between").value = find("between").value === "hold" ? "linear" : "hold"; refresh(); },
  r: () => find("reset").onclick(),
};
document.addEventListener("keydown", (event) => {
  const own = event.target.closest(event.key === " " ? "button, input, select, summary" : "input[type=number], select"), act = KEYS[event.key] || KEYS[event.key.toLowerCase()];
  if (!act || own || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  act(event);
});

// Rows as full as may be: four panels are two and two where three would fit.
function arrange() {
  const most = Math.max(1, Math.floor(find("panels").clientWidth / NARROWEST_PANEL)), rows = Math.ceil(panels.length / most);
  find("panels").style.setProperty("--columns", Math.ceil(panels.length / rows));
  refresh();
}
// What a pointer has pressed gives the focus back, so that space plays again.
document.addEventListener("click", (event) => {
  const pressed = event.detail ? event.target.closest("button, summary, input[type=checkbox]") : null;
  if (pressed) pressed.blur();
});
new ResizeObserver(arrange).observe(find("panels"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", refresh);

// A page may be opened at an instant, standing still: page.html#frame=12 of the marked take, or #t=1.5.
function followAddress() {
  const asked = /^#(frame|t)=(-?\d+(?:\.\d+)?)$/.exec(location.hash);
  if (!asked) return false;
  setPlaying(false);
  if (asked[1] === "frame") goToFrame(Number(asked[2]) - panels[marked].take.firstFrame); else seek(Number(asked[2]));
  return true;
}
window.onhashchange = followAddress;
mark(marked);
if (!followAddress()) setPlaying(!matchMedia("(prefers-reduced-motion: reduce)").matches);
show();
