"""A trained codebook as it rests in a run folder: the codes that a field reads."""

from pathlib import Path

import torch
from jaxtyping import Float32

from motionkit.training.run import RunFolder
from motionkit.training.tensors import CheckpointError, load_tensors

STAGE_NAME = "codebook"
FORMAT = "nerm-codebook"
FORMAT_VERSION = 1


def load_codes(run: RunFolder | Path) -> Float32[torch.Tensor, "codes dimension"]:
    """The codebook {e_i} that a run's first stage learnt; raises `CheckpointError` or `RunError` without one."""
    folder = (run if isinstance(run, RunFolder) else RunFolder(run)).stage(STAGE_NAME)
    if not folder.model_path.is_file():
        folder.read_summary()
    tensors, description = load_tensors(folder.model_path)
    if (description.get("format"), description.get("version")) != (FORMAT, FORMAT_VERSION) or "codes" not in tensors:
        raise CheckpointError(
            f"{folder.model_path} is {description.get('format')!r} version {description.get('version')}, expected "
            f"{FORMAT!r} version {FORMAT_VERSION}: train it again (motionkit train --stage codebook --overwrite)"
        )
    return tensors["codes"]
