"""KIT-ML folders in HumanML3D's form: 21 joints, 12.5 fps, 251 numbers, lengths in thousandths of the body's height.

Published files have the root at 560 units on average, which is the hip's height of a body of 1,000 units; this project
makes such a body 1.7 m tall. Source: https://github.com/EricGuo5513/HumanML3D, https://motion-annotation.humanoids.kit.edu.
"""

from fractions import Fraction
from pathlib import Path

from motionkit.core.motion import Motion
from motionkit.core.skeleton import KIT21
from motionkit.formats.pose_folders import humanml3d
from motionkit.formats.pose_folders.humanml3d import Layout
from motionkit.formats.scan.items import ReadOptions, ScanResult, SourceItem

BODY_HEIGHT_METRES = 1.7
UNIT_METRES = BODY_HEIGHT_METRES / 1000.0
KIT = Layout("kit", KIT21, Fraction(25, 2), UNIT_METRES)


def claims(folder: Path) -> bool:
    """Whether a folder is one of KIT-ML's, judged by the shape of the first array that states one."""
    return humanml3d.claims(folder, KIT)


def find(folder: Path, root: Path) -> ScanResult:
    """All sequences of a folder with their splits."""
    return humanml3d.find(folder, root, KIT)


def read_kit(item: SourceItem, options: ReadOptions) -> Motion:
    """Read one sequence in metres at 12.5 fps; raises `FormatError`."""
    return humanml3d.read_humanml3d(item, options, KIT)
