"""One file per motion, with a CSV of metadata that the files cannot hold; `motionkit ingest` reads both."""

import csv
import json
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from motionkit.core.errors import UsageError
from motionkit.core.files import naming
from motionkit.core.framerate import format_fps
from motionkit.core.motion import Caption, Motion
from motionkit.core.plain_text import markdown_text, spreadsheet_text
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import SkeletonMapError, map_joints
from motionkit.edit.export.selection import Outcome, Selection, flat_names, nested_names
from motionkit.io.registry import Format, writer_of

TABLE = "motions.csv"
# As motionkit.io.annotations reads them; sequence_id, the id in the store, is informative.
COLUMNS = (
    *("file", "sequence_id", "captions", "action", "style", "subject", "split"),
    *("fps", "stated_fps", "licence", "source", "subset"),
)


def export_files(selection: Selection, folder: Path, format: Format) -> Iterator[Outcome]:
    """Write each motion to `folder/ID.SUFFIX` and its row to motions.csv; yields the outcome of each.

    Formats whose files share a framerate and joints get one folder, as motions of the 22 joints. A sequence whose
    skeleton cannot be mapped is skipped. Raises `UsageError` for different framerates in such a format.
    """
    names_of, is_shared = (flat_names, True) if format.shared_file else (nested_names, False)
    if is_shared and len(selection.framerates) > 1:
        *most, last = [format_fps(fps) for fps in selection.framerates]
        found = f"{', '.join(most)} and {last}"
        raise UsageError(f"a folder of joints has one framerate, the sequences have {found}: give one with --fps")
    return _write(selection, folder, names_of(selection.sequence_ids, format.suffixes[0]), format)


def _write(selection: Selection, folder: Path, names: Sequence[PurePosixPath], format: Format) -> Iterator[Outcome]:
    assert format.write is not None
    with MotionTable(folder / TABLE) as table:
        for motion, name in zip(selection.motions(), names, strict=True):
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                with naming(path):
                    format.write(_with_22_joints(motion) if format.shared_file else motion, path)
            except SkeletonMapError as error:
                yield Outcome(motion.sequence_id, "skeleton", str(error))
                continue
            table.add(motion, name)
            yield Outcome(motion.sequence_id)


def _with_22_joints(motion: Motion) -> Motion:
    return Motion(map_joints(motion, SMPL22.name), SMPL22, motion.timegrid, sequence_id=motion.sequence_id)


def names_a_file(out: Path | None) -> bool:
    """Whether a command's `--out` is one file: it has a suffix, and is no folder that exists."""
    return out is not None and bool(out.suffix) and not out.is_dir()


def output_suffix(out: Path | None, file_format: str | None, *, several: bool) -> str | None:
    """The suffix of the files that a command writes: of `--out` where it is one file, or of `--format`.

    None means each motion's own. Raises `UsageError` for a suffix that no format writes, for a format that is not that
    of the file, and for one file where several motions are written.
    """
    suffix = None if file_format is None else f".{file_format}"
    if out is not None and names_a_file(out):
        if several:
            raise UsageError(f"{out} is one file: for several motions name a folder, without a suffix")
        if suffix not in (None, out.suffix.lower()):
            raise UsageError(f"--format {file_format} and --out {out} are two formats: give one of them")
        suffix = out.suffix.lower()
    if suffix is not None:
        writer_of(suffix)
    return suffix


class MotionTable:
    """Writes motions.csv, a row for each file; owns the open file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._handle = path.open("w", encoding="utf-8", newline="")
        self._table = csv.DictWriter(self._handle, COLUMNS, lineterminator="\n")
        self._table.writeheader()

    def __enter__(self) -> "MotionTable":
        return self

    def __exit__(self, *raised: object) -> None:
        with naming(self._path):
            self._handle.close()

    def add(self, motion: Motion, name: PurePosixPath) -> None:
        """Add a motion that was written to `name`, a path from the table's folder."""
        with naming(self._path):
            self._table.writerow(_row(motion, name))


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
