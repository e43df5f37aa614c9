// Positions and other arrays as text (motionkit/viz/player/takes.py).

function bytesOf(text) {
  const letters = atob(text), bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  return bytes;
}

// Positions in metres, [frames, joints, 3] in one array: grid points are differences to those of the parents.
function unpack(packed) {
  const parents = packed.parents, count = parents.length, isWide = parents.map((_, joint) => packed.wide.includes(joint));
  const wide = new Int32Array(bytesOf(packed.wideNumbers).buffer), narrow = new Int16Array(bytesOf(packed.narrowNumbers).buffer);
  const frames = wide.length / (3 * packed.wide.length), metres = new Float32Array(3 * frames * count);
  const points = new Int32Array(3 * count);
  let fromWide = 0, fromNarrow = 0, to = 0;
  for (let frame = 0; frame < frames; frame++) {
    for (let joint = 0; joint < count; joint++) {
      const above = parents[joint];
      for (let axis = 0; axis < 3; axis++) {
        let point = isWide[joint] ? wide[fromWide++] : narrow[fromNarrow++];
        if (above >= 0) point += points[3 * above + axis];
        points[3 * joint + axis] = point;
        metres[to++] = point * packed.step;
      }
    }
  }
  return metres;
}

// Which frames were observed, a bit for each; null where all of them were.
function unpackBits(text, length) {
  if (text === null) return null;
  const bytes = bytesOf(text);
  return Uint8Array.from({ length }, (_, i) => (bytes[i >> 3] >> (i & 7)) & 1);
}
