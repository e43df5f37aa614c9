"""Splits by performer: nobody in two, the shares that were asked for, the same for the same seed."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.core.errors import UsageError
from motionkit.core.motion import Caption
from motionkit.store import Store, StoreWriter
from motionkit.store.life import DEFAULT_SHARES, assign_groups, split
from motionkit.store.validate import faults


def taken_by(make_motion, name, subject, *captions, source="made", num_frames=30):
    motion = make_motion(name, num_frames, fps=Fraction(30))
    provenance = replace(motion.provenance, source=source, subject=subject)
    return replace(motion, provenance=provenance, captions=tuple(map(Caption, captions)))


def write(path, motions):
    with StoreWriter.create(path) as writer:
        for motion in motions:
            writer.add(motion)
    return path


@pytest.fixture
def many(tmp_path, make_motion):
    """Two data sets whose subjects have the same numbers: 30 performers of 1 to 4 takes."""
    motions = [
        taken_by(make_motion, f"{source}-{subject}-{take}", f"{subject:02}", source=source, num_frames=20 + 7 * take)
        for source in ("first", "second")
        for subject in range(15)
        for take in range(1 + subject % 4)
    ]
    return write(tmp_path / "store", motions)


def splits_of(path, *keys):
    """The splits in which each group of sequences is."""
    found = {}
    rows = Store.open(path).sequences[[*keys, "split"]]
    for *group, name in rows.itertuples(index=False):
        found.setdefault(tuple(group), set()).add(name)
    return found


@given(
    seconds=st.lists(st.floats(0.1, 50.0), min_size=3, max_size=25),
    shares=st.lists(st.floats(0.05, 1.0), min_size=1, max_size=3),
    seed=st.integers(0, 1000),
)
def test_no_split_is_farther_from_its_share_than_a_group_is_long(seconds, shares, seed):
    lengths = np.array(seconds)
    found = assign_groups(lengths, shares, seed)
    got = np.bincount(found, weights=lengths, minlength=len(shares))
    asked = np.array(shares) / sum(shares) * lengths.sum()
    # One group more than it lacked; where a split would have stayed empty, another may lack as many groups.
    assert (got - asked <= lengths.max() + 1e-9).all()
    assert (np.bincount(found, minlength=len(shares)) > 0).all()
    np.testing.assert_array_equal(found, assign_groups(lengths, shares, seed))


def test_performers_are_whole_and_shares_near(many):
    report = split(many)
    assert all(len(found) == 1 for found in splits_of(many, "source", "subject").values())
    seconds = Store.open(many).sequences.groupby(["source", "subject"])["duration_seconds"].sum()
    assert [each.split for each in report.splits] == list(DEFAULT_SHARES)
    assert sum(each.num_groups for each in report.splits) == 30
    for each in report.splits:
        assert each.share == pytest.approx(each.duration_seconds / seconds.sum())
        assert abs(each.share - DEFAULT_SHARES[each.split]) * seconds.sum() <= seconds.max()
    # 01 of one data set is not 01 of the other: some seed parts them.
    parted = [split(many, seed=seed) and splits_of(many, "subject") for seed in range(3)]
    assert any(len(found) > 1 for each in parted for found in each.values())


def test_only_the_column_changes_and_the_seed_decides(many):
    before = Store.open(many)
    first = split(many, seed=1)
    after = Store.open(many)
    assert list(faults(many)) == []
    assert first.fingerprint == after.fingerprint != before.fingerprint
    assert after.sequences_table.drop_columns("split").equals(before.sequences_table.drop_columns("split"))
    assert split(many, seed=1).num_changed == 0
    assert split(many, seed=2, dry_run=True).num_changed > 0
    assert split(many, seed=1).fingerprint == first.fingerprint


def test_a_whole_source_is_held_out(many):
    split(many, {"test": 1.0}, where="source = 'second'")
    assert splits_of(many, "source") == {("first",): {"train"}, ("second",): {"test"}}
    report = split(many, {"train": 1.0, "test": 1.0}, by="source")
    assert [(each.num_groups, each.requested_share) for each in report.splits] == [(1, 0.5), (1, 0.5)]


def test_nobody_is_torn_by_a_condition(many):
    split(many, {"train": 1.0})
    with pytest.raises(UsageError, match="--by sequence_id"):
        split(many, {"test": 1.0}, where="num_frames < 30")
    split(many, {"test": 1.0}, by="sequence_id", where="num_frames < 30")
    # Performers whom the choice does not touch may be in two splits: they were before.
    split(many, {"test": 1.0}, where="subject = '00'")


@pytest.mark.parametrize(
    ("shares", "options", "message"),
    [
        ({"train": 1.0, "tset": 1.0}, {}, "'tset'"),
        ({"train": 1.0, "test": float("nan")}, {}, "nan"),
        (DEFAULT_SHARES, {"by": "nonsense"}, "--by 'nonsense'"),
        (DEFAULT_SHARES, {"by": "source"}, "'source'"),
        (DEFAULT_SHARES, {"where": "fps = 1"}, "fps = 1"),
        (DEFAULT_SHARES, {"by": "style"}, "'style'"),
    ],
)
def test_what_cannot_be_split_is_reported_and_left(many, shares, options, message):
    before = Store.open(many).fingerprint
    with pytest.raises(UsageError, match=message):
        split(many, shares, **options)
    assert Store.open(many).fingerprint == before


def test_wordings_are_held_out_whatever_their_case_and_punctuation(tmp_path, make_motion):
    """Eight performers: 0 to 3 say 'walk' and each a word of their own, 4 says both of 5's, 6 and 7 say nothing."""
    said = [("Walk.", f"word {number}") for number in range(4)] + [("run", "jump"), ("Jump!",), (), ()]
    path = write(tmp_path / "worded", [taken_by(make_motion, f"{n}", f"{n}", *texts) for n, texts in enumerate(said)])
    halves = {"train": 1.0, "test": 1.0}
    known = split(path, halves, by="sequence_id", dry_run=True, seed=3).splits[1]
    assert 0 < known.num_seen <= known.num_captioned
    report = split(path, halves, by="wording", where="len(captions) > 0")
    found = [next(iter(splits_of(path, "sequence_id")[f"{number}",])) for number in range(6)]
    assert len(set(found[:4])) == len(set(found[4:])) == 1 and found[0] != found[4]
    assert sorted((each.num_groups, each.num_captioned) for each in report.splits) == [(1, 2), (1, 4)]
    assert [each.num_seen for each in report.splits] == [report.splits[0].num_captioned, 0]
    with pytest.raises(UsageError, match="'wording'"):
        split(path, halves, by="wording")


def test_what_shares_a_performer_or_a_wording_stays_together(tmp_path, make_motion):
    """a – b by performer, b – c by wording, d – e by wording; f by nothing."""
    said = [("1", "walk"), ("1", "run"), ("2", "Run"), ("", "jump"), ("", "jump"), ("3",)]
    store = write(
        tmp_path / "linked", [taken_by(make_motion, name, *each) for name, each in zip("abcdef", said, strict=True)]
    )
    report = split(store, {"train": 3.0, "val": 2.0, "test": 1.0}, by=["performer", "wording"])
    a, b, c, d, e, f = (splits_of(store, "sequence_id")[name,] for name in "abcdef")
    assert a == b == c != d == e != f and report.by == "performer and wording"
    assert [each.num_groups for each in report.splits] == [1, 1, 1]
