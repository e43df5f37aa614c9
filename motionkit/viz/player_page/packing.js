// Positions and other arrays as text (motionkit/viz/player.py).

function bytesOf(text) {
  const letters = atob(text), bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  return bytes;
}

// Positions in metres, [frames, joints, 3] in one array: the root's, and steps from it.
function unpack(packed) {
  const root = new Float32Array(bytesOf(packed.root).buffer), steps = new Int16Array(bytesOf(packed.steps).buffer);
  const width = 3 * steps.length / root.length;
  return Float32Array.from(steps, (step, i) => root[3 * Math.floor(i / width) + i % 3] + step * packed.stepMetres);
}

// Which frames were observed, a bit for each; null where all of them were.
function unpackBits(text, length) {
  if (text === null) return null;
  const bytes = bytesOf(text);
  return Uint8Array.from({ length }, (_, i) => (bytes[i >> 3] >> (i & 7)) & 1);
}
