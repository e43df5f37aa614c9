"""PA-HiRes' tables by the command line, on the embedded corpus."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from motionkit.demo_corpus import write_demo_corpus
from motionkit.store.ingest import ingest

COMMON = ("--split", "all", "--where", "fps = 30 OR fps = 60")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pahires-tables")
    corpus = write_demo_corpus(folder / "corpus", num_sequences=24)
    ingest([corpus.folder / "bvh"], folder / "store", num_workers=1)
    return folder / "store"


def test_a_table_is_written_as_json_and_markdown(motionkit: Callable[..., object], store: Path, tmp_path: Path) -> None:
    outcome = motionkit(
        "eval", "--paper", "pahires", "--table", "1", "--store", store, "--results", tmp_path, "--json", *COMMON
    )
    assert outcome.code == 0
    result = json.loads(outcome.stdout)
    assert result == {**json.loads((tmp_path / "pahires-table1.json").read_text()), **result}
    assert result["task"] == "pahires-table1"
    psnr = next(block for block in result["blocks"] if block["title"].endswith("30 fps: PSNR (dB)"))
    values = {row["name"]: row["cells"]["×4"]["value"] for row in psnr["rows"]}
    assert values["hold"] < values["SLERP"]
    assert "| SLERP |" in (tmp_path / "pahires-table1.md").read_text()
    assert any("PA-HiRes: not trained (motionkit train --stage pahires" in line for line in result["missing"])


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--table", "1", "--encoder", "liif"), "--encoder liif: give NAME=RUN"),
        (("--table", "1", "--encoder", "liif=nobody"), "there is no run"),
        (("--table", "2", "--fps", "29"), "no chosen take"),
        (("--table", "3", "--where", "fps = 50"), "no chosen take"),
        (("--table", "2", "--where", "speed > 1"), "the condition"),
        (("--table", "4"), "motionkit ablate 4 --paper pahires --run nano trains"),
        (("--figure", "6"), "motionkit ablate figure6 --paper pahires --run nano trains"),
        (("--table", "extrapolation", "--split", "nowhere"), "no sequence"),
    ],
)
def test_what_cannot_be_had_is_told_in_a_line(
    motionkit: Callable[..., object], store: Path, tmp_path: Path, arguments: tuple[str, ...], told: str
) -> None:
    outcome = motionkit("eval", "--paper", "pahires", "--store", store, "--results", tmp_path, *arguments)
    assert outcome.code == 1 or outcome.code == 2
    assert told in " ".join(outcome.stderr.split())
    assert "Traceback" not in outcome.stderr
