"""`motionkit ablate` and `train --for`: what a table needs is trained by one command, once, and the table shows it."""

import json
from fractions import Fraction
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

import motionkit as mk
from benchmarks.trust import scenarios
from eval.clip_fid.score import Protocol
from eval.commands.ablate import ablate
from eval.report.results import Block, Result, Row, to_markdown
from eval.tables.nerm import figures
from eval.tables.nerm.reconstruction import ABLATIONS
from eval.tables.table import EvalConfig
from motionkit.demo_corpus import write_demo_corpus
from motionkit.generate.models import installed_models
from motionkit.store.ingest import ingest
from motionkit.training.run import RunFolder
from nerm.recipes import OTHERWISE
from tests.helpers.nerm_corpus import analytic_positions
from tests.helpers.table_request import table_request
from tests.helpers.tiny import SETTINGS
from tests.helpers.tiny_peers import write_captioned_store


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a store of six short motions."""
    folder = tmp_path_factory.mktemp("ablate")
    with mk.StoreWriter.create(folder / "store") as writer:
        for index, rate in enumerate((120, 30, 60, 120, 120, 60)):
            grid = mk.TimeGrid(Fraction(rate), 3 * rate + 1)
            positions = analytic_positions(grid.seconds(), index % 4)
            split = "test" if index >= 4 else "train"
            writer.add(mk.Motion(positions, mk.SMPL22, grid, split=split, sequence_id=f"walk-{index}"))
    return folder


@pytest.fixture(autouse=True)
def smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "STEPS", (2, 1))
    monkeypatch.setattr(figures, "REPEATS", 1)


def command(project: Path, *arguments: str) -> str:
    app = typer.Typer()
    app.command()(ablate)
    places = ("--store", str(project / "store"), "--runs", str(project / "runs"))
    result = CliRunner().invoke(app, [*arguments, *places, *SETTINGS], catch_exceptions=False)
    assert result.exit_code == 0
    return result.stdout


def summaries(project: Path) -> dict[str, int]:
    return {
        str(path.parent.relative_to(project / "runs")): path.stat().st_mtime_ns
        for path in (project / "runs").rglob("summary.json")
    }


def test_variants_of_two_tables_are_trained_once_and_kept(project: Path) -> None:
    both = ("6", "7", "--only", "global,global-transformer")
    lines = command(project, *both).splitlines()
    assert [line.partition(":")[0] for line in lines] == ["field", "denoiser"] * 2
    trained = summaries(project)
    assert {"nano/codebook", "nano-global/codebook", "nano-global/field", "nano-global/denoiser"} <= set(trained)
    codes = {path.read_bytes() for path in (project / "runs").glob("*/codebook/model.safetensors")}
    assert len(codes) == 1
    again = json.loads(command(project, *both, "--json"))
    assert [each["variant"] for each in again["trained"]] == ["global", "global-transformer"]
    assert summaries(project) == trained


def test_a_seed_has_its_own_run_and_overwrite_leaves_what_it_does_not_name(project: Path) -> None:
    arguments = ("8", "--only", "global", "--run", "again")
    command(project, *arguments)
    before = summaries(project)
    assert "again-global/denoiser" not in before
    other = json.loads(command(project, *arguments, "--seed", "2", "--json"))
    (trained,) = other["trained"]
    assert (trained["run"], [each["stage"] for each in trained["stages"]]) == ("again-global-seed2", ["field"])
    command(project, *arguments, "--overwrite")
    after = summaries(project)
    assert after["again-global/field"] > before["again-global/field"]
    assert after["again-global/codebook"] == before["again-global/codebook"]


def test_a_list_trains_nothing(tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(ablate)
    result = CliRunner().invoke(app, ["--list", "--runs", str(tmp_path)], catch_exceptions=False)
    assert "global-fourier" in result.stdout
    assert "field.encoder.kind=fourier" in result.stdout
    assert "not trained" in result.stdout
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "name a table: 5"),
        (("4",), "there is no ablation '4'"),
        (("5", "--only", "global,nobody"), "--only nobody: no such variant"),
        (("5", "--set", "field.nothing=1"), "no setting is called 'field.nothing'"),
    ],
)
def test_faults_are_reported_before_anything_is_trained(arguments, message, tmp_path):
    app = typer.Typer()
    app.command()(ablate)
    with pytest.raises((mk.UsageError, mk.MotionkitError), match=message):
        CliRunner().invoke(app, [*arguments, "--runs", str(tmp_path)], catch_exceptions=False)
    assert not list(tmp_path.iterdir())


def request(project: Path, run: str, results: str, *rates: int) -> EvalConfig:
    protocol = Protocol(16, 16, num_clips=80, replications=2, detailed_replications=0)
    fps = tuple(Fraction(rate) for rate in rates)
    return table_request(project / "store", project / results, run=project / "runs" / run, fps=fps, protocol=protocol)


def table(project: Path, number: str, run: str, results: str) -> Result:
    return ABLATIONS[number].build(request(project, run, results, 20, 60))


def rows(block: Block) -> dict[str, Row]:
    return {row.name: row for row in block.rows}


def test_a_table_shows_what_is_trained_and_says_how_to_train_the_rest(project: Path) -> None:
    command(project, "7", "--run", "table", "--only", "global")
    result = table(project, "7", "table", "results-7")
    training, mre, held_out, synthesis, *printed = result.blocks
    assert result.task == "nerm-table7"
    for block in (training, mre, held_out):
        assert block.columns == ("20 fps", "60 fps")
        assert set(rows(block)["global: MLP"].cells) == {"20 fps", "60 fps"}
        assert rows(block)["global: MLP"].cells["20 fps"].value > 0
    absent = rows(training)["global: transformer"]
    assert absent.cells == {}
    assert absent.note == "not trained: motionkit ablate 7 --run table --only global-transformer"
    assert list(rows(synthesis)) == [
        "real, independent draws (P1)",
        "real, disjoint halves of the takes (P2)",
        "global: transformer",
        "global: MLP",
    ]
    scores = {name: row.cells["60 fps"].value for name, row in rows(synthesis).items() if row.cells}
    assert scores["global: MLP"] > scores["real, independent draws (P1)"]
    assert [set(rows(block)) for block in printed] == [{"transformer decoder (paper)", "mlp decoder (paper)"}] * 2
    assert rows(printed[0])["mlp decoder (paper)"].cells["120 fps"].value == 0.038
    assert rows(printed[1])["transformer decoder (paper)"].cells["20 fps"].value == 0.381
    assert "| global: transformer | – | – |" in to_markdown(result)
    assert result.notes == ()
    drawn = figures.FIGURE_5.build(request(project, "table-global", "results-7", 60))
    scores, spread = (rows(block) for block in drawn.blocks)
    assert scores["real, independent draws (P1)"].cells == rows(synthesis)["real, independent draws (P1)"].cells
    as_it_is, planted = (scores[f"{OTHERWISE}, unconditional{form}"].cells["60 fps"] for form in ("", ", planted"))
    assert as_it_is.value > 1.0 and planted.value != as_it_is.value
    assert spread["real"].cells["60 fps"].value > 0.0
    cost, detail = figures.FIGURE_8.build(request(project, "table-global", "results-7", 60)).blocks
    assert [row.name for row in cost.rows if row.origin == "ours"] == [
        f"{OTHERWISE}, 2 diffusion steps (its own)",
        f"{OTHERWISE}, 1 diffusion steps",
    ]
    assert all(set(row.cells) == set(cost.columns) for row in cost.rows if row.origin == "ours")
    assert detail.title == "Detail profile, 60 fps"
    assert all(set(row.cells[figures.CPU].details) == {"at 20 fps", "at 120 fps"} for row in cost.rows[2:])
    with pytest.raises(mk.UsageError, match="one framerate"):
        figures.FIGURE_8.build(request(project, "table-global", "results-7", 20, 60))


def test_tables_share_runs(project: Path) -> None:
    command(project, "8", "--run", "kept", "--only", "global")
    first, other = (table(project, number, "kept", "results-8") for number in ("8", "9"))
    assert other.blocks[0].rows[1].cells == first.blocks[0].rows[1].cells
    # One run, two rows of the paper.
    assert rows(first.blocks[0])["global: d = 256"].cells == rows(first.blocks[0])["global: λ_KL = 1e-4"].cells
    assert any(line.startswith("clip-FID: no denoiser is trained") for line in other.missing)
    assert rows(first.blocks[-1])["latent_dim = 512 (paper)"].cells["20 fps"].value == 0.0407


# Of every system's settings those that it has.
EVERY_SYSTEM = (
    *("conditions.kind=action", "network.transformer.width=32", "network.transformer.inner=32"),
    *("motions.max_frames=130", "motions.min_seconds=1", "motions.mirrored=false"),
    *("network.diffusion.num_steps=4", "network.diffusion.sampling_steps=4"),
    *("schedule.steps=3", "schedule.batch_size=4", *scenarios.SETTINGS["codebook"].split()),
    "field.windows.max_duration_seconds=10",
)


@pytest.fixture(scope="module")
def captioned_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_captioned_store(tmp_path_factory.mktemp("systems") / "store", held_out=4)


def test_a_table_has_a_row_for_every_installed_system(motionkit, captioned_store, tmp_path):
    places = ("--store", captioned_store, "--runs", tmp_path / "runs", "--run", "all")
    options = ("--fps", "20", "--clips", "64", "--replications", "1", "--evaluator", "kinematic")
    table = ("eval", "--table", "2", *places, *options, "--results", tmp_path / "results")
    settings = [word for setting in EVERY_SYSTEM for word in ("--set", setting)]
    command = ("train", "--for", "table:2", *places, "--device", "cpu", *settings)

    before = motionkit(*table)
    assert before.code == 0
    assert "motionkit train --for table:2 --run all trains the missing ones" in before.stderr

    done = motionkit(*command)
    assert done.code == 0, done.stderr
    assert "next: motionkit eval --table 2" in done.stdout
    models = installed_models().values()
    stages = [name for model in models for name in model.stages]
    run = RunFolder(tmp_path / "runs" / "all")
    assert all(run.stage(name).is_complete for name in stages)
    again = motionkit(*command)
    assert again.code == 0 and again.stderr.count("complete already, kept") >= len(stages)

    after = motionkit(*table)
    assert after.code == 0 and "trains the missing ones" not in after.stderr
    result = json.loads((tmp_path / "results" / "nerm-table2.json").read_text())
    rows = {row["name"] for row in result["blocks"][0]["rows"]}
    for model in models:
        title = model.load(run.path).name
        assert {title, f"{title}, planted"} <= rows, result["missing"]


# Smaller still; the number of sines is what the table varies.
TINY = [each for each in scenarios.SETTINGS["pahires"].split() if "sines" not in each and "tasks.l" not in each]
# All tests choose the same takes, so that the demo_store's caches are written once.
TAKES = "fps = 30 OR fps = 60"
COMMON = ("--split", "all", "--where", TAKES)


@pytest.fixture(scope="module")
def demo_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pahires-tables")
    write_demo_corpus(folder / "corpus", every=8)
    ingest([folder / "corpus"], folder / "store", num_workers=1)
    return folder / "store"


def test_variants_are_trained_and_shown_by_two_commands(motionkit, demo_store, tmp_path):
    sets = [part for setting in TINY for part in ("--set", setting)]
    places = ("--paper", "pahires", "--store", demo_store, "--runs", tmp_path / "runs", "--run", "tiny")
    trained = motionkit("ablate", "4", *places, "--only", "full,sines-4-shared", "--where", TAKES, *sets)
    assert trained.code == 0, trained.stderr
    assert [line.partition(":")[0] for line in trained.stdout.splitlines()] == ["pahires", "pahires"]
    again = motionkit("ablate", "4", *places, "--only", "full", "--seed", "1", "--where", TAKES, *sets)
    assert again.code == 0, again.stderr
    eval_places = (*places, *COMMON, "--json", "--results")
    result = json.loads(motionkit("eval", "--table", "4", *eval_places, tmp_path / "table").stdout)
    psnr = {row["name"]: row["cells"] for row in result["blocks"][0]["rows"]}
    assert set(psnr["own parameters in every layer"]) == {"ζ = 16"}
    assert set(psnr["one activation shared by all layers"]) == {"ζ = 4"}
    of_full = psnr["own parameters in every layer"]["ζ = 16"]
    lowest, highest = of_full["details"].values()
    assert lowest < highest and of_full["value"] == pytest.approx((lowest + highest) / 2)
    assert set(psnr["SLERP, not trained"]) == {f"ζ = {count}" for count in (1, 2, 4, 8, 16, 32)}
    assert "after 8 steps, form exact" in result["caption"]
    assert any("motionkit ablate 4 --paper pahires --run tiny --only sines-1)" in line for line in result["missing"])
    printed = {row["name"]: row["cells"] for row in result["blocks"][-2]["rows"]}
    assert printed["own parameters (paper)"]["ζ = 16"]["value"] == 30.53
    figure = json.loads(motionkit("eval", "--figure", "6", *eval_places, tmp_path / "figure").stdout)
    ours = next(row for row in figure["blocks"][0]["rows"] if row["name"] == "PA-HiRes")
    assert set(ours["cells"]) == {"S = 3"}
    assert ours["cells"]["S = 3"] == psnr["own parameters in every layer"]["ζ = 16"]
    assert motionkit("report", "--results", tmp_path / "figure", "--format", "png").code == 0
    assert (tmp_path / "figure" / "pahires-figure6.png").stat().st_size > 10_000
