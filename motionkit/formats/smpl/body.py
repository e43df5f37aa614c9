"""The skeleton that a pose of the SMPL family moves: of the user's own body model, or of SMPL's mean shape."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from motionkit.formats.smpl.body_model import find_body_model
from motionkit.formats.smpl.layouts import BODY, PoseLayout
from motionkit.formats.smpl.mean_shape import mean_shape_skeleton
from motionkit.skeleton import Skeleton

# The log line of a body whose gender is not the subject's.
SUBSTITUTE = re.compile(r"joints: (?P<family>\w+) neutral \(the file's gender: (?P<gender>male|female)\)")


@dataclass(frozen=True)
class Body:
    """A skeleton and the log lines that say whose it is."""

    skeleton: Skeleton
    operations: tuple[str, ...]


def mean_body(layout: PoseLayout) -> Body:
    """The 22 joints of SMPL's mean shape; what else the layout turns is left out, and the log says so."""
    operations = ["joints: SMPL's mean shape, no body model given"]
    left_out = layout.num_joints - BODY.num_joints
    if left_out:
        operations.append(f"rotations of {left_out} joints left out (hands, face): they need a body model")
    return Body(mean_shape_skeleton(), tuple(operations))


def own_body(
    models: Path, layout: PoseLayout, family: PoseLayout, gender: str, betas: Float[np.ndarray, "betas"]
) -> Body:
    """The joints of a layout as a model of the user's folder has them for these betas.

    The body joints alone (`BODY`) are of no family, any other layout is its own. `gender` is empty where nobody says
    it. Raises `FormatError` (`no-body-model`).
    """
    model = find_body_model(models, family if layout is BODY else layout, gender)
    rest = model.rest_joints(betas)[: layout.num_joints]
    used = min(len(betas), model.shape_directions.shape[-1])
    fallback = "" if model.gender == gender else f" (the file's gender: {gender or 'unknown'})"
    line = f"joints: {model.family} {model.gender}{fallback}, {used} betas"
    return Body(layout.skeleton(f"{model.family}-{model.gender}", rest), (line,))


def substituted_body(operations: Iterable[str]) -> str:
    """What to tell of a motion by its log where a neutral body stands in for a man's or a woman's; else empty.

    Betas are of one gender's shape space: in the neutral model's they make another body.
    """
    found = next(filter(None, map(SUBSTITUTE.match, operations)), None)
    if found is None:
        return ""
    family, gender = found["family"], found["gender"]
    return (
        f"has the neutral {family} body under a {gender} subject's betas, so bone lengths are not the subject's: put "
        f"{family.upper()}_{gender.upper()}.npz into the folder of --body-models and ingest again with --overwrite"
    )
