// One clock in seconds for all takes; each has its own frames on it. A frame is held until the time of the next one.

const SAME_SECONDS = 1e-6;

function secondsOf(take, frame) {
  if (take.unevenSeconds) return take.unevenSeconds[frame];
  return take.startSeconds + frame * take.fps[1] / take.fps[0];
}

// Intervals are half-open: the last frame lasts as long as any other.
function endOf(take) { return secondsOf(take, take.numFrames - 1) + take.fps[1] / take.fps[0]; }

// The frame that is held at an instant, how far it is to the next (0 … 1), and whether the take is there at all:
// -1 before it begins, 1 after its end.
function frameAt(take, seconds) {
  const last = take.numFrames - 1;
  const state = seconds < secondsOf(take, 0) - SAME_SECONDS ? -1 : seconds >= endOf(take) - SAME_SECONDS ? 1 : 0;
  if (state) return { frame: state < 0 ? 0 : last, part: 0, state };
  let frame;
  if (take.unevenSeconds) {
    let low = 0, high = last;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (take.unevenSeconds[middle] <= seconds + SAME_SECONDS) low = middle; else high = middle - 1;
    }
    frame = low;
  } else {
    frame = Math.min(last, Math.floor((seconds + SAME_SECONDS - take.startSeconds) * take.fps[0] / take.fps[1]));
  }
  if (frame === last) return { frame, part: 0, state };
  const here = secondsOf(take, frame), part = (seconds - here) / (secondsOf(take, frame + 1) - here);
  return { frame, part: part < 1e-3 ? 0 : Math.min(part, 1), state };
}

// The take's own instant where each begins again at its end, as long as the longest plays.
function againAt(take, seconds) {
  const start = secondsOf(take, 0), length = endOf(take) - start;
  return seconds < start ? seconds : start + Math.max(0, (seconds - start + SAME_SECONDS) % length - SAME_SECONDS);
}
