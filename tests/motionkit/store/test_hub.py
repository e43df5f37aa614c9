"""Stores and runs pushed to and pulled from a Hub of this machine, by `huggingface_hub` itself."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch
import typer
import yaml
from typer.testing import CliRunner, Result

import motionkit as mk
from motionkit.cli.export import export
from motionkit.cli.hub import pull, push
from motionkit.core.errors import DamagedFileError, StoreError
from motionkit.store.commit import read_manifest
from motionkit.store.hub import HubError
from motionkit.store.life import compact, remove
from motionkit.training.loop import save_tensors
from motionkit.training.run import RunFolder
from tests.helpers.hub import Hub, local_hub
from tests.helpers.pages import run_page
from tests.helpers.repository import REPOSITORY

pytest.importorskip("huggingface_hub", reason="needs the extra motionkit[hub]")
PAGE = REPOSITORY / "docs" / "howto" / "hub.md"
WALKS = "hf://datasets/me/walks"


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    with local_hub() as (found, address):
        files = f"{address}/{{repo_id}}/resolve/{{revision}}/{{filename}}"
        places = {"HF_HUB_CACHE": str(tmp_path / "cache"), "HF_TOKEN_PATH": str(tmp_path / "no-token")}
        constants = {"ENDPOINT": address, "HUGGINGFACE_CO_URL_TEMPLATE": files, "HF_HUB_OFFLINE": False, **places}
        for name, value in constants.items():
            monkeypatch.setattr(f"huggingface_hub.constants.{name}", value)
        monkeypatch.delenv("HF_TOKEN", raising=False)
        monkeypatch.chdir(tmp_path)
        yield found


@pytest.fixture
def store(tmp_path: Path) -> mk.Store:
    """Three short motions of 30 and 60 fps in `./store`."""
    with mk.StoreWriter.create(tmp_path / "store") as writer:
        for number in range(3):
            positions = np.random.default_rng(number).normal(size=(40, 22, 3)).astype(np.float32)
            motion = mk.Motion.from_joints(positions, fps=Fraction(30 * (1 + number % 2)))
            writer.add(replace(motion, sequence_id=f"lab/{number}"))
    return mk.Store.open(tmp_path / "store")


@pytest.fixture
def run_folder(tmp_path: Path) -> RunFolder:
    """The run `walker`, one of whose two stages is complete."""
    run = RunFolder(tmp_path / "runs" / "walker")
    for name in ("field", "denoiser"):
        stage = run.stage(name)
        stage.path.mkdir(parents=True)
        stage.config_path.write_text('{"recipe": "nano", "seed": 0, "store_fingerprint": "ab"}')
        stage.append_metrics({"step": 1.0, "loss": 0.5})
        save_tensors(stage.model_path, {"weight": torch.ones(3)}, {})
        (stage.path / "checkpoint.safetensors").write_bytes(b"large")
    run.stage("field").finish({"loss": 0.5})
    return run


def run(command: object, *arguments: object) -> Result:
    app = typer.Typer()
    app.command()(command)  # type: ignore[type-var]
    return CliRunner().invoke(app, list(map(str, arguments)))


def done(command: object, *arguments: object) -> str:
    result = run(command, *arguments)
    assert result.exit_code == 0, result.output + repr(result.exception)
    return result.output


def test_a_store_goes_and_comes_back(hub: Hub, store: mk.Store) -> None:
    assert "would push 4 files" in done(push, WALKS, "--dry-run")
    assert not hub.commits
    (store.path / "notes.txt").write_text("mine")
    done(push, WALKS)
    assert hub.private == {"datasets/me/walks": True}
    files = hub.files("datasets/me/walks")
    assert set(files) == {"README.md", "manifest.json", *store.manifest.files}
    card = files["README.md"].decode()
    assert yaml.safe_load(card.split("---\n")[1])["license"] == "other"
    done(pull, WALKS, "--store", "copy")
    assert mk.Store.open("copy").fingerprint == store.fingerprint
    there = mk.Store.open(WALKS)
    np.testing.assert_array_equal(there["lab/2"].joint_positions, store["lab/2"].joint_positions)

    remove(store.path, ["lab/0"])
    compact(store.path)
    done(push, WALKS)
    pushed = [name for name in hub.files("datasets/me/walks") if name.endswith(".parquet")]
    assert set(pushed) == set(read_manifest(store.path).files)
    assert list(mk.Store.open(WALKS)) == ["lab/1", "lab/2"]
    assert "copy" in str(run(pull, WALKS, "--store", "copy").exception)


def test_a_stream_downloads_parts_as_it_reads_them(hub: Hub, store: mk.Store) -> None:
    with mk.StoreWriter.append(store.path) as writer:
        writer.add(replace(store["lab/0"], sequence_id="lab/more"))
    done(push, WALKS)
    stream = mk.ClipStream(WALKS, seconds=0.5, seed=0, buffer=1)
    assert not [path for path in hub.served if "part-" in path]
    downloaded = [sum("part-" in path for path in hub.served) for _ in stream]
    assert (downloaded[0], downloaded[-1], len(downloaded)) == (1, 2, stream.num_windows)


def test_a_store_that_is_damaged_or_not_whole_is_not_pulled(hub: Hub, store: mk.Store) -> None:
    done(push, WALKS)
    whole = hub.files("datasets/me/walks")
    part = next(name for name in store.manifest.files if name.startswith("motions/"))
    hub.add("datasets/me/walks", {**whole, part: whole[part][:-200] + bytes(100) + whole[part][-100:]})
    failed = run(pull, WALKS, "--store", "copy").exception
    assert isinstance(failed, StoreError)
    hub.add("datasets/me/walks", {name: content for name, content in whole.items() if name != part})
    with pytest.raises(HubError, match="walks"):
        mk.Store.open(WALKS).read(0)
    assert isinstance(run(pull, WALKS, "--store", "copy").exception, StoreError)
    assert [path.name for path in Path().iterdir() if path.name.startswith("copy")] == []
    hub.add("datasets/me/walks", {"loader.py": b"raise SystemExit"})
    with pytest.raises(HubError, match=WALKS):
        mk.Store.open(WALKS)
    assert "loader.py" not in hub.served


def test_what_goes_to_the_wrong_place_is_reported(hub: Hub, store: mk.Store) -> None:
    done(push, WALKS, "--public")
    assert hub.private == {"datasets/me/walks": False}
    for command, arguments, message in (
        (push, (WALKS,), "--public"),
        (push, (f"{WALKS}/part",), f"{WALKS}/part"),
        (push, ("hf://me/walker",), "--run"),
        (push, ("hf://me/walker", "--run", "a", "--store", "store"), "hf://datasets"),
        (pull, ("hf://datasets/me/other", "--store", "new"), "hf://datasets/me/other"),
        (pull, ("hf://walks",), "hf://datasets/OWNER/NAME"),
        (pull, (WALKS, "--run", "a"), WALKS),
    ):
        assert message in str(run(command, *arguments).exception)


def test_complete_stages_of_a_run_go_and_come_back(hub: Hub, run_folder: RunFolder) -> None:
    done(push, "hf://me/walker", "--run", "walker")
    files = hub.files("models/me/walker")
    names = ("SHA256SUMS", "config.json", "metrics.jsonl", "model.safetensors", "summary.json")
    assert sorted(files) == ["README.md", *(f"field/{name}" for name in names)]

    # Names that are no stage's, and other files, are left where they are.
    others = {f"{other}/{name}": b"{}" for other in ("-rf", "a/b", ".git") for name in ("config.json", "summary.json")}
    hub.add("models/me/walker", {**files, **others, "field/pytorch_model.bin": b"", "train.py": b""})
    done(pull, "hf://me/walker", "--run", "theirs")
    pulled = run_folder.path.with_name("theirs")
    came = sorted(str(path.relative_to(pulled)) for path in pulled.rglob("*") if path.is_file())
    assert came == [f"field/{name}" for name in names]
    assert RunFolder(pulled).stage("field").read_summary() == {"loss": 0.5}

    weights = files["field/model.safetensors"]
    for damaged in (weights[:-1] + bytes([weights[-1] ^ 1]), b""):
        hub.add("models/me/walker", {**files, "field/model.safetensors": damaged})
        assert isinstance(run(pull, "hf://me/walker", "--run", "damaged").exception, DamagedFileError)
        assert not run_folder.path.with_name("damaged").exists()
        run_folder.stage("field").model_path.write_bytes(damaged)
        assert isinstance(run(push, "hf://me/walker", "--run", "walker").exception, DamagedFileError)


def test_the_how_to_runs(hub: Hub, store: mk.Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    datasets = pytest.importorskip("datasets", reason="needs the package datasets")
    monkeypatch.setattr(datasets.config, "HF_DATASETS_OFFLINE", True)
    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", tmp_path / "datasets")
    commands = {"push": push, "pull": pull, "export": export}
    names = run_page(PAGE, lambda words: print(done(commands[words[0]], *words[1:])))
    assert list(names["store"]) == list(store)
    last = store["lab/2"]
    np.testing.assert_array_equal(names["joints"], last.joint_positions)
