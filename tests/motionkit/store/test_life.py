"""Removal, compaction, merging, splits: each is one commit, and what stays is bit by bit what it was."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import motionkit as mk
from motionkit.core.errors import StoreError, UsageError
from motionkit.store.life import DEFAULT_SHARES, assign_groups, compact, merge, remove, split
from motionkit.store.validate import faults


def motions(make_motion, count=40):
    return [
        make_motion(
            f"take-{i}",
            600 if i % 7 == 3 else 30 + i,
            fps=Fraction(120 if i % 2 else 30),
            rotations=i % 3 == 0,
            skeleton=mk.KIT21 if i % 5 == 4 else make_motion("any").skeleton,
            split="test" if i % 4 == 0 else "train",
        )
        for i in range(count)
    ]


def write(path, motions, *, part_bytes=2**18, pieces=1):
    """A store of the motions, appended in so many pieces."""
    for piece in np.array_split(np.arange(len(motions)), pieces):
        writer = mk.StoreWriter.append(path, part_bytes=part_bytes) if path.exists() else mk.StoreWriter.create(path)
        with writer:
            for i in piece:
                writer.add(motions[i])
    return path


def assert_holds(path, motions, indices=None):
    """The store is intact and holds these motions, under these indices."""
    assert list(faults(path)) == []
    store = mk.Store.open(path)
    assert store.select().tolist() == (list(range(len(motions))) if indices is None else indices)
    for found, expected in zip(store.read_many(store.select()), motions, strict=True):
        assert found.sequence_id == expected.sequence_id
        assert found.captions == expected.captions
        np.testing.assert_array_equal(found.joint_positions, expected.joint_positions)
        assert (found.local_rotations is None) == (expected.local_rotations is None)
        if expected.local_rotations is not None:
            np.testing.assert_array_equal(found.local_rotations, expected.local_rotations)
            np.testing.assert_array_equal(found.root_translation, expected.root_translation)


def test_removed_sequences_are_gone_and_the_others_keep_their_numbers(tmp_path, make_motion):
    made = motions(make_motion)
    path = write(tmp_path / "store", made, pieces=4)
    before = mk.Store.open(path)
    assert set(remove(path, ["take-5"], where="split = 'test'")) == {"take-5", *(f"take-{i}" for i in range(0, 40, 4))}
    kept = [i for i in range(40) if i % 4 and i != 5]
    assert_holds(path, [made[i] for i in kept], kept)
    store = mk.Store.open(path)
    assert store.fingerprint != before.fingerprint
    assert store.read("take-7").sequence_id == store.read(7).sequence_id == "take-7"
    assert store.sequences.loc[7, "sequence_id"] == "take-7"
    for nobody in (5, 40, -1, "take-5"):
        with pytest.raises(StoreError, match=str(nobody)):
            store.read(nobody)
    assert store.query("SELECT count(*) AS n FROM motions").to_pylist() == [{"n": len(kept)}]
    assert before.read(5).sequence_id == "take-5"  # whoever opened it before reads on


def test_a_number_is_not_given_twice(tmp_path, make_motion):
    """Neither a sequence's nor a part's, also where the last ones were removed: old readers must not see new frames."""
    path = write(tmp_path / "store", motions(make_motion, 20), pieces=2)
    parts = mk.Store.open(path).manifest.parts
    remove(path, [f"take-{i}" for i in range(10, 20)])
    assert mk.Store.open(path).manifest.parts == parts[:1]
    with mk.StoreWriter.append(path) as writer:
        assert writer.add(make_motion("again")) == 20
    store = mk.Store.open(path)
    assert store.manifest.parts == (parts[0], "motions/part-00002.parquet")
    assert store.read(20).sequence_id == "again"


def test_a_removal_of_nothing_changes_nothing(small_store):
    before = mk.Store.open(small_store).fingerprint
    assert remove(small_store, where="fps = 1") == ()
    with pytest.raises(StoreError, match="'nobody'"):
        remove(small_store, ["take-0", "nobody"])
    with pytest.raises(UsageError, match="nonsense = 1"):
        remove(small_store, where="nonsense = 1")
    assert mk.Store.open(small_store).fingerprint == before


def test_a_compacted_store_is_that_of_one_ingest(tmp_path, make_motion):
    """But for the numbers of its parts, which go on."""
    made = motions(make_motion)
    path = write(tmp_path / "store", made, pieces=7)
    remove(path, where="split = 'test'")
    kept = [motion for motion in made if motion.split != "test"]
    assert compact(path, part_bytes=2**18)
    assert_holds(path, kept)
    with mk.StoreWriter.create(tmp_path / "fresh", part_bytes=2**18) as writer:
        for motion in kept:
            writer.add(motion)
    store, fresh = mk.Store.open(path), mk.Store.open(tmp_path / "fresh")
    assert len(store.manifest.parts) == len(fresh.manifest.parts) > 1
    for ours, theirs in zip(store.manifest.parts, fresh.manifest.parts, strict=True):
        assert (path / ours).read_bytes() == (fresh.path / theirs).read_bytes()
    assert store.sequences_table.drop_columns("part").equals(fresh.sequences_table.drop_columns("part"))
    assert store.skeletons_table.equals(fresh.skeletons_table)
    assert sorted(each.name for each in (path / "motions").iterdir()) == [
        name.removeprefix("motions/") for name in store.manifest.parts
    ]
    assert not compact(path, part_bytes=2**18)


def test_reading_a_store_that_was_compacted_meanwhile_is_reported(tmp_path, make_motion):
    path = write(tmp_path / "store", motions(make_motion, 6), pieces=2)
    before = mk.Store.open(path)
    before.read(0)
    assert compact(path)
    assert before.read(1).sequence_id == "take-1"  # its row group is still in memory
    for use in (lambda: before.read(5), lambda: before.query("SELECT count(*) FROM motions")):
        with pytest.raises(StoreError, match=str(path)):
            use()


def test_a_merge_is_one_ingest_of_what_is_new(tmp_path, make_motion):
    made = motions(make_motion, 20)
    first, second = write(tmp_path / "first", made[:12], pieces=3), write(tmp_path / "second", made[8:])
    write(tmp_path / "fresh", made)
    assert merge(tmp_path / "out", [first, second]) == (20, 4)
    assert mk.Store.open(tmp_path / "out").fingerprint == mk.Store.open(tmp_path / "fresh").fingerprint
    assert merge(first, [second, second]) == (8, 16)
    assert_holds(first, made)
    merge(tmp_path / "subset", [tmp_path / "fresh"], where="fps = 120 AND has_rotations")
    chosen = [motion for motion in made if motion.fps == 120 and motion.local_rotations is not None]
    assert_holds(tmp_path / "subset", chosen)
    assert set(mk.Store.open(tmp_path / "subset").skeletons) == {motion.skeleton.fingerprint for motion in chosen}


def test_one_id_for_two_files_is_a_conflict(tmp_path, make_motion):
    mine, theirs = motions(make_motion, 9), motions(make_motion, 12)
    theirs = [replace(each, provenance=replace(each.provenance, source_sha256="cd" * 32)) for each in theirs]
    out, source = write(tmp_path / "out", mine), write(tmp_path / "source", theirs)
    before = mk.Store.open(out).fingerprint
    with pytest.raises(StoreError, match="'take-0', 'take-1'"):
        merge(out, [source])
    assert mk.Store.open(out).fingerprint == before
    merge(out, [source], where="sequence_id NOT IN (" + ", ".join(f"'take-{i}'" for i in range(9)) + ")")
    assert_holds(out, [*mine, *theirs[9:]])


def taken_by(make_motion, name, subject, *captions, source="made", num_frames=30):
    motion = make_motion(name, num_frames, fps=Fraction(30))
    provenance = replace(motion.provenance, source=source, subject=subject)
    return replace(motion, provenance=provenance, captions=tuple(map(mk.Caption, captions)))


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
    rows = mk.Store.open(path).sequences[[*keys, "split"]]
    for *group, name in rows.itertuples(index=False):
        found.setdefault(tuple(group), set()).add(name)
    return found


@settings(max_examples=25)
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
    seconds = mk.Store.open(many).sequences.groupby(["source", "subject"])["duration_seconds"].sum()
    assert [each.split for each in report.splits] == list(DEFAULT_SHARES)
    assert sum(each.num_groups for each in report.splits) == 30
    for each in report.splits:
        assert each.share == pytest.approx(each.duration_seconds / seconds.sum())
        assert abs(each.share - DEFAULT_SHARES[each.split]) * seconds.sum() <= seconds.max()
    # 01 of one data set is not 01 of the other: some seed parts them.
    parted = [split(many, seed=seed) and splits_of(many, "subject") for seed in range(3)]
    assert any(len(found) > 1 for each in parted for found in each.values())


def test_only_the_column_changes_and_the_seed_decides(many):
    before = mk.Store.open(many)
    first = split(many, seed=1)
    after = mk.Store.open(many)
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
    before = mk.Store.open(many).fingerprint
    with pytest.raises(UsageError, match=message):
        split(many, shares, **options)
    assert mk.Store.open(many).fingerprint == before


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


def test_training_loses_captions_that_a_held_out_performer_has(tmp_path, make_motion):
    said = [("a person walks forward", "run"), ("Someone is walking forward.",), ("jump",), ("lying down",)]
    path = write(tmp_path / "unseen", [taken_by(make_motion, f"{n}", f"{n}", *texts) for n, texts in enumerate(said)])
    split(path, {"train": 1.0}, by="sequence_id", where="sequence_id <> '1'")
    report = split(path, {"val": 1.0}, by="sequence_id", where="sequence_id = '1'", unseen_wordings=True)
    motions = {name: [caption.text for caption in mk.Store.open(path)[name].captions] for name in "0123"}
    assert motions == {"0": ["run"], "1": ["Someone is walking forward."], "2": ["jump"], "3": ["lying down"]}
    assert report.num_captions_removed == 1


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
