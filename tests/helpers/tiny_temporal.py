"""PA-HiRes and its peers at a size of seconds."""

from dataclasses import replace
from typing import Any

from motionkit.training.config import apply_overrides
from pahires.recipes import NetworkSettings, PaHiResConfig, nano
from pahires.temporal.settings import TaskSettings, TemporalSettings
from peers.inbetweening import DELTA_INTERP, TS_FORMER, DeltaInterpNetworkConfig, TsFormerNetworkConfig
from peers.super_resolution import (
    A_LIIF,
    LIIF,
    LMF,
    META_SR,
    ALiifNetworkConfig,
    EdsrConfig,
    LiifNetworkConfig,
    LmfNetworkConfig,
    MetaSrNetworkConfig,
)
from tests.helpers.small_network import TASKS

PAHIRES_NETWORK = NetworkSettings(
    frames_per_scale=(2, 4, 6), embedding=16, code=16, attention_tokens=4, hidden=24, decoder_layers=2, num_sines=4
)
PAHIRES = PaHiResConfig(
    network=PAHIRES_NETWORK,
    training=apply_overrides(
        replace(nano().training, tasks=TASKS, mirrored=False, ema_decay=0.0),
        ["schedule.steps=40", "schedule.batch_size=8"],
    ),
)
EDSR = EdsrConfig(blocks=1, features=8)
ON_GRIDS = apply_overrides(
    TemporalSettings(tasks=TaskSettings(num_frames=6, num_queries=8)),
    ["schedule.steps=60", "schedule.batch_size=8", "schedule.learning_rate=0.003"],
)
WITH_GAPS = replace(
    ON_GRIDS, tasks=TaskSettings(0.0, 1.0, past_frames=4, future_frames=2, longest_gap=9, num_queries=8)
)
SYSTEMS = {each.name: each for each in (LIIF, META_SR, A_LIIF, LMF, DELTA_INTERP, TS_FORMER)}
SIZES: dict[str, Any] = {
    "liif": LiifNetworkConfig(EDSR, 32, 2),
    "meta-sr": MetaSrNetworkConfig(EDSR, 16),
    "a-liif": ALiifNetworkConfig(EDSR, 16, 2, 3, 16, 2),
    "lmf": LmfNetworkConfig(EDSR, 16, 2),
    "delta-interp": DeltaInterpNetworkConfig(32, 1, 2, 2, 4, 32, 0.2),
    "ts-former": TsFormerNetworkConfig(16, 1, 2, 8, 16),
}
GAPS = ("delta-interp", "ts-former")
TEMPORAL_PEERS: dict[str, Any] = {
    name: SYSTEMS[name].config_type(sizes, WITH_GAPS if name in GAPS else ON_GRIDS) for name, sizes in SIZES.items()
}
