"""All kinds of output in one table: what each is, and how it is written."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from motionkit.export.bvh import export_bvh
from motionkit.export.joints_npy import export_joints_npy
from motionkit.export.selection import Outcome, Selection


@dataclass(frozen=True)
class Export:
    """One kind of output: `write` fills an empty folder and yields what became of each sequence, in order.

    What cannot be written as asked for is found before the first frame is read and raises `UsageError`.
    """

    name: str
    description: str
    write: Callable[[Selection, Path], Iterator[Outcome]]


EXPORTS: Mapping[str, Export] = {
    entry.name: entry
    for entry in (
        Export("bvh", "a BVH file each, own skeleton and framerate", export_bvh),
        Export("joints-npy", "22 joints in metres as .npy, one framerate", export_joints_npy),
    )
}
