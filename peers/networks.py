"""From a stage's settings to its network, and from a run to its encoder."""

from pathlib import Path
from typing import Any

from torch import nn

from motionkit.clips.temporal.encoder import NetworkEncoder
from motionkit.clips.temporal.training import load_network
from motionkit.core.errors import UsageError
from motionkit.fields.motion_field import MotionEncoder
from peers.a_liif import ALiif, Lmf
from peers.delta_interp import DeltaInterp
from peers.liif import Liif, MetaSr
from peers.recipes import (
    ALiifConfig,
    DeltaInterpConfig,
    LiifConfig,
    LmfConfig,
    MetaSrConfig,
    PeerConfig,
    TsFormerConfig,
)
from peers.ts_former import TsFormer


def network_of(config: PeerConfig, numbers: int) -> nn.Module:
    """The network of a peer's settings for rows of so many numbers, its weights drawn from torch's generator.

    Raises `UsageError` for blended curves, whose weights no peer answers.
    """
    if config.training.answer.curves:
        raise UsageError("peers answer rows alone, not weights of curves: leave training.answer.blended empty")
    match config:
        case LiifConfig():
            return Liif(config.network, numbers)
        case MetaSrConfig():
            return MetaSr(config.network, numbers)
        case ALiifConfig():
            return ALiif(config.network, numbers)
        case LmfConfig():
            return Lmf(config.network, numbers)
        case DeltaInterpConfig():
            return DeltaInterp(config.network, numbers)
        case TsFormerConfig():
            return TsFormer(config.network, numbers)


CONFIGS: dict[str, type[Any]] = {
    "liif": LiifConfig,
    "meta-sr": MetaSrConfig,
    "a-liif": ALiifConfig,
    "lmf": LmfConfig,
    "delta-interp": DeltaInterpConfig,
    "ts-former": TsFormerConfig,
}


def load_peer(stage: str, run: Path) -> MotionEncoder:
    """A run's trained peer, by its stage; raises `RunError` or `CheckpointError` where there is none."""
    trained = load_network(run, stage, CONFIGS[stage], network_of, lambda config: config.training)
    return NetworkEncoder(trained)
