"""All formats in one table: how each is found, read, and what people are told about it."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from motionkit.core.motion import Motion
from motionkit.formats import deepmimic, humanact12, joints_csv, parquet
from motionkit.formats.acclaim import asfamc
from motionkit.formats.arrays import joints_npy, npy, npz
from motionkit.formats.bvh import document as bvh
from motionkit.formats.bvh import lafan1, style100
from motionkit.formats.bvh.document import BvhDocument
from motionkit.formats.c3d import motion as c3d
from motionkit.formats.pose_folders import humanml3d, kit
from motionkit.formats.scan.items import ReadOptions, ScanResult, SourceItem
from motionkit.formats.smpl import amass, uestc


@dataclass(frozen=True)
class Format:
    """One format: how its sequences are found and read, and what people are told about it.

    A file format has `suffixes`, and `accepts` where the suffix alone does not tell; a single file of another name is
    known by a word that it `begins` with, comments aside. A folder format has `claims`,
    which says whether a folder is one, and `find`, which lists its sequences; a claimed folder is not searched further.
    `beside` lists the files of a folder, there or not, that belong to its sequences without being one: what is read
    with them, and what a data set is known to put there. A text file that can be written again with its own lines has
    `document`, which reads the same skeleton, frames and clock as `read`, but frames where they are needed.
    """

    name: str
    description: str
    framerate: str
    rotations: bool
    read: Callable[[SourceItem, ReadOptions], Motion]
    suffixes: tuple[str, ...] = ()
    accepts: Callable[[Path], bool] | None = None
    begins: bytes = b""
    claims: Callable[[Path], bool] | None = None
    find: Callable[[Path, Path], ScanResult] | None = None
    beside: Callable[[Path], Iterable[Path]] = lambda folder: ()
    document: Callable[[Path, ReadOptions], BvhDocument] | None = None
    writes: bool = False


def _of_path(read: Callable[[Path, ReadOptions], Motion]) -> Callable[[SourceItem, ReadOptions], Motion]:
    # A reader for which a file is all there is to a sequence.
    return lambda item, options: read(item.path, options)


FORMATS: Mapping[str, Format] = {
    entry.name: entry
    for entry in (
        Format(
            name="lafan1",
            description="LaFAN1's takes (.bvh named walk1_subject5), with theme, subject and the benchmark's split",
            framerate="Frame Time",
            rotations=True,
            read=_of_path(lafan1.read_lafan1),
            document=lafan1.read_lafan1_document,
            suffixes=(".bvh",),
            accepts=lafan1.accepts,
        ),
        Format(
            name="100style",
            description="100STYLE's takes (.bvh named Style_FW), cut as Frame_Cuts.csv says, with style and movement",
            framerate="Frame Time",
            rotations=True,
            read=_of_path(style100.read_100style),
            document=style100.read_100style_document,
            suffixes=(".bvh",),
            accepts=style100.accepts,
            beside=style100.tables_of_cuts,
        ),
        Format(
            name="bvh",
            description="BioVision hierarchy (.bvh), any skeleton and channel order",
            framerate="Frame Time",
            rotations=True,
            read=_of_path(bvh.read_bvh),
            document=bvh.read_document,
            suffixes=(".bvh",),
            begins=b"HIERARCHY",
            writes=True,
        ),
        Format(
            name="asfamc",
            description="Acclaim skeleton and motion (.amc with its .asf beside it), as CMU publishes them",
            framerate="not stated: annotation CSV or --fps",
            rotations=True,
            read=_of_path(asfamc.read_asfamc),
            suffixes=(".amc",),
            beside=asfamc.skeletons,
            begins=b":FULLY-SPECIFIED",
        ),
        Format(
            name="c3d",
            description="C3D (.c3d): markers without bones; a --skeleton-map makes the 22 joints of them",
            framerate="POINT:RATE",
            rotations=False,
            read=_of_path(c3d.read_c3d),
            suffixes=(".c3d",),
        ),
        Format(
            name="deepmimic",
            description="DeepMimic's motions (.txt or .json, Loop and Frames; the humanoid of 15 joints)",
            framerate="the frames' durations",
            rotations=True,
            read=_of_path(deepmimic.read_deepmimic),
            suffixes=(".txt", ".json"),
            accepts=deepmimic.accepts,
        ),
        Format(
            name="uestc",
            description="UESTC as ACTOR uses it (.npz, SMPL poses, action, view and subject in the name)",
            framerate="30, by definition",
            rotations=True,
            read=_of_path(uestc.read_uestc),
            suffixes=(".npz", ".pkl"),
            accepts=uestc.accepts,
        ),
        Format(
            name="amass",
            description="AMASS (.npz): SMPL, SMPL-H or SMPL-X poses, both generations of files",
            framerate="mocap_framerate or mocap_frame_rate",
            rotations=True,
            read=amass.read_amass,
            suffixes=(".npz",),
            accepts=amass.accepts,
            beside=amass.shapes,
        ),
        Format(
            name="humanml3d",
            description="HumanML3D folder: new_joints and/or new_joint_vecs (263 numbers), texts, splits",
            framerate="20, by definition",
            rotations=False,
            read=humanml3d.read_humanml3d,
            claims=humanml3d.claims,
            find=humanml3d.find,
            beside=humanml3d.files_of_folder,
            writes=True,
        ),
        Format(
            name="kit",
            description="KIT-ML folder in HumanML3D's form: 21 joints, 251 numbers",
            framerate="12.5, by definition",
            rotations=False,
            read=kit.read_kit,
            claims=kit.claims,
            find=kit.find,
            beside=humanml3d.files_of_folder,
            writes=True,
        ),
        Format(
            name="humanact12",
            description="HumanAct12 clips (.npy, 24 joints, action in the name)",
            framerate="20, by definition",
            rotations=False,
            read=_of_path(humanact12.read_humanact12),
            suffixes=(".npy",),
            accepts=humanact12.accepts,
            beside=joints_npy.manifests,
        ),
        Format(
            name="joints-npy",
            description="joint positions (.npy, frames × joints × 3; 21, 22 or 24 joints)",
            framerate="motions.json, annotation CSV or --fps",
            rotations=False,
            read=_of_path(joints_npy.read_joints_npy),
            suffixes=(".npy",),
            accepts=joints_npy.accepts,
            beside=joints_npy.manifests,
            begins=npy.MAGIC,
            writes=True,
        ),
        Format(
            name="npz",
            description="this project's .npz: joint_positions, a clock, anything else that is known",
            framerate="fps_numerator/fps_denominator, fps, or time_seconds",
            rotations=True,
            read=_of_path(npz.read_npz),
            suffixes=(".npz",),
            accepts=npz.accepts,
            writes=True,
        ),
        Format(
            name="csv",
            description="joint positions (.csv, time_seconds or frame, then JOINT_x, JOINT_y, JOINT_z)",
            framerate="time_seconds; else annotation CSV or --fps",
            rotations=False,
            read=_of_path(joints_csv.read_joints_csv),
            suffixes=(".csv",),
            accepts=joints_csv.accepts,
            writes=True,
        ),
        Format(
            name="parquet",
            description="rows of motions as export --format parquet writes them, a folder of .parquet files",
            framerate="fps_numerator/fps_denominator, or fps",
            rotations=True,
            read=parquet.read_parquet,
            claims=parquet.claims,
            find=parquet.find,
            beside=parquet.beside,
            writes=True,
        ),
    )
}
