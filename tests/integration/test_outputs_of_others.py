"""What other systems write, through the command line: as captures, and as samples of a model."""

import json
import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import motionkit as mk
from eval.commands.samples import samples as command
from eval.sample_folder.reading import Manifest, read_manifest
from motionkit.core.errors import MotionkitError
from motionkit.core.skeletons.mapping import map_joints
from motionkit.features import humanml3d
from tests.helpers import published_layouts as published
from tests.helpers import vector_samples
from tests.helpers.analytic import analytic_motion
from tests.helpers.repository import REPOSITORY
from tests.helpers.vector_samples import interhuman_rows, motionstreamer_rows

FRAMES = 40


@pytest.fixture
def outputs(tmp_path):
    """A walk as Kimodo's joints and as SMPL-H's 52; a body at rest as SMPL's parameters and as Motion-X's rows.

    Others as pose vectors: one person's and two persons' of InterHuman, MotionStreamer's.
    """
    folder = tmp_path / "outputs"
    folder.mkdir()
    walk = analytic_motion("walk", 2.0).query(np.arange(FRAMES) / 30)
    joints = walk.joint_positions.astype(np.float32)
    np.savez(folder / "kimodo.npz", posed_joints=joints)
    np.save(folder / "joints52.npy", np.concatenate((joints, np.repeat(joints[:, -1:], 30, axis=1)), axis=1))
    (folder / "motions.json").write_text('{"fps": 30}')
    rest = np.zeros((FRAMES, 3), np.float32)
    np.savez(folder / "gvhmr.npz", global_orient=rest, body_pose=np.zeros((FRAMES, 63)), transl=rest + 0.9, fps=30)
    np.save(folder / "motionx.npy", np.zeros((FRAMES, 322), np.float32))
    alone = interhuman_rows(vector_samples.walk())
    np.save(folder / "alone.npy", alone)
    np.save(folder / "two.npy", np.hstack((alone, alone)))
    np.save(folder / "streamed.npy", motionstreamer_rows(vector_samples.walk()))
    return folder


def test_they_are_ingested(motionkit, outputs, tmp_path):
    outcome = motionkit("ingest", outputs, "--store", tmp_path / "store")
    assert outcome.code == 0 and "stored 8 sequences" in outcome.stdout
    store = mk.Store.open(tmp_path / "store")
    kinds = dict(zip(store.sequences["source_format"], store.sequences["has_rotations"], strict=True))
    assert kinds == {
        **{"kimodo": False, "joints-npy": False, "smpl": True, "motion-x": True},
        **{"interhuman": False, "motionstreamer": True},
    }
    assert {"outputs/two/person1", "outputs/two/person2", "outputs/alone"} < set(store.sequences["sequence_id"])
    np.testing.assert_array_equal(
        store.read("outputs/kimodo").joint_positions, store.read("outputs/joints52").joint_positions
    )


def test_one_file_of_pose_vectors_goes_everywhere(motionkit, tmp_path):
    rows = humanml3d.vectors(vector_samples.walk(20).joint_positions, "smpl22")
    np.save(tmp_path / "000021.npy", rows)
    store, out = tmp_path / "store", tmp_path / "out"
    assert motionkit("view", tmp_path / "000021.npy", "--out", tmp_path / "page.html").code == 0
    outcome = motionkit("ingest", tmp_path / "000021.npy", "--store", store)
    assert outcome.code == 0 and "stored 1 sequence" in outcome.stdout
    assert motionkit("export", out, "--store", store, "--format", "bvh").code == 0
    (written,) = out.glob("**/*.bvh")
    found = mk.read(written)
    assert found.fps == 20 and found.num_frames == len(rows)
    stated = motionkit("samples", tmp_path / "000021.npy")
    assert stated.code == 1 and "statistics" in stated.stderr


@pytest.mark.parametrize("suffix", [".fbx", ".pt", ".pth", ".pkl", ".pickle"])
def test_what_is_never_loaded_is_refused_with_the_page_that_converts_it(motionkit, tmp_path, suffix):
    path = tmp_path / f"walk{suffix}"
    path.write_bytes(b"cos\nmkdir\n(S'" + str(tmp_path / "sprung").encode() + b"'\ntR.")
    for words in (("ingest", path, "--store", tmp_path / "store"), ("samples", path), ("view", path)):
        outcome = motionkit(*words)
        assert outcome.code == 1 and not (tmp_path / "sprung").exists()
    assert "docs/formats.md" in outcome.stderr


def test_a_rig_is_shown_and_a_map_of_it_drafted(motionkit, tmp_path):
    walk = vector_samples.walk()
    names = tuple(f"{'l' if n.startswith('left') else 'r'}{n.partition('_')[2].title()}" if "_" in n else f"x{n}"
                  for n in walk.skeleton.joint_names)  # fmt: skip
    assert len(set(names)) == 22
    strange = replace(walk, skeleton=replace(walk.skeleton, joint_names=names))
    strange.save(tmp_path / "walk.bvh")
    shown = motionkit("info", tmp_path / "walk.bvh")
    assert shown.code == 0 and "no mapping; provide --skeleton-map" in shown.stdout and "missing  " in shown.stdout
    init = ("info", tmp_path / "walk.bvh", "--init", tmp_path / "rig.toml")
    assert motionkit(*init).code == 0
    assert motionkit(*init).code == 2, "it exists"
    text = (tmp_path / "rig.toml").read_text()
    assert 'left_knee = "lknee"' in text
    rows = dict(zip(walk.skeleton.joint_names, names, strict=True))
    completed = re.sub(r'# (\w+) = ""', lambda row: f'{row[1]} = "{rows[row[1]]}"', text)
    (tmp_path / "rig.toml").write_text(completed)
    store = tmp_path / "store"
    outcome = motionkit("ingest", tmp_path / "walk.bvh", "--store", store, "--skeleton-map", tmp_path / "rig.toml")
    assert outcome.code == 0 and "cannot be mapped" not in outcome.stderr
    opened = mk.Store.open(store)
    found = opened.read(opened.sequences["sequence_id"][0])
    reached = map_joints(found, "smpl22")[:, [4, 7, 18, 20]] - walk.joint_positions[:, [4, 7, 18, 20]]
    assert np.abs(reached).max() < 2e-3
    assert motionkit("info", "--init", tmp_path / "none.toml").code == 2


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
