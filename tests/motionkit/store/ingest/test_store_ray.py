"""Ingest by a local Ray of two workers: the same store, byte for byte, and clear words where Ray is not to be had."""

import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

import motionkit
from motionkit.core.errors import MissingExtraError, MotionkitError, StoreError, UsageError
from motionkit.store import Store
from motionkit.store.engines import check_engine, ray_engine
from motionkit.store.engines.parallel import WorkerDied, map_in_order
from motionkit.store.engines.ray_engine import RayEngine
from motionkit.store.ingest import stretches
from motionkit.store.ingest.ingest import ingest
from tests.helpers.small_bvh import two_joints_bvh


@pytest.fixture(scope="module")
def ray() -> Iterator[RayEngine]:
    with RayEngine(None, 2) as engine:
        yield engine


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    folder = tmp_path / "takes"
    folder.mkdir()
    for take in range(70):
        rows = [f"{frame} 90 0 {take} 0 {frame / 7:.6f} 0 {frame} 0" for frame in range(1, 20 + 9 * take)]
        text = two_joints_bvh(rows)
        (folder / f"take-{take:02d}.bvh").write_text(text if take % 20 != 13 else text[:-200])
    return folder


def test_results_come_in_order_and_the_input_that_a_worker_dies_of_is_named(ray: RayEngine) -> None:
    # Inside the test, so that it travels by value: Ray's workers cannot import test modules.
    def ten_times_but_die_of_five(numbers: Sequence[int]) -> list[int]:
        return os._exit(1) if 5 in numbers else [10 * number for number in numbers]

    batches = [[0], [1, 2], [3, 4, 5, 6], *([number] for number in range(7, 20))]
    results = list(map_in_order(ray, ten_times_but_die_of_five, batches))
    assert [batch for batch, _ in results] == [[0], [1, 2], [3, 4], [5], [6], *batches[3:]]
    for batch, output in results:
        assert isinstance(output, WorkerDied) if batch == [5] else output == [10 * number for number in batch]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device", "part.new"), StoreError("no store here")])
def test_what_a_worker_raises_is_raised(ray: RayEngine, error: Exception) -> None:
    def refuse(numbers: Sequence[int]) -> list[int]:
        raise error

    with pytest.raises(type(error)) as caught:
        list(map_in_order(ray, refuse, [[0]]))
    assert str(caught.value) == str(error)


def test_the_store_does_not_depend_on_the_engine(
    ray: RayEngine, takes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stretches, "STRETCH_BYTES", 2**16)
    reports = {
        name: ingest([takes], tmp_path / name, engine=engine, num_workers=workers)
        for name, engine, workers in (("alone", "local", 1), ("local", "local", 2), ("ray", "ray", None))
    }
    assert {report.num_stored for report in reports.values()} == {67}
    assert {tuple(map(str, report.problems)) for report in reports.values()} == {
        tuple(map(str, reports["alone"].problems))
    }
    assert len({(tmp_path / name / "manifest.json").read_bytes() for name in reports}) == 1
    assert len(Store.open(tmp_path / "ray").manifest.parts) > 3


@pytest.mark.parametrize("deaths", [1, 2])
def test_a_worker_that_dies_at_the_start(
    ray: RayEngine, deaths: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def version_after_deaths(_: Sequence[None]) -> str:
        before = len(list(tmp_path.iterdir()))
        if before < deaths:
            (tmp_path / str(before)).touch()
            os._exit(1)
        return motionkit.__version__

    monkeypatch.setattr(ray_engine, "_version", version_after_deaths)
    if deaths == 1:
        with RayEngine(None, 2) as engine:
            assert engine.num_workers == 2
    else:
        with pytest.raises(MotionkitError, match="two workers of Ray ended"), RayEngine(None, 2):
            pass


def test_without_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r"pip install '\.\[ray\]'"), RayEngine(None, 2):
        pass


@pytest.mark.parametrize("name", ["dask", "ray:", "ray://", "ray://host", "ray://:10001", "ray://host:port"])
def test_engines_that_are_none(name: str) -> None:
    with pytest.raises(UsageError, match="expected local, ray"):
        check_engine(name)
