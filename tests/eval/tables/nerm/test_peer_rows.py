"""A trained peer's rows: by the same path as NeRM's, planted, upsampled both ways, with how it was trained."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from eval.clip_fid import score
from eval.clip_fid.score import Protocol
from eval.sets.sets import RowId, Variant
from eval.tables.nerm import table2
from motionkit.core.motion import Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store.writer import StoreWriter
from peers.motions import ConditionsConfig, MotionsConfig
from tests.helpers.nerm_corpus import analytic_positions
from tests.helpers.table_request import table_request
from tests.helpers.tiny_peers import STEPS, tiny_config, train_peer

NAME = "MDM, 50 steps"


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("peers") / "store"
    with StoreWriter.create(path) as writer:
        for index in range(12):
            grid = TimeGrid(Fraction(60), 270)
            positions = analytic_positions(grid.seconds() + 0.3 * index, index % 4)
            split = ("train", "test")[index % 2]
            writer.add(Motion(positions, SMPL22, grid, split=split, sequence_id=f"take-{index}"))
    return path


def test_a_peer_of_a_run_has_rows_and_the_others_have_commands(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(score, "FIT_CLIPS", 600)

    def none(*arguments: object) -> None:
        raise ValueError("left out")

    monkeypatch.setattr(table2, "copies_block", none)
    motions = MotionsConfig(max_frames=100, min_seconds=1.0, mirrored=False)
    config = replace(tiny_config("mdm-50"), conditions=ConditionsConfig(kind="none"), motions=motions)
    train_peer("mdm-50", store, tmp_path / "run", config)

    protocol = Protocol(num_clips=200, replications=2, detailed_replications=1, resamplings=50)
    values = {"fps": (Fraction(20), Fraction(60)), "protocol": protocol, "features": ("kinematic",)}
    result = table2.TABLE.build(table_request(store, tmp_path / "results", run=tmp_path / "run", **values))
    rows = {row.name: row for row in result.blocks[0].rows}
    vectors, upsampled, planted = (
        str(RowId(NAME, variant)) for variant in (Variant.AS_VECTORS, Variant.UPSAMPLED, Variant.PLANTED)
    )
    assert {NAME, planted, vectors} <= rows.keys()
    assert upsampled not in rows
    for name in (NAME, vectors):
        assert np.isfinite([cell.value for cell in rows[name].cells.values()]).all()
    # Velocities a frame that are left as they are carry the body three times as far.
    assert rows[vectors].cells["60 fps"].value > rows[NAME].cells["60 fps"].value
    assert f"mdm-50: {STEPS} steps, " in rows[NAME].note and "trained at up to 20 fps" in rows[NAME].note
    commands = " && ".join(f"motionkit train --stage {stage} --run run" for stage in ("mld-vae", "mld"))
    assert f"MLD: run 'run' has none ({commands})" in result.missing
    assert not any(line.startswith(NAME) for line in result.missing)
