import json
from pathlib import Path

import pytest

from eval.commands import demo_steps
from eval.commands.demo import demo
from eval.commands.demo_steps import DemoFolder, DemoSize, run_demo
from motionkit.core.errors import LinkError, UsageError
from nerm.names import LOCAL

TINY = DemoSize(
    num_sequences=64,
    overrides=("codebook.schedule.steps=2", "field.schedule.steps=3", "denoiser.schedule.steps=2"),
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
    monkeypatch.setattr(demo_steps, "SMALLEST", TINY)
    demo(folder=folder.path, smallest=True, as_json=True)
    document = json.loads(capsys.readouterr().out)
    assert set(document["seconds"]) == {"corpus", "ingest", "train", "generate", "eval", "picture"}
    rows = [row["name"] for block in document["table"]["blocks"] for row in block["rows"]]
    assert LOCAL in rows and "NeRM (paper)" in rows
    assert all(Path(place).exists() for place in document["places"].values())
    assert folder.picture.read_bytes().startswith(b"\x89PNG")
    assert f"| {LOCAL} |" in (folder.results / "nerm-table2.md").read_text()
    assert len(list(folder.generated.glob("*.bvh"))) == 1


def test_another_demo_takes_the_place_of_the_first_and_nothing_else(folder: DemoFolder, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(UsageError, match="something else"):
        run_demo(DemoFolder(tmp_path), TINY, seed=0)
    assert (tmp_path / "thesis.tex").read_text() == "mine"


def test_a_demo_that_was_stopped_at_its_beginning_begins_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = DemoFolder(tmp_path / "demo")

    def stopped(*arguments: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(demo_steps, "write_demo_corpus", stopped)
        for _ in range(2):  # there is a marker, and nothing else
            with pytest.raises(KeyboardInterrupt):
                run_demo(made, TINY, seed=0)
        assert [path.name for path in made.path.iterdir()] == [demo_steps.MARKER]


def test_a_part_of_a_demo_that_is_a_link_is_not_deleted_through(folder: DemoFolder, tmp_path: Path) -> None:
    (tmp_path / "demo" / "corpus").mkdir(parents=True)
    (tmp_path / "demo" / "corpus" / "LICENSE").touch()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").touch()
    (tmp_path / "demo" / "store").symlink_to(tmp_path / "mine")
    with pytest.raises(LinkError, match="store is a symbolic link"):
        run_demo(DemoFolder(tmp_path / "demo"), TINY, seed=0)
    assert (tmp_path / "mine" / "thesis.tex").exists()
    assert (tmp_path / "demo" / "corpus" / "LICENSE").exists()
