"""PA-HiRes' tables by the command line, on the embedded corpus."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.trust.scenarios import SETTINGS
from motionkit.demo_corpus import write_demo_corpus
from motionkit.store.ingest import ingest

# Smaller still; the number of sines is what the table varies.
TINY = [each for each in SETTINGS["pahires"].split() if "sines" not in each and "tasks.l" not in each]
# All tests choose the same takes, so that the store's caches are written once.
TAKES = "fps = 30 OR fps = 60"
COMMON = ("--split", "all", "--where", TAKES)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pahires-tables")
    write_demo_corpus(folder / "corpus", every=8)
    ingest([folder / "corpus"], folder / "store", num_workers=1)
    return folder / "store"


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
