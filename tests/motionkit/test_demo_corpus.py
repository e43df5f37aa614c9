"""The embedded corpus: people held out, framerates that are true, and files that are read as they were packed."""

from collections import defaultdict
from fractions import Fraction
from pathlib import Path

import numpy as np

from motionkit.demo_corpus import FOLDER, read_demo_corpus, write_demo_corpus
from motionkit.features.quality import measure
from motionkit.io.asfamc import read_asfamc
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import read, scan
from tests.helpers.repository import REPOSITORY

RATES = {Fraction(rate) for rate in (20, 30, 60, 120)}


def test_nobody_is_in_two_splits_and_every_framerate_in_train_and_test() -> None:
    people, rates = defaultdict(set), defaultdict(set)
    for motion in read_demo_corpus():
        assert motion.captions[0].text and motion.action and motion.duration_seconds > 1.0
        people[motion.split].add(motion.provenance.subject)
        rates[motion.split].add(motion.fps)
    assert set(people) == {"train", "val", "test"}
    assert len(set.union(*people.values())) == sum(map(len, people.values())) == 23
    assert rates["train"] == rates["test"] == RATES


def test_nothing_is_odd_about_any_motion() -> None:
    for motion in read_demo_corpus():
        quality = measure(motion)
        assert quality.flags == (), (motion.sequence_id, quality.flags)


def test_what_is_written_is_read_by_the_scan(tmp_path: Path) -> None:
    written = write_demo_corpus(tmp_path / "corpus", every=10)
    found = scan([tmp_path / "corpus"])
    assert found.problems == () and found.warnings == ()
    motions = {item.path.stem: read(item) for item in found.items}
    assert len(motions) == len(written) == 12
    for motion in written:
        again = motions[motion.sequence_id]
        assert (again.fps, again.num_frames, again.captions) == (motion.fps, motion.num_frames, motion.captions)
        assert (again.action, again.split) == (motion.action, motion.split)
        assert again.provenance.subject == motion.provenance.subject
        assert again.provenance.licence.startswith("CMU mocap database")
        order = [again.skeleton.joint_names.index(name) for name in motion.skeleton.joint_names]
        assert np.abs(again.joint_positions[:, order] - motion.joint_positions).max() < 2e-4


def test_a_cut_is_every_second_frame_of_its_file(captures: Path) -> None:
    [packed] = read_demo_corpus(["05_02"])
    source = read_asfamc(captures / "cmu" / "asfamc" / "05" / "05_02.amc", ReadOptions(fps=Fraction(120)))
    joints = [source.skeleton.index(name) for name in packed.skeleton.joint_names]
    assert packed.fps == 60
    expected = source.joint_positions[120:840:2, joints]
    assert np.linalg.norm(packed.joint_positions - expected, axis=-1).max() < 3e-4


def test_both_notices_are_the_same() -> None:
    assert (FOLDER / "NOTICE").read_text() == (REPOSITORY / "NOTICE").read_text()
