"""Rules that correct framerates which files state wrongly: the shipped ones, and the user's."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from motionkit.core.errors import UsageError
from motionkit.core.motion import Motion
from motionkit.io.registry import ReadOptions
from motionkit.io.scan import parse_rules, read, read_rules, scan
from tests.helpers.amass_samples import smplh_fields, stageii_fields, write_amass
from tests.helpers.format_samples import bvh_text, write_asfamc
from tests.helpers.refusal import refusal


def read_file(root: Path, path: Path, options: ReadOptions | None = None) -> Motion:
    (item,) = (item for item in scan([root], options).items if item.path == path.resolve())
    return read(item, options)


@pytest.mark.parametrize(
    ("path", "stated", "used"),
    [
        ("TotalCapture/s1/walking1_stageii.npz", 120.0, 60),
        ("TotalCapture/s1/walking1_stageii.npz", 60.0, 60),
        ("TotalCapture/s1/walking1_poses.npz", 120.0, 120),
        ("SSM_synced/20160930_50032/jumping_poses.npz", 120.0, 60),
        ("SSM_synced/20160330_03333/jumping_poses.npz", 120.0, 120),
        ("KIT/3/walk_stageii.npz", 120.0, 100),
        ("CMU/CMU/80/80_63_stageii.npz", 120.0, 60),
        ("CMU/63/63_01_stageii.npz", 120.0, 120),
    ],
)
def test_shipped_rules_correct_what_they_name_and_nothing_else(
    tmp_path: Path, path: str, stated: float, used: int
) -> None:
    fields = smplh_fields(mocap_framerate=None) | {"mocap_frame_rate": stated}
    file = write_amass(tmp_path / "AMASS" / path, fields)
    for root in (tmp_path / "AMASS", tmp_path / "AMASS" / Path(path).parts[0]):
        motion = read_file(root, file)
        assert motion.fps == used and motion.provenance.stated_fps == str(stated)
        assert any("rule" in line for line in motion.provenance.operations) == (used != round(stated))


def test_the_users_rules_win_and_explicit_framerates_win_over_rules(tmp_path: Path) -> None:
    file = write_amass(tmp_path / "KIT" / "3" / "walk_stageii.npz", stageii_fields())
    rules = tmp_path / "rules.toml"
    rules.write_text(
        '[[rule]]\nfiles = "*_run_*.npz"\nfps = 24\n\n'
        '[[rule]]\nfiles = ["3/*.npz"]\nfps = "30000/1001"\nstated = 120\nsource = "me"\n'
    )
    own = ReadOptions(fps_rules=read_rules(rules))
    motion = read_file(tmp_path / "KIT", file, own)
    assert motion.fps == Fraction(30000, 1001) and "rules.toml, rule 2, me" in motion.provenance.operations[-1]
    assert read_file(tmp_path / "KIT", file, ReadOptions(fps=Fraction(50), fps_rules=own.fps_rules)).fps == 50
    (tmp_path / "KIT" / "clips.csv").write_text("file,fps\n3/walk_stageii.npz,48\n")
    assert read_file(tmp_path / "KIT", file, own).fps == 48


def test_rules_hold_for_every_format(tmp_path: Path) -> None:
    bvh = tmp_path / "data" / "062" / "62_11.bvh"
    bvh.parent.mkdir(parents=True)
    for frame_time, has_rule in ((".0083333", True), (".0166667", False)):
        bvh.write_text(bvh_text(frame_time=frame_time))
        motion = read_file(tmp_path / "data", bvh)
        assert motion.fps == 60 and any("rule" in line for line in motion.provenance.operations) == has_rule
    amc = write_asfamc(tmp_path / "data")
    rules = parse_rules('[[rule]]\nfiles = "*.amc"\nfps = 120', "mine")
    motion = read_file(tmp_path / "data", amc, ReadOptions(fps_rules=rules))
    assert motion.fps == 120 and "mine, rule 1" in motion.provenance.operations[-1]


@pytest.mark.parametrize("value", [-1.0, np.nan, 1e9, "fast", None])
def test_a_rule_replaces_a_framerate_that_is_none(tmp_path: Path, value: object) -> None:
    file = write_amass(tmp_path / "a_poses.npz", smplh_fields(mocap_framerate=value))
    assert refusal(read_file, tmp_path, file).reason == ("no-framerate" if value is None else "framerate")
    rules = parse_rules('[[rule]]\nfiles = "*.npz"\nfps = 100', "mine")
    assert read_file(tmp_path, file, ReadOptions(fps_rules=rules)).fps == 100


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("rule = ", "f.toml"),
        ("[[rule]]\nfps = 60", "rule 1"),
        ('[[rule]]\nfiles = "a"\nfps = 60\nframerate = 3', "framerate"),
        ("[[rule]]\nfiles = [7]\nfps = 60", "files"),
        ('[[rule]]\nfiles = "a"\nfps = 60\n[[rule]]\nfiles = "b"\nfps = nan', "rule 2"),
    ],
)
def test_bad_rules_are_reported_by_their_number(tmp_path: Path, text: str, place: str) -> None:
    (tmp_path / "f.toml").write_text(text)
    with pytest.raises(UsageError, match=place):
        read_rules(tmp_path / "f.toml")
