"""Planted variants of rows: the same motions with foot sliding removed."""

from collections.abc import Mapping
from dataclasses import replace

from eval.sets.generated import Window
from eval.sets.row_ids import RowId, Variant
from eval.sets.sets import Ragged, SampleSet
from motionkit.core.motion import Motion
from motionkit.core.skeleton import STANDARD_SKELETONS
from motionkit.core.timegrid import TimeGrid
from motionkit.fields.contact.planted import planted, planted_frames
from motionkit.fields.detail import Detail, detailed
from motionkit.fields.motion_field import MotionField, Observation

VARIANT_NOTES = {
    Variant.PLANTED: "the same motions with feet that stand, on bones of one length (docs/plant.md)",
    Variant.DETAILED: "the planted motions with what captures hold above 10 Hz, drawn anew (docs/detail.md)",
}
"""Tables' notes for rows of planted motion."""


def detailed_fields(fields: Mapping[Window, MotionField], detail: Detail, seed: int) -> dict[Window, MotionField]:
    """Motion fields with detail above 10 Hz, sampled for each, as `motionkit generate --detail` does."""
    return {
        window: detailed(field, detail, seed=seed, number=number)
        for number, (window, field) in enumerate(fields.items())
    }


def planted_fields(fields: Mapping[Window, MotionField]) -> dict[Window, MotionField]:
    """Planted generated motion fields, as `motionkit generate` writes them."""
    return {window: planted(field, "free") for window, field in fields.items()}


def planted_set(samples: SampleSet) -> SampleSet:
    """A set's motions planted, as `motionkit plant --path free` writes them; without rotations."""
    joints = samples.sequences.values.shape[1]
    skeleton = next(each for each in STANDARD_SKELETONS.values() if each.num_joints == joints)
    made = []
    for positions in samples.sequences:
        # Not from_joints, which refuses bodies of no person's size: a model may generate such.
        motion = Motion(positions, skeleton, TimeGrid(samples.fps, len(positions)))
        planting = planted_frames(Observation.of(motion), motion.timegrid, "free")
        made.append(planting(motion.timegrid.seconds()).joint_positions)
    name = str(RowId(samples.name, Variant.PLANTED))
    return replace(samples, name=name, sequences=Ragged.of(made), local_rotations=None)
