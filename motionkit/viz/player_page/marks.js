// Which cards a filter shows, and what is written of the marked ones.

function isShown(card, filter) {
  const texts = [card.name, card.action, ...card.captions.map(([text]) => text)].join("\n").toLowerCase();
  return (!filter.fps || card.nativeFps.join("/") === filter.fps)
    && ["source", "action", "split"].every((name) => !filter[name] || card[name] === filter[name])
    && (!filter.flag || card.flags.includes(filter.flag))
    && card.duration_seconds >= (filter.shortest || 0) && card.duration_seconds <= (filter.longest || Infinity)
    && filter.text.toLowerCase().split(/\s+/).every((word) => texts.includes(word));
}

// A table of annotations for each source (docs/formats.md#annotations): its paths count from the source, and a file of
// several motions has one row.
function tablesOf(cards, column, value) {
  const cell = (text) => (/[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const sources = new Map();
  for (const card of cards) {
    if (!sources.has(card.source)) sources.set(card.source, new Map());
    const rows = sources.get(card.source);
    if (!rows.has(card.source_path)) rows.set(card.source_path, [card.source_path, card.sequence_id, value].map(cell).join(","));
  }
  return [...sources].map(([source, rows]) => [source, `file,sequence_id,${column}\n${[...rows.values()].join("\n")}\n`]);
}

// A word of a command for a POSIX shell.
function quoted(text) {
  if (/^[\w./:=@%+-]+$/.test(text)) return text;
  return /["$`\\!\n]/.test(text) ? `'${text.replaceAll("'", "'\\''")}'` : `"${text}"`;
}

// The command that puts sequences of a store into a split.
function splitCommand(store, split, cards) {
  const ids = cards.map((card) => `'${card.sequence_id.replaceAll("'", "''")}'`).join(", ");
  return `motionkit split ${quoted(store)} --shares ${quoted(`${split}=1`)} --by sequence_id --where ${quoted(`sequence_id IN (${ids})`)}`;
}
