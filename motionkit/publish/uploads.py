"""Files of a store or a run to upload to the Hub, with a card; without caches and checkpoints."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from motionkit.core.errors import StoreError, UsageError
from motionkit.core.progress import OnProgress, ignore, task
from motionkit.publish.cards import run_card, store_card
from motionkit.store.hub.repository import Repository
from motionkit.store.manifest import read_committed, read_manifest
from motionkit.store.reader import Store, not_committed
from motionkit.store.reports.summary import summarise
from motionkit.store.schema import MANIFEST_FILE, SEGMENTS_FOLDER, SEQUENCES_FILE, SKELETONS_FILE
from motionkit.store.validate import faults
from motionkit.training.run import STAGE_NAME, RunFolder, weights_sha256

CARD = "README.md"
STAGE_FILE = re.compile(rf"{STAGE_NAME}/(config\.json|metrics\.jsonl|model\.safetensors|summary\.json)")
_PART = re.compile(rf"{SEGMENTS_FOLDER}/part-[0-9]{{5,10}}\.parquet")


@dataclass(frozen=True)
class Upload:
    """Files by their paths in the repository, as paths on the disk or as bytes.

    Other files in the repository whose paths match `replaces` are deleted.
    """

    files: Mapping[str, Path | bytes]
    replaces: re.Pattern[str]
    licences: tuple[str, ...] = ()

    @property
    def num_bytes(self) -> int:
        """Bytes of all files."""
        return sum(len(each) if isinstance(each, bytes) else each.stat().st_size for each in self.files.values())


def store_upload(path: Path, repository: Repository, on_progress: OnProgress = ignore) -> Upload:
    """A store's committed files and its card; raises `StoreError` if it is not intact."""
    manifest, content = read_manifest(path), (path / MANIFEST_FILE).read_bytes()
    with task(on_progress, "check", len(manifest.files)) as work:
        fault = next(faults(path, lambda _: work.advance()), None)
    if fault:
        raise StoreError(f"{path}: {fault}; 'motionkit validate --store {path}' says more")
    files: dict[str, Path | bytes] = {name: path / name for name in manifest.parts}
    for name in (SEQUENCES_FILE, SKELETONS_FILE):
        table = read_committed(path, name, manifest.files[name])
        if table is None:
            raise not_committed(path)
        files[name] = table
    store = Store.open(path)
    licences = tuple(sorted(set(store.columns("licence")["licence"])))
    files |= {MANIFEST_FILE: content, CARD: store_card(summarise(store), repository).encode()}
    return Upload(files, _PART, licences)


def run_upload(run: RunFolder, repository: Repository) -> Upload:
    """The complete stages of a run and its card; raises `UsageError` if there are none, `DamagedFileError`."""
    stages = [run.stage(path.parent.name) for path in sorted(run.path.glob("*/summary.json"))]
    if not stages:
        raise UsageError(f"{run.path} has no complete stage: motionkit train --run {run.path.name}")
    weights_sha256(run.path)
    for stage in stages:
        stage.check()
    files: dict[str, Path | bytes] = {
        f"{stage.path.name}/{path.name}": path for stage in stages for path in stage.result_paths if path.is_file()
    }
    return Upload(files | {CARD: run_card(stages, repository).encode()}, STAGE_FILE)
