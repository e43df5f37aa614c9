"""Sources → store: scan, read and write in chunks, commit; unreadable files are reported and counted."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count, islice
from pathlib import Path
from typing import Literal

from motionkit.core.errors import FormatError, StoreError
from motionkit.core.files import is_store
from motionkit.core.skeleton import SMPL22, Skeleton
from motionkit.core.skeletons.families import parse_layout_map
from motionkit.core.skeletons.mapping import SkeletonMapError, joint_map
from motionkit.io.scan.items import ReadOptions, ScanResult, SourceItem
from motionkit.io.scan.scanner import kinds_of, scan
from motionkit.store.codec import RefusedMotion
from motionkit.store.engines import LOCAL, check_engine, make_engine
from motionkit.store.engines.parallel import Engine, WorkerDied, map_in_order, usable_cores
from motionkit.store.ingest import PRELOADED
from motionkit.store.ingest.stored import StoredCounts, warnings_of
from motionkit.store.ingest.stretches import NumberedItem, ReadSequence, ReadStretch, cut, read_stretch
from motionkit.store.manifest import read_manifest
from motionkit.store.reports.summary import BodySizes
from motionkit.store.writer import StoreWriter

OnError = Literal["skip", "stop"]


@dataclass(frozen=True)
class DatasetCount:
    """Counts of an index's sequences of one dataset: files found, missing and failed."""

    dataset: str
    num_found: int
    num_missing: int
    num_failed: int


@dataclass(frozen=True)
class IngestReport:
    """Result of an ingest: sequences stored, those already in the store, problems (each costs a sequence), warnings.

    `datasets` says it by dataset where the sequences are an index's. `ignored` are the files of the sources' folders
    that are no sequences and belong to none, `stored` counts what was stored by what is known of it.
    `committed` is False where the store was left as it was: after a problem under `stop`, or with nothing to store.
    """

    store: Path
    committed: bool
    num_stored: int
    num_frames: int
    duration_seconds: float
    num_already_stored: int
    num_in_store: int
    problems: tuple[FormatError, ...]
    warnings: tuple[FormatError, ...]
    datasets: tuple[DatasetCount, ...] = ()
    ignored: tuple[Path, ...] = ()
    stored: StoredCounts = field(default_factory=StoredCounts)

    @property
    def problems_by_reason(self) -> dict[str, int]:
        """Number of problems by their reason, most frequent first."""
        return dict(Counter(problem.reason for problem in self.problems).most_common())

    @property
    def warnings_by_reason(self) -> dict[str, int]:
        """Number of warnings by their reason, most frequent first."""
        return dict(Counter(warning.reason for warning in self.warnings).most_common())

    @property
    def ignored_by_suffix(self) -> dict[str, int]:
        """Number of ignored files by their suffix, most frequent first; by their name where they have none."""
        return kinds_of(self.ignored)


@dataclass(frozen=True)
class Listener:
    """Callbacks of an ingest.

    `on_start` the number of sequences, `on_item` after each, `on_problem` what cost a sequence,
    `on_warning` what looks odd and cost none.
    """

    on_start: Callable[[int], None] = lambda num_items: None
    on_item: Callable[[], None] = lambda: None
    on_problem: Callable[[FormatError], None] = lambda problem: None
    on_warning: Callable[[FormatError], None] = lambda warning: None


def ingest(
    sources: Sequence[Path],
    store: Path,
    *,
    options: ReadOptions | None = None,
    on_error: OnError = "skip",
    overwrite: bool = False,
    num_workers: int | None = None,
    engine: str = LOCAL,
    listener: Listener | None = None,
) -> IngestReport:
    """Read every sequence of the sources into a store, which is made, added to, or (`overwrite`) replaced.

    The store is the same, byte for byte, whatever the number of workers and whichever `engine` (`local`, `ray`,
    `ray://HOST:PORT`) runs them; without a number given, all cores read, or as many as there are stretches.
    Under `skip` the good sequences are stored; under `stop` the first problem ends the ingest and the store stays as it
    was. A sequence that the store holds from an equal file is counted and left alone; one with the same id from another
    file is a problem, and so is one whose id an earlier sequence of the sources has. Raises `UsageError` for sources or
    options that make no sense and `StoreError` for a store that cannot be written.
    """
    check_engine(engine)
    run = _Run(store, options or ReadOptions(), on_error, engine, num_workers, listener or Listener())
    return run.ingest(sources, overwrite)


class _Stopped(Exception):
    """A problem under `stop`, or nothing to store: leaves the writer without a commit."""


class _Run:
    """One ingest: owns its counts and problems."""

    def __init__(
        self,
        store: Path,
        options: ReadOptions,
        on_error: OnError,
        engine: str,
        num_workers: int | None,
        listener: Listener,
    ) -> None:
        self._store = store
        self._options = options
        self._on_error = on_error
        self._engine_name = engine
        self._num_workers = num_workers
        self._listener = listener
        self._problems: list[FormatError] = []
        self._warnings: list[FormatError] = []
        self._rigs: set[tuple[tuple[str, ...], str]] = set()
        self._sizes = BodySizes(())
        self._failed_by_dataset: Counter[str] = Counter()
        self._num_stored = 0
        self._num_frames = 0
        self._num_already_stored = 0
        self._duration_seconds = 0.0
        self._counts = StoredCounts()

    def ingest(self, sources: Sequence[Path], overwrite: bool) -> IngestReport:
        appends = is_store(self._store) and not overwrite
        writer = StoreWriter.append(self._store) if appends else StoreWriter.create(self._store, overwrite=overwrite)
        found = scan(sources, self._options)
        committed = True
        try:
            for warning in found.warnings:
                self._warn(warning)
            for problem in found.problems:
                self._fail(problem)
            if found.items:
                self._write(writer, found)
                self._check_maps()
            if not self._num_stored:
                raise _Stopped
        except _Stopped:
            committed = False
        except OSError as error:
            # Readers report problems of files; this is the store's disk, before the commit: full, or not writable.
            raise StoreError(f"the store {self._store} cannot be written ({error}); it is as it was") from None
        return IngestReport(
            store=self._store,
            committed=committed,
            num_stored=self._num_stored if committed else 0,
            num_frames=self._num_frames if committed else 0,
            duration_seconds=self._duration_seconds if committed else 0.0,
            num_already_stored=self._num_already_stored,
            num_in_store=read_manifest(self._store).num_sequences if is_store(self._store) else 0,
            problems=tuple(self._problems),
            warnings=tuple(self._warnings),
            datasets=self._datasets(found) if self._options.index else (),
            ignored=tuple(path for path in found.ignored if not path.is_relative_to(self._store.resolve())),
            stored=self._counts if committed else StoredCounts(),
        )

    def _write(self, writer: StoreWriter, found: ScanResult) -> None:
        with ExitStack() as held:
            held.enter_context(writer)
            self._sizes = BodySizes(writer.skeletons)
            self._numbers = count(writer.next_sequence_index)
            engine = held.enter_context(self._engine(found.items))
            self._read_all(writer, engine, found.items)
            if not self._num_stored:
                raise _Stopped

    def _read_all(self, writer: StoreWriter, engine: Engine, items: Sequence[SourceItem]) -> None:
        function = partial(read_stretch, store=self._store.absolute(), options=self._options)
        self._listener.on_start(len(items))
        with closing(map_in_order(engine, function, self._numbered(writer, items))) as results:
            for stretch, result in results:
                self._take(writer, stretch, result)

    def _numbered(self, writer: StoreWriter, items: Sequence[SourceItem]) -> Iterator[list[NumberedItem]]:
        # An index is the place among the sequences that are new, whether or not those before it can be read: so a part
        # has the same bytes whoever writes it, whenever.
        for stretch in cut(items):
            known = [writer.holds(item.sequence_id) for item in stretch]
            yield [
                NumberedItem(item, None if is_known else next(self._numbers))
                for item, is_known in zip(stretch, known, strict=True)
            ]

    def _engine(self, items: Sequence[SourceItem]) -> Engine:
        if self._engine_name != LOCAL:
            return make_engine(self._engine_name, self._num_workers)
        if self._num_workers is not None:
            return make_engine(LOCAL, min(self._num_workers, len(items)), PRELOADED)
        return make_engine(LOCAL, sum(1 for _ in islice(cut(items), usable_cores())), PRELOADED)

    def _take(self, writer: StoreWriter, stretch: Sequence[NumberedItem], result: ReadStretch | WorkerDied) -> None:
        if isinstance(result, WorkerDied):
            (each,) = stretch
            message = "the process that read it ended without a word (killed, or out of memory?): --workers 1 shows"
            self._fail(FormatError(f"{message} where", path=each.item.path, reason="worker-died"), each.item)
            self._listener.on_item()
            return
        place = {} if result.part is None else {"part": writer.add_part(result.part)}
        for each, outcome in zip(stretch, result.outcomes, strict=True):
            if isinstance(outcome, FormatError):
                self._fail(outcome, each.item)
            else:
                self._add(writer, each.item, replace(outcome, row={**outcome.row, **place}))
            self._listener.on_item()

    def _add(self, writer: StoreWriter, item: SourceItem, read: ReadSequence) -> None:
        self._check_rig(item, read.skeleton)
        if writer.holds_from(item.sequence_id, read.row["source_sha256"]):
            self._num_already_stored += 1
            return
        is_new_skeleton = not writer.knows_skeleton(read.skeleton)
        try:
            writer.add_row(read.row, read.skeleton)
        except RefusedMotion as refused:
            self._fail(FormatError(str(refused), path=item.path, reason=refused.reason), item)
            return
        size = self._sizes.warning_of(read.skeleton) if is_new_skeleton else ""
        if size:
            self._warn(FormatError(size, path=item.path, reason="body-size"))
        for warning in warnings_of(item, read.row):
            self._warn(warning)
        self._num_stored += 1
        self._num_frames += read.row["num_frames"]
        self._duration_seconds += read.row["duration_seconds"]
        self._counts.add(read.row)

    def _check_rig(self, item: SourceItem, skeleton: Skeleton) -> None:
        # Joints that no layout knows are reported once, whatever the lengths of their bones; the motions are kept.
        # Markers, which have no bones, are reported once for all their sets.
        rig = (skeleton.joint_names if skeleton.offsets.any() else (), skeleton.layout_map)
        if rig in self._rigs:
            return
        self._rigs.add(rig)
        try:
            joint_map(skeleton, SMPL22.name)
        except SkeletonMapError as error:
            self._warn(FormatError(str(error), path=item.path, reason="unmapped-skeleton"))

    def _check_maps(self) -> None:
        used = {layout_map for _, layout_map in self._rigs}
        for text in self._options.skeleton_maps:
            if text not in used:
                family = parse_layout_map(text)
                needs = ", ".join(sorted(family.requires))
                message = f"fits no skeleton of the sources; it requires the joints {needs}"
                self._warn(FormatError(message, path=f"skeleton map {family.name!r}", reason="unused-skeleton-map"))

    def _warn(self, warning: FormatError) -> None:
        self._warnings.append(warning)
        self._listener.on_warning(warning)

    def _datasets(self, found: ScanResult) -> tuple[DatasetCount, ...]:
        of_files = Counter(item.subset for item in found.items) + Counter(found.refused)
        failed = self._failed_by_dataset + Counter(found.refused)
        wanted = of_files + Counter(found.missing)
        return tuple(
            DatasetCount(name, of_files[name], found.missing.get(name, 0), failed[name])
            for name, _ in wanted.most_common()
        )

    def _fail(self, problem: FormatError, item: SourceItem | None = None) -> None:
        if item is not None:
            self._failed_by_dataset[item.subset] += 1
        self._problems.append(problem)
        self._listener.on_problem(problem)
        if self._on_error == "stop":
            raise _Stopped
