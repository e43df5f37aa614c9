"""Sets that can be scored, but whose scores mean something else than they seem to."""

from fractions import Fraction

import numpy as np

from eval.sets.sets import SampleSet, sample_set, set_remarks

FPS = Fraction(30)


def moving(name: str, seed: int = 0, num_sequences: int = 4) -> SampleSet:
    rng = np.random.default_rng(seed)
    sequences = [rng.normal(size=(60, 22, 3)).astype(np.float32) for _ in range(num_sequences)]
    return sample_set(name, FPS, sequences, [str(index) for index in range(num_sequences)])


def frozen(name: str, num_poses: int) -> SampleSet:
    poses = np.random.default_rng(1).normal(size=(num_poses, 1, 22, 3)).astype(np.float32)
    return sample_set(name, FPS, [np.repeat(pose, 60, axis=0) for pose in poses], [str(i) for i in range(num_poses)])


def test_sequences_of_the_real_set_are_found_in_any_order() -> None:
    real = moving("real")
    half = sample_set("half", FPS, [*moving("other", seed=2).sequences, real.sequences[3], real.sequences[0]], "abcdef")
    remarks = set_remarks(real, {"half": half, "copy": real.select([2, 0, 1, 3]), "other": moving("other", seed=2)})
    assert [remark.split(" are copies")[0] for remark in remarks] == [
        "half, 30 fps: 2 of 6 sequences",
        "copy, 30 fps: 4 of 4 sequences",
    ]


def test_motion_that_stands_still_is_named_even_where_sequences_differ() -> None:
    remarks = set_remarks(moving("real"), {"statues": frozen("statues", 3), "dancer": moving("dancer", seed=3)})
    assert [remark.split(":")[0] for remark in remarks] == ["statues, 30 fps"]
