"""`motionkit export`: what comes out of a store goes into another one."""

from fractions import Fraction

import numpy as np
import pytest

from motionkit.motion import Motion
from motionkit.skeleton import SMPL22
from motionkit.store import Store, StoreWriter
from motionkit.timegrid import TimeGrid


def test_bvh_and_back(motionkit, takes, tmp_path):
    table = tmp_path / "notes.csv"
    table.write_text('file,caption,split\nalpha.bvh,"a person slides, slowly",test\n')
    store, again = tmp_path / "store", tmp_path / "again"
    motionkit("ingest", takes, "--store", store, "--captions", table, "--fps", "48000/1001", "--workers", 1)
    outcome = motionkit("export", tmp_path / "out", "--store", store)
    assert (outcome.code, outcome.error_lines) == (0, [])
    assert outcome.stdout == f"wrote 3 files and motions.csv to {tmp_path}/out\n"
    assert motionkit("ingest", tmp_path / "out", "--store", again, "--workers", 1).code == 0
    motions = Store.open(store).read_many(range(3))
    for before, after in zip(motions, Store.open(again).read_many(range(3)), strict=True):
        assert after.fps == before.fps == Fraction(48000, 1001)
        assert after.split == before.split
        assert after.captions == before.captions
        assert after.skeleton.joint_names == before.skeleton.joint_names
        np.testing.assert_allclose(after.joint_positions, before.joint_positions, atol=2e-4)


@pytest.fixture
def bodies(tmp_path):
    """Two motions on the 22 joints, at 30 and at 60 fps."""
    with StoreWriter.create(tmp_path / "store") as writer:
        for name, fps in (("a/slow", 30), ("a/fast", 60)):
            places = np.linspace(0, 1, 40 * 66, dtype=np.float32).reshape(40, 22, 3)
            writer.add(Motion(places, SMPL22, TimeGrid(Fraction(fps), 40), sequence_id=name))
    return tmp_path / "store"


def test_joints_of_one_framerate(motionkit, bodies, tmp_path):
    out = tmp_path / "out"
    assert motionkit("export", out, "--store", bodies, "--format", "joints-npy", "--where", "fps = 30").code == 0
    np.testing.assert_array_equal(np.load(out / "a_slow.npy"), Store.open(bodies).read("a/slow").joint_positions)
    assert not (out / "a_fast.npy").exists()
    mixed = motionkit("export", tmp_path / "mixed", "--store", bodies, "--format", "joints-npy")
    assert mixed.code == 2
    assert "have 30 and 60: give one with --fps" in mixed.stderr
    both = motionkit("export", tmp_path / "both", "--store", bodies, "--format", "joints-npy", "--fps", 60, "--json")
    assert both.code == 0
    assert len(np.load(tmp_path / "both" / "a_slow.npy")) == 79
    assert len(np.load(tmp_path / "both" / "a_fast.npy")) == 40


def test_an_id_may_not_lead_out_of_the_folder(motionkit, make_id_store, tmp_path):
    store = make_id_store("../../escaped")
    outcome = motionkit("export", tmp_path / "deep" / "out", "--store", store)
    assert outcome.code == 2
    assert "cannot be a file's name" in outcome.stderr
    assert not list(tmp_path.rglob("escaped*"))


@pytest.fixture
def make_id_store(tmp_path):
    def make(sequence_id):
        with StoreWriter.create(tmp_path / "ids") as writer:
            places = np.zeros((3, 22, 3), np.float32)
            writer.add(Motion(places, SMPL22, TimeGrid(Fraction(30), 3), sequence_id=sequence_id))
        return tmp_path / "ids"

    return make


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--format", "mp3"), "unknown format 'mp3', expected one of bvh, joints-npy"),
        (("--where", "fps = 7"), "no sequence of"),
        (("--fps", "fast"), "--fps fast"),
    ],
)
def test_usage_faults(motionkit, bodies, tmp_path, arguments, says):
    outcome = motionkit("export", tmp_path / "out", "--store", bodies, *arguments)
    assert outcome.code == 2
    assert says in outcome.stderr
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_not_empty(motionkit, bodies):
    outcome = motionkit("export", bodies.parent, "--store", bodies)
    assert outcome.code == 2
    assert "is not empty" in outcome.stderr


def test_a_file_where_a_folder_is_to_be(motionkit, bodies, tmp_path):
    (tmp_path / "taken").write_text("mine")
    outcome = motionkit("export", tmp_path / "taken", "--store", bodies)
    assert (outcome.code, outcome.stderr) == (2, f"motionkit: {tmp_path / 'taken'} is a file: name a new folder\n")
    below = motionkit("export", tmp_path / "taken" / "deeper", "--store", bodies)
    assert below.code == 1
    assert below.stderr == f"motionkit: [Errno 20] Not a directory: '{tmp_path / 'taken' / 'deeper'}'\n"
