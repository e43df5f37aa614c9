"""Whole BVH documents in memory, as tests compare them."""

import numpy as np

from motionkit.fields.motion_field import Poses
from motionkit.formats.bvh.document import BvhDocument


def lines_of(document: BvhDocument) -> list[bytes]:
    """All frames as written."""
    return [document.frames.line(frame) for frame in range(len(document.frames))]


def table_of(document: BvhDocument) -> np.ndarray:
    """All numbers, one row a frame."""
    return document.frames.table(np.arange(len(document.frames)))


def poses_of(document: BvhDocument) -> Poses:
    """All poses."""
    return document.poses(np.arange(len(document.frames)))
