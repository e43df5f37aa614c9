from collections import Counter
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.motion import Motion
from motionkit.fields.motion_field import to_motion
from motionkit.io.scan import reading, scanner
from motionkit.synthetic.demo_corpus import DemoCorpus, draw_sequences, split_of, write_demo_corpus

NUM_SEQUENCES = 24


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> DemoCorpus:
    return write_demo_corpus(tmp_path_factory.mktemp("demo") / "corpus", NUM_SEQUENCES, seed=5)


@pytest.fixture(scope="module")
def motions(corpus: DemoCorpus) -> dict[str, Motion]:
    found = scanner.scan([corpus.folder])
    assert found.problems == () and found.warnings == ()
    return {item.path.stem: reading.read(item) for item in found.items}


def test_the_readers_find_every_sequence(corpus: DemoCorpus, motions: dict[str, Motion]) -> None:
    assert len(motions) == NUM_SEQUENCES == corpus.num_bvh + corpus.num_humanml3d
    formats = Counter(motion.provenance.source_format for motion in motions.values())
    assert formats == {"bvh": corpus.num_bvh, "humanml3d": corpus.num_humanml3d}
    assert {motion.fps for motion in motions.values()} == {20, 24, 30, 50, 60, 100, 120, 250}


def test_what_is_read_is_what_was_performed(motions: dict[str, Motion]) -> None:
    for sequence in draw_sequences(NUM_SEQUENCES, seed=5):
        motion = motions[sequence.name]
        truth = to_motion(sequence.field, sequence.fps)
        assert (motion.fps, motion.num_frames) == (truth.fps, truth.num_frames)
        assert (motion.action, motion.split) == (sequence.field.action, sequence.split)
        assert motion.provenance.subject == sequence.subject
        assert motion.provenance.licence.startswith("CC0")
        if motion.provenance.source_format == "bvh":
            order = [motion.skeleton.joint_names.index(name) for name in truth.skeleton.joint_names]
            assert np.abs(motion.joint_positions[:, order] - truth.joint_positions).max() < 3e-4
            assert motion.captions[0] == sequence.field.captions[0]
        else:
            assert [caption.text for caption in motion.captions] == [
                caption.text for caption in sequence.field.captions
            ]
            assert np.abs(motion.joint_positions[0, 0, [0, 2]]).max() < 1e-6


def test_the_humanml3d_folder_is_complete(corpus: DemoCorpus) -> None:
    folder = corpus.folder / "humanml3d"
    for joints in sorted((folder / "new_joints").glob("*.npy")):
        num_frames = len(np.load(joints))
        assert np.load(folder / "new_joint_vecs" / joints.name).shape == (num_frames - 1, 263)
    assert np.load(folder / "Mean.npy").shape == np.load(folder / "Std.npy").shape == (263,)
    names = (folder / "all.txt").read_text().split()
    assert len(names) == corpus.num_humanml3d
    assert set(names) == {
        name for split in ("train", "val", "test") for name in (folder / f"{split}.txt").read_text().split()
    }


def test_the_same_seed_writes_the_same_bytes(corpus: DemoCorpus, tmp_path: Path) -> None:
    again = write_demo_corpus(tmp_path / "again", NUM_SEQUENCES, seed=5)
    files = sorted(path.relative_to(corpus.folder) for path in corpus.folder.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(again.folder) for path in again.folder.rglob("*") if path.is_file())
    for file in files:
        assert (corpus.folder / file).read_bytes() == (again.folder / file).read_bytes(), file


def test_the_default_corpus_is_varied() -> None:
    sequences = draw_sequences(320, seed=0)
    assert len(sequences) == 320
    assert len({sequence.name for sequence in sequences}) == 320
    assert len({sequence.field.action for sequence in sequences}) >= 14
    assert min(Counter(sequence.fps for sequence in sequences).values()) >= 20
    splits = Counter(sequence.split for sequence in sequences)
    assert 0.12 < splits["test"] / 320 < 0.28 and splits["train"] > 200 and splits["val"] > 4
    seconds = np.array([sequence.field.end_seconds for sequence in sequences])
    assert seconds.min() >= 1.95 and seconds.max() <= 9.85
    captions = {caption.text for sequence in sequences for caption in sequence.field.captions}
    assert len(captions) > 400
    fast = [sequence for sequence in sequences if sequence.split == "test" and sequence.fps >= Fraction(120)]
    assert len(fast) >= 10
    assert all(sequence.split == split_of(sequence.name) for sequence in sequences)


def test_too_few_sequences_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at least 16"):
        write_demo_corpus(tmp_path, 8)
