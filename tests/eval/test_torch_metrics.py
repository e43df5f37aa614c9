"""Each metric's value is its function's, whatever the batches, the precision, or the processes that share the work."""

import copy
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.multiprocessing.spawn import spawn
from torchmetrics import Metric, MetricCollection

import eval
from eval import ClipFID, DeclaredMean, RPrecision, clip_fid
from eval.clip_fid import score
from eval.metrics.motion import derivative_error, l2p
from eval.metrics.retrieval import r_precision

RNG = np.random.default_rng(0)
ROWS = RNG.normal(size=(96, 8)) + 1e6
OTHERS = ROWS + RNG.normal(size=(96, 8))
PREDICTED, TARGET = RNG.normal(size=(2, 96, 20, 4, 3))
STD = np.ones((4, 3))
# A metric, its arrays (cut into batches along the first axis), and the function's own value of all of them.
CASES = {
    "acceleration": (
        DeclaredMean("acceleration_error", fps=30),
        (PREDICTED, TARGET),
        derivative_error(PREDICTED, TARGET, 30.0, order=2),
    ),
    "l2p": (DeclaredMean("l2p", std=STD), (PREDICTED, TARGET), l2p(PREDICTED, TARGET, STD)),
}
MOTIONS = [RNG.normal(size=(length, 22, 3)).cumsum(axis=0).astype(np.float32) / 50 for length in (80, 100, 70, 120)]
FEW: dict[str, Any] = {"clips": 128, "replications": 2, "seed": 5}


@pytest.fixture
def quick_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fit the descriptor on few clips."""
    monkeypatch.setattr(score, "FIT_CLIPS", 256)


def fed(metric: Metric, arrays: tuple[np.ndarray, ...], cuts: tuple[int, ...]) -> Metric:
    """The metric after updates with the arrays' batches."""
    metric = copy.deepcopy(metric)
    for batch in zip(*(np.split(array, cuts) for array in arrays), strict=True):
        metric.update(*map(torch.from_numpy, batch))
    return metric


@pytest.mark.parametrize("name", CASES)
def test_the_value_is_the_functions_whatever_the_batches(name: str) -> None:
    metric, arrays, expected = CASES[name]
    for cuts in ((), (1, 40)):
        value = fed(metric, arrays, cuts).compute()
        assert value.dtype == torch.float64
        assert float(value) == pytest.approx(expected, rel=1e-12)
    first, second = (fed(metric, tuple(array[half] for array in arrays), ()) for half in (slice(48), slice(48, None)))
    alone = float(copy.deepcopy(second).compute())
    second.merge_state(first)
    assert float(second.compute()) == pytest.approx(expected, rel=1e-12)
    second.reset()
    second.update(*(torch.from_numpy(array[48:]) for array in arrays))
    assert float(second.compute()) == pytest.approx(alone, rel=1e-12) and alone != expected


def test_r_precision_is_the_functions_and_draws_pools_of_all_pairs() -> None:
    top, mm_dist = r_precision(ROWS, OTHERS, rng=np.random.default_rng(3))
    expected = {f"r_precision_top{rank}": share for rank, share in enumerate(top, start=1)}
    for cuts in ((), (5, 50)):
        values = fed(RPrecision(seed=3), (ROWS, OTHERS), cuts).compute()
        assert {name: float(value) for name, value in values.items()} == pytest.approx(
            expected | {"mm_dist": mm_dist}, rel=1e-12
        )
    with pytest.raises(ValueError, match="pools of 32"):
        fed(RPrecision(), (ROWS[:8], OTHERS[:8]), ()).compute()


@pytest.mark.usefixtures("quick_fit")
def test_clip_fid_is_the_functions_in_lists_and_padded_batches() -> None:
    expected = clip_fid(MOTIONS[:2], MOTIONS, fps=60, **FEW)
    one_by_one, padded = (ClipFID(60, MOTIONS[:2], **FEW) for _ in range(2))
    for motion in MOTIONS:
        one_by_one.update([torch.from_numpy(motion).double()])
    batch = torch.full((2, 120, 22, 3), torch.nan)
    for row, motion in zip(batch, MOTIONS[2:], strict=True):
        row[: len(motion)] = torch.from_numpy(motion)
    padded.update([torch.from_numpy(motion) for motion in MOTIONS[:2]])
    padded.update(batch, num_frames=torch.tensor([70, 120]))
    for metric in (one_by_one, padded, copy.deepcopy(padded)):
        values = {name: float(value) for name, value in metric.compute().items()}
        assert values == {"clip_fid": expected.value, "clip_fid_ci95": expected.ci95}
    padded.reset()
    padded.update([torch.from_numpy(motion) for motion in MOTIONS[:2]])
    assert float(padded.compute()["clip_fid"]) == clip_fid(MOTIONS[:2], MOTIONS[:2], fps=60, **FEW).value


def test_clip_fid_refuses_what_cannot_be_compared() -> None:
    metric = ClipFID(60, MOTIONS[:2], **FEW)
    with pytest.raises(ValueError, match=r"\[10\] exceed a batch of 9 frames"):
        metric.update(torch.zeros(1, 9, 22, 3), num_frames=torch.tensor([10]))
    with pytest.raises(ValueError, match="NaN"):
        metric.update(torch.full((1, 9, 22, 3), torch.nan))


def test_settings_and_half_precision() -> None:
    assert DeclaredMean("jerk_error", fps=30, sync_on_compute=False).sync_on_compute is False
    assert DeclaredMean("jerk_error", fps=30).higher_is_better is False
    assert DeclaredMean("accuracy").higher_is_better is True
    for declared, settings, error in (
        ("jerk_error", {"frame_rate": 30}, ValueError),
        ("jerks", {}, KeyError),
    ):
        with pytest.raises(error):
            DeclaredMean(declared, **settings)
    both = MetricCollection({"mpjpe": DeclaredMean("mpjpe"), "mre": DeclaredMean("mean_vector_distance")})
    predicted = torch.ones(6, 1, 3, dtype=torch.bfloat16)
    both["mpjpe"].update(predicted, 3 * predicted)
    both["mre"].update(predicted[:, 0], 3 * predicted[:, 0])
    assert {name: round(float(value), 6) for name, value in both.compute().items()} == {"mpjpe": 0, "mre": 3.464102}


def test_importing_eval_is_light_and_a_missing_package_is_named() -> None:
    script = "import sys, eval; assert not {'torch', 'numpy', 'torchmetrics'} & set(sys.modules)\n"
    without = "import importlib.util as u; u.find_spec = lambda name, *_: None\n"
    for code, message in ((script, ""), (script + without + "from eval import ClipFID\n", "pip install '.[metrics]'")):
        done = subprocess.run((sys.executable, "-c", code), capture_output=True, text=True, check=False)
        assert message in done.stderr and (done.returncode == 0) == (not message), done.stderr
    assert {name for name in dir(eval) if not hasattr(eval, name)} == set()


def values_of(rows: slice, motions: slice) -> dict[str, float]:
    """The metrics of some of the data; in a group of processes, of the data of all."""
    score.FIT_CLIPS = 256
    pairs, error = RPrecision(), DeclaredMean("mpjpe")
    clips = ClipFID(60, MOTIONS[:2], clips=64, replications=2)
    pairs.update(torch.from_numpy(ROWS[rows]), torch.from_numpy(OTHERS[rows]))
    error.update(PREDICTED[rows, 0], TARGET[rows, 0])
    clips.update([torch.from_numpy(motion) for motion in MOTIONS[motions]])
    values = {"mpjpe": error.compute(), **pairs.compute(), **clips.compute()}
    return {name: float(value) for name, value in values.items()}


def work(rank: int, folder: str) -> None:
    """One of two processes."""
    torch.distributed.init_process_group("gloo", init_method=f"file://{folder}/meet", rank=rank, world_size=2)
    halves = ((slice(0, 30), slice(0, 2)), (slice(30, 96), slice(2, 4)))
    torch.save(values_of(*halves[rank]), Path(folder) / f"{rank}.pt")
    torch.distributed.destroy_process_group()


@pytest.mark.usefixtures("quick_fit")
def test_two_processes_have_the_value_of_the_whole(tmp_path: Path) -> None:
    spawn(work, args=(str(tmp_path),), nprocs=2)  # type: ignore[no-untyped-call]
    expected = values_of(slice(0, 96), slice(0, 4))
    for rank in range(2):
        assert torch.load(tmp_path / f"{rank}.pt", weights_only=True) == pytest.approx(expected, rel=1e-12)
