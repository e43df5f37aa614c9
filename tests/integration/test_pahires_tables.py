"""PA-HiRes' tables by the command line, on the embedded corpus."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from motionkit.core.files import read_json
from motionkit.demo_corpus import write_demo_corpus
from motionkit.store.ingest import ingest

TINY = (
    *(
        "training.schedule.steps=2",
        "training.schedule.batch_size=8",
        "training.tasks.gap=0",
        "network.hidden=16",
        "network.code=16",
    ),
    *("network.attention_tokens=4", "network.embedding=8", "network.decoder_layers=1"),
)
# All tests choose the same takes, so that the store's caches are written once.
TAKES = "fps = 30 OR fps = 60"
COMMON = ("--split", "all", "--where", TAKES)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pahires-tables")
    write_demo_corpus(folder / "corpus", every=8)
    ingest([folder / "corpus"], folder / "store", num_workers=1)
    return folder / "store"


def test_tables_are_written_as_json_and_markdown(motionkit: Callable[..., object], store: Path, tmp_path: Path) -> None:
    """All that can be built, and what the others lack."""
    everything = ("--paper", "pahires", "--table", "all", "--store", store, "--results", tmp_path, "--json")
    outcome = motionkit("eval", *everything, "--fps", "30", "--runs", tmp_path, *COMMON)
    assert outcome.code == 2
    results = {result["task"]: result for result in json.loads(outcome.stdout)}
    assert list(results) == [f"pahires-{name}" for name in ("table1", "table2", "table3", "extrapolation")]
    assert "4 of 7 were built. 4: " in outcome.stderr and "; figure5: " in outcome.stderr
    result = results["pahires-table1"]
    assert {"format": "motionkit-result/1", **result} == read_json(tmp_path / "pahires-table1.json", "")
    psnr = next(block for block in result["blocks"] if block["title"].endswith("30 fps: PSNR (dB)"))
    values = {row["name"]: row["cells"]["×4"]["value"] for row in psnr["rows"]}
    assert values["hold"] < values["SLERP"]
    assert "| SLERP |" in (tmp_path / "pahires-table1.md").read_text()
    assert any("PA-HiRes: not trained (motionkit train --stage pahires" in line for line in result["missing"])


def test_variants_are_trained_and_shown_by_two_commands(
    motionkit: Callable[..., object], store: Path, tmp_path: Path
) -> None:
    sets = [part for setting in TINY for part in ("--set", setting)]
    places = ("--paper", "pahires", "--store", store, "--runs", tmp_path / "runs", "--run", "tiny")
    trained = motionkit("ablate", "4", *places, "--only", "full,sines-4-shared", "--where", TAKES, *sets)
    assert trained.code == 0, trained.stderr
    assert [line.partition(":")[0] for line in trained.stdout.splitlines()] == ["tiny-full", "tiny-sines-4-shared"]
    again = motionkit("ablate", "4", *places, "--only", "full", "--seed", "1", "--where", TAKES, *sets)
    assert again.stdout.startswith("tiny-full-seed1: "), again.stderr
    eval_places = (*places, *COMMON, "--json", "--results")
    result = json.loads(motionkit("eval", "--table", "4", *eval_places, tmp_path / "table").stdout)
    psnr = {row["name"]: row["cells"] for row in result["blocks"][0]["rows"]}
    assert set(psnr["own parameters in every layer"]) == {"ζ = 16"}
    assert set(psnr["one activation shared by all layers"]) == {"ζ = 4"}
    starts = next(block for block in result["blocks"] if block["title"] == "From other starts: PSNR (dB)")
    (of_full,) = starts["rows"]
    assert of_full["name"].endswith("own parameters in every layer; ζ = 16")
    both = [of_full["cells"][f"seed {seed}"]["value"] for seed in (0, 1)]
    assert both[0] != both[1]
    assert psnr["own parameters in every layer"]["ζ = 16"]["value"] == pytest.approx(sum(both) / 2)
    assert set(psnr["SLERP, not trained"]) == {f"ζ = {count}" for count in (1, 2, 4, 8, 16, 32)}
    assert "steps 2, batch 8, form exact" in result["caption"]
    assert any("motionkit ablate 4 --paper pahires --run tiny --only sines-1)" in line for line in result["missing"])
    printed = {row["name"]: row["cells"] for row in result["blocks"][-2]["rows"]}
    assert printed["own parameters (paper)"]["ζ = 16"]["value"] == 30.53
    figure = json.loads(motionkit("eval", "--figure", "6", *eval_places, tmp_path / "figure").stdout)
    ours = next(row for row in figure["blocks"][0]["rows"] if row["name"] == "PA-HiRes")
    assert set(ours["cells"]) == {"S = 3"}
    assert ours["cells"]["S = 3"] == psnr["own parameters in every layer"]["ζ = 16"]
    assert motionkit("report", "--results", tmp_path / "figure", "--format", "png").code == 0
    assert (tmp_path / "figure" / "pahires-figure6.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--table", "1", "--encoder", "liif"), "--encoder liif: give NAME=RUN"),
        (("--table", "1", "--encoder", "liif=nobody"), "there is no run"),
        (("--table", "2", "--fps", "29"), "motionkit: no chosen sequence of"),
        (("--table", "3", "--where", "fps = 50"), "CMU, 30 fps: no"),
        (("--table", "2", "--where", "speed > 1"), "the condition"),
        (("--table", "4"), "motionkit ablate 4 --paper pahires --run nano trains"),
        (("--figure", "6"), "motionkit ablate figure6 --paper pahires --run nano trains"),
        (("--table", "extrapolation", "--split", "nowhere"), "no sequence"),
    ],
)
def test_what_cannot_be_had_is_reported_in_a_line(
    motionkit: Callable[..., object], store: Path, tmp_path: Path, arguments: tuple[str, ...], told: str
) -> None:
    outcome = motionkit("eval", "--paper", "pahires", "--store", store, "--results", tmp_path, *arguments)
    assert outcome.code == 1 or outcome.code == 2
    assert told in " ".join(outcome.stderr.split())
    assert "Traceback" not in outcome.stderr
