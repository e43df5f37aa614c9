"""Table 1: a model that is the real motion scores like it; one that ignores its captions scores chance."""

from collections.abc import Sequence
from fractions import Fraction
from functools import partial
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from eval.native_evaluator.evaluator import NativeEvaluator
from eval.report.results import Result, read_result, to_markdown, write_result
from eval.sets.motions import NoRealMotionError
from eval.sets.sets import SampleSet
from eval.tables.nerm import table1
from eval.tables.nerm.table1 import FLOOR, ORACLE, title_of
from eval.text_motion.guo import GuoFiles
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.motion import Caption
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.generate.models import GenerationRequest, SamplingOptions
from tests.helpers.scripted_model import PosesAt, ScriptedModel, install_models, trained_run
from tests.helpers.table_request import rows_of, table_request, write_takes

TAKES = 70
TOP1, TOP3, FID, MM_DIST = (title_of(name) for name in ("r_precision_top1", "r_precision_top3", "fid", "mm_dist"))
MULTIMODALITY = title_of("multimodality")


def positions_at(times_seconds: np.ndarray, take: int, shake: float = 0.0) -> np.ndarray:
    """A body that leans as its number says: what an evaluator can tell from any stretch of it."""
    rest = rest_positions(SMPL22) + 0.05 * np.random.default_rng(take).normal(size=(22, 3))
    swing = np.sin(2 * np.pi * times_seconds)[:, None, None] * 0.02
    return (rest + swing + shake).astype(np.float32)


class Shapes(NativeEvaluator):
    """An evaluator that sees four numbers of a motion's mean pose; a sentence is the number of a take."""

    name, fingerprint, pair_score = "shapes", "1", ""

    def __init__(self) -> None: ...

    def remark_at(self, fps: Fraction) -> str:
        return ""

    def embed_motions(self, samples: SampleSet) -> np.ndarray:
        means = [sequence.astype(np.float64).mean(axis=0).ravel() for sequence in samples.sequences]
        return np.stack(means)[:, 3:7]

    def embed_texts(self, captions: Sequence[Caption]) -> np.ndarray:
        whole = np.arange(20) / 20
        poses = [positions_at(whole, int(caption.text)).astype(np.float64).mean(axis=0) for caption in captions]
        return np.stack(poses).reshape(len(captions), -1)[:, 3:7]


def listens(request: GenerationRequest, chance: tuple[int, int]) -> PosesAt:
    """The take that a caption names; motion i of a seed differs from motion j by a millimetre."""
    return partial(positions_at, take=int(request.text), shake=0.001 * np.random.default_rng(chance).normal())


def ignores(request: GenerationRequest, chance: tuple[int, int]) -> PosesAt:
    """Always another take than the caption's."""
    return partial(positions_at, take=1000 + int(np.random.default_rng(chance).integers(500)))


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    takes = (positions_at(np.arange(41 + 20 * (take % 3)) / 20, take) for take in range(TAKES))
    return write_takes(tmp_path_factory.mktemp("table1") / "store", takes, Fraction(20))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run, and beside it one that was trained at a single framerate."""
    trained_run(tmp_path / "runs" / "nano-fixed")
    return trained_run(tmp_path / "runs" / "nano")


@pytest.fixture
def models(run: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, ScriptedModel]:
    """`nano` listens to its captions, `nano-fixed` doesn't."""
    made = {"nano": ScriptedModel(listens), "nano-fixed": ScriptedModel(ignores)}
    install_models(monkeypatch, lambda folder: made[folder.name])
    monkeypatch.setattr(table1, "_evaluator", lambda name, config: Shapes())
    return made


def build(store: Path, folder: Path, run: Path | None, **changes: object) -> Result:
    return table1.TABLE.build(table_request(store, folder, **{"run": run, "max_motions": TAKES, **changes}))


def test_a_model_that_is_the_real_motion_scores_like_it(
    store: Path, tmp_path: Path, run: Path, models: dict[str, ScriptedModel]
) -> None:
    result = build(store, tmp_path, run)
    rows = rows_of(result)
    assert rows["real"][TOP1] > 0.99 and rows["NeRM"][TOP1] > 0.99
    assert rows["NeRM, fixed framerate"][TOP3] == pytest.approx(3 / 32, abs=0.08)
    assert rows["NeRM"][MM_DIST] < 0.01 < 0.1 < rows["NeRM, fixed framerate"][MM_DIST]
    assert rows["NeRM"][FID] < 0.2 * rows[FLOOR][FID]
    assert FID not in rows["real"]
    assert rows[ORACLE][TOP1] == 1.0
    systems = ("real", "NeRM", "NeRM, planted", "NeRM, fixed framerate", "NeRM, fixed framerate, planted")
    assert {name: each["N"] for name, each in rows.items() if "N" in each} == {FLOOR: 35, **dict.fromkeys(systems, 70)}
    assert rows["NeRM, planted"][MM_DIST] != rows["NeRM"][MM_DIST]
    # 0.001 times a normal number on every coordinate: pairs are 0.002/√π apart in each of the four that are seen.
    assert rows["NeRM"][MULTIMODALITY] == pytest.approx(2 * 0.002 / np.sqrt(np.pi), rel=0.2)
    assert rows["NeRM, fixed framerate"][MULTIMODALITY] > 10 * rows["NeRM"][MULTIMODALITY]
    (details,) = {tuple(row.cells[FID].details) for row in result.blocks[0].rows if row.name == "NeRM"}
    assert details == ("FID∞", "KID")
    other_way = rows_of(result, 1)
    assert other_way["NeRM"][title_of("r_precision_top1_motion_asks")] > 0.99
    assert not result.missing
    # Both rows of a model are of the same motions: one for each caption, and 30 of two texts.
    assert models["nano"].asked == TAKES + 60


def test_the_result_says_what_its_numbers_mean(
    store: Path, tmp_path: Path, run: Path, models: dict[str, ScriptedModel]
) -> None:
    result = build(store, tmp_path, run, published="t2m")
    assert result.definition["protocol"]["multimodality"]["pairs"] == "shared"
    assert result.definition["real_motions"]["shapes"]["motions"] == 70
    assert set(result.provenance["runs"]) == {"nano", "nano-fixed"}
    assert result.blocks[0].provenance == {"evaluator": "shapes", "fingerprint": "1", "protocol": "t2m"}
    assert rows_of(result)["real"][FID] > 0
    assert rows_of(result)["NeRM"]["N"] == 64
    assert title_of("multimodality_shared_pairs") in result.blocks[0].columns
    text = to_markdown(result)
    assert "N = 64 against 64 real motions; 30 motions of 2 texts" in text
    assert "| MDM (paper) | 0.611 ± 0.007 | 5.566 ± 0.027 | 0.544 ± 0.044 |" in text
    assert read_result(write_result(result, tmp_path)).blocks == result.blocks


@pytest.mark.parametrize("published", ["tmr", "kimodo"])
def test_retrieval_stands_in_blocks_of_its_own(
    published: str,
    store: Path,
    tmp_path: Path,
    run: Path,
    models: dict[str, ScriptedModel],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Shapes, "pair_score", "tmr_score")
    sentences = np.random.default_rng(0).normal(size=(TAKES, 40)).astype(np.float32)
    encoder = SimpleNamespace(encode=lambda texts: sentences)
    monkeypatch.setattr(table1, "load_text_encoder", lambda name: encoder)
    result = build(store, tmp_path, run, published=published)
    blocks = [block.title for block in result.blocks if block.title.startswith("Retrieval")]
    assert len(blocks) == (4 if published == "tmr" else 1) and "N = 70" in blocks[0]
    scores = {name: cells.get(title_of("tmr_score")) for name, cells in rows_of(result).items()}
    assert scores["NeRM"] > scores["NeRM, fixed framerate"]
    rows = rows_of(result, 2)
    first, tenth, middle = (title_of(name) for name in ("recall_at_1", "recall_at_10", "median_rank"))
    assert rows["real"][first] > 0.95 and rows["NeRM"][first] > 0.95 and rows[ORACLE][first] == 1.0
    if published == "tmr":
        assert rows["chance"][tenth] == pytest.approx(10 / 70) and rows["chance"][middle] == 35.5
        assert rows["NeRM, fixed framerate"][tenth] < 0.4 and rows["NeRM, fixed framerate"][middle] > 15
        assert "pools of 32, N = 32" in blocks[3]
    else:
        assert rows["NeRM"][title_of("recall_at_10_real_asked")] > 0.95
        assert "of the other texts count as a text's own" in result.blocks[2].note


def test_a_model_that_makes_less_crops_the_real_motions(
    store: Path, tmp_path: Path, run: Path, models: dict[str, ScriptedModel]
) -> None:
    def check(request: GenerationRequest, sampling: SamplingOptions = SamplingOptions()) -> None:
        raise UsageError("no texts")

    models["nano"].max_duration_seconds = 3.0  # type: ignore[misc]
    # Who can have no row cuts nobody's motions.
    models["nano-fixed"].max_duration_seconds, models["nano-fixed"].check = 1.0, check  # type: ignore[misc, attr-defined]
    result = build(store, tmp_path, run)
    assert "NeRM, fixed framerate: no texts" in result.missing
    assert result.definition["real_motions"]["shapes"]["cropped"] == 23
    assert result.definition["protocol"]["lengths"]["longest_seconds"] == 3.0


def test_what_there_is_not_is_named(store: Path, tmp_path: Path, run: Path, models: dict[str, ScriptedModel]) -> None:
    result = build(store, tmp_path / "results", run.with_name("nowhere"))
    assert set(rows_of(result)) == {ORACLE, FLOOR, "real"}
    assert any("NeRM: there is no run" in line for line in result.missing)
    assert any("--set field.clips.fixed_fps=20" in line for line in result.missing)

    def refuse(request: GenerationRequest, chance: tuple[int, int]) -> PosesAt:
        raise MotionkitError("this model was trained without texts")

    models["nano"].script = refuse
    models["nano-fixed"].script = lambda request, chance: lambda times: np.full((len(times), 22, 3), np.nan, np.float32)
    result = build(store, tmp_path / "results", run)
    assert set(rows_of(result)) == {ORACLE, FLOOR, "real"}
    assert "NeRM, shapes: this model was trained without texts" in result.missing
    assert any("'NeRM, fixed framerate': sequence 'motion 0' holds NaN" in line for line in result.missing)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"published": "mmd"}, "no text-to-motion protocol 'mmd'"),
        ({"features": ("kinematic",)}, "--evaluator kinematic"),
        ({"features": ("guo",)}, "--weights"),
        ({"features": ("guo",), "guo": GuoFiles(Path("finest.tar"))}, "--glove"),
        ({"features": ("motion-clip",)}, "--motion-clip"),
        ({"fps": (Fraction(20), Fraction(60))}, "give one --fps"),
        ({"where": "sequence_id < 'take-031'"}, r"31 captioned motions, .* a text chooses among 32"),
        ({"max_motions": 31}, "--motions 31, but a text chooses among 32"),
    ],
)
def test_requests_that_mean_nothing(
    changes: dict[str, object], message: str, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table1, "load_evaluator", lambda run, stage: Shapes())
    with pytest.raises((UsageError, NoRealMotionError), match=message):
        build(store, tmp_path / "results", tmp_path / "run", **changes)


def test_an_evaluator_that_is_missing_leaves_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table1, "load_guo", lambda files: Shapes())
    files = GuoFiles(Path("finest.tar"), glove=Path("glove"))
    config = table_request(Path("store"), Path("results"), features=("guo", "native"), guo=files)
    assert [each.name for each in table1.text_motion_evaluators(config)] == ["shapes"]
    assert config.missing.lines[0].startswith("--evaluator native: it belongs to a run")


def test_samples_are_rows(store: Path, tmp_path: Path, models: dict[str, ScriptedModel]) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    lines = ["file,caption,group"]
    for take, answer in product(range(40), range(2)):
        np.save(folder / f"{take}-{answer}.npy", positions_at(np.arange(40) / 20, take, 0.001 * answer))
        lines.append(f"{take}-{answer}.npy,{take},prompt {take}")
    (folder / "captions.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "samples.toml").write_text("fps = 20\n", encoding="utf-8")
    for published, real in (("native", 70), ("mld", 40)):
        result = build(store, tmp_path, None, samples={"mine": folder}, published=published)
        rows = {row.name: row for row in result.blocks[0].rows}
        assert rows["mine"].cells["N"].value == 40
        assert rows["mine"].cells[TOP1].value > 0.9
        assert f"N = 40 against {real} real motions; 2 motions of 40 texts" in rows["mine"].note
        assert "there are 2 sets of motions" in rows["mine"].note
        assert set(result.provenance["samples"]) == {"mine"}
