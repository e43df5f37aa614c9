// Cards that move while they are in sight, the filter, the player of one card, the marks.

const find = (id) => document.getElementById(id);
const data = JSON.parse(find("data").textContent);
const filter = find("filter"), player = find("player"), inSight = new Set();
const WITHOUT = { seen: null, unevenSeconds: null, ends: [], details: [], labels: [], firstFrame: 0 };
// Jumps leave the size of the body.
const AIR = 1.2;
const THUMBNAIL = { plain: true, follow: true };
const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
const fpsText = ([numerator, denominator]) => `${rounded(numerator / denominator, 3)} fps`;
const cards = data.cards.map((card) => ({ ...WITHOUT, ...card, isMarked: false }));
let isSaved = true, shown = cards, opened = null, panel = null, playing = true, seconds = 0, last = null;

function fillFilter() {
  const options = {
    fps: [(card) => [card.nativeFps.join("/")], "framerates", (value) => fpsText(value.split("/"))],
    source: [(card) => [card.source], "sources"], action: [(card) => [card.action], "actions"],
    flag: [(card) => card.flags, "flags"], split: [(card) => [card.split], "splits"],
  };
  for (const [name, [valuesOf, plural, textOf]] of Object.entries(options)) {
    const counts = new Map(), select = filter.elements[name];
    for (const card of cards) for (const value of valuesOf(card)) if (value) counts.set(value, (counts.get(value) || 0) + 1);
    const sorted = [...counts].sort(([a], [b]) => a.localeCompare(b, "en", { numeric: true }));
    select.append(new Option(`all ${plural}`, ""), ...sorted.map(([value, count]) => new Option(`${textOf ? textOf(value) : value} (${count})`, value)));
    select.hidden = counts.size === 0;
  }
}

function makeCard(card) {
  const box = element("div", "card"), open = element("button", "open"), label = element("label"), input = element("input");
  card.box = box; card.canvas = element("canvas"); card.input = input;
  const facts = [fpsText(card.nativeFps), `${rounded(card.duration_seconds, 1)} s`, card.action, ...card.flags];
  const said = element("p", "said", card.captions.map(([text]) => text).join(" / "));
  const id = element("p", "id");
  id.append(element("bdi", "", card.name));
  open.append(card.canvas, id, element("p", "facts", facts.filter(Boolean).join(" · ")), said);
  open.title = card.name;
  open.onclick = () => openCard(card);
  input.type = "checkbox"; input.ariaLabel = `mark ${card.name}`;
  input.onchange = () => mark([card], input.checked);
  label.append(input);
  box.append(open, label);
  return box;
}

// What has left the sight gives its picture's memory back.
const observer = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    const card = cards[target.dataset.number];
    card.frame = null;
    if (isIntersecting) { card.take ||= measured(card); inSight.add(card); } else { inSight.delete(card); card.canvas.width = 0; }
  }
}, { rootMargin: "80px" });

function drawThumbnails(now) {
  for (const card of inSight) {
    const instant = still ? card.startSeconds : againAt(card.take, card.startSeconds + now / 1000), { frame } = frameAt(card.take, instant);
    if (frame !== card.frame) drawPanel(card, instant, THUMBNAIL, AIR * card.take.size);
    card.frame = frame;
  }
}

function drawOpened(now) {
  const { take } = panel;
  if (playing && last !== null) seconds = againAt(take, seconds + (now - last) / 1000);
  last = now;
  drawPanel(panel, seconds, { linear: true, follow: true }, AIR * take.size);
  find("time").value = seconds;
  find("clock").textContent = `${seconds.toFixed(2)} s`;
}

function tick(now) {
  inks.clear();
  if (opened) drawOpened(now); else drawThumbnails(now);
  requestAnimationFrame(tick);
}

function setPlaying(yes) { playing = yes; find("play").textContent = playing ? "Pause" : "Play"; }

function openCard(card) {
  const isPart = card.numFrames * card.fps[1] / card.fps[0] < card.duration_seconds - 0.2;
  const facts = [fpsText(card.nativeFps), `${rounded(card.num_frames, 0)} frames`, `${rounded(card.duration_seconds, 2)} s`,
    isPart ? `shown: ${rounded(card.startSeconds, 1)} to ${rounded(endOf(card), 1)} s` : "", card.action, card.subject && `subject ${card.subject}`, card.split, ...card.flags];
  if (panel) panel.figure.remove();
  opened = card; last = null; Object.assign(view, FIRST_VIEW);
  panel = makePanel({ ...card, facts: facts.filter(Boolean) }, 0, true, () => {}, () => {});
  seconds = find("time").min = card.startSeconds;
  find("time").max = endOf(panel.take) - SAME_SECONDS;
  find("marks").checked = card.isMarked;
  find("every-frame").textContent = `motionkit view ${quoted(card.sequence_id)} --store ${quoted(data.store)}`;
  player.prepend(panel.figure);
  setPlaying(true);
  if (!player.open) player.showModal();
}

function step(by) { const next = shown[shown.indexOf(opened) + by]; if (next) openCard(next); }

function mark(some, isMarked) {
  for (const card of some) { card.isMarked = card.input.checked = isMarked; card.box.classList.toggle("marked", isMarked); }
  isSaved = false;
  describeMarks();
}

function describeMarks() {
  const marked = cards.filter((card) => card.isMarked), value = find("value").value;
  isSaved ||= !marked.length;
  find("number").textContent = `${rounded(marked.length, 0)} marked`;
  find("table").disabled = find("unmark").disabled = !marked.length;
  const split = find("column").value === "split" && value ? value : "test";
  find("command").value = marked.length ? splitCommand(data.store, split, marked) : "";
}

function applyFilter() {
  const chosen = Object.fromEntries(new FormData(filter));
  shown = cards.filter((card) => { const yes = isShown(card, chosen); card.box.hidden = !yes; return yes; });
  const minutes = shown.reduce((sum, card) => sum + card.duration_seconds, 0) / 60;
  const length = minutes < 90 ? `${rounded(minutes, 1)} min` : `${rounded(minutes / 60, 1)} h`;
  find("count").textContent = `${rounded(shown.length, 0)} of ${rounded(cards.length, 0)} sequences, ${length}`;
}

function download() {
  for (const [source, text] of tablesOf(cards.filter((card) => card.isMarked), find("column").value, find("value").value)) {
    const link = element("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
    link.download = `marked-${(source || "motions").replace(/[^\w.-]+/g, "_")}.csv`;
    link.click();
  }
  isSaved = true;
}

document.querySelector("h1").textContent = document.title;
fillFilter();
find("cards").append(...cards.map(makeCard));
cards.forEach((card, number) => { card.box.dataset.number = number; observer.observe(card.box); });
filter.oninput = applyFilter;
filter.onsubmit = (event) => event.preventDefault();
find("mark-all").onclick = () => mark(shown, true);
find("unmark").onclick = () => mark(cards, false);
find("column").onchange = find("value").oninput = describeMarks;
find("table").onclick = download;
find("before").onclick = () => step(-1);
find("after").onclick = () => step(1);
find("play").onclick = () => setPlaying(!playing);
find("time").oninput = (event) => { setPlaying(false); seconds = Number(event.target.value); };
find("marks").onchange = (event) => mark([opened], event.target.checked);
find("close").onclick = () => player.close();
player.onclose = () => { opened = null; Object.assign(view, FIRST_VIEW); };
player.onclick = (event) => { if (event.target === player) player.close(); };
player.onkeydown = (event) => {
  if (event.target.type === "range" || (event.key === " " && event.target.closest("button, input, summary"))) return;
  const act = { ArrowLeft: () => step(-1), ArrowRight: () => step(1), " ": () => setPlaying(!playing), m: () => find("marks").click() }[event.key];
  if (act) { event.preventDefault(); act(); }
};
window.onbeforeunload = (event) => { if (!isSaved) event.preventDefault(); };
applyFilter();
describeMarks();
// A page may be opened with a card: corpus.html#ID.
const named = cards.find((card) => card.sequence_id === decodeURIComponent(location.hash.slice(1)));
if (named) openCard(named);
requestAnimationFrame(tick);
