"""`motionkit samples`: what a folder holds, and the manifest that says what it cannot."""

import json
import re
from dataclasses import fields
from pathlib import Path

import pytest

from eval.commands.samples import samples as command
from eval.sample_folder.manifest import Manifest, read_manifest
from motionkit.core.errors import MotionkitError
from tests.helpers import published_layouts as published
from tests.helpers.repository import REPOSITORY

DEFAULTS = {"init": False, "fps": None, "up": None}


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
    assert whole == {field.name for field in fields(Manifest)}
