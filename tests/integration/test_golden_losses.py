"""Losses of the first steps of every registered stage, as they were recorded, on any processor.

A change of these is a change of what is learnt: if it is meant, record again with --record-golden.
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eval.native_evaluator.stage import native, tmr
from motionkit.core import plugins
from motionkit.training.config import apply_overrides
from motionkit.training.detail import DetailConfig, load_detail
from motionkit.training.run import RunFolder, StageContext
from tests.helpers.analytic import write_analytic_store
from tests.helpers.float64 import float64_on_one_thread
from tests.helpers.tiny import NERM
from tests.helpers.tiny_peers import STAGES as GENERATIVE_PEERS
from tests.helpers.tiny_peers import tiny_config
from tests.helpers.tiny_temporal import PAHIRES, TEMPORAL_PEERS

GOLDEN = Path(__file__).with_name("golden_losses.json")
# Kernels for several processors (no vectors, AVX2, AVX-512; of torch, MKL, oneDNN, numpy, OpenBLAS) differ by 4e-13 at
# most; the C library's sines without FMA, which round a few float32 features the other way, by 1e-8.
TOLERANCE = 1e-7
STEPS = "schedule.steps=4"
EVALUATOR = [
    *("network.convolution=16", "network.recurrent=8", "network.shared=5", "network.text_hidden=8"),
    *("schedule.steps=4", "schedule.batch_size=12", "training.framerates=20,60", "training.statistics_batches=2"),
]
# Larger weights and learning rates where the published ones are so small that a change of 1e-4 of them is not seen.
PAHIRES_LARGER = ["training.loss.velocity_weight=20", "training.schedule.learning_rate=0.01"]
LARGER = {name: ["network.kl_weight=0.1"] for name in ("mld-vae", "inr-mlp", "actor", "nemf")}
LARGER["mld"] = ["schedule.learning_rate=0.02"]
LARGER["hier"] = ["network.kept_weight=0.1", "network.critic_weight=0.1"]
NERM_CONFIG = apply_overrides(
    NERM,
    [
        *(f"{stage}.{STEPS}" for stage in ("codebook", "field", "denoiser")),
        "codebook.schedule.drop_every=0.5",
        "field.loss.kl_weight=0.01",
        "denoiser.conditions.text_encoder=minilm",
    ],
)
CONFIGS: dict[str, Any] = {
    **dict.fromkeys(("codebook", "field", "denoiser"), NERM_CONFIG),
    "evaluator": apply_overrides(native("nano"), EVALUATOR),
    "tmr": apply_overrides(tmr("nano"), EVALUATOR),
    "pahires": apply_overrides(PAHIRES, [f"training.{STEPS}", *PAHIRES_LARGER]),
    **{name: apply_overrides(tiny, [f"training.{STEPS}"]) for name, tiny in TEMPORAL_PEERS.items()},
    **{name: apply_overrides(tiny_config(name), [STEPS, *LARGER.get(name, [])]) for name in GENERATIVE_PEERS},
    "detail": DetailConfig(),
}


class HashEncoder:
    """Embeddings of a sentence's sha256."""

    name, fingerprint, dimension = "minilm", "0" * 64, 16

    def encode(self, texts: Sequence[str]) -> np.ndarray:
        rows = [list(hashlib.sha256(text.encode()).digest()[: self.dimension]) for text in texts]
        return (np.array(rows, dtype=np.float32).reshape(-1, self.dimension) - 128) / 128


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    folder = tmp_path_factory.mktemp("golden")
    write_analytic_store(folder / "store")
    return RunFolder(folder / "run")


def train(name: str, run: RunFolder) -> dict[str, float]:
    """Train a stage after those that it builds on, unless it is trained. Returns its losses."""
    stage, config = plugins.load_all("STAGES")[name], CONFIGS[name]
    if not run.stage(name).is_complete:
        for earlier in stage.builds_on(config):
            train(earlier, run)
        context = StageContext(run.path.parent / "store", run, "tiny", seed=1, device="cpu")
        stage.check(context, config)
        stage.train(context, config)
    if name == "detail":  # It is fitted in closed form, without a loss.
        return {field: float(np.linalg.norm(array)) for field, array in vars(load_detail(run.path)).items()}
    (logged,) = run.stage(name).read_metrics()
    return {figure: value for figure, value in logged.items() if figure not in ("step", "seconds")}


def test_every_stage_has_its_losses() -> None:
    assert CONFIGS.keys() == plugins.load_all("STAGES").keys()


@pytest.mark.parametrize("name", CONFIGS)
def test_losses_are_those_that_were_recorded(name, run, monkeypatch, pytestconfig):
    monkeypatch.setattr("motionkit.training.text.load_minilm", lambda name: HashEncoder())
    with float64_on_one_thread():
        found = train(name, run)
    golden = json.loads(GOLDEN.read_text(encoding="utf-8"))
    if pytestconfig.getoption("--record-golden"):
        golden[name] = found
        GOLDEN.write_text(json.dumps(golden, indent=2) + "\n", encoding="utf-8")
    assert found == pytest.approx(golden[name], rel=TOLERANCE, abs=1e-12)
