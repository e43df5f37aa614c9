"""`motionkit train --for`: which stages, in which order, for how long; what goes on and what is refused."""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import torch
import typer
from typer.testing import CliRunner

from eval.tables import table as table_module
from eval.tables.table import Content, EvalConfig, Table, table_that_shows
from motionkit.cli import train as train_module
from motionkit.cli.console import parse_duration
from motionkit.core.errors import UsageError
from motionkit.store import Store, StoreWriter
from motionkit.store.commit import read_manifest
from motionkit.training import loop as loop_module
from motionkit.training.loop import load_tensors, run_training, save_tensors
from motionkit.training.run import Began, Loader, Stage, StageContext, StageFolder
from tests.helpers.plugin_lists import install_only

SECONDS_A_STEP = 2.0
PREPARING_SECONDS = 30.0


@dataclass(frozen=True)
class Config:
    steps: int = 6
    codes: bool = True


class Climb:
    """A weight that grows by its schedule's rate; every step takes `SECONDS_A_STEP` of the clock below."""

    def __init__(self, steps: int, clock: "Clock") -> None:
        self.steps, self.clock, self.weight = steps, clock, torch.zeros(1)

    def step(self, step: int, generator: torch.Generator) -> Mapping[str, torch.Tensor]:
        self.clock.now += SECONDS_A_STEP
        self.weight += torch.rand(1, generator=generator) * (1 - step / self.steps)
        return {"loss": self.weight[0]}

    def state_tensors(self) -> dict[str, torch.Tensor]:
        return {"weight": self.weight}

    def load_state_tensors(self, tensors: Mapping[str, torch.Tensor]) -> None:
        self.weight = tensors["weight"].clone()


class Clock:
    """Processor time that passes in steps alone."""

    now = 0.0


def loader(*stages: str) -> Loader[object]:
    return Loader(stages[-1].upper(), stages, load=lambda run: object())


SYSTEMS = {"ours": loader("field", "denoiser"), "theirs": loader("vae", "latents"), "other": loader("gan")}


def build(config: EvalConfig, store: Store) -> Content:
    raise NotImplementedError


TABLE = Table("nerm", "2", "a table", "v/1", build, shown=lambda: SYSTEMS, reads=("judge",))


@dataclass
class World:
    """Stages that write down in which order they were trained."""

    clock: Clock = field(default_factory=Clock)
    trained: list[str] = field(default_factory=list)

    def stage(self, name: str, builds_on: Callable[[Config], tuple[str, ...]], share: float = 1.0) -> Stage[Config]:
        def train(context: StageContext, config: Config) -> None:
            self.trained.append(name)
            fingerprint = read_manifest(context.store).fingerprint
            folder = context.begin(name, config, store_fingerprint=fingerprint, builds_on=builds_on(config))
            training = Climb(config.steps, self.clock)
            run_training(context, training, folder)
            save_tensors(folder.model_path, training.state_tensors(), {})
            folder.finish({"steps": training.steps})

        recipes = {"nano": Config} if name != "gan" else {"nano": Config, "big": Config}
        return Stage(name, f"trains {name}", recipes, train, builds_on=builds_on, share=share)

    def clock_since(self, _device: torch.device, _began: Began) -> Callable[[], float]:
        """Processor time since a stage began, which prepares itself for `PREPARING_SECONDS`."""
        start = self.clock.now - PREPARING_SECONDS
        return lambda: self.clock.now - start

    def stages(self) -> dict[str, Stage[Config]]:
        def nothing(config: Config) -> tuple[str, ...]:
            return ()

        made = (
            self.stage("codes", nothing),
            self.stage("field", lambda config: ("codes",) if config.codes else (), 3.0),
            self.stage("denoiser", lambda config: ("field",)),
            self.stage("unwanted", nothing),
            self.stage("vae", nothing),
            self.stage("latents", lambda config: ("vae",)),
            self.stage("gan", nothing),
            self.stage("judge", nothing),
        )
        return {stage.name: stage for stage in made}


# Of a stage that is complete nothing before it is asked for: "codes" stays out.
KEPT = ["field", "denoiser", "vae", "latents", "gan", "judge"]
ORDER = ["codes", "field", "denoiser", "vae", "latents", "gan", "judge"]


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[World]:
    world = World()
    install_only(monkeypatch, STAGES=world.stages())
    monkeypatch.setattr(table_module, "table_that_shows", lambda paper, target: TABLE)
    monkeypatch.setattr(loop_module, "seconds_spent", world.clock_since)
    with StoreWriter.create(tmp_path / "store"):
        pass
    monkeypatch.chdir(tmp_path)
    yield world


def run(*arguments: str) -> dict[str, dict[str, float]]:
    app = typer.Typer()
    app.command()(train_module.train)
    done = CliRunner().invoke(app, ["--for", "table:2", *arguments, "--json"], catch_exceptions=False)
    assert done.exit_code == 0
    return {stage["stage"]: stage for stage in json.loads(done.stdout)["stages"]}


def test_what_a_table_lacks_is_trained_in_order(world: World) -> None:
    assert list(run()) == world.trained == ORDER
    world.trained.clear()
    assert list(run()) == KEPT and not world.trained
    run("--overwrite")
    assert world.trained == ORDER


def test_a_budget_is_spent_by_one_thread_and_measured_once(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    threads: list[int] = []
    step = Climb.step
    monkeypatch.setattr(Climb, "step", lambda *args: (threads.append(torch.get_num_threads()), step(*args))[1])
    run("--budget", "40m")
    assert set(threads) == {1}
    folder = StageFolder(Path("runs/nano/gan"))
    steps = folder.read_summary()["steps"]
    folder.summary_path.unlink()
    monkeypatch.setattr("tests.eval.tables.test_train_for.SECONDS_A_STEP", 7.0)
    assert run("--budget", "40m")["gan"]["steps"] == steps


def test_what_is_complete_is_kept_and_the_rest_goes_on(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = run("--run", "whole")
    stop = Climb.step

    def stopped(self: Climb, step: int, generator: torch.Generator) -> Mapping[str, torch.Tensor]:
        if world.trained[-1] == "vae" and step == 3:
            raise OSError("the disk is full")
        return stop(self, step, generator)

    monkeypatch.setattr(Climb, "step", stopped)
    with pytest.raises(OSError, match="disk is full"):
        run("--run", "parts")
    monkeypatch.setattr(Climb, "step", stop)
    world.trained.clear()
    assert list(run("--run", "parts")) == KEPT
    assert world.trained == ORDER[ORDER.index("vae") :]
    for name in whole:
        first, second = (Path("runs") / each / name / "model.safetensors" for each in ("whole", "parts"))
        assert first.read_bytes() == second.read_bytes()


def test_every_system_has_the_same_budget(world: World) -> None:
    found = run("--budget", "40m")
    seconds = {name: summary.get("budget_seconds") for name, summary in found.items()}
    # 1 : 3 : 1 of one system, 1 : 1 of another, and an evaluator has none.
    assert seconds == {
        **{"codes": 480, "field": 1440, "denoiser": 480, "vae": 1200, "latents": 1200, "gan": 2400},
        "judge": None,
    }
    for name, summary in found.items():
        if (budget := seconds[name]) is None:
            assert summary["steps"] == 6
            continue
        assert summary["measured_seconds_a_step"] == SECONDS_A_STEP
        spent = summary["preparing_seconds"] + summary["measuring_seconds"] + summary["steps"] * SECONDS_A_STEP
        assert summary["preparing_seconds"] == PREPARING_SECONDS and spent == pytest.approx(budget, abs=2)
    # What was measured leaves no trace: the same number of steps by its setting is the same training.
    run("--run", "told", "--set", f"steps={int(found['gan']['steps'])}")
    told, measured = (load_tensors(Path("runs") / each / "gan" / "model.safetensors")[0] for each in ("told", "nano"))
    assert torch.equal(told["weight"], measured["weight"])


def test_a_budget_of_stages_of_no_system_is_refused(world: World) -> None:
    app = typer.Typer()
    app.command()(train_module.train)
    with pytest.raises(UsageError, match="--budget is for the systems of a table"):
        CliRunner().invoke(app, ["--budget", "20m"], catch_exceptions=False)
    CliRunner().invoke(app, ["--stage", "gan", "--budget", "20m"], catch_exceptions=False)
    assert json.loads(Path("runs/nano/gan/summary.json").read_text())["budget_seconds"] == 1200


def test_tables_are_known_by_what_they_show() -> None:
    table = table_that_shows(None, "table:2")
    assert table is table_that_shows("nerm", "table:2") is not table_that_shows("pahires", "table:2")
    assert {"nerm", "mdm", "mld"} <= set(table.shown()) and table.reads == ()
    assert set(table_that_shows("pahires", "table:3").shown()) >= {"pahires", "ts-former"}
    assert table_that_shows("nerm", "figure:8").reads == ()
    for paper, wanted, told in (
        ("nerm", "2", "--for 2: table:NUMBER or figure:NUMBER of the installed tables: nerm-1"),
        ("nerm", "table:99", "of the installed tables: nerm-1"),
        ("nerm", "table:5", "no rows of systems (of ablations: motionkit ablate)"),
    ):
        with pytest.raises(UsageError) as found:
            table_that_shows(paper, wanted)
        assert told in str(found.value)


def test_durations_have_units() -> None:
    assert [parse_duration(text, "--budget") for text in ("90s", "20m", "1.5h")] == [90.0, 1200.0, 5400.0]
    for text in ("20", "0m", "m", "-3m", "20 m", "1h30m"):
        with pytest.raises(UsageError):
            parse_duration(text, "--budget")
