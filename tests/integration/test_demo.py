import json
from pathlib import Path

import pytest

from eval.commands import demo_steps as demo_module
from eval.commands.demo import demo
from eval.commands.demo_steps import DemoFolder, DemoSize, run_demo
from motionkit.errors import UsageError

TINY = DemoSize(
    num_sequences=64,
    overrides=("codebook.steps=2", "field.steps=3", "denoiser.steps=2"),
    num_clips=64,
    replications=1,
    max_motions=4,
    num_pictured=1,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> DemoFolder:
    return DemoFolder(tmp_path_factory.mktemp("demo") / "here")


def test_the_whole_chain_leaves_everything_behind(
    folder: DemoFolder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(demo_module, "SMALLEST", TINY)
    demo(folder=folder.path, smallest=True, as_json=True)
    document = json.loads(capsys.readouterr().out)
    assert set(document["seconds"]) == {"corpus", "ingest", "train", "generate", "eval", "picture"}
    rows = [row["name"] for block in document["table"]["blocks"] for row in block["rows"]]
    assert "NeRM" in rows and "NeRM (paper)" in rows
    assert all(Path(place).exists() for place in document["places"].values())
    assert folder.picture.read_bytes().startswith(b"\x89PNG")
    assert "| NeRM |" in (folder.results / "nerm-table2.md").read_text()
    assert len(list(folder.generated.glob("*.bvh"))) == 1


def test_another_demo_takes_the_place_of_the_first_and_nothing_else(folder: DemoFolder, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(UsageError, match="something else"):
        run_demo(DemoFolder(tmp_path), TINY, seed=0)
    assert (tmp_path / "thesis.tex").read_text() == "mine"
