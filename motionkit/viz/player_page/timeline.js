// The line of time below: speeds of all takes, captions and observed frames of the marked one, the instant that is shown.

const EDGE = 8, LANE = 15, MASK = 12, MOST_LANES = 3;
const timeline = { canvas: document.getElementById("timeline"), picture: document.createElement("canvas"), key: "" };

function instantX(seconds, width) { return EDGE + (width - 2 * EDGE) * (seconds - page.start) / Math.max(page.end - page.start, 1e-9); }
function instantAt(x, width) { return page.start + (page.end - page.start) * Math.max(0, Math.min(1, (x - EDGE) / (width - 2 * EDGE))); }

function drawTimeline(panels, marked, seconds) {
  const [pen, width, height] = prepare(timeline.canvas), ratio = window.devicePixelRatio || 1;
  const key = [width, height, ratio, marked, colour("--ink")].join();
  if (key !== timeline.key) {
    timeline.key = key;
    timeline.picture.width = timeline.canvas.width; timeline.picture.height = timeline.canvas.height;
    const still = timeline.picture.getContext("2d");
    still.setTransform(ratio, 0, 0, ratio, 0, 0);
    drawStill(still, width, height, panels, panels[marked].take);
  }
  if (width && height) pen.drawImage(timeline.picture, 0, 0, width, height);
  pen.fillStyle = colour("--ink");
  pen.fillRect(instantX(seconds, width) - 1, 0, 2, height);
}

// How much room what is below the curves takes, in pixels.
function heightBelow(take) { return LANE * captionLanes(take).length + (take.seen && take.seen.includes(0) ? MASK : 0); }

function drawStill(pen, width, height, panels, marked) {
  const lanes = captionLanes(marked), bottom = height - 3 - heightBelow(marked), top = 16;
  let fastest = 1e-6;
  for (const { take } of panels) for (const speed of take.speeds) fastest = Math.max(fastest, speed);
  pen.strokeStyle = colour("--line"); pen.beginPath(); pen.moveTo(EDGE, bottom); pen.lineTo(width - EDGE, bottom); pen.stroke();
  for (const { take, curve } of panels) {
    pen.strokeStyle = curve; pen.lineWidth = 1.2; pen.beginPath();
    // The fastest of the frames that share a column, so that no spike is lost.
    let column = null, highest = 0;
    for (let frame = 0; frame < take.numFrames; frame++) {
      const x = Math.round(2 * instantX(secondsOf(take, frame), width)) / 2, speed = take.speeds[frame];
      if (x === column) { highest = Math.max(highest, speed); continue; }
      if (column !== null) pen.lineTo(column, bottom - (bottom - top) * highest / fastest);
      column = x; highest = speed;
    }
    pen.lineTo(column, bottom - (bottom - top) * highest / fastest);
    pen.stroke();
  }
  pen.font = "11px system-ui, sans-serif"; pen.textBaseline = "middle"; pen.fillStyle = colour("--soft");
  pen.fillText(`${fastest.toFixed(2)} m/s`, EDGE, 8);
  pen.textAlign = "right"; pen.fillText(`${page.end.toFixed(2)} s`, width - EDGE, 8); pen.textAlign = "left";
  lanes.forEach((lane, row) => lane.forEach(([text, start, end]) => {
    const x = instantX(start, width), wide = instantX(end, width) - x, y = bottom + 2 + row * LANE;
    pen.fillStyle = colour("--line"); pen.fillRect(x + 1, y, Math.max(1, wide - 2), LANE - 2);
    pen.save(); pen.beginPath(); pen.rect(x + 3, y, Math.max(0, wide - 6), LANE); pen.clip();
    pen.fillStyle = colour("--ink"); pen.fillText(text, x + 4, y + LANE / 2 - 1); pen.restore();
  }));
  if (marked.seen && marked.seen.includes(0)) for (let frame = 0; frame < marked.numFrames; frame++) {
    const x = instantX(secondsOf(marked, frame), width), wide = Math.max(1, instantX(secondsOf(marked, frame) + marked.fps[1] / marked.fps[0], width) - x);
    if (marked.seen[frame]) { pen.fillStyle = colour("--ink"); pen.fillRect(x, height - 13, Math.min(1.5, wide), 11); }
    else { pen.fillStyle = colour("--made"); pen.globalAlpha = 0.3; pen.fillRect(x, height - 11, wide, 7); pen.globalAlpha = 1; }
  }
}

// Captions that are about a part of the take, each in the first lane that is free.
function captionLanes(take) {
  const lanes = [];
  for (const [text, start, end] of take.captions) {
    if (end === null && start <= page.start) continue;
    const until = end === null ? endOf(take) : end, lane = lanes.find((each) => each[each.length - 1][2] <= start + SAME_SECONDS);
    if (lane) lane.push([text, start, until]);
    else if (lanes.length < MOST_LANES) lanes.push([[text, start, until]]);
  }
  return lanes;
}
