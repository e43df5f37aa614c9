"""train.txt, val.txt and test.txt: a sequence's name a line."""

from collections.abc import Collection
from pathlib import Path

from motionkit.errors import FormatError

SPLITS = ("train", "val", "test")


def read_splits(folder: Path, known: Collection[str], where: str) -> tuple[dict[str, str], list[FormatError]]:
    """Split by name, and a warning (`split-without-motion`) for each file with names that `where` does not know.

    Where none of a file's names is known, the warning shows one of each side: they are spelled differently, or the
    files are another corpus's.
    """
    splits: dict[str, str] = {}
    warnings: list[FormatError] = []
    for split in SPLITS:
        path = folder / f"{split}.txt"
        names = _lines(path)
        splits |= dict.fromkeys(names, split)
        absent = [name for name in names if name not in known]
        if absent:
            message = f"lists {len(absent):,} sequences that {where} has not, first {absent[0][:40]!r}"
            if len(absent) == len(names) and known:
                message = f"none of its {len(names):,} names is in {where}: it lists {absent[0][:40]!r}, "
                message += f"{where} has {next(iter(known))[:40]!r}; so nothing is of the split {split}"
            warnings.append(FormatError(message, path=path, reason="split-without-motion"))
    return splits, warnings


def _lines(path: Path) -> list[str]:
    if not path.is_file():
        return []
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    return [line.strip() for line in lines if line.strip()]
