"""HumanAct12: 1,191 clips of 12 actions, (T, 24, 3) joints in metres, 20 fps, the action's code in the file name.

Source: https://github.com/EricGuo5513/action-to-motion. According to its author, the capture really ran at 15 fps
(HumanML3D issue 124; set `--fps 15`). Users report that left and right are swapped (issue 147); the files' sides are
not changed.
"""

import re
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

from motionkit.core.motion import Motion
from motionkit.io import joints_npy, source_file
from motionkit.io.registry import FileHead, Format, ReadOptions, of_path

FPS = Fraction(20)
NUM_JOINTS = 24
NAME = re.compile(r"P(?P<subject>\d+)G\d+R\d+F\d+T\d+A(?P<action>\d\d)\d\d", re.IGNORECASE)
ACTIONS = (
    *("warm_up", "walk", "run", "jump", "drink", "lift_dumbbell"),
    *("sit", "eat", "turn_steering_wheel", "phone", "boxing", "throw"),
)


def accepts(head: FileHead) -> bool:
    """Whether a .npy file is a HumanAct12 clip: its name has the data set's form and its array is [T, 24, 3]."""
    shape = head.array_shape
    return NAME.fullmatch(head.path.stem) is not None and (shape is None or shape[1:] == (NUM_JOINTS, 3))


def read_humanact12(path: Path, options: ReadOptions | None = None) -> Motion:
    """Read one clip as the 22 body joints in metres with its action; raises `FormatError`."""
    options = options or ReadOptions()
    fps = options.fps or FPS
    motion = joints_npy.read_joints_npy(path, replace(options, fps=fps))
    match = NAME.fullmatch(path.stem)
    code = int(match["action"]) if match else 0
    operations = (*motion.provenance.operations, *source_file.replaced_fps(fps, FPS, who="the data set"))
    return replace(
        motion,
        action=ACTIONS[code - 1] if 1 <= code <= len(ACTIONS) else "",
        provenance=replace(
            motion.provenance,
            source_format="humanact12",
            stated_fps=str(FPS),
            subject=match["subject"] if match else "",
            operations=operations,
        ),
    )


FORMAT = Format(
    name="humanact12",
    read=of_path(read_humanact12),
    suffixes=(".npy",),
    accepts=accepts,
    beside=(joints_npy.MANIFEST,),
)
