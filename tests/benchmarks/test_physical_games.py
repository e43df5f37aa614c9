"""The benchmark of physical figures on performances with planted feet."""

from fractions import Fraction
from pathlib import Path

import pytest

from benchmarks.eval.physical import RATIO, framerates_result, games_result
from eval.sets.motions import real_motion
from motionkit.core.motion import Motion
from motionkit.fields.motion_field import to_motion
from motionkit.store.reader import Store
from motionkit.store.writer import StoreWriter
from tests.helpers.analytic import analytic_motion


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("games") / "store"
    with StoreWriter.create(path) as writer:
        for seed, fps in enumerate((120, 120, 60)):
            motion = to_motion(analytic_motion("walk", 3.0, seed), Fraction(fps))
            of_take = (motion.joint_positions, motion.skeleton, motion.timegrid)
            writer.add(Motion(*of_take, split="test", sequence_id=f"take-{seed}"))
    return path


def test_framerates_show_the_same_takes_and_what_changes(store: Path) -> None:
    result = framerates_result(real_motion(Store.open(store), "test"), store)
    assert result.caption.startswith("2 real takes, 6 s")
    ours, field = ({row.name: row.cells for row in block.rows} for block in result.blocks)
    assert ours["Jerk below 10 Hz, m/s³"][RATIO].value == pytest.approx(1.0, abs=0.05)
    # A step is a sixth as long at six times the framerate, and its second difference a 36th of the smooth part.
    assert field["PhysDiff Skate, mm/frame"][RATIO].value < 0.5
    assert field["MBench jitter degree, m/frame²"][RATIO].value < 0.2
    assert list(ours["Jitter of 10 to 20 Hz, mm"]) == ["40 fps", "60 fps", "100 fps", "120 fps"]


def test_games_win_what_the_page_says_they_win(store: Path) -> None:
    (block,) = games_result(real_motion(Store.open(store), "test"), store).blocks
    rows = {row.name: {name: cell.value for name, cell in row.cells.items()} for row in block.rows}
    speed, jerk, ground = (
        rows[name] for name in ("Skating speed, m/s", "Jerk below 10 Hz, m/s³", "Time on the ground")
    )
    assert speed["real"] < 0.05 < 0.25 < speed["sliding"] == pytest.approx(speed["raised"], rel=1e-5)
    assert speed["frozen"] == jerk["frozen"] == 0.0
    assert jerk["half speed"] < jerk["real"] / 2 < jerk["shaking"]
    assert max(ground["rising"], ground["shaking"]) < ground["real"] / 2
    assert rows["GMD skating ratio"]["raised"] == rows["PhysDiff Skate, mm/frame"]["raised"] == 0.0
    assert rows["PhysDiff Float, mm"]["rising"] > rows["PhysDiff Float, mm"]["real"] + 100
    jitter = rows["Jitter of 10 to 20 Hz, mm"]
    assert jitter["upsampled"] < jitter["upsampled, noise"]
