const find = (id) => document.getElementById(id);
const study = JSON.parse(find("study").textContent), { trials } = study, store = `motionkit study ${study.study}`;
const [before, after] = study.shell.split("__DATA__");

// What was answered outlives a page that is closed by mistake, where the browser lets it.
function remembered() {
  try { return JSON.parse(localStorage.getItem(store)) || {}; } catch { return {}; }
}
function remember() {
  try { localStorage.setItem(store, JSON.stringify({ participant, answers, place })); } catch { /* private window */ }
}
const newParticipant = () => [...crypto.getRandomValues(new Uint8Array(8))].map((byte) => byte.toString(16).padStart(2, "0")).join("");

let { participant = newParticipant(), answers = trials.map(() => null), place = 0 } = remembered();
let shownAt = 0;

function show() {
  const isEnd = place >= trials.length, hadFocus = !find("asking").hidden;
  find("welcome").hidden = true;
  find("asking").hidden = isEnd;
  find("end").hidden = !isEnd;
  remember();
  if (isEnd) { offer(); find("download").focus(); return; }
  const { question, caption, player } = trials[place];
  find("place").textContent = `${place + 1} of ${trials.length}`;
  find("question").textContent = study.questions[question];
  find("caption").textContent = question === "consistent" ? caption : "";
  for (const choice of ["a", "b"]) find(choice).classList.toggle("chosen", answers[place]?.choice === choice);
  find("back").disabled = place === 0;
  find("motions").srcdoc = before + JSON.stringify(player).replaceAll("<", "\\u003c") + after;
  if (!hadFocus) find("begin").blur();
  shownAt = performance.now();
}

function answer(choice) {
  answers[place] = { trial: place, choice, seconds: Math.round((performance.now() - shownAt) / 100) / 10 };
  place += 1;
  show();
}

function back() { if (place > 0) { place -= 1; show(); } }

function offer() {
  const text = JSON.stringify({ format: study.format, study: study.study, participant, answers }, null, 2);
  URL.revokeObjectURL(find("download").href);
  find("download").href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
  find("download").download = `answers-${participant}.json`;
}

function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || find("asking").hidden) return;
  const act = { a: () => answer("a"), b: () => answer("b"), backspace: back }[event.key.toLowerCase()];
  if (act) { event.preventDefault(); act(); }
}
document.addEventListener("keydown", onKey);
// Keys of the player go to the player, which has the focus as soon as it is there.
find("motions").onload = () => {
  find("motions").contentWindow.document.addEventListener("keydown", onKey);
  find("motions").contentWindow.focus();
};
find("count").textContent = trials.length;
find("begin").textContent = place ? "Go on" : "Begin";
find("begin").onclick = show;
find("a").onclick = () => answer("a");
find("b").onclick = () => answer("b");
find("back").onclick = find("again").onclick = back;
find("next-person").onclick = () => {
  participant = newParticipant(); answers = trials.map(() => null); place = 0;
  remember();
  find("end").hidden = true; find("welcome").hidden = false; find("begin").textContent = "Begin"; find("begin").focus();
};
