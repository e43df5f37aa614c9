"""The generative peers, each with its stages, networks and recipes. Imports nothing heavy.

`paper` has the published sizes, batch size and steps; `nano` trains small networks in about the CPU time of NeRM's
`nano`: 18 minutes on one core for all stages together.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from motionkit.training.config import Schedule
from peers.generative.peer import GenerativePeer, PeerStage
from peers.generative.settings import (
    ActorNetworkConfig,
    CamdmNetworkConfig,
    ConditionsConfig,
    FlowNetworkConfig,
    HierNetworkConfig,
    InrMlpNetworkConfig,
    Jl2pNetworkConfig,
    MdmNetworkConfig,
    MldNetworkConfig,
    MldVaeNetworkConfig,
    MotionsConfig,
    NemfNetworkConfig,
    NemfPathNetworkConfig,
    OptimizerConfig,
    T2mAutoencoderNetworkConfig,
    T2mNetworkConfig,
    TransformerSizes,
)

Recipe = Mapping[str, Any]


def _cosine(steps: int, batch_size: int, learning_rate: float) -> Schedule:
    return Schedule(
        steps=steps, batch_size=batch_size, learning_rate=learning_rate, kind="cosine", warmup_fraction=0.02
    )


def _of_one_stage(
    title: str, name: str, order: int, description: str, network: str, *, nano: Recipe, paper: Recipe
) -> GenerativePeer:
    return GenerativePeer(title, (PeerStage(name, order, description, network, {"nano": nano, "paper": paper}),))


# Whole windows, of which a step sees five frames.
WHOLE_IN_5 = MotionsConfig(pose_vectors="field", crops="whole", seen="scattered", seen_frames=5)
IN_24 = MotionsConfig(seen="stretch", seen_frames=24)
STRETCHES = MotionsConfig(fps=30.0, max_frames=294, seen="stretch", seen_frames=55)
COORDINATES = MotionsConfig(pose_vectors="field", crops="whole")

UNCONDITIONAL = ConditionsConfig(kind="none")
MINILM = ConditionsConfig(text_encoder="minilm", scaled=True)
# Two heads of 64 and no dropout: attention over 196 frames is twice as fast on a CPU.
SMALL = TransformerSizes(4, 128, 2, 256, dropout=0.0)
MDM_PAPER = {"network": MdmNetworkConfig(), "schedule": Schedule(steps=600_000)}
MDM_NANO = {
    "network": MdmNetworkConfig(SMALL),
    "conditions": MINILM,
    "schedule": _cosine(6000, 16, 1e-3),
    "optimizer": OptimizerConfig(ema_decay=0.995),
    "precision": "auto",
}


def _in_50_steps(parts: Mapping[str, Any], ema_decay: float) -> dict[str, Any]:
    """The same training with 50 diffusion steps."""
    diffusion = replace(parts["network"].diffusion, num_steps=50, sampling_steps=50)
    network = replace(parts["network"], diffusion=diffusion)
    return {**parts, "network": network, "optimizer": OptimizerConfig(ema_decay=ema_decay)}


MDM = _of_one_stage(
    "MDM",
    "mdm",
    80,
    "MDM: diffusion of whole motions in 1,000 steps (NeRM's peer)",
    "peers.generative.networks.mdm:Mdm",
    nano=MDM_NANO,
    paper=MDM_PAPER,
)
MDM_50 = _of_one_stage(
    "MDM, 50 steps",
    "mdm-50",
    81,
    "MDM trained with 50 diffusion steps",
    "peers.generative.networks.mdm:Mdm",
    nano=_in_50_steps(MDM_NANO, 0.995),
    paper=_in_50_steps(MDM_PAPER, 0.9999),
)
SMALL_SKIPS = TransformerSizes(5, 128, 2, 256, dropout=0.0)
MLD = GenerativePeer(
    "MLD",
    (
        PeerStage(
            "mld-vae",
            82,
            "MLD, stage 1: a VAE of whole motions",
            "peers.generative.networks.mld:MldVae",
            {
                "nano": {
                    "network": MldVaeNetworkConfig(SMALL_SKIPS),
                    "conditions": UNCONDITIONAL,
                    "schedule": Schedule(
                        steps=1200, batch_size=16, learning_rate=5e-4, kind="cosine", warmup_fraction=0.1
                    ),
                    "precision": "auto",
                },
                "paper": {
                    "network": MldVaeNetworkConfig(),
                    "conditions": UNCONDITIONAL,
                    "schedule": Schedule(epochs=6000, batch_size=128),
                    "optimizer": OptimizerConfig(weight_decay=0.01),
                },
            },
        ),
        PeerStage(
            "mld",
            83,
            "MLD, stage 2: diffusion of the VAE's latents",
            "peers.generative.networks.mld:Mld",
            {
                "nano": {
                    "network": MldNetworkConfig(SMALL_SKIPS, time_features=128, noises=8),
                    "conditions": replace(MINILM, nothing="empty"),
                    "schedule": _cosine(4000, 16, 3e-3),
                    "optimizer": OptimizerConfig(ema_decay=0.995),
                    "precision": "auto",
                },
                "paper": {
                    "network": MldNetworkConfig(),
                    "conditions": ConditionsConfig(nothing="empty"),
                    "schedule": Schedule(epochs=2000),
                    "optimizer": OptimizerConfig(weight_decay=0.01),
                },
            },
            builds_on=("mld-vae",),
        ),
    ),
)
# Without diffusion there is no guidance, so no condition is dropped.
GIVEN = ConditionsConfig(drop=0.0)
GIVEN_NANO = replace(MINILM, drop=0.0)


INR_MLP = _of_one_stage(
    "INR-MLP",
    "inr-mlp",
    84,
    "INR-MLP: an MLP of time and a latent code per training motion",
    "peers.generative.networks.inr_mlp:InrMlp",
    nano={
        "network": InrMlpNetworkConfig(reseeds=2),
        "motions": WHOLE_IN_5,
        "conditions": GIVEN_NANO,
        "schedule": _cosine(12_000, 256, 1e-3),
        "optimizer": OptimizerConfig(clip_norm=2.0),
        "precision": "auto",
    },
    paper={
        "network": InrMlpNetworkConfig(),
        "motions": WHOLE_IN_5,
        "conditions": replace(GIVEN, kind="action"),
        "schedule": Schedule(epochs=10_000, batch_size=512, learning_rate=1e-3),
        "optimizer": OptimizerConfig(clip_norm=2.0),
    },
)
ACTOR = _of_one_stage(
    "ACTOR",
    "actor",
    85,
    "ACTOR: a conditional VAE of whole motions",
    "peers.generative.networks.actor:Actor",
    nano={
        "network": ActorNetworkConfig(SMALL),
        "conditions": GIVEN_NANO,
        "schedule": _cosine(2900, 16, 5e-4),
        "precision": "auto",
    },
    paper={
        "network": ActorNetworkConfig(),
        "motions": MotionsConfig(max_frames=60),
        "conditions": replace(GIVEN, kind="action"),
        "schedule": Schedule(epochs=5000, batch_size=20),
        "optimizer": OptimizerConfig(weight_decay=0.01),
    },
)
T2M = GenerativePeer(
    "T2M",
    (
        PeerStage(
            "t2m-autoencoder",
            86,
            "T2M, stage 1: snippets of four frames",
            "peers.generative.networks.t2m:T2mAutoencoder",
            {
                "nano": {
                    "network": T2mAutoencoderNetworkConfig(width=192),
                    "motions": IN_24,
                    "conditions": UNCONDITIONAL,
                    "schedule": _cosine(4000, 128, 3e-3),
                    "precision": "auto",
                },
                "paper": {
                    "network": T2mAutoencoderNetworkConfig(),
                    "motions": IN_24,
                    "conditions": UNCONDITIONAL,
                    "schedule": Schedule(epochs=270, batch_size=128),
                },
            },
            share=0.3,
        ),
        PeerStage(
            "t2m",
            87,
            "T2M, stage 2: a conditional recurrent VAE of snippets",
            "peers.generative.networks.t2m:T2m",
            {
                "nano": {
                    "network": T2mNetworkConfig(width=256, value=128, latent=64),
                    "conditions": GIVEN_NANO,
                    "schedule": _cosine(1500, 32, 5e-4),
                    "optimizer": OptimizerConfig(clip_norm=0.5),
                },
                "paper": {
                    "network": T2mNetworkConfig(),
                    "conditions": GIVEN,
                    "schedule": Schedule(steps=300_000, batch_size=32, learning_rate=2e-4),
                    "optimizer": OptimizerConfig(clip_norm=0.5),
                },
            },
            builds_on=("t2m-autoencoder",),
            share=0.7,
        ),
    ),
)
CAMDM = _of_one_stage(
    "CAMDM",
    "camdm",
    88,
    "CAMDM: autoregressive diffusion of motion segments in 4 steps",
    "peers.generative.networks.camdm:Camdm",
    nano={
        "network": CamdmNetworkConfig(SMALL),
        "motions": STRETCHES,
        "conditions": replace(MINILM, drop=0.15),
        "schedule": _cosine(6000, 64, 3e-3),
        "optimizer": OptimizerConfig(ema_decay=0.995),
        "precision": "auto",
    },
    paper={
        "network": CamdmNetworkConfig(),
        "motions": STRETCHES,
        "conditions": ConditionsConfig(drop=0.15),
        "schedule": Schedule(epochs=100, batch_size=512),
        "optimizer": OptimizerConfig(weight_decay=0.01),
    },
)
FLOW = _of_one_stage(
    "ACMDM-S (flow)",
    "flow",
    89,
    "ACMDM's small form: a rectified flow of absolute coordinates",
    "peers.generative.networks.flow:Flow",
    nano={
        "network": FlowNetworkConfig(TransformerSizes(4, 128, 2, 341, 0.0), sampling_steps=25, guidance_scale=1.0),
        "motions": COORDINATES,
        "conditions": MINILM,
        "schedule": _cosine(5000, 16, 3e-3),
        "optimizer": OptimizerConfig(ema_decay=0.995),
        "precision": "auto",
    },
    paper={
        "network": FlowNetworkConfig(),
        "motions": COORDINATES,
        "schedule": Schedule(epochs=500, learning_rate=2e-4),
        "optimizer": OptimizerConfig(weight_decay=0.01, ema_decay=0.9999),
    },
)
# Every twelfth frame of KIT's 100 fps; 9.8 s, as the others.
SLOW = MotionsConfig(fps=25 / 3, max_frames=82)
JL2P = _of_one_stage(
    "JL2P",
    "jl2p",
    90,
    "JL2P: autoregressive poses from a joint code of motions and texts",
    "peers.generative.networks.jl2p:Jl2p",
    nano={
        "network": Jl2pNetworkConfig(width=256, lengths=(2, 4, 8, 16, 32, 82), mean_first=0.5),
        "motions": SLOW,
        "conditions": GIVEN_NANO,
        "schedule": _cosine(6000, 64, 1e-3),
        "optimizer": OptimizerConfig(clip_norm=1.0),
    },
    paper={
        "network": Jl2pNetworkConfig(),
        "motions": replace(SLOW, seen="stretch", seen_frames=16),
        "conditions": GIVEN,
        "schedule": Schedule(
            epochs=1000, batch_size=100, learning_rate=1e-3, kind="steps", drop=0.99, drop_every=0.001
        ),
    },
)
HIER = _of_one_stage(
    "Hier",
    "hier",
    91,
    "Hier: autoregressive poses from one code for each half of the body",
    "peers.generative.networks.hier:Hier",
    nano={
        "network": HierNetworkConfig(limb=64, width=160, mean_first=0.5),
        "motions": SLOW,
        "conditions": GIVEN_NANO,
        "schedule": _cosine(2400, 32, 3e-3),
        "optimizer": OptimizerConfig(clip_norm=1.0),
    },
    paper={
        "network": HierNetworkConfig(),
        "motions": replace(SLOW, seen="stretch", seen_frames=32),
        "conditions": GIVEN,
        "schedule": Schedule(
            epochs=300, batch_size=32, learning_rate=1e-3, kind="steps", drop=0.99, drop_every=1 / 300
        ),
    },
)
CLIPS = MotionsConfig(fps=30.0, max_frames=128, min_seconds=128 / 30)
LONG = MotionsConfig(fps=30.0, max_frames=294)
NEMF = GenerativePeer(
    "NeMF",
    (
        PeerStage(
            "nemf-path",
            92,
            "NeMF, stage 1: the root's path from the body's motion",
            "peers.generative.networks.nemf:NemfPath",
            {
                "nano": {
                    "network": NemfPathNetworkConfig(widths=(64, 64, 64)),
                    "motions": LONG,
                    "conditions": UNCONDITIONAL,
                    "schedule": _cosine(2200, 16, 1e-3),
                    "precision": "auto",
                },
                "paper": {
                    "network": NemfPathNetworkConfig(),
                    "motions": CLIPS,
                    "conditions": UNCONDITIONAL,
                    "schedule": Schedule(epochs=1000, batch_size=16),
                    "optimizer": OptimizerConfig(weight_decay=1e-4),
                },
            },
            share=0.2,
        ),
        PeerStage(
            "nemf",
            93,
            "NeMF, stage 2: a neural field over time, and a VAE of its latents",
            "peers.generative.networks.nemf:Nemf",
            {
                "nano": {
                    "network": NemfNetworkConfig(
                        304, (64, 96, 128, 128), local_latent=128, turn_latent=32, width=192, kl_cycles=4
                    ),
                    "motions": LONG,
                    "conditions": UNCONDITIONAL,
                    "schedule": _cosine(2400, 32, 1e-3),
                    "precision": "auto",
                },
                "paper": {
                    "network": NemfNetworkConfig(),
                    "motions": CLIPS,
                    "conditions": UNCONDITIONAL,
                    "schedule": Schedule(epochs=1000, batch_size=16),
                    "optimizer": OptimizerConfig(weight_decay=1e-4),
                },
            },
            builds_on=("nemf-path",),
            share=0.8,
        ),
    ),
    conditional=False,
)
PEERS = (MDM, MDM_50, MLD, INR_MLP, ACTOR, T2M, CAMDM, FLOW, JL2P, HIER, NEMF)
