"""A small store of analytic motions at several framerates, captioned, and how to ingest an export again."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest

from motionkit.core.motion import Caption, Motion, Provenance
from motionkit.edit.export import ExportReport, Selection, export, export_kinds
from motionkit.fields.motion_field import to_motion
from motionkit.store import Store, StoreWriter
from motionkit.store.ingest import ingest
from tests.helpers.analytic import analytic_motion

RATES = (Fraction(30), Fraction(60000, 1001), Fraction(120))


def performance(index: int, fps: Fraction, seconds: float = 4.0) -> Motion:
    """A body that walks, with rotations, captions and a history."""
    motion = to_motion(analytic_motion("walk", seconds, index), fps)
    return replace(
        motion,
        captions=(Caption("a person walks, then waves"), Caption("waves", 1.5, 2.25, "wave/VERB")),
        action="walk",
        style="old" if index else "",
        split=("train", "val", "test")[index % 3],
        sequence_id=f"lab/take {index}",
        provenance=Provenance(source="lab", licence="CC-BY-4.0", subject=f"S{index}", stated_fps=f"{float(fps):.2f}"),
    )


@pytest.fixture(scope="session")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Three performances at 30, 59.94 and 120 fps."""
    path = tmp_path_factory.mktemp("corpus") / "store"
    with StoreWriter.create(path) as writer:
        for index, fps in enumerate(RATES):
            writer.add(performance(index, fps))
    return Store.open(path)


@pytest.fixture
def export_as(tmp_path: Path) -> Callable[..., ExportReport]:
    """`export_as(store, "bvh", fps=…)` into `tmp_path/out`."""

    def run(store: Store, name: str, fps: Fraction | None = None, where: str | None = None) -> ExportReport:
        kind = export_kinds()[name]
        return export(Selection(store, store.select(where), fps or kind.fps), tmp_path / "out", kind)

    return run


@pytest.fixture
def ingest_again(tmp_path: Path) -> Callable[[Path], list[Motion]]:
    """The motions of a folder after a journey through ingest and a store; any warning is a fault."""

    def run(folder: Path) -> list[Motion]:
        report = ingest([folder], tmp_path / "again", num_workers=1)
        assert not report.problems and not report.warnings
        again = Store.open(tmp_path / "again")
        return list(again.read_many(range(again.num_sequences)))

    return run
