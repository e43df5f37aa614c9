"""Ingest: chunks of the sources, workers that die, and the same store, byte for byte, from all engines."""

import subprocess
import sys
from pathlib import Path

import pytest

from motionkit.core.errors import MissingExtraError, UsageError
from motionkit.core.skeleton import KIT21, SMPL22, Skeleton
from motionkit.store import Store
from motionkit.store import ingest as module
from motionkit.store.ingest import body_size_warning, ingest
from motionkit.store.workers import check_engine, start_workers
from tests.helpers.format_samples import TWO_JOINTS, bvh_hierarchy, bvh_text

HEAD = bvh_hierarchy(TWO_JOINTS)


def folder_of(tmp_path: Path, lengths: list[int]) -> Path:
    """A folder of BVH files 0.bvh, 1.bvh … with so many frames."""
    folder = tmp_path / "takes"
    folder.mkdir()
    for number, length in enumerate(lengths):
        rows = [f"{frame} 90 0 0 0 {frame / 7:.6f} 0 {frame} 0" for frame in range(length)]
        (folder / f"{number}.bvh").write_text(bvh_text(rows, "0.01", HEAD))
    return folder


@pytest.mark.parametrize("workers", [1, 2])
def test_an_index_is_the_place_among_what_is_new(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: int) -> None:
    """Whatever failed and whatever is there already: so a part's bytes do not depend on other parts."""
    monkeypatch.setattr(module, "CHUNK_BYTES", 2000)
    folder = folder_of(tmp_path, [20, 30, 40, 50, 60])
    broken = folder / "2.bvh"
    good = broken.read_text()
    broken.write_text("HIERARCHY\n")
    first = ingest([folder], tmp_path / "store", num_workers=workers)
    assert (first.stored.num_rows, len(first.problems)) == (4, 1)
    assert Store.open(tmp_path / "store").sequences["sequence_index"].tolist() == [0, 1, 3, 4]
    broken.write_text(good)
    (folder / "5.bvh").write_text((folder / "4.bvh").read_text())
    second = ingest([folder], tmp_path / "store", num_workers=workers)
    assert (second.stored.num_rows, second.num_already_stored) == (2, 4)
    store = Store.open(tmp_path / "store")
    assert store.sequences["sequence_index"].tolist() == [0, 1, 3, 4, 5, 6]
    assert [store.read(index).num_frames for index in (0, 3, 5, 6)] == [20, 50, 40, 60]
    names = sorted(f"motions/{path.name}" for path in (store.path / "motions").iterdir())
    assert names == list(store.manifest.parts)


KILLED = """
import os, signal, sys
from pathlib import Path
from motionkit.store import ingest as module

folder, store, when = map(Path, sys.argv[1:])
marker, finish, read = folder.parent / "died", module.PartWriter.finish, module.read
module.CHUNK_BYTES = 12000

def die(once):
    if not (once and marker.exists()):
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)

def deadly(item, options):
    if when.name != "written" and item.path.stem == "1":
        die(once=when.name == "reading")
    return read(item, options)

def finish_or_die(part):
    written = finish(part)
    if when.name == "written" and part.num_rows > 1:
        die(once=True)
    return written

module.read, module.PartWriter.finish = deadly, finish_or_die
if __name__ == "__main__":
    report = module.ingest([folder], store, num_workers=2)
    reasons = [(problem.path.name, problem.reason) for problem in report.problems]
    assert reasons == ([("1.bvh", "worker-died")] if when.name == "always" else []), reasons
"""


@pytest.mark.parametrize("when", ["reading", "written", "always"])
def test_a_worker_that_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str) -> None:
    """Once: its chunk is done again, whole. Always: the file is named, and the others of its chunk are stored."""
    folder = folder_of(tmp_path, [20, 40, 300, 30, 600, 50])
    monkeypatch.setattr(module, "CHUNK_BYTES", 12000)
    program = tmp_path / "program.py"
    program.write_text(KILLED)
    subprocess.run([sys.executable, program, folder, tmp_path / "store", when], check=True)
    assert (tmp_path / "died").exists()
    if when == "always":
        monkeypatch.setattr(module, "_size", {path: path.stat().st_size for path in folder.iterdir()}.__getitem__)
        (folder / "1.bvh").write_text("HIERARCHY\n")  # a file that cannot be read leaves the same gap
    ingest([folder], tmp_path / "undisturbed", num_workers=1)
    stores = [Store.open(tmp_path / name) for name in ("undisturbed", "store")]
    assert len(stores[0].manifest.parts) > 2
    assert stores[0].fingerprint == stores[1].fingerprint
    names = [sorted(path.name for path in (store.path / "motions").iterdir()) for store in stores]
    assert names[0] == names[1]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_problem_under_stop_leaves_no_part_of_other_chunks(tmp_path, monkeypatch, workers):
    monkeypatch.setattr(module, "CHUNK_BYTES", 1)
    folder = folder_of(tmp_path, [20, 30, 40, 50, 60])
    (folder / "3.bvh").write_text("HIERARCHY\n")
    report = ingest([folder], tmp_path / "store", num_workers=workers, on_error="stop")
    assert (report.committed, len(report.problems)) == (False, 1)
    assert list((tmp_path / "store" / "motions").iterdir()) == []


@pytest.mark.parametrize(
    ("skeleton", "warns"),
    [(SMPL22.scaled(0.6), False), (SMPL22.scaled(1 / 2.2), True), (SMPL22.scaled(2.0), True), (KIT21, False)],
)
def test_a_body_of_no_persons_size_is_reported(skeleton: Skeleton, warns: bool) -> None:
    assert bool(body_size_warning(skeleton)) == warns


def refuse(number: int) -> int:
    raise OSError(28, "No space left on device", "part.new")


@pytest.mark.parametrize("number", [1, 2])
def test_what_a_worker_raises_is_raised(number: int) -> None:
    with pytest.raises(OSError, match=r"part\.new"), start_workers("local", number) as running:
        list(running.map(refuse, [0], refuse))


def test_the_store_does_not_depend_on_the_engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "captures"
    folder.mkdir()
    for number in range(70):
        rows = [f"{frame} 90 0 {number} 0 {frame / 7:.6f} 0 {frame} 0" for frame in range(1, 20 + 9 * number)]
        text = bvh_text(rows, "0.01", HEAD)
        (folder / f"walk-{number:02d}.bvh").write_text(text if number % 20 != 13 else text[:-200])
    monkeypatch.setattr(module, "CHUNK_BYTES", 2**16)
    reports = {
        name: ingest([folder], tmp_path / name, engine=engine, num_workers=number)
        for name, engine, number in (("alone", "local", 1), ("local", "local", 2), ("ray", "ray", 2))
    }
    assert {report.stored.num_rows for report in reports.values()} == {67}
    assert len({tuple(map(str, report.problems)) for report in reports.values()}) == 1
    assert len({(tmp_path / name / "manifest.json").read_bytes() for name in reports}) == 1
    assert len(Store.open(tmp_path / "ray").manifest.parts) > 3


def test_without_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match="ray"), start_workers("ray", 2):
        pass


@pytest.mark.parametrize("name", ["dask", "ray://host", "ray://host:port"])
def test_unknown_engines(name: str) -> None:
    with pytest.raises(UsageError, match=name):
        check_engine(name)
