"""Ids as file names: ids come from files, so none may lead out of the folder, and no two may meet."""

from collections import Counter
from collections.abc import Sequence
from pathlib import PurePosixPath

from motionkit.errors import UsageError


def nested_names(sequence_ids: Sequence[str], suffix: str) -> list[PurePosixPath]:
    """`a/b` → `a/b.SUFFIX`; raises `UsageError` for an id that is no path below a folder, or one that comes twice."""
    return _distinct(sequence_ids, [_below(sequence_id, suffix) for sequence_id in sequence_ids])


def flat_names(sequence_ids: Sequence[str], suffix: str = "") -> list[PurePosixPath]:
    """`a/b` → `a_b.SUFFIX`, all in one folder; raises `UsageError` as `nested_names` does."""
    below = [_below(sequence_id, suffix) for sequence_id in sequence_ids]
    return _distinct(sequence_ids, [PurePosixPath(path.as_posix().replace("/", "_")) for path in below])


def short_names(sequence_ids: Sequence[str]) -> list[PurePosixPath]:
    """The last part of each id where these differ (`HumanML3D/000021` → `000021`), else the ids as `flat_names`."""
    last = [PurePosixPath(_below(sequence_id, "").name) for sequence_id in sequence_ids]
    return last if len(set(last)) == len(last) else flat_names(sequence_ids)


def _below(sequence_id: str, suffix: str) -> PurePosixPath:
    parts = PurePosixPath(sequence_id).parts
    if not parts or parts[0] == "/" or ".." in parts or "\0" in sequence_id:
        raise UsageError(f"the id {sequence_id!r} cannot be a file's name: leave the sequence out with --where")
    return PurePosixPath(*parts[:-1], parts[-1] + suffix)


def _distinct(sequence_ids: Sequence[str], names: list[PurePosixPath]) -> list[PurePosixPath]:
    taken, count = Counter(names).most_common(1)[0] if names else (None, 0)
    if count > 1:
        ids = " and ".join(repr(one) for one, name in zip(sequence_ids, names, strict=True) if name == taken)
        raise UsageError(f"{ids} would be written to one file, {taken}: choose one of them with --where")
    return names
