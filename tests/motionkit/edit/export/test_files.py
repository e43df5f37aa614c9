"""Files out of a store and in again."""

import numpy as np


def test_npz_loses_nothing(store, export_as, ingest_again):
    report = export_as(store, "npz")
    assert (report.num_sequences, report.num_files) == (3, 4)
    for before, after in zip(store.read_many(range(3)), ingest_again(report.folder), strict=True):
        for name in ("timegrid", "captions", "action", "style", "split", "skeleton"):
            assert getattr(after, name) == getattr(before, name), name
        for name in ("source", "subset", "licence", "subject", "stated_fps", "operations"):
            assert getattr(after.provenance, name) == getattr(before.provenance, name), name
        for name in ("joint_positions", "local_rotations", "root_translation"):
            np.testing.assert_array_equal(getattr(after, name), getattr(before, name))


def test_bvh_keeps_the_exact_framerate_and_the_words(store, export_as, ingest_again):
    report = export_as(store, "bvh")
    for before, after in zip(store.read_many(range(3)), ingest_again(report.folder), strict=True):
        for name in ("fps", "captions", "action", "style", "split"):
            assert getattr(after, name) == getattr(before, name), name
        order = [after.skeleton.index(joint) for joint in before.skeleton.joint_names]
        np.testing.assert_allclose(after.joint_positions[:, order], before.joint_positions, atol=2e-4)


def test_csv_keeps_the_standard_joints_to_the_last_bit(store, export_as, ingest_again):
    report = export_as(store, "csv")
    for before, after in zip(store.read_many(range(3)), ingest_again(report.folder), strict=True):
        for name in ("timegrid", "captions", "action", "style", "split"):
            assert getattr(after, name) == getattr(before, name), name
        assert after.skeleton.joint_names == before.skeleton.joint_names
        np.testing.assert_array_equal(after.joint_positions, before.joint_positions)
