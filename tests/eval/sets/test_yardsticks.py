"""Copies of the real set are counted; the FID of as many random real motions stands beside that of fewer motions."""

import numpy as np

from eval.metrics.distributions import fid
from eval.sets.sets import num_copies, size_remarks

RNG = np.random.default_rng(0)
REAL = RNG.normal(size=(300, 12)) * np.linspace(0.1, 30, 12)


def test_copies_are_counted_to_rounding_whatever_their_order() -> None:
    order = RNG.permutation(300)[:40]
    copies = REAL[order] * (1 + 1e-12)
    others = RNG.normal(size=(25, 12)) * np.linspace(0.1, 30, 12)
    assert num_copies(REAL, np.concatenate((others, copies))) == 40
    assert num_copies(REAL, others) == 0
    # One number of a row apart is another motion.
    near = REAL[:5].copy()
    near[:, 7] += 0.01
    assert num_copies(REAL, near) == 0
    # Equal first numbers are no copies.
    assert num_copies(np.concatenate((np.zeros((9, 1)), REAL[:9, 1:]), axis=1), np.zeros((2, 12))) == 0


def test_fewer_motions_are_reported_with_what_as_many_real_ones_score() -> None:
    few = RNG.normal(size=(50, 12)) * np.linspace(0.1, 30, 12)
    (remark,) = size_remarks(REAL, REAL, few, seed=3)
    assert remark.startswith("as many random real motions (50) have an FID of ")
    told = float(remark.split("FID of ")[1].split(" from")[0])
    drawn = [fid(REAL, REAL[np.random.default_rng(i).choice(300, 50, replace=False)]) for i in range(200)]
    assert abs(told - np.mean(drawn)) < 3 * np.std(drawn) / np.sqrt(10)
    assert size_remarks(REAL, REAL, few, seed=3) == [remark]
    assert size_remarks(REAL, REAL, REAL + 0.5, seed=0) == []
    (copied,) = size_remarks(REAL, REAL[:200], REAL, seed=0)
    assert copied.startswith("300 of 300 motions are real motions")
    # Where FID compares with the real motions of the same texts, there are no fewer of either.
    assert size_remarks(REAL, REAL[:50], few, seed=3) == []
