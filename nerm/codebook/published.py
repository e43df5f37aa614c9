"""T2M-GPT's own VQ-VAE from a local file: names and shapes checked, its statistics recognised (Zhang et al. 2023a).

The checkpoint (`net_last.pth`: key `net`, names `vqvae.…`) is read with `weights_only=True`. Its pose vectors are the
published 263 (KIT: 251) numbers in the *evaluator's* statistics, root and contacts weighted 25-fold, not in Std.npy's:
T2M-GPT takes mean.npy and std.npy from the folder `meta` of the evaluator's checkpoint (dataset_VQ.py). The field reads
the codes alone; encoding motions needs these statistics too.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from motionkit.core.errors import FormatError
from motionkit.core.shapes import Float32
from motionkit.features.layout import vector_layout
from motionkit.features.statistics import Statistics, check_statistics
from motionkit.io import npy, source_file
from motionkit.training.tensors import CheckpointError, fill_checked, foreign_tensors, read_foreign
from nerm.codebook.network import DOWNSAMPLINGS, CodebookNetwork
from nerm.settings import CodebookNetworkConfig

# T2M-GPT's README, "VQ-VAE training": 512 codes of 512 numbers, width 512, depth 3, two downsamplings, ReLU, no norm.
PUBLISHED = CodebookNetworkConfig()
JOINTS_BY_NUMBERS = {263: 22, 251: 21}
PREFIX = "vqvae."
CODES = "vqvae.quantizer.codebook"


@dataclass(frozen=True, eq=False)
class PublishedCodebook:
    """The VQ-VAE with its codes, and the statistics of its pose vectors if given."""

    network: CodebookNetwork
    num_features: int
    statistics: Statistics | None

    @property
    def codes(self) -> Float32[torch.Tensor, "codes dimension"]:
        """The codebook {e_i}."""
        return self.network.quantiser.codes


def load_published(
    path: Path, statistics: Path | None = None, config: CodebookNetworkConfig = PUBLISHED
) -> PublishedCodebook:
    """Read T2M-GPT's checkpoint, and with `statistics` the folder that holds its mean.npy and std.npy.

    Raises `CheckpointError` for any other file: one that needs unpickling, missing or unexpected names, shapes other
    than `config`'s, non-finite values, an untrained codebook; and for statistics that are not the evaluator's.
    """
    tensors = foreign_tensors(read_foreign(path), "net", path, "T2M-GPT's VQ-VAE")
    first = f"{PREFIX}encoder.model.0.weight"
    shape = tuple(tensors[first].shape) if first in tensors else ()
    if len(shape) != 3 or shape[1] not in JOINTS_BY_NUMBERS:
        raise CheckpointError(
            f"{path}: net/{first} is {shape or 'missing'}; T2M-GPT's VQ-VAE begins with pose vectors of 263 numbers "
            "(HumanML3D) or 251 (KIT)"
        )
    network = CodebookNetwork(config, shape[1]).eval().requires_grad_(False)
    fill_checked(dict(_own_tensors(network)), tensors, "net", path, "T2M-GPT's VQ-VAE")
    network.quantiser.started.fill_(True)
    _check_codes(network.quantiser.codes, path)
    found = None if statistics is None else load_evaluator_statistics(statistics, JOINTS_BY_NUMBERS[shape[1]])
    return PublishedCodebook(network, shape[1], found)


def load_evaluator_statistics(folder: Path, num_joints: int) -> Statistics:
    """mean.npy and std.npy as the published evaluators use them.

    Raises `CheckpointError` if they are missing, of another size, or the dataset's own (Mean.npy, Std.npy).
    """
    arrays, numbers = [], vector_layout(num_joints).size
    for name in ("mean.npy", "std.npy"):
        try:
            data = source_file.read_bytes(folder / name)
            arrays.append(npy.parse_npy(folder / name, data, (numbers,)).astype(np.float64))
        except FormatError as error:
            raise CheckpointError(
                f"{error}; expected the folder `meta` of the evaluator's checkpoint (VQVAEV3_CB1024_CMT_H1024_NRES3)"
            ) from None
    try:
        found = Statistics("humanml3d", *arrays)
        check_statistics(found, num_joints, "evaluator")
    except ValueError as error:
        raise CheckpointError(f"{folder}: {error}") from None
    return found


def published_name(own: str) -> str:
    """The name in T2M-GPT's checkpoint of a parameter of `CodebookNetwork.encoder` or `.decoder`.

    There each downsampling is a nested block (encdec.py): a convolution and a ResNet, or a ResNet, an upsampling and a
    convolution.
    """
    half, place, *inside = own.split(".")
    number, rest = int(place), ".".join(inside)
    rest = rest.replace("dilated", "conv1").replace("pointwise", "conv2")
    size = 2 if half == "encoder" else 3
    block, part = divmod(number - 2, size)
    if number < 2:
        return f"{PREFIX}{half}.model.{number}.{rest}"
    if block >= DOWNSAMPLINGS:
        return f"{PREFIX}{half}.model.{2 + DOWNSAMPLINGS + number - 2 - size * DOWNSAMPLINGS}.{rest}"
    is_stack = part == (1 if half == "encoder" else 0)
    return f"{PREFIX}{half}.model.{2 + block}.{part}.{'model.' if is_stack else ''}{rest}"


def _own_tensors(network: CodebookNetwork) -> Iterator[tuple[str, torch.Tensor]]:
    for half in ("encoder", "decoder"):
        for name, tensor in getattr(network, half).named_parameters(prefix=half):
            yield published_name(name), tensor
    yield CODES, network.quantiser.codes


def _check_codes(codes: Float32[torch.Tensor, "codes dimension"], path: Path) -> None:
    spread = float(codes.std(dim=0).mean())
    if spread == 0.0:
        raise CheckpointError(f"{path}: all {len(codes)} codes are the same, so this VQ-VAE was never trained")
    distinct = len(torch.unique(codes, dim=0))
    if distinct < len(codes) // 2:
        raise CheckpointError(f"{path}: only {distinct} of {len(codes)} codes differ; a trained codebook has no copies")
