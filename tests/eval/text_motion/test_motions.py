"""Which real motions take part: captions, the stretches that they are about, lengths, framerates."""

from fractions import Fraction

import numpy as np
import pytest

from eval.sets.motions import NoRealMotionError
from eval.text_motion.motions import captioned_motions
from eval.text_motion.protocol import LengthRule, find_text_motion_protocol
from motionkit.core.motion import Caption, Motion
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import TimeGrid
from motionkit.store import Store, StoreWriter

CROPPED = LengthRule(1.0, 3.0, "cropped")


def take(name: str, seconds: float, captions: tuple[Caption, ...], fps: int = 20) -> Motion:
    grid = TimeGrid(Fraction(fps), round(seconds * fps) + 1)
    positions = np.zeros((grid.num_frames, 22, 3), dtype=np.float32)
    # The root's x is the time in seconds, so that a crop tells where it was cut.
    positions[:, :, 0] = grid.seconds()[:, None]
    positions[:, :, 1] = np.arange(22) * 0.05
    return Motion(positions, SMPL22, grid, captions=captions, sequence_id=name, split="test")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    path = tmp_path_factory.mktemp("pairs") / "store"
    with StoreWriter.create(path) as writer:
        writer.add(take("plain", 2.0, (Caption("walks"), Caption("goes", tokens="go/VERB"))))
        writer.add(take("long", 7.0, (Caption("runs"),)))
        writer.add(take("part", 6.0, (Caption("jumps", 1.0, 3.0),)))
        writer.add(take("rest", 4.0, (Caption("sits", 2.0),)))
        writer.add(take("short", 0.5, (Caption("blinks"),)))
        writer.add(take("mute", 2.0, ()))
        writer.add(take("slow", 2.0, (Caption("waits"),), fps=10))
    return Store.open(path)


def test_each_motion_is_the_stretch_of_its_first_caption(store: Store) -> None:
    found = captioned_motions(store, "test", None, Fraction(20), CROPPED)
    assert found.samples.sequence_ids == ("plain", "long", "part", "rest")
    assert [caption.text for caption in found.captions] == ["walks", "runs", "jumps", "sits"]
    roots = [sequence[:, 0, 0] for sequence in found.samples.sequences]
    spans = [(round(float(root[0]), 3), round(float(root[-1]), 3)) for root in roots]
    # [1, 3) s holds the poses at 1.00 … 2.95; the middle 3 s of 7 are 2 … 5.
    assert spans == [(0.0, 2.0), (2.0, 5.0), (1.0, 2.95), (2.0, 4.0)]
    requests = found.requests()
    assert [each.duration_seconds for each in requests] == pytest.approx([2.0, 3.0, 1.95, 2.0])
    assert [each.text for each in requests] == ["walks", "runs", "jumps", "sits"]
    assert found.num_cropped == 1
    assert found.left_out == {"captured below 20 fps": 1, "shorter than 1 s": 1, "without a caption": 1}
    assert found.known_captions["goes"].tokens == "go/VERB"
    chosen = found.select(np.array([2, 0]))
    assert chosen.samples.captions == ("jumps", "walks")
    assert [caption.text for caption in chosen.captions] == ["jumps", "walks"]


def test_a_model_that_makes_less_shortens_the_real_motions() -> None:
    published = LengthRule(2.0, 10.0, "left out")
    assert published.limited(10.0) is published
    assert published.limited(4.0) == LengthRule(2.0, 4.0, "cropped")
    assert published.limited(1.5) == LengthRule(1.5, 1.5, "cropped")


def test_published_lengths_are_those_of_the_loaders_at_either_framerate() -> None:
    # Numbers of pose vectors, of which T poses have T − 1 (text-to-motion, data/dataset.py).
    for fps, fewest, most in ((Fraction(20), 40, 199), (Fraction(25, 2), 24, 199)):
        rule = find_text_motion_protocol("t2m").lengths_at(fps)
        assert rule.most_frames(fps) - 1 == most
        assert float(rule.shortest_seconds * fps) == pytest.approx(fewest)
        # The longest that Guo's evaluators take whole.
        assert find_text_motion_protocol("native").lengths_at(fps).most_frames(fps) - 1 == 196


def test_too_few_motions_are_reported(store: Store) -> None:
    with pytest.raises(NoRealMotionError, match=r"1 captioned sequence at 20 fps, .*1 shorter than 1 s"):
        captioned_motions(store, "test", "sequence_id IN ('plain', 'short', 'mute')", Fraction(20), CROPPED)
