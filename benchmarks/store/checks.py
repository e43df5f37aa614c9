"""Cost of verifying the checksums of a store, its parts and its caches.

    python -m benchmarks.store.checks STORE [--sources FOLDER …] [--repeats 5] [--json]

Each piece of work is done with its check and without it, in turn, in one process; processor time of one thread, the
least of the repeats, files in the operating system's cache. With --sources, they are ingested too, once each, by one
worker.
"""

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import pyarrow as pa
import pyarrow.parquet as pq
from rich.table import Table

from benchmarks.command import arguments_parser, print_json
from motionkit.cli.console import stdout
from motionkit.core import checksums
from motionkit.core.skeleton import Skeleton
from motionkit.store import Store, codec
from motionkit.store.cache.positions import open_cache
from motionkit.store.ingest.ingest import ingest
from motionkit.store.manifest import FileEntry, Manifest
from motionkit.store.parts import SegmentReader
from motionkit.store.schema import part_writer_options

Patch = Callable[[], Any]


def seconds(work: Callable[[], object]) -> float:
    """Processor time of this process and of its children."""
    begun = time.process_time()
    work()
    return time.process_time() - begun


def compared(work: Callable[[], object], without: Patch | None, repeats: int) -> dict[str, float]:
    """Least processor time of the work with its check, and of the work without."""
    work()
    checked, unchecked = [], []
    for _ in range(repeats):
        checked.append(seconds(work))
        if without is not None:
            with without():
                unchecked.append(seconds(work))
    return {"checked": min(checked), **({"unchecked": min(unchecked)} if unchecked else {})}


def read_all(store: Store) -> None:
    for _ in store.read_many(store.select()):
        pass


def first_reads(store: Store, entries: dict[str, FileEntry]) -> None:
    """The checks of each part before a process first reads from it."""
    reader = SegmentReader(store.path, entries)
    for name in store.manifest.parts:
        reader.checked_part(name)


def fresh_cache(store: Store) -> None:
    checksums._sha256_of_version.cache_clear()
    open_cache(store)


def skeletons_only(path: Path, manifest: Manifest, sequences: pa.Table, skeletons: pa.Table) -> dict[str, Skeleton]:
    return {row["skeleton"]: codec.skeleton_from_row(row) for row in skeletons.to_pylist()}


def measure(path: Path, sources: list[Path], repeats: int) -> dict[str, dict[str, float]]:
    store, parquet_file = Store.open(path), pq.ParquetFile
    entries = store.manifest.files
    of_before = {name: replace(entry, footer_sha256="") for name, entry in entries.items()}
    patch = partial(partial, mock.patch)
    unchecked_cache = patch("motionkit.store.cache.positions.file_fault", lambda *arguments, **options: "")
    unchecked_pages = patch("motionkit.store.parts.pq.ParquetFile", lambda source, **options: parquet_file(source))
    works: dict[str, tuple[Callable[[], object], Patch | None]] = {
        "open the store": (
            lambda: Store.open(path),
            patch("motionkit.store.reader.require_sound", skeletons_only),
        ),
        "every motion in order": (lambda: read_all(Store.open(path)), unchecked_pages),
        "before the first read of each part": (lambda: first_reads(store, entries), None),
        "the same, parts of before page checksums": (lambda: first_reads(store, of_before), None),
        "open the cache, first time": (lambda: fresh_cache(store), unchecked_cache),
        "open the cache again": (lambda: open_cache(store), unchecked_cache),
    }
    figures = {what: compared(work, without, repeats) for what, (work, without) in works.items()}
    return figures | ({"ingest": ingest_figures(sources)} if sources else {})


def ingest_figures(sources: list[Path]) -> dict[str, float]:
    """An ingest whose pages have checksums, and one whose pages have none."""
    figures = {}
    for name, wanted in (("checked", True), ("unchecked", False)):
        options = part_writer_options() | {"write_page_checksum": wanted}
        with (
            tempfile.TemporaryDirectory() as folder,
            mock.patch("motionkit.store.parts.part_writer_options", lambda chosen=options: chosen),
        ):
            store = Path(folder) / "store"
            figures[name] = seconds(lambda path=store: ingest(sources, path, num_workers=1))
    return figures


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("--sources", nargs="*", type=Path, default=[])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    figures = measure(arguments.store, arguments.sources, arguments.repeats)
    if arguments.json:
        print_json(figures, arguments.store)
        return
    table = Table(title=f"{arguments.store}: processor seconds")
    for heading in ("", "with checks", "without", "more"):
        table.add_column(heading, justify="left" if not heading else "right")
    for what, found in figures.items():
        with_checks, without = found["checked"], found.get("unchecked")
        if without is None:
            table.add_row(what, f"{with_checks:.4f}", "", "")
        else:
            table.add_row(what, f"{with_checks:.4f}", f"{without:.4f}", f"{100 * (with_checks / without - 1):+.1f} %")
    stdout.print(table)


if __name__ == "__main__":
    main()
