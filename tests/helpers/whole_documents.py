"""Whole BVH documents in memory, as tests compare them."""

import numpy as np

from motionkit.fields.motion_field import Poses
from motionkit.io.bvh.document import BvhDocument


def lines_of(document: BvhDocument) -> list[bytes]:
    """All frames as written."""
    return [document.lines.line(frame) for frame in range(len(document.lines))]


def table_of(document: BvhDocument) -> np.ndarray:
    """All numbers, one row a frame."""
    return document.lines.table(np.arange(len(document.lines)))


def poses_of(document: BvhDocument) -> Poses:
    """All poses."""
    return document.poses(np.arange(len(document.lines)))
