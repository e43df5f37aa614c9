"""A single array of HumanML3D's (263) or KIT-ML's (251) pose vectors, read as joints and written as vectors again."""

import io
from pathlib import Path

import numpy as np

from motionkit.core.checksums import write_json
from motionkit.core.errors import MotionkitError
from motionkit.core.motion import Motion, Provenance
from motionkit.core.timegrid import TimeGrid, format_fps
from motionkit.features import humanml3d
from motionkit.features.humanml3d import at_origin, facing_forward
from motionkit.formats.arrays import joints_npy, npy
from motionkit.formats.humanml3d import LAYOUTS, Layout, recover_positions
from motionkit.formats.scan.items import ReadOptions
from motionkit.formats.source import clock, source_file
from motionkit.store.named_motions.holes import ReadClip, filled_rows

LAYOUT_BY_WIDTH: dict[int, Layout] = {layout.num_values: layout for layout in LAYOUTS.values()}


def accepts(path: Path) -> bool:
    """Whether a .npy file holds rows of 263 or 251 numbers."""
    shape = npy.peek_shape(path) if path.suffix.lower() == ".npy" else None
    return shape is not None and len(shape) == 2 and shape[1] in LAYOUT_BY_WIDTH


def read_vectors(path: Path, options: ReadOptions) -> ReadClip:
    """The motion of pose vectors in metres, and which rows are whole; raises `FormatError`.

    The framerate is the published one unless `motions.json` beside the file or one folder above, or `options`, say
    another. A row that holds nan is not whole; where it breaks the path off, the path goes on from the row before.
    """
    data = source_file.read_bytes(path)
    vectors = npy.parse_npy(path, data, (None, None))
    layout = LAYOUT_BY_WIDTH[vectors.shape[1]]
    filled, seen = filled_rows({"": vectors}, path)
    manifests = (folder / joints_npy.MANIFEST for folder in (path.parent, path.parent.parent))
    stated = next((read for read in map(joints_npy.read_manifest, manifests) if read.fps), None)
    fps = options.fps or (stated.fps if stated and stated.fps else layout.fps)
    checked = npy.read_npy(path, _bytes_of(filled[""]), (None, layout.num_values))
    positions = recover_positions(checked, layout.skeleton.num_joints) * np.float32(layout.unit_metres)
    operations = [f"joint positions recovered from {layout.num_values}-number pose vectors"]
    operations += clock.replaced_fps(fps, layout.fps, who="the data set")
    motion = Motion(
        joint_positions=positions,
        skeleton=layout.skeleton,
        timegrid=TimeGrid(fps, len(positions)),
        sequence_id=path.stem,
        provenance=Provenance(
            source_path=path.name,
            source_sha256=source_file.sha256(data),
            source_format=layout.name,
            stated_fps=format_fps(fps),
            operations=tuple(operations),
        ),
    )
    return ReadClip(motion, seen)


def write_vectors(motion: Motion, path: Path) -> None:
    """Write T − 1 rows for T poses, and the framerate to `motions.json` beside them.

    Rates in the vectors are per frame, so they are those of the motion's framerate. Positions are where the first frame
    is above the origin and faces Z+, as the convention has it; nothing is scaled. Raises `MotionkitError` for one pose,
    and for a folder whose `motions.json` says another framerate.
    """
    layout = next(each for each in LAYOUTS.values() if each.skeleton == motion.skeleton)
    if motion.num_frames < 2:
        raise MotionkitError("pose vectors need two poses at least")
    name = layout.skeleton.name
    positions = facing_forward(at_origin(motion.joint_positions / np.float32(layout.unit_metres)), name)
    stated = {"fps": format_fps(motion.fps), "layout": name, "vectors": humanml3d.CONVENTION}
    manifest = path.parent / joints_npy.MANIFEST
    if joints_npy.read_manifest(manifest).fps not in (None, motion.fps):
        raise MotionkitError(f"{manifest} says another framerate than {motion.fps}: one folder holds one, use --out")
    np.save(path, humanml3d.vectors(positions, name), allow_pickle=False)
    write_json(manifest, stated)


def _bytes_of(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()
