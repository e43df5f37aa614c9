"""LaFAN1: BVH in centimetres at 30 fps, `walk1_subject1.bvh`.

Source: https://github.com/ubisoft/ubisoft-laforge-animation-dataset (README.md: names and themes; evaluate.py: the
actors of both sets). The same names at 60 fps are https://github.com/orangeduck/lafan1-resolved, read the same way.
"""

import re
from dataclasses import replace
from pathlib import Path

from motionkit.core.motion import Motion
from motionkit.io.bvh import BvhDocument, read_document
from motionkit.io.registry import FileHead, Format, ReadOptions, of_path

THEMES = (
    *("aiming", "dance", "fallAndGetUp", "fight", "fightAndSports", "ground", "jumps", "multipleActions", "obstacles"),
    *("push", "pushAndFall", "pushAndStumble", "run", "sprint", "walk"),
)
NAME = re.compile(rf"(?P<theme>{'|'.join(THEMES)})(?P<take>\d+)_(?P<subject>subject\d+)", re.IGNORECASE)
TRAIN_SUBJECTS = ("subject1", "subject2", "subject3", "subject4")
TEST_SUBJECTS = ("subject5",)


def accepts(head: FileHead) -> bool:
    """Whether a BVH file has one of LaFAN1's names: a theme, a take number and a subject."""
    return NAME.fullmatch(head.path.stem) is not None


def read_lafan1(path: Path, options: ReadOptions | None = None) -> Motion:
    """Read one take with its theme as the action, its subject, and the benchmark's split: subject 5 is the test set.

    The root's OFFSET, a take's starting position, is set to zero, so that takes of one subject share their skeleton;
    position channels replace it anyway. Raises `FormatError` as `read_bvh` does.
    """
    return read_lafan1_document(path, options, strict=True).motion


def read_lafan1_document(path: Path, options: ReadOptions | None = None, *, strict: bool = False) -> BvhDocument:
    """The same with the file's text; raises `FormatError` as `read_document` does."""
    document = read_document(path, options, strict=strict)
    motion = document.motion
    offsets = motion.skeleton.offsets.copy()
    offsets[0] = 0.0
    name = NAME.fullmatch(path.stem)
    subject = name["subject"].lower() if name else ""
    motion = replace(
        motion,
        skeleton=replace(motion.skeleton, name="lafan1", offsets=offsets),
        action=name["theme"] if name else "",
        split="test" if subject in TEST_SUBJECTS else "train" if subject in TRAIN_SUBJECTS else "",
        provenance=replace(motion.provenance, source_format="lafan1", subject=subject),
    )
    return replace(document, motion=motion)


FORMAT = Format(
    name="lafan1",
    read=of_path(read_lafan1),
    document=read_lafan1_document,
    suffixes=(".bvh",),
    accepts=accepts,
    turns_up=True,
)
