"""Checks of a store, and of the stages of runs."""

import shlex
import time
from collections.abc import Iterator
from pathlib import Path

from motionkit.core.errors import MotionkitError
from motionkit.doctor.finding import Finding
from motionkit.store.commit import leftovers, require_present_version
from motionkit.store.manifest import Manifest, read_manifest
from motionkit.store.reader import Store
from motionkit.store.schema import MANIFEST_FILE
from motionkit.training.run import RunFolder, StageFolder

MEGABYTE = 1e6
# Training logs and saves at least this often; after a longer silence it has stopped.
SILENT_SECONDS = 300.0


def store_findings(path: Path) -> Iterator[Finding]:
    """Whether a store opens, has all its parts and a split; removed sequences and leftovers of stopped commands.

    Parts are not read; `motionkit validate` does that.
    """
    if not (path / MANIFEST_FILE).exists():
        yield Finding("store", f"{path}: none", "note", f"motionkit ingest SOURCE --store {shlex.quote(str(path))}")
        return
    try:
        manifest = read_manifest(path)
        store = Store.open(path)
    except (MotionkitError, OSError) as error:
        yield Finding("store", str(error), "problem", f"motionkit validate {_option('store', path)}")
        return
    yield Finding(
        "store",
        f"{path} opens: {manifest.num_sequences:,} sequences, format version {manifest.format_version}, "
        f"{manifest.num_bytes / MEGABYTE:,.1f} MB in {len(manifest.parts):,} parts",
    )
    yield from _part_findings(path, manifest)
    splits = set(store.columns("split")["split"])
    if not splits & {"train", "test"}:
        yield Finding("store", "no sequence is for training or held out", "note", _command("split", path))
    try:
        require_present_version(path, manifest)
    except MotionkitError as error:
        yield Finding("store", str(error), "note", _command("migrate", path))
    if manifest.num_removed_segments:
        fact = f"{manifest.num_removed_segments:,} segments of removed sequences are still on the disk"
        yield Finding("store", fact, "note", f"{_command('compact', path)} drops them for good")


def _part_findings(path: Path, manifest: Manifest) -> Iterator[Finding]:
    wrong = [name for name in manifest.parts if _size(path / name) != manifest.files[name].num_bytes]
    if wrong:
        fact = f"{path}: {len(wrong):,} parts are missing or have another size, {wrong[0]} first"
        yield Finding("store", fact, "problem", f"restore them from a copy; {_command('validate', path)} says more")
    num_left = len(leftovers(path, manifest))
    if num_left:
        fact = f"{path}: {num_left:,} files of a command that was stopped, or is writing now"
        yield Finding("store", fact, "note", "the next command that writes to the store removes them")


def run_findings(runs: Path, store: Path) -> Iterator[Finding]:
    """For each run, complete and stopped stages, and whether the store has changed since."""
    found = sorted(path for path in runs.iterdir() if any(path.glob("*/config.json"))) if runs.is_dir() else []
    if not found:
        yield Finding("runs", f"{runs}: none", "note", "motionkit train")
        return
    try:
        fingerprint = read_manifest(store).fingerprint
    except MotionkitError:
        fingerprint = ""
    for path in found:
        yield from _findings_of_run(path, fingerprint)


def _findings_of_run(path: Path, fingerprint: str) -> Iterator[Finding]:
    complete, others = [], False
    for config in sorted(path.glob("*/config.json")):
        stage = RunFolder(path).stage(config.parent.name)
        try:
            begun = stage.read_config()
            others |= bool(fingerprint) and begun.get("store_fingerprint", fingerprint) != fingerprint
            if stage.is_complete:
                stage.check()
                complete.append(stage.path.name)
                continue
            done = stage.read_metrics()
        except MotionkitError as error:
            yield Finding("runs", str(error), "problem", f"motionkit train --stage {stage.path.name} … --overwrite")
            continue
        yield _unfinished(stage, str(begun.get("recipe", "")), int(done[-1]["step"]) if done else 0)
    if complete:
        yield Finding("runs", f"{path}: {', '.join(complete)} complete")
    if others:
        fact = f"{path}: trained from another store than this, or from an earlier state of it"
        yield Finding("runs", fact, "note", "tables of this store would be about another split; see --store")


def _unfinished(stage: StageFolder, recipe: str, step: int) -> Finding:
    run, silent = stage.path.parent, time.time() - _last_written(stage)
    fact = f"{run}: {stage.path.name} is not complete, {step:,} steps logged"
    if silent < SILENT_SECONDS:
        return Finding("runs", f"{fact}; written to {silent:.0f} s ago", "note", "it may be in training now")
    command = shlex.join(["motionkit", "train", "--stage", stage.path.name, "--recipe", recipe, "--run", run.name])
    return Finding("runs", fact, "note", f"{command} --resume, with the --set and --where that it was begun with")


def _last_written(stage: StageFolder) -> float:
    return max(path.stat().st_mtime for path in (stage.path, *stage.path.iterdir()))


def _size(path: Path) -> int | None:
    return path.stat().st_size if path.is_file() else None


def _option(name: str, path: Path) -> str:
    return f"--{name} {shlex.quote(str(path))}"


def _command(name: str, store: Path) -> str:
    return f"motionkit {name} {_option('store', store)}"
