"""Sequences of a store as files: which ones, their names, one file each, and a CSV of what the files cannot hold."""

import csv
import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pyarrow as pa

from motionkit.core.errors import UsageError
from motionkit.core.files import naming
from motionkit.core.framerate import format_fps
from motionkit.core.motion import Caption, Motion
from motionkit.core.plain_text import markdown_text, spreadsheet_text
from motionkit.core.shapes import Int64
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import SkeletonMapError, map_joints
from motionkit.fields.resample import resample
from motionkit.io.registry import Format
from motionkit.store.reader import Store

TABLE = "motions.csv"
# As motionkit.io.annotations reads them; sequence_id, the id in the store, is informative.
COLUMNS = (
    *("file", "sequence_id", "captions", "action", "style", "subject", "split"),
    *("fps", "stated_fps", "licence", "source", "subset"),
)


@dataclass(frozen=True, eq=False)
class Selection:
    """Sequences of a store by ascending index, at their own framerates or, with `fps`, resampled to one."""

    store: Store
    indices: Int64[np.ndarray, "sequences"]
    fps: Fraction | None = None

    @cached_property
    def table(self) -> pa.Table:
        """The sequences' rows of the store's table (columns: motionkit.store.schema.SEQUENCES)."""
        return self.store.sequences_table.take(self.store.rows_of(self.indices))

    @property
    def sequence_ids(self) -> list[str]:
        """Ids in order."""
        ids: list[str] = self.table["sequence_id"].to_pylist()
        return ids

    @property
    def framerates(self) -> tuple[Fraction, ...]:
        """The different framerates that will be written, ascending."""
        if self.fps is not None:
            return (self.fps,)
        columns = (self.table[name].to_pylist() for name in ("fps_numerator", "fps_denominator"))
        return tuple(sorted({Fraction(*pair) for pair in zip(*columns, strict=True)}))

    def motions(self) -> Iterator[Motion]:
        """The motions in order, one at a time in memory."""
        for motion in self.store.read_many(self.indices.tolist()):
            yield motion if self.fps is None else resample(motion, self.fps)


@dataclass(frozen=True)
class Outcome:
    """The outcome of one sequence; `reason` (a short slug) and `message` say why it was skipped, else empty.

    `lacks` names missing metadata of a written sequence that the format's readers need.
    """

    sequence_id: str
    reason: str = ""
    message: str = ""
    lacks: tuple[str, ...] = ()


def file_names(sequence_ids: Sequence[str], suffix: str = "", *, flat: bool = False) -> list[PurePosixPath]:
    """`a/b` → `a/b.SUFFIX`, or with `flat` `a_b.SUFFIX`, all in one folder.

    Raises `UsageError` for an id that is not a path below a folder, and for two with the same name.
    """
    names = []
    for sequence_id in sequence_ids:
        path = PurePosixPath(sequence_id)
        if not path.parts or path.is_absolute() or ".." in path.parts or "\0" in sequence_id:
            raise UsageError(f"the id {sequence_id!r} cannot be a file's name: leave the sequence out with --where")
        names.append(PurePosixPath(("_" if flat else "/").join(path.parts) + suffix))
    repeated, count = Counter(names).most_common(1)[0] if names else (None, 0)
    if count > 1:
        ids = " and ".join(repr(one) for one, name in zip(sequence_ids, names, strict=True) if name == repeated)
        raise UsageError(f"{ids} would be written to one file, {repeated}: choose one of them with --where")
    return names


def export_files(selection: Selection, folder: Path, format: Format) -> Iterator[Outcome]:
    """Write each motion to `folder/ID.SUFFIX` and its row to motions.csv; yields the outcome of each.

    Formats whose files share a framerate and joints get one folder, as motions of the 22 joints. A sequence whose
    skeleton cannot be mapped is skipped. Raises `UsageError` for different framerates in such a format.
    """
    assert format.write is not None
    is_shared = bool(format.shared_file)
    if is_shared and len(selection.framerates) > 1:
        *most, last = [format_fps(fps) for fps in selection.framerates]
        raise UsageError(
            f"a folder of joints has one framerate, the sequences have {', '.join(most)} and {last}: give one with "
            "--fps"
        )
    names = file_names(selection.sequence_ids, format.suffixes[0], flat=is_shared)
    with motion_table(folder) as add_row:
        for motion, name in zip(selection.motions(), names, strict=True):
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            written = motion
            try:
                if is_shared:
                    joints = map_joints(motion, SMPL22.name)
                    written = Motion(joints, SMPL22, motion.timegrid, sequence_id=motion.sequence_id)
                with naming(path):
                    format.write(written, path)
            except SkeletonMapError as error:
                yield Outcome(motion.sequence_id, "skeleton", str(error))
                continue
            add_row(motion, name)
            yield Outcome(motion.sequence_id)


@contextmanager
def motion_table(folder: Path) -> Iterator[Callable[[Motion, PurePosixPath], None]]:
    """Write motions.csv in a folder: yields a function that adds the row of a motion and its file's path there."""
    path = folder / TABLE
    with naming(path), path.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        table.writeheader()
        yield lambda motion, name: table.writerow(_row(motion, name))


def _row(motion: Motion, name: PurePosixPath) -> dict[str, str]:
    provenance = motion.provenance
    cells = {
        "sequence_id": motion.sequence_id,
        "captions": captions_json(motion.captions),
        "action": motion.action,
        "style": motion.style,
        "subject": provenance.subject,
        "split": motion.split,
        "fps": format_fps(motion.fps),
        "stated_fps": provenance.stated_fps,
        "licence": provenance.licence,
        "source": provenance.source,
        "subset": provenance.subset,
    }
    file = name.as_posix()
    # A path is read again, and stays the same with ./ before it.
    file = file if spreadsheet_text(file) == file else f"./{file}"
    return {"file": file, **{column: spreadsheet_text(cell) for column, cell in cells.items()}}


def captions_json(captions: Sequence[Caption]) -> str:
    """All captions as one JSON list: a plain sentence where nothing but the text is said, else an object."""
    return json.dumps([_caption(caption) for caption in captions], ensure_ascii=False) if captions else ""


def _caption(caption: Caption) -> str | dict[str, str | float]:
    stated: dict[str, str | float] = {}
    if caption.start_seconds or caption.end_seconds is not None:
        stated["start_seconds"] = caption.start_seconds
    if caption.end_seconds is not None:
        stated["end_seconds"] = caption.end_seconds
    if caption.tokens:
        stated["tokens"] = caption.tokens
    return {"text": caption.text, **stated} if stated else caption.text


def render(template: str, **values: Any) -> str:
    """Render `templates/TEMPLATE`; raises for a missing name.

    Values in HTML are escaped, those in Markdown by the filter `markdown`.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("motionkit.edit.export", "templates"),
        undefined=StrictUndefined,
        autoescape=template.endswith(".html.j2"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["markdown"] = markdown_text
    return environment.get_template(template).render(values)
