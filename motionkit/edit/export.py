"""Sequences of a store as files: a file each, the published data sets' folders, or a store with a card (Parquet).

A folder of HumanML3D's or KIT-ML's form has what the published pipeline makes of every clip, at any framerate:
resampled (anti-aliased), mapped to the layout, one skeleton, floor, origin, facing Z+, pose vectors, and joints
recovered from them. T poses give T − 1 rows of both, as published. Source:
https://github.com/EricGuo5513/HumanML3D, motion_representation.ipynb.
"""

import csv
import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pyarrow as pa

from motionkit.core.errors import MotionkitError, UsageError, counted, lasting, markdown_text
from motionkit.core.files import is_store, naming, require_new, whole_folder, write_json
from motionkit.core.motion import Caption, Motion
from motionkit.core.shapes import Int64
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import SkeletonMapError, map_joints
from motionkit.features import humanml3d
from motionkit.fields.resample import resample
from motionkit.io import joints_npy
from motionkit.io.humanml3d import HUMANML3D, JOINTS_FOLDER, KIT, Entry, FolderWriter, Layout
from motionkit.io.registry import Format, writers
from motionkit.io.texts import SPLITS
from motionkit.store import Store, StoreWriter
from motionkit.store.commit import LOCK_FILE
from motionkit.store.reports import summarise

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
    """The outcome of one sequence; `reason` (a short slug) and `message` say why it was skipped, else empty."""

    sequence_id: str
    reason: str = ""
    message: str = ""


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
        *most, last = [str(fps) for fps in selection.framerates]
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
        "fps": str(motion.fps),
        "stated_fps": provenance.stated_fps,
        "licence": provenance.licence,
        "source": provenance.source,
        "subset": provenance.subset,
    }
    file = name.as_posix()
    # A spreadsheet would run these as formulas; a path is read again, and stays the same with ./ before it.
    formula = ("=", "+", "-", "@", "\t", "\r")
    file = f"./{file}" if file.startswith(formula) else file
    return {"file": file, **{name: f"'{cell}" if cell.startswith(formula) else cell for name, cell in cells.items()}}


def captions_json(captions: Sequence[Caption]) -> str:
    """All captions as one JSON list: a plain sentence where nothing but the text is said, else an object."""
    stated = [{name: value for name, value in asdict(each).items() if value or name == "text"} for each in captions]
    shortest = [each if len(each) > 1 else each["text"] for each in stated]
    return json.dumps(shortest, ensure_ascii=False) if captions else ""


def render(template: str, **values: Any) -> str:
    """Render `templates/TEMPLATE`; raises for a missing name.

    Values in HTML are escaped, those in Markdown by the filter `markdown`.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("motionkit.edit", "templates"),
        undefined=StrictUndefined,
        autoescape=template.endswith(".html.j2"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"markdown": markdown_text, "counted": counted, "lasting": lasting}
    return environment.get_template(template).render(values)


MIN_POSES = 2


@dataclass(frozen=True)
class Kind:
    """A published data set: its layout, the number of its units per unit of the layout's skeleton, and its loader.

    `loader_min_frames` is the minimum of text-to-motion's data loader, which silently drops shorter clips.
    """

    layout: Layout
    units_per_skeleton_unit: float
    loader_min_frames: int


# 22 joints in metres and vectors of 263 numbers; 21 joints in thousandths of the body's height and vectors of 251.
HUMANML3D_KIND = Kind(HUMANML3D, 1.0, 40)
KIT_KIND = Kind(KIT, 1000.0, 24)


def export_pose_folder(selection: Selection, folder: Path, kind: Kind) -> Iterator[Outcome]:
    """Write a folder of the published form at the selection's framerate; yields the outcome of each sequence."""
    (fps,) = selection.framerates
    layout, published = replace(kind.layout, fps=fps), kind.layout.fps
    names = [name.name for name in file_names(selection.sequence_ids)]
    if len(set(names)) < len(names):
        names = list(map(str, file_names(selection.sequence_ids, flat=True)))
    writer = FolderWriter(folder, layout)
    lacks: Counter[str] = Counter()
    with motion_table(folder) as add_row:
        for motion, name in zip(selection.motions(), names, strict=True):
            entry = pose_entry(motion, name, kind)
            if isinstance(entry, Outcome):
                yield entry
                continue
            writer.add(entry)
            add_row(motion, PurePosixPath(JOINTS_FOLDER, f"{name}.npy"))
            lacks["captions"] += not entry.captions
            lacks["split"] += entry.split not in SPLITS
            lacks["length"] += len(entry.joint_positions) < kind.loader_min_frames
            yield Outcome(motion.sequence_id)
    num_sequences = writer.finish()
    # Framerate, layout and unit for readers, the convention and its published framerate.
    manifest = {
        "fps": str(fps),
        "layout": layout.skeleton.name,
        "unit_metres": layout.unit_metres,
        "vectors": humanml3d.CONVENTION,
        "published_fps": str(published),
    }
    write_json(folder / joints_npy.MANIFEST, manifest)
    text = render(
        "pose_folder.md.j2",
        layout=layout,
        fps=f"{float(layout.fps):.6g}",
        published_fps=f"{float(published):.6g}",
        is_published=layout.fps == published,
        smoothing_seconds=float(Fraction(humanml3d.SMOOTHING_FRAMES) / layout.fps),
        num_sequences=num_sequences,
        loader_min_frames=kind.loader_min_frames,
        lacks=+lacks,
    )
    (folder / "README.md").write_text(text, encoding="utf-8")


def pose_entry(motion: Motion, name: str, kind: Kind) -> Entry | Outcome:
    """A motion's processed joints and pose vectors at its own framerate, T − 1 rows each, or the reason for none."""
    layout = kind.layout.skeleton.name
    if motion.num_frames < MIN_POSES:
        message = f"{motion.num_frames} pose at {motion.fps} fps; pose vectors need at least {MIN_POSES}"
        return Outcome(motion.sequence_id, "too-short", message)
    try:
        joints = map_joints(motion, layout)
    except SkeletonMapError as error:
        return Outcome(motion.sequence_id, "skeleton", str(error))
    target = humanml3d.standard_bone_lengths(layout) * np.float32(kind.units_per_skeleton_unit)
    with np.errstate(divide="ignore", invalid="ignore"):
        vectors = humanml3d.vectors(humanml3d.process(joints, layout, target), layout)
    if not np.isfinite(vectors).all():
        return Outcome(motion.sequence_id, "degenerate", "the legs of frame 0 have no length: nothing says the scale")
    return Entry(name, humanml3d.positions(vectors, layout), vectors, motion.captions, motion.split)


@dataclass(frozen=True)
class Export:
    """An output format: `write` fills an empty folder and yields the outcome of each sequence, in order.

    `fps` is the default framerate of all motions; None keeps each at its own. Unsupported requests raise `UsageError`
    before the first frame is read.
    """

    name: str
    write: Callable[[Selection, Path], Iterator[Outcome]]
    fps: Fraction | None = None


def export_kinds() -> Mapping[str, Export]:
    """All output formats: a file per motion in every writable format, and data sets."""
    kinds = (
        *(Export(name, partial(export_files, format=each)) for name, each in writers().items()),
        Export("humanml3d", partial(export_pose_folder, kind=HUMANML3D_KIND), HUMANML3D_KIND.layout.fps),
        Export("kit", partial(export_pose_folder, kind=KIT_KIND), KIT_KIND.layout.fps),
        Export("parquet", export_parquet),
    )
    return {kind.name: kind for kind in kinds}


def export_parquet(selection: Selection, folder: Path) -> Iterator[Outcome]:
    """Write a store with the selection, and its card (README.md): Parquet for `datasets`, pandas, polars, duckdb."""
    with StoreWriter.create(folder) as writer:
        for motion in selection.motions():
            writer.add(motion)
            yield Outcome(motion.sequence_id)
    (folder / LOCK_FILE).unlink()
    card = render("store_card.md.j2", summary=summarise(Store.open(folder)), address="OUT")
    (folder / "README.md").write_text(card, encoding="utf-8")


@dataclass(frozen=True)
class ExportReport:
    """The result of an export: sequences and files written, their bytes, and skipped sequences with reasons."""

    folder: Path
    format: str
    num_sequences: int
    num_files: int
    num_bytes: int
    left_out: tuple[Outcome, ...]


def is_export(folder: Path) -> bool:
    """Whether a folder is an earlier export: it has our table of motions, or is a store with its card."""
    if is_store(folder):
        return (folder / "README.md").is_file()
    table = folder / TABLE
    return table.is_file() and table.read_bytes().startswith(",".join(COLUMNS).encode() + b"\n")


def export(
    selection: Selection,
    folder: Path,
    kind: Export,
    on_outcome: Callable[[Outcome], None] = lambda outcome: None,
    *,
    overwrite: bool = False,
) -> ExportReport:
    """Write a selection in one format into a new or empty folder, or with `overwrite` in place of an earlier export.

    `on_outcome` is called for each sequence.

    Everything is written into `FOLDER.partial`, which is renamed when complete and deleted on errors (`whole_folder`).
    Raises `UsageError` for another folder that is not empty, `BusyError` for one that another process writes,
    `MotionkitError` if nothing could be written.
    """
    left_out: list[Outcome] = []
    num_sequences = 0
    # A link to an empty folder is filled where it points.
    with whole_folder(folder.resolve() if folder.is_symlink() else folder.absolute()) as partial_folder:
        # Under the lock, after leftovers of a killed export are deleted.
        require_new(folder, overwrite=overwrite, replaced=is_export, instead="another folder keeps both")
        for outcome in kind.write(selection, partial_folder):
            if outcome.reason:
                left_out.append(outcome)
            else:
                num_sequences += 1
            on_outcome(outcome)
        if not num_sequences:
            first = left_out[0].message if left_out else "the selection is empty"
            number = counted(len(left_out), "sequence")
            raise MotionkitError(f"none of {number} can be written as {kind.name}, first: {first}")
        sizes = [path.stat().st_size for path in partial_folder.rglob("*") if path.is_file()]
    return ExportReport(folder, kind.name, num_sequences, len(sizes), sum(sizes), tuple(left_out))
