"""Sources → store: scan, read and write in chunks, commit; unreadable files are reported and counted."""

import os
import re
import socket
from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from itertools import count, groupby, islice
from pathlib import Path
from typing import Literal

import pyarrow as pa

from motionkit.core.errors import FormatError, MotionkitError, StoreError
from motionkit.core.files import MOTIONS_FOLDER, is_store
from motionkit.core.progress import OnProgress, Task, ignore, task
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.mapping import SkeletonMapError, joint_map, parse_layout_map, rest_positions
from motionkit.io.body_frame import standing_metres
from motionkit.io.cuts import missing_seconds, unlike_stated_seconds
from motionkit.io.registry import ReadOptions, ScanResult, SourceItem
from motionkit.io.scan import read, scan
from motionkit.store.commit import pending_part
from motionkit.store.reader import Store
from motionkit.store.schema import SEQUENCES, EncodedMotion, RefusedMotion, Row, encode
from motionkit.store.workers import LOCAL, WorkerDied, Workers, check_engine, start_workers, usable_cores
from motionkit.store.writer import PartWriter, PendingPart, StoreWriter

# A second of reading, and a part of about 10 MB: keeps all workers busy for small corpora.
CHUNK_BYTES, CHUNK_ITEMS = 32 << 20, 1024
# Larger corpora are cut into this number of chunks, until their parts have the 128 MB and more that are read best. A
# worker returns the rows of all items of a chunk at once.
NUM_CHUNKS = 64
MAX_CHUNK_BYTES, MAX_CHUNK_ITEMS = 512 << 20, 4096
# Before its second frame a jump may be seen one frame late.
FIRST_FRAMES = 2
# From ankle to head: nobody is so small or tall, but a grown body is whose inches or CMU's units were read as another.
SMALLEST_METRES, LARGEST_METRES = 0.7, 2.1
WORKER_DIED = "the process that read it ended without a word (killed, or out of memory?): --workers 1 shows where"
# The log line of a neutral body in place of the subject's gender.
SUBSTITUTE = re.compile(r"joints: (?P<family>\w+) neutral \(the file's gender: (?P<gender>male|female)\)")


# A sequence to read and its index; None if the store has its id, so that it is read but not written.
NumberedItem = tuple[SourceItem, int | None]


@dataclass(frozen=True, eq=False)
class ReadChunk:
    """A chunk that was read: its part, None if nothing was written; each item's row without the part, and skeleton."""

    part: PendingPart | None
    outcomes: tuple[tuple[Row, Skeleton] | FormatError, ...]


def chunks_of(items: Iterable[SourceItem]) -> Iterator[list[SourceItem]]:
    """The items in order, in chunks of a 64th of all files' bytes; a larger file is a chunk of its own.

    A chunk has 32 MiB at least and 512 MiB at most. It depends on the items alone. Sequences of one file come into one
    chunk, so that it is read once, unless they are more than 1,024 for each 32 MiB, or 4,096.
    """
    files = [(_size(path), list(of_file)) for path, of_file in groupby(items, key=lambda item: item.path)]
    share = sum(size for size, _ in files) // NUM_CHUNKS
    max_bytes = min(max(CHUNK_BYTES, share), MAX_CHUNK_BYTES)
    max_items = min(CHUNK_ITEMS * max_bytes // CHUNK_BYTES, MAX_CHUNK_ITEMS)
    chunk: list[SourceItem] = []
    num_bytes = 0
    for size, of_file in files:
        if chunk and num_bytes + size > max_bytes:
            yield chunk
            chunk, num_bytes = [], 0
        num_bytes += size
        for item in of_file:
            if len(chunk) == max_items:
                yield chunk
                chunk, num_bytes = [], size
            chunk.append(item)
    if chunk:
        yield chunk


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def read_chunk(
    items: Sequence[NumberedItem], store: Path, options: ReadOptions, deadly: Container[int] = ()
) -> ReadChunk:
    """Read sequences and write those that have an index into one part of the store, under a pending name.

    A fault of a source is returned, so that it travels between processes like a result. The items at the positions
    `deadly` are faults, unread. Raises `OSError` where the part cannot be written, and `StoreError` where there is no
    such store.
    """
    if not (store / MOTIONS_FOLDER).is_dir():
        raise StoreError(f"there is no store {store} on {socket.gethostname()}: it must be where all machines see it")
    part = PartWriter(pending_part(store, items[0][1] or 0))
    skeletons: dict[str, Skeleton] = {}
    outcomes: list[tuple[Row, Skeleton] | FormatError] = []
    try:
        for position, (item, sequence_index) in enumerate(items):
            if position in deadly:
                outcomes.append(FormatError(WORKER_DIED, path=item.path, reason="worker-died"))
                continue
            motion = read_or_fault(item, options)
            if isinstance(motion, FormatError):
                outcomes.append(motion)
                continue
            row = motion.row
            if sequence_index is not None:
                part_row = part.add(sequence_index, motion)
                row = {**row, "sequence_index": sequence_index, "part_row": part_row}
            outcomes.append((row, skeletons.setdefault(motion.skeleton.fingerprint, motion.skeleton)))
        return ReadChunk(part.finish(), tuple(outcomes))
    finally:
        part.abandon()


def read_or_fault(item: SourceItem, options: ReadOptions) -> EncodedMotion | FormatError:
    """Reads and encodes one sequence, or returns its error.

    Exceptions that readers don't handle are returned too (`unexpected`): one odd file must not end an ingest of a
    million.
    """
    try:
        return encode(read(item, options))
    except FormatError as problem:
        if os.path.lexists(item.path):
            return problem
        message = f"there is no such file on {socket.gethostname()}, but there was when the source was scanned: "
        message += "removed since, or not in a folder that all machines share"
        return FormatError(message, path=item.path, reason="not-visible")
    except RefusedMotion as refused:
        return FormatError(str(refused), path=item.path, reason=refused.reason)
    except Exception as error:
        text = f"{type(error).__name__}: {error}".splitlines()[0]
        return FormatError(f"the {item.format} reader failed: {text}", path=item.path, reason="unexpected")


def _read_again(workers: Workers, function: Callable[..., ReadChunk], chunk: Sequence[NumberedItem]) -> ReadChunk:
    """A chunk whose worker died: once more, then without the files that workers die of, which are found one by one."""
    with suppress(WorkerDied):
        return workers.call(function, chunk)
    deadly: set[int] = set()
    for position, (item, _) in enumerate(chunk):
        try:
            workers.call(function, [(item, None)])
        except WorkerDied:
            deadly.add(position)
    with suppress(WorkerDied):
        if len(deadly) < len(chunk) or len(chunk) == 1:
            return workers.call(partial(function, deadly=deadly), chunk)
    raise MotionkitError("workers end whatever they read: killed, or out of memory? --workers 1 shows where")


@dataclass(frozen=True)
class IngestReport:
    """Result of an ingest: what it stored, what the store had already, problems (each costs a sequence), warnings.

    `stored` are the added rows of the table of sequences. `datasets` counts an index's sequences by dataset: `found`
    files that are there, `missing` and `failed` ones. `ignored` are the files of the sources' folders that are no
    sequences and belong to none. `committed` is False where the store was left as it was: after a problem under `stop`,
    or with nothing to store.
    """

    store: Path
    committed: bool
    stored: pa.Table
    num_already_stored: int
    num_in_store: int
    problems: tuple[FormatError, ...]
    warnings: tuple[FormatError, ...]
    datasets: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    ignored: tuple[Path, ...] = ()


def ingest(
    sources: Sequence[Path],
    store: Path,
    *,
    options: ReadOptions | None = None,
    on_error: Literal["skip", "stop"] = "skip",
    overwrite: bool = False,
    num_workers: int | None = None,
    engine: str = LOCAL,
    on_progress: OnProgress = ignore,
    on_problem: Callable[[FormatError], None] = lambda problem: None,
    on_warning: Callable[[FormatError], None] = lambda warning: None,
) -> IngestReport:
    """Read every sequence of the sources into a store, which is made, added to, or (`overwrite`) replaced.

    The store is the same, byte for byte, whatever the number of workers and whichever `engine` (`local`, `ray`,
    `ray://HOST:PORT`) runs them; without a number given, all cores read, or as many as there are chunks. Under `skip`
    the good sequences are stored; under `stop` the first problem ends the ingest and the store stays as it was. A
    sequence that the store holds from an equal file is counted and left alone; one with the same id from another file
    is a problem, and so is one whose id an earlier sequence of the sources has. `on_problem` is called with each fault
    that costs a sequence, `on_warning` with others. Raises `UsageError` for sources or options that make no sense and
    `StoreError` for a store that cannot be written.
    """
    check_engine(engine)
    options = options or ReadOptions()
    appends = is_store(store) and not overwrite
    writer = StoreWriter.append(store) if appends else StoreWriter.create(store, overwrite=overwrite)
    with task(on_progress, "ingest", note="scanning") as work:
        scanned = scan(sources, options)
        work.note("")
        work.set_total(len(scanned.items))
        run = _Ingest(writer, options, on_error == "stop", work, on_problem, on_warning)
        try:
            run.store_all(scanned, engine, num_workers)
            committed = True
        except _Stopped:
            committed = False
        except OSError as error:
            # Readers report problems of files; this is the store's disk, before the commit: full, or not writable.
            raise StoreError(f"the store {store} cannot be written ({error}); it is as it was") from None
    sequences = Store.open(store).sequences_table if is_store(store) else SEQUENCES.empty_table()
    return IngestReport(
        store=store,
        committed=committed,
        stored=sequences.slice(sequences.num_rows - (run.num_stored if committed else 0)),
        num_already_stored=run.num_already_stored,
        num_in_store=sequences.num_rows,
        problems=tuple(run.problems),
        warnings=tuple(run.warnings),
        datasets=_datasets(scanned, run.failed_by_dataset) if options.index else {},
        ignored=tuple(path for path in scanned.ignored if not path.is_relative_to(store.resolve())),
    )


def _datasets(scanned: ScanResult, failed_by_dataset: Counter[str]) -> dict[str, dict[str, int]]:
    with_file = Counter(item.subset for item in scanned.items)
    return {
        name: {"found": with_file[name], "missing": scanned.missing.get(name, 0), "failed": failed_by_dataset[name]}
        for name, _ in (with_file + Counter(scanned.missing)).most_common()
    }


class _Stopped(Exception):
    """A problem under `stop`, or nothing to store: leaves the writer without a commit."""


@dataclass
class _Ingest:
    """One ingest: owns the writer, the counts and the faults."""

    writer: StoreWriter
    options: ReadOptions
    stops: bool
    work: Task
    on_problem: Callable[[FormatError], None]
    on_warning: Callable[[FormatError], None]
    num_stored: int = 0
    num_already_stored: int = 0
    problems: list[FormatError] = field(default_factory=list)
    warnings: list[FormatError] = field(default_factory=list)
    failed_by_dataset: Counter[str] = field(default_factory=Counter)
    rigs: set[tuple[tuple[str, ...], str]] = field(default_factory=set)
    bodies: set[Skeleton] = field(default_factory=set)

    def store_all(self, scanned: ScanResult, engine: str, num_workers: int | None) -> None:
        """Report the faults of a scan, read its items and commit them; raises `_Stopped` if there is none to commit."""
        for warning in scanned.warnings:
            self._warn(warning)
        for problem in scanned.problems:
            self._fail(problem)
        if not scanned.items:
            raise _Stopped
        if engine == LOCAL:
            num_workers = num_workers or sum(1 for _ in islice(chunks_of(scanned.items), usable_cores()))
        # Arrow loads pandas to convert a row.
        with self.writer, start_workers(engine, num_workers, preload=["motionkit.store.ingest", "pandas"]) as workers:
            function = partial(read_chunk, store=self.writer.path.absolute(), options=self.options)
            chunks = self._numbered_chunks(scanned.items)
            with closing(workers.map(function, chunks, partial(_read_again, workers, function))) as results:
                for chunk, result in results:
                    self._add_chunk(chunk, result)
            if not self.num_stored:
                raise _Stopped
        self._check_maps()

    def _numbered_chunks(self, items: Sequence[SourceItem]) -> Iterator[list[NumberedItem]]:
        # An index is the place among the sequences that are new, whether or not those before it can be read: so a part
        # has the same bytes whoever writes it, whenever.
        numbers = count(self.writer.next_sequence_index)
        for chunk in chunks_of(items):
            yield [(item, None if self.writer.holds(item.sequence_id) else next(numbers)) for item in chunk]

    def _add_chunk(self, chunk: Sequence[NumberedItem], result: ReadChunk) -> None:
        place = {} if result.part is None else {"part": self.writer.add_part(result.part)}
        for (item, _), outcome in zip(chunk, result.outcomes, strict=True):
            if isinstance(outcome, FormatError):
                self._fail(outcome, item)
            else:
                row, skeleton = outcome
                self._add(item, {**row, **place}, skeleton)
            self.work.advance()

    def _add(self, item: SourceItem, row: Row, skeleton: Skeleton) -> None:
        self._check_rig(item, skeleton)
        if self.writer.holds_from(item.sequence_id, row["source_sha256"]):
            self.num_already_stored += 1
            return
        try:
            self.writer.add_row(row, skeleton)
        except RefusedMotion as refused:
            self._fail(FormatError(str(refused), path=item.path, reason=refused.reason), item)
            return
        if self.options.index is None and row["source_sha256"] in self.writer.former_sources:
            message = f"now stored twice: an equal file had another id before this ingest, not {item.sequence_id!r}"
            self._warn(FormatError(message, path=item.path, reason="stored-twice"))
        if skeleton not in self.bodies and (size := body_size_warning(skeleton)):
            self._warn(FormatError(size, path=item.path, reason="body-size"))
        self.bodies.add(skeleton)
        for warning in _warnings_of(item, row):
            self._warn(warning)
        self.num_stored += 1

    def _check_rig(self, item: SourceItem, skeleton: Skeleton) -> None:
        # Joints that no layout knows are reported once, whatever the lengths of their bones; the motions are kept.
        # Markers, which have no bones, are reported once for all their sets.
        rig = (skeleton.joint_names if skeleton.offsets.any() else (), skeleton.layout_map)
        if rig in self.rigs:
            return
        self.rigs.add(rig)
        try:
            joint_map(skeleton, SMPL22.name)
        except SkeletonMapError as error:
            self._warn(FormatError(str(error), path=item.path, reason="unmapped-skeleton"))

    def _check_maps(self) -> None:
        used = {layout_map for _, layout_map in self.rigs}
        for text in self.options.skeleton_maps:
            if text not in used:
                family = parse_layout_map(text)
                required = ", ".join(sorted(family.requires))
                message = f"fits no skeleton of the sources; it requires the joints {required}"
                self._warn(FormatError(message, path=f"skeleton map {family.name!r}", reason="unused-skeleton-map"))

    def _warn(self, warning: FormatError) -> None:
        self.warnings.append(warning)
        self.on_warning(warning)

    def _fail(self, problem: FormatError, item: SourceItem | None = None) -> None:
        if item is not None:
            self.failed_by_dataset[item.subset] += 1
        self.problems.append(problem)
        self.on_problem(problem)
        if self.stops:
            raise _Stopped


def _warnings_of(item: SourceItem, row: Row) -> Iterator[FormatError]:
    """Warnings about a stored motion by its row in the table of sequences.

    `neutral-body`: no model of the subject's gender; `first-frame`: a jump after the first frame; `shortened`, or
    `duration` for a whole file: the file's length differs from the index's.
    """
    substitute = next(filter(None, map(SUBSTITUTE.match, row["operations"])), None)
    if substitute is not None:
        # Betas belong to one gender's shape space: the neutral model gives another body for them.
        family, gender = substitute["family"], substitute["gender"]
        message = f"has the neutral {family} body under a {gender} subject's betas, so bone lengths are not the "
        message += f"subject's: put {family.upper()}_{gender.upper()}.npz into the folder of --body-models and ingest "
        yield FormatError(f"{message}again with --overwrite", path=item.path, reason="neutral-body")
    if item.cut is None:
        jump = row["first_teleport_seconds"]
        if jump is not None and jump < (FIRST_FRAMES + 0.5) * row["seconds_between_frames"]:
            # Converters put a T-pose before the motion.
            message = f"jumps at {jump:.3g} s: does it begin with a reference pose? --skip-frames N leaves out the "
            message += "first frames of every file, a column skip_frames of the annotation table those of one"
            yield FormatError(message, path=item.path, reason="first-frame")
        return
    fps = Fraction(row["fps_numerator"], row["fps_denominator"])
    seconds = row["duration_seconds"]
    missing = missing_seconds(item.cut, item.path, row["num_frames"], fps, row["stated_fps"])
    if missing > 0.0:
        message = f"ends {missing:.3g} s before {item.sequence_id} does; {seconds:.3g} s of it are kept"
        yield FormatError(message, path=item.path, reason="shortened")
    elif unlike_stated_seconds(item.cut, row["num_frames"], fps):
        message = f"lasts {seconds:.4g} s at {float(fps):g} fps, which is not what the index says of "
        message += f"{item.sequence_id}; its captions' seconds won't fit: is the framerate wrong (--fps-rules)?"
        yield FormatError(message, path=item.path, reason="duration")


def body_size_warning(skeleton: Skeleton) -> str:
    """A warning where nobody is as small or as large as a skeleton; empty also for joints that are not known."""
    try:
        metres = standing_metres(skeleton, rest_positions(skeleton)[None])
    except SkeletonMapError:
        return ""
    if SMALLEST_METRES < metres < LARGEST_METRES or metres == 0.0:  # markers
        return ""
    return f"its body is {metres:.3g} m from ankle to head: is that its unit? The log says which; --unit-metres sets it"
