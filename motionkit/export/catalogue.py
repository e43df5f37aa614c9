"""All kinds of output in one table: what each is, and how it is written."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from motionkit.export.motion_files import export_bvh, export_gltf, export_joints_csv, export_joints_npy, export_npz
from motionkit.export.parquet import export_parquet
from motionkit.export.pose_folder import export_humanml3d, export_kit
from motionkit.export.selection import Outcome, Selection
from motionkit.formats.pose_folders.humanml3d import HUMANML3D
from motionkit.formats.pose_folders.kit import KIT


@dataclass(frozen=True)
class Export:
    """One kind of output: `write` fills an empty folder and yields what became of each sequence, in order.

    `fps` is the framerate of all motions where none is asked for; None leaves each at its own.
    What cannot be written as asked for is found before the first frame is read and raises `UsageError`.
    """

    name: str
    description: str
    write: Callable[[Selection, Path], Iterator[Outcome]]
    fps: Fraction | None = None


EXPORTS: Mapping[str, Export] = {
    entry.name: entry
    for entry in (
        Export("bvh", "a BVH file each, own skeleton and framerate", export_bvh),
        Export("joints-npy", "22 joints in metres as .npy, one framerate", export_joints_npy),
        Export("npz", "an .npz file each, everything that is known", export_npz),
        Export("csv", "a table of joint positions each, with time stamps", export_joints_csv),
        Export("humanml3d", "HumanML3D's folder: joints, 263 numbers, texts, splits", export_humanml3d, HUMANML3D.fps),
        Export("kit", "KIT-ML's folder: 21 joints, 251 numbers, texts, splits", export_kit, KIT.fps),
        Export("gltf", "a .glb each: an animated, visible skeleton for viewers and engines", export_gltf),
        Export("parquet", "Parquet by split with a dataset card: datasets, pandas, polars, duckdb", export_parquet),
    )
}
