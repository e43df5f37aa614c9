"""A small valid source of every format in the catalogue."""

import json
import struct
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

import motionkit as mk
from motionkit.features import humanml3d
from motionkit.io.deepmimic import humanoid3d
from motionkit.io.humanml3d import HUMANML3D, Entry, FolderWriter, Layout
from tests.helpers.amass_samples import smplh_fields, write_amass
from tests.helpers.format_samples import bvh_text, lafan1_text, write_asfamc
from tests.helpers.vector_samples import interhuman_rows, motionstreamer_rows, walk


def bodies(num_frames: int, joints: int) -> np.ndarray:
    """Joints that stand a hand apart and move a little."""
    rng = np.random.default_rng(3)
    return (0.2 + 0.05 * np.arange(joints)[:, None] + 0.01 * rng.normal(size=(num_frames, joints, 3))).astype(
        np.float32
    )


def write_array(name: str, array: np.ndarray) -> Callable[[Path], Path]:
    """A source of one .npy file."""

    def write(folder: Path) -> Path:
        np.save(folder / name, array)
        return folder / name

    return write


def write_vectors(rows: Callable[[], np.ndarray]) -> Callable[[Path], Path]:
    """A source of one .npy file of pose vectors."""
    return lambda folder: write_array("take.npy", rows())(folder)


def write_arrays(name: str, **arrays: np.ndarray) -> Callable[[Path], Path]:
    """A source of one .npz file."""

    def write(folder: Path) -> Path:
        np.savez(folder / name, **arrays)  # type: ignore[arg-type]
        return folder / name

    return write


def write_acclaim(folder: Path) -> Path:
    write_asfamc(folder)
    return next(folder.glob("*.amc"))


def write_animation(folder: Path) -> Path:
    mk.write(mk.Motion(bodies(5, 22), mk.SMPL22, mk.TimeGrid(Fraction(30), 5)), folder / "take.glb")
    return folder / "take.glb"


def write_style(folder: Path) -> Path:
    (folder / "Old").mkdir()
    (folder / "Frame_Cuts.csv").write_text("STYLE_NAME,FW_START,FW_STOP\nOld,0,3\n")
    (folder / "Old" / "Old_FW.bvh").write_text(bvh_text())
    return folder / "Old" / "Old_FW.bvh"


def write_motion_of_frames(folder: Path) -> Path:
    frame = [1 / 30, 0.0, 0.9, 0.0]
    for size in humanoid3d()[1]:
        frame += {4: [1.0, 0.0, 0.0, 0.0], 1: [0.0], 0: []}[size]
    (folder / "walk.txt").write_text(json.dumps({"Loop": "wrap", "Frames": [frame] * 4}))
    return folder / "walk.txt"


def c3d_bytes(
    positions: np.ndarray,
    processor: int,
    scale: float,
    labels: tuple[str, ...] = ("LASI", "RASI", "SACR"),
    analog: int = 0,
) -> bytes:
    """A C3D file written word by word: integers where the scale is positive, in the processor's byte order."""
    order = ">" if processor == 86 else "<"

    def real(value: float) -> bytes:
        if processor == 85:
            b = struct.pack("<f", value * 4)
            return b[2:] + b[:2]
        return struct.pack(f"{order}f", value)

    def parameter(name: bytes, kind: int, dimensions: tuple[int, ...], body: bytes) -> bytes:
        content = struct.pack("bB", kind, len(dimensions)) + bytes(dimensions) + body + b"\0"
        return struct.pack("bb", len(name), 1) + name + struct.pack(f"{order}h", len(content) + 2) + content

    width = max(map(len, labels))
    text = b"".join(label.encode().ljust(width) for label in labels)
    records = struct.pack("bb", 5, -1) + b"POINT" + struct.pack(f"{order}h", 3) + b"\0"
    for name, number in ((b"USED", positions.shape[1]), (b"FRAMES", len(positions)), (b"DATA_START", 3)):
        records += parameter(name, 2, (), struct.pack(f"{order}h", number))
    records += parameter(b"SCALE", 4, (), real(scale)) + parameter(b"RATE", 4, (), real(100.0))
    records += parameter(b"LABELS", -1, (width, len(labels)), text) + parameter(b"UNITS", -1, (2,), b"cm")
    section = (bytes([1, 0x50, 1, processor]) + records).ljust(512, b"\0")
    num_frames, num_points = positions.shape[:2]
    header = bytes([2, 0x50]) + struct.pack(f"{order}5H", num_points, analog, 1, num_frames, 0) + real(scale)
    header += struct.pack(f"{order}2H", 3, 1) + real(100.0)
    frames = b""
    for frame in positions:
        for point in frame:
            seen = 0.0 if np.isfinite(point).all() else -1.0
            numbers = [*np.nan_to_num(point), seen]
            frames += b"".join(
                real(number) if scale < 0 else struct.pack(f"{order}h", round(number / (scale if i < 3 else 1)))
                for i, number in enumerate(numbers)
            )
        frames += b"".join(real(1e6) if scale < 0 else struct.pack(f"{order}h", 12345) for _ in range(analog))
    return header.ljust(512, b"\0") + section + frames


def write_bytes(name: str, content: bytes) -> Callable[[Path], Path]:
    """A source of one binary file."""

    def write(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return write


def write_pose_folder(folder: Path, entries: Iterable[Entry], layout: Layout = HUMANML3D) -> int:
    """Write a folder of HumanML3D's form; the number of its sequences."""
    writer = FolderWriter(folder, layout)
    for entry in entries:
        writer.add(entry)
    return writer.finish()


def write_published(joints: int) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        write_pose_folder(folder, [Entry("000001", bodies(12, joints), None, (), "train")])
        return folder / "new_joints" / "000001.npy"

    return write


# Markers as detectors of key points name them, and the joints of the 22 that they are.
TRC_JOINTS = {
    **{"RHip": 2, "RKnee": 5, "RAnkle": 8, "RBigToe": 11, "LHip": 1, "LKnee": 4, "LAnkle": 7, "LBigToe": 10},
    **{"RShoulder": 17, "RElbow": 19, "RWrist": 21, "LShoulder": 16, "LElbow": 18},
    **{"LWrist": 20, "Head": 15, "Neck": 12},
}


def trc_text(points: np.ndarray, names: Sequence[str] = tuple(TRC_JOINTS)) -> str:
    """A TRC table at 60 fps of points in metres, in millimetres; NaN is empty."""
    head = [
        "PathFileType\t4\t(X/Y/Z)\twalk.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"60\t60\t{len(points)}\t{len(names)}\tmm\t60\t1\t{len(points)}",
        "Frame#\tTime\t" + "".join(f"{name}\t\t\t" for name in names),
        "\t\t" + "".join(f"X{number}\tY{number}\tZ{number}\t" for number in range(1, len(names) + 1)),
        "",
    ]
    rows = (
        "\t".join([str(frame + 1), f"{frame / 60:.6f}", *("" if np.isnan(x) else repr(float(x)) for x in row.ravel())])
        for frame, row in enumerate(1000 * points.astype(np.float64))
    )
    return "\n".join((*head, *rows)) + "\n"


# Each writes a source into an empty folder and returns the file that holds the motion.
SOURCES: dict[str, Callable[[Path], Path]] = {
    "lafan1": write_bytes("walk1_subject5.bvh", lafan1_text(6).encode()),
    "100style": write_style,
    "bvh": write_bytes("take.bvh", bvh_text().encode()),
    "asfamc": write_acclaim,
    "c3d": write_bytes("take.c3d", c3d_bytes(100 * bodies(4, 3), 84, -1.0)),
    "trc": write_bytes("take.trc", trc_text(bodies(4, len(TRC_JOINTS))).encode()),
    "deepmimic": write_motion_of_frames,
    "uestc": write_arrays("a0_d1_p001_c1_color.npz", pose=np.full((3, 72), 0.1, np.float32)),
    "amass": lambda folder: write_amass(folder / "take_poses.npz", smplh_fields()),
    "smpl": write_arrays(
        "hmr.npz",
        global_orient=np.zeros((4, 3), np.float32),
        body_pose=np.full((4, 63), 0.1, np.float32),
        transl=np.zeros((4, 3), np.float32),
        fps=np.array(30.0),
    ),
    "motion-x": write_array("clip1.npy", np.full((4, 322), 0.1, np.float32)),
    "kimodo": write_arrays("generated.npz", posed_joints=bodies(5, 30)),
    "humanml3d": write_published(22),
    "kit": write_published(21),
    "humanact12": write_array("P01G01R01F0069T0143A0102.npy", bodies(8, 24)),
    "joints-npy": write_array("take.npy", bodies(8, 22)),
    "pose-vectors": write_vectors(lambda: humanml3d.vectors(walk(20, 2.0).joint_positions, "smpl22")),
    "interhuman": write_vectors(lambda: interhuman_rows(walk(30, 2.0))),
    "motionstreamer": write_vectors(lambda: motionstreamer_rows(walk(30, 2.0))),
    "npz": write_arrays("take.npz", joint_positions=bodies(5, 22), fps=np.array(30.0), captions=np.array(["walks"])),
    "csv": write_bytes("take.csv", b"time_seconds,a_x,a_y,a_z\n0.0,1,2,3\n0.5,1,2,3.5\n1.0,1,2,3.25\n"),
    "gltf": write_animation,
}
