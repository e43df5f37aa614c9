"""Takes as a recording of Rerun's viewer (.rrd): named joints and bones, at their own seconds (https://rerun.io)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from motionkit.core.errors import MissingExtraError
from motionkit.core.files import whole_file
from motionkit.viz.film import COLOURS
from motionkit.viz.player.takes import Take, drawing_of

# The viewer is dark: bones and what is neither left nor right are light, as the films' are not.
LIGHT = (190, 190, 190)


def write_recording(path: Path, takes: Sequence[Take]) -> None:
    """Write takes as an .rrd file: a view each, side by side, y up, in metres, on one clock in seconds.

    All native frames without NaN are included. Raises `MissingExtraError` without the extra `rerun`.
    """
    try:
        import rerun
        from rerun.blueprint import Horizontal, Spatial3DView
    except ImportError:
        raise MissingExtraError("rerun-sdk", "rerun") from None
    places = [rerun.new_entity_path([take.name]) for take in takes]
    views = [Spatial3DView(origin=place, name=take.name) for place, take in zip(places, takes, strict=True)]
    with whole_file(path) as temporary:
        recording = rerun.RecordingStream("motionkit")
        recording.save(temporary, default_blueprint=Horizontal(*views))
        for place, take in zip(places, takes, strict=True):
            _log(recording, place, take)
        recording.disconnect()


def _log(recording: object, place: str, take: Take) -> None:
    """Register joints as named key points, connected by bones."""
    import rerun

    drawing, names = drawing_of(take.skeleton, take.joint_positions), take.skeleton.joint_names
    joints = [
        rerun.AnnotationInfo(number, name, tuple(bytes.fromhex(COLOURS[side][1:])) if side else LIGHT)
        for number, (name, side) in enumerate(zip(names, drawing.sides, strict=True))
    ]
    bones = [(joint, parent) for joint, parent in enumerate(drawing.bones) if parent >= 0]
    body = rerun.ClassDescription(
        info=rerun.AnnotationInfo(0, take.name, LIGHT), keypoint_annotations=joints, keypoint_connections=bones
    )
    look = rerun.Points3D.from_fields(class_ids=[0], keypoint_ids=range(len(names)), radii=[0.012], show_labels=False)
    for each in (rerun.ViewCoordinates.RIGHT_HAND_Y_UP, rerun.AnnotationContext([body]), look):
        rerun.log(place, each, static=True, recording=recording)
    whole = np.isfinite(take.joint_positions).all(axis=(1, 2))
    clock = rerun.TimeColumn("time", duration=np.round(take.frame_seconds()[whole] * 1e9).astype("timedelta64[ns]"))
    poses = rerun.Points3D.columns(positions=take.joint_positions[whole].reshape(-1, 3))
    rerun.send_columns(place, [clock], poses.partition(np.full(int(whole.sum()), len(names))), recording=recording)
