"""The convention that a setting names: for a training, and from a trained field's file."""

from collections.abc import Mapping

import torch

from motionkit.store.reader import Store
from nerm.pose_vectors.convention import PoseVectors
from nerm.pose_vectors.field import FIELD_VECTORS
from nerm.pose_vectors.native import NativeVectors
from nerm.pose_vectors.rotations import RotationVectors, smpl_rig, training_rig
from nerm.settings import PoseVectorsName

RIG = "rig.offsets"


def training_vectors(name: PoseVectorsName, store: Store, where: str | None) -> PoseVectors:
    """The convention that a training on some sequences of a store learns; raises `UsageError` as `open` does."""
    if name == "field":
        return FIELD_VECTORS
    return NativeVectors() if name == "native" else RotationVectors(training_rig(store, where))


def described(vectors: PoseVectors) -> dict[str, torch.Tensor]:
    """What a convention adds to a trained field's file: the rig of `rotations`, nothing else."""
    return {RIG: torch.from_numpy(vectors.skeleton.offsets)} if isinstance(vectors, RotationVectors) else {}


def restored(name: PoseVectorsName, tensors: Mapping[str, torch.Tensor]) -> PoseVectors:
    """A trained field's convention from its file; raises `KeyError` where the rig is missing."""
    if name == "rotations":
        return RotationVectors(smpl_rig(tensors[RIG].numpy()))
    return FIELD_VECTORS if name == "field" else NativeVectors()
