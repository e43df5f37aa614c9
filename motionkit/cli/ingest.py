"""`motionkit ingest`: read sources into a store."""

from collections import Counter
from collections.abc import Iterable
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from motionkit.cli import console
from motionkit.core.errors import FormatError, MotionkitError, UsageError, counted, lasting
from motionkit.core.files import default_path

if TYPE_CHECKING:
    from motionkit.store.ingest import IngestReport

# Suffixes of ignored files, and faults of one reason.
SHOWN_KINDS, MAX_PRINTED_OF_A_REASON = 5, 5


def ingest(
    sources: Annotated[list[Path], typer.Argument(help="Files and folders of motions.", show_default=False)],
    store: Annotated[Path | None, typer.Option(help="Store to create or to add to.", show_default="./store")] = None,
    format: Annotated[str, typer.Option(help="auto detects it by name and content; or one format's name.")] = "auto",
    captions: Annotated[
        Path | None, typer.Option(help="CSV with a column 'file' and any of caption, action, split, fps …")
    ] = None,
    index: Annotated[
        list[Path] | None,
        typer.Option(
            help="Index of segments: HumanML3D's index.csv, TMR's annotations.json (KIT-ML), BABEL's train.json, "
            "BONES-SEED's metadata."
        ),
    ] = None,
    texts: Annotated[Path | None, typer.Option(help="Folder of the index's captions: 000000.txt …")] = None,
    splits: Annotated[
        Path | None,
        typer.Option(help="Folder of the index's train.txt, val.txt, test.txt.", show_default="beside it or --texts"),
    ] = None,
    mirrored: Annotated[bool, typer.Option("--mirrored", help="The index's mirrored sequences too, M000000 …")] = False,
    compat: Annotated[
        Literal["humanml3d-20fps"] | None,
        typer.Option(help="Only the frames that HumanML3D published, not every native one."),
    ] = None,
    fps: Annotated[str | None, typer.Option(help="Framerate that replaces what files say: 120, 30000/1001.")] = None,
    fps_rules: Annotated[
        list[Path] | None,
        typer.Option(help="TOML of framerates that files state wrongly (docs/formats.md), before the shipped one."),
    ] = None,
    unit_metres: Annotated[
        float | None, typer.Option(help="Length of one file unit in metres: 0.01 for centimetres.")
    ] = None,
    up: console.Up = None,
    skeleton_map: console.SkeletonMaps = None,
    body_models: Annotated[
        Path | None,
        typer.Option(
            help="Folder of your own SMPL, SMPL-H or SMPL-X models (.npz), for AMASS's joints (else a mean shape).",
            envvar="MOTIONKIT_BODY_MODELS",
            exists=True,
            file_okay=False,
            resolve_path=True,
            show_default=False,
        ),
    ] = None,
    skip_frames: Annotated[
        int,
        typer.Option(min=0, help="Frames to skip at the start of every file; a column skip_frames sets it for one."),
    ] = 0,
    on_error: Annotated[
        Literal["skip", "stop"],
        typer.Option(help="skip: bad sequences are reported. stop: the first one leaves the store as it was."),
    ] = "skip",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the store instead of adding to it.")] = False,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes that read.", show_default="all cores, one for few files")
    ] = None,
    engine: Annotated[
        str, typer.Option(help="local, ray (here, or that of RAY_ADDRESS) or ray://HOST:PORT.")
    ] = "local",
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Read motions of any known format into a store, at their native framerates.

    An existing store is added to: sequences that it has from equal files are kept, and the same id from another file
    is refused. The result does not depend on the engine or the number of workers.

    Example: motionkit ingest takes"""
    from motionkit.io.registry import IndexOptions
    from motionkit.io.scan import read_rules
    from motionkit.store.ingest import ingest as ingest_sources

    if not index and (texts or splits or mirrored or compat):
        raise UsageError("--texts, --splits, --mirrored and --compat are about an index: give one with --index")
    if index and (skip_frames or captions):
        raise UsageError("--skip-frames and --captions are about whole files, --index is about segments of files")
    of_index = IndexOptions(tuple(index or ()), texts, splits, mirrored, published=compat is not None)
    options = console.read_options(
        console.parse_rate(fps),
        skeleton_map,
        unit_metres,
        up,
        format=format,
        captions=captions,
        index=of_index if index else None,
        fps_rules=tuple(rule for path in fps_rules or () for rule in read_rules(path)),
        body_models=body_models,
        skip_frames=skip_frames,
        skip_derived=True,
    )
    num_printed: Counter[str] = Counter()

    def print_fault(fault: FormatError, prefix: str = "") -> None:
        """Print the first few faults of each reason: a corpus can have many."""
        num_printed[fault.reason] += 1
        if num_printed[fault.reason] <= MAX_PRINTED_OF_A_REASON:
            console.stderr.print(f"{prefix}{fault}")
        elif num_printed[fault.reason] == MAX_PRINTED_OF_A_REASON + 1:
            console.stderr.print(f"{prefix}more of the kind {fault.reason}: counted at the end, --json names them all")

    with console.progress() as show:
        report = ingest_sources(
            *(sources, store or default_path("store")),
            options=options,
            on_error=on_error,
            overwrite=overwrite,
            num_workers=workers,
            engine=engine,
            on_progress=show,
            on_problem=print_fault,
            on_warning=partial(print_fault, prefix="warning: "),
        )
    console.print_json(_as_json(report)) if as_json else _print_summary(report, console.of_default("--store", store))
    if report.problems and on_error == "stop":
        raise MotionkitError(f"stopped at the first problem; the store {report.store} is as it was")
    if not report.num_in_store:
        raise MotionkitError(f"nothing could be stored in {report.store}")
    if report.problems and not report.stored.num_rows:
        raise MotionkitError(f"nothing was stored; the store {report.store} is as it was")


def _print_summary(report: "IngestReport", of_store: str) -> None:
    stored = report.stored.select(["num_frames", "duration_seconds", "quality_flags", "split", "subject"]).to_pydict()
    num_sequences = report.stored.num_rows
    console.stdout.print(
        f"stored {counted(num_sequences, 'sequence')} ({lasting(sum(stored['duration_seconds'], 0.0))}, "
        f"{counted(sum(stored['num_frames']), 'frame')}) in {report.store}, which holds {report.num_in_store:,}",
    )
    if report.num_already_stored:
        console.stdout.print(
            f"already there: {report.num_already_stored:,}, as they were (--overwrite makes the store anew)"
        )
    for name, faults in (("failed", report.problems), ("warnings", report.warnings)):
        if faults:
            reasons = [f"{count:,} {reason}" for reason, count in _counts(each.reason for each in faults).items()]
            console.stdout.print(f"{name}: {len(faults):,} ({', '.join(reasons)})")
    if report.ignored:
        suffixes = _counts(path.suffix.lower() or path.name for path in report.ignored)
        kinds = [f"{count:,} {suffix}" for suffix, count in suffixes.items()]
        listed = ", ".join(kinds[:SHOWN_KINDS]) + (", …" if len(kinds) > SHOWN_KINDS else "")
        console.stdout.print(f"ignored: {len(report.ignored):,} ({listed}; the first: {report.ignored[0]})")
    for name, counts in report.datasets.items():
        console.stdout.print(f"{name or '-'}: {', '.join(f'{number:,} {state}' for state, number in counts.items())}")
    if not num_sequences:
        return
    if num_flagged := sum(map(bool, stored["quality_flags"])):
        flags = ", ".join(f"{count:,} {flag}" for flag, count in _counts(chain(*stored["quality_flags"])).items())
        console.stdout.print(
            f"quality: {counted(num_flagged, 'sequence')} with flags ({flags}); "
            f"'motionkit info --quality{of_store}' lists them"
        )
    by = "" if all(stored["subject"]) else " --by sequence_id"
    is_split = 2 * sum(map(bool, stored["split"])) >= num_sequences
    console.stdout.print(f"next: motionkit {'train' if is_split else 'split' + by}{of_store}")


def _counts(words: Iterable[str]) -> dict[str, int]:
    return dict(Counter(words).most_common())


def _as_json(report: "IngestReport") -> dict[str, Any]:
    return {
        "store": str(report.store),
        "committed": report.committed,
        "stored": report.stored.num_rows,
        "frames": sum(report.stored["num_frames"].to_pylist()),
        "hours": sum(report.stored["duration_seconds"].to_pylist()) / 3600,
        "already_stored": report.num_already_stored,
        "sequences_in_store": report.num_in_store,
        "failed": _counts(each.reason for each in report.problems),
        "warnings": _counts(each.reason for each in report.warnings),
        "quality_flags": _counts(chain(*report.stored["quality_flags"].to_pylist())),
        "datasets": report.datasets,
        "ignored": _counts(path.suffix.lower() or path.name for path in report.ignored),
        "ignored_paths": [str(path) for path in report.ignored],
        "problems": [{"reason": each.reason, "message": str(each)} for each in report.problems],
        "warned": [{"reason": each.reason, "message": str(each)} for each in report.warnings],
    }
