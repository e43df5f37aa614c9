"""Rest joints of SMPL-family bodies from the user's own model files: J(β) = 𝒥·(T̄ + S·β).

Only .npz models are read, and of them three arrays; a .pkl is a program for Python's unpickler. Source: Loper et al.,
"SMPL: A Skinned Multi-Person Linear Model", 2015, Eq. 8 and 10; array names as in https://github.com/vchoutas/smplx.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float64

from motionkit.errors import FormatError
from motionkit.formats import sourcefile
from motionkit.formats.arrays import npz_archive
from motionkit.formats.smpl.layouts import PoseLayout

# SMPL-X files hold 300 directions of shape and then 100 of facial expression; the small ones 10 and 10.
SMPLX_DIRECTIONS, SMPLX_BETAS, SMALL_SMPLX_BETAS = 400, 300, 10


@dataclass(frozen=True, eq=False)
class BodyModel:
    """A body model reduced to its joints: `mean_joints` at rest and their `shape_directions`, in metres."""

    family: str
    gender: str
    mean_joints: Float64[np.ndarray, "joints 3"]
    shape_directions: Float64[np.ndarray, "joints 3 betas"]

    def rest_joints(self, betas: Float[np.ndarray, "betas"]) -> Float64[np.ndarray, "joints 3"]:
        """Joints of the body with these betas at rest; betas beyond the model's are left out."""
        used = min(len(betas), self.shape_directions.shape[-1])
        moved: Float64[np.ndarray, "joints 3"] = self.shape_directions[..., :used] @ betas[:used].astype(np.float64)
        joints: Float64[np.ndarray, "joints 3"] = self.mean_joints + moved
        return joints


def find_body_model(folder: Path, layout: PoseLayout, gender: str) -> BodyModel:
    """The model of a family for a gender, or its neutral one where the folder has no other.

    Raises `FormatError` (`no-body-model`) where there is none, naming the files that would do.
    """
    genders = dict.fromkeys((gender, "neutral")) if gender else ("neutral",)
    for wanted in genders:
        for path in _candidates(folder, layout.family, wanted):
            if path.is_file():
                return load_body_model(path, layout, wanted)
    pickled = [path for wanted in genders for path in _candidates(folder, layout.family, wanted, ".pkl")]
    found = next((path for path in pickled if path.is_file()), None)
    if found:
        raise FormatError(
            "is a Python pickle, which can run code when it is loaded; take the .npz that the model's site offers, or "
            "convert it as docs/formats.md shows",
            path=found,
            reason="no-body-model",
        )
    names = ", ".join(
        path.relative_to(folder).as_posix() for path in _candidates(folder, layout.family, gender or "neutral")
    )
    raise FormatError(
        f"no {layout.family} model for gender {gender or 'unknown'!r}, nor a neutral one; expected one of {names}",
        path=folder,
        reason="no-body-model",
    )


@lru_cache(maxsize=16)
def load_body_model(path: Path, layout: PoseLayout, gender: str) -> BodyModel:
    """Read a model file, once in each process; raises `FormatError` as `npz_archive` does, and `bones`."""
    archive = npz_archive.open_archive(path, sourcefile.read_bytes(path))
    template = npz_archive.read_numbers(archive, "v_template", (None, 3)).astype(np.float64)
    regressor = npz_archive.read_numbers(archive, "J_regressor", (None, len(template))).astype(np.float64)
    if len(regressor) != layout.num_joints:
        raise FormatError(
            f"J_regressor has {len(regressor)} joints, expected the {layout.num_joints} of {layout.family}",
            path=path,
            reason="bones",
        )
    directions = npz_archive.read_numbers(archive, "shapedirs", (len(template), 3, None))
    if layout.family == "smplx":
        directions = directions[..., : SMPLX_BETAS if directions.shape[-1] >= SMPLX_DIRECTIONS else SMALL_SMPLX_BETAS]
    moved = np.tensordot(regressor, directions.astype(np.float64), axes=1)
    return BodyModel(layout.family, gender, regressor @ template, moved)


def _candidates(folder: Path, family: str, gender: str, suffix: str = ".npz") -> Iterator[Path]:
    # As the sites of SMPL, MANO (SMPL-H) and SMPL-X pack them, with or without the family's folder.
    for parent in (folder / family, folder):
        yield parent / f"{family.upper()}_{gender.upper()}{suffix}"
        yield parent / gender / f"model{suffix}"
