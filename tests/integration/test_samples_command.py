"""`motionkit samples`: what a folder holds, and the manifest that says what it cannot."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from eval.commands.samples import samples as command
from eval.sample_folder.manifest import READERS, manifest_text, read_manifest
from motionkit.core.errors import MotionkitError, UsageError
from tests.helpers import published_layouts as published
from tests.helpers.repository import REPOSITORY

DEFAULTS = {"init": False, "fps": None, "unit_metres": None, "statistics": None, "mean": None, "std": None}


@pytest.fixture
def samples(capsys):
    """What the command prints on stdout."""

    def run(folder: Path, **given: object) -> str:
        capsys.readouterr()
        command(folder, **{**DEFAULTS, "as_json": False, **given})
        return capsys.readouterr().out

    return run


def test_a_folder_is_described(samples, tmp_path):
    folder = published.write_mdm(tmp_path / "mdm")
    assert samples(folder, fps="20").splitlines()[:5] == [
        "motions     6, 0.3 min, 53 to 73 frames (median 63)",
        "framerate   20 fps (6)",
        "captions    6, 3 different",
        "actions     none",
        "prompts     3 with 2 motions each",
    ]
    found = json.loads(samples(folder, fps="20", as_json=True))
    assert found["prompt_sizes"] == {"2": 3}
    assert found["body_metres"] == pytest.approx(1.48, abs=0.03)
    with pytest.raises(MotionkitError, match=r"results\.npy: nothing says its framerate"):
        samples(folder)


def test_the_axis_that_points_up_can_be_given(samples, tmp_path):
    """x, which is never inferred: for one look, and written into the manifest."""
    folder = tmp_path / "mine"
    folder.mkdir()
    for index, joints in enumerate(published.motions()):
        x, y, z = np.moveaxis(joints, -1, 0)
        np.save(folder / f"m{index}.npy", np.stack((y, -x, z), axis=-1))
    turned = "turned from x up to y up"
    with pytest.raises(MotionkitError, match="6 lying"):
        samples(folder, fps="20")
    assert turned in samples(folder, fps="20", up="x")
    assert turned in samples(folder, fps="20", up="x", init=True)
    assert turned in samples(folder)


def test_a_manifest_is_written_and_read(samples, tmp_path):
    found = np.concatenate(published.vectors())
    for name, numbers in (("Mean.npy", found.mean(axis=0)), ("Std.npy", np.maximum(found.std(axis=0), 0.01))):
        np.save(tmp_path / name, numbers)
    mean, std = np.load(tmp_path / "Mean.npy"), np.load(tmp_path / "Std.npy")
    folder = published.write_t2m_gpt_vectors(tmp_path / "gpt", mean, std)
    for name in ("samples.toml", "mean.npy", "std.npy"):
        (folder / name).unlink()
    with pytest.raises(MotionkitError, match="nothing says whether"):
        samples(folder)
    given = {
        "statistics": "normalised",
        "mean": tmp_path / "Mean.npy",
        "std": tmp_path / "Std.npy",
        "fps": "30000/1001",
    }
    told = samples(folder, init=True, **given)
    assert "30000/1001 fps (6)" in told
    text = (folder / "samples.toml").read_text()
    assert 'statistics = "normalised"' in text
    assert "# unit_metres = 0.01" in text
    assert samples(folder) == told
    with pytest.raises(UsageError, match="is there already"):
        samples(folder, init=True)


def test_every_line_of_a_manifest_can_be_set(samples, tmp_path):
    text = manifest_text({"statistics": "normalised"})
    for name in ("mean.npy", "std.npy", "prompts.txt"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "samples.toml").write_text(text.replace("# ", "", 1).replace("\n# ", "\n").replace("What", "# What", 1))
    manifest = read_manifest(tmp_path)
    assert (manifest.fps, manifest.up, manifest.unit_metres) == (20, "z", 0.01)
    assert manifest.files == ("**/*_pred.npy",)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"fps": "x"}, "--fps x"),
        ({"unit_metres": 0.01}, "--unit-metres goes with --init"),
        ({"init": True, "statistics": "mine"}, "expected raw or normalised"),
        ({"init": True, "statistics": "normalised"}, "needs --mean FILE and --std FILE"),
        ({"init": True, "statistics": "raw", "mean": Path("m")}, "needs --mean FILE and --std FILE"),
        ({"init": True, "statistics": "normalised", "mean": Path("m"), "std": Path("s")}, "there is no such file"),
    ],
)
def test_usage_faults(samples, tmp_path, given, says):
    with pytest.raises(UsageError, match=says):
        samples(tmp_path, **given)
    assert not list(tmp_path.iterdir())


def test_motions_that_are_left_out_are_named_and_cost_the_exit_code(samples, tmp_path, capsys):
    folder = published.write_t2m_gpt(tmp_path / "gpt")
    np.save(folder / "000009_pred.npy", np.full((1, 50, 22, 3), np.nan, np.float32))
    with pytest.raises(MotionkitError, match=r"1 motions of .* are left out of every table"):
        command(folder, **{**DEFAULTS, "fps": "20"}, as_json=False)
    assert "left out    " in capsys.readouterr().out


def test_the_manifests_of_the_page_are_manifests(tmp_path):
    page = (REPOSITORY / "docs" / "samples.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    assert len(blocks) == 2
    for name in ("mean.npy", "std.npy", "prompts.txt", "text_prompt.txt"):
        (tmp_path / name).write_bytes(b"")
    for block in blocks:
        (tmp_path / "samples.toml").write_text(block, encoding="utf-8")
        assert read_manifest(tmp_path).fps == 20
    whole = set(re.findall(r"^(\w+) = ", blocks[0], re.MULTILINE)) | {"exclude"}
    assert whole == set(READERS)
