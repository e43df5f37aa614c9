"""HumanML3D's text files: one caption per line, `caption#word/POS word/POS …#start#end`, in seconds.

0.0#0.0 and nan mean the whole motion. Source: https://github.com/EricGuo5513/HumanML3D (texts.zip, README).
"""

import math
from collections.abc import Collection, Iterable
from pathlib import Path

from motionkit.core.errors import FormatError
from motionkit.core.motion import Caption
from motionkit.io import source_file


def read_texts(path: Path) -> tuple[Caption, ...]:
    """Captions with their segments; swapped ends are reordered. A line without `#` is a caption of the whole motion.

    Raises `FormatError` (`text`, `encoding`, `empty`) naming the line.
    """
    text = source_file.decode(source_file.read_bytes(path), path)
    return tuple(_caption(line, path, number) for number, line in enumerate(text.split("\n"), start=1) if line.strip())


def format_texts(captions: Iterable[Caption], duration_seconds: float) -> str:
    """The lines for some captions; words without tags get the tag X (other), `#` in a caption becomes a space."""
    lines = []
    for caption in captions:
        words = " ".join(caption.text.replace("#", " ").split())
        tokens = caption.tokens or " ".join(f"{word.strip('.,;:!?').lower()}/X" for word in words.split())
        whole = caption.start_seconds == 0.0 and caption.end_seconds is None
        end = duration_seconds if caption.end_seconds is None else caption.end_seconds
        start, end = (0.0, 0.0) if whole else (caption.start_seconds, end)
        lines.append(f"{words}#{tokens.replace('#', ' ')}#{start!r}#{end!r}\n")
    return "".join(lines)


def _caption(line: str, path: Path, number: int) -> Caption:
    parts = line.strip().split("#")
    if len(parts) == 1:
        return Caption(parts[0])
    if len(parts) != 4:
        message = f"{len(parts)} parts between '#', expected caption#tokens#start#end"
        raise FormatError(message, path=path, reason="text", line=number)
    try:
        start, end = (float(part) for part in parts[2:])
    except ValueError:
        message = f"segment {parts[2][:20]!r} to {parts[3][:20]!r}, expected seconds"
        raise FormatError(message, path=path, reason="text", line=number) from None
    if not (math.isfinite(start) and math.isfinite(end)) or start == end == 0.0:
        return Caption(parts[0], tokens=parts[1])
    start, end = max(0.0, min(start, end)), max(start, end)
    return Caption(parts[0], start, end, parts[1])


SPLITS = ("train", "val", "test")
# Kimodo's splits of BONES-SEED: takes of contents that are new (test), and new takes of contents that train has (val).
KIMODO = {"train": "train", "val": "test_repetition", "test": "test_content"}


def split_files(folder: Path) -> dict[str, Path]:
    """The split files in a folder: train.txt, val.txt, test.txt, or Kimodo's, such as train_split_paths.txt."""
    named = {split: (folder / f"{KIMODO[split]}_split_paths.txt", folder / f"{split}.txt") for split in SPLITS}
    return {split: path for split, paths in named.items() for path in paths if path.is_file()}


def read_splits(folder: Path, known: Collection[str], where: str) -> tuple[dict[str, str], list[FormatError]]:
    """Split by name, and a warning (`split-without-motion`) for each file with names not in `known`.

    Folders before a name are left out.
    """
    splits: dict[str, str] = {}
    warnings: list[FormatError] = []
    for split, path in split_files(folder).items():
        try:
            text = path.read_text(encoding="utf-8-sig", errors="replace")
        except OSError as error:
            raise source_file.unreadable(path, error) from None
        names = [name for line in text.splitlines() if (name := line.strip().rpartition("/")[2])]
        splits |= dict.fromkeys(names, split)
        absent = [name for name in names if name not in known]
        if absent:
            message = f"lists {len(absent):,} sequences that {where} has not, first {absent[0][:40]!r}"
            message += f"; {where} has {next(iter(known))[:40]!r}" if known else ""
            warnings.append(FormatError(message, path=path, reason="split-without-motion"))
    return splits, warnings
