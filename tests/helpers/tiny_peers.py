"""The generative peers at a size of seconds, on four captioned motions that are known."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import motionkit as mk
from motionkit.training.config import Schedule
from motionkit.training.run import RunFolder, StageContext
from peers.diffusion import (
    CAMDM,
    FLOW,
    MDM,
    MDM_50,
    MLD,
    MLD_VAE,
    CamdmNetworkConfig,
    FlowNetworkConfig,
    MldNetworkConfig,
    MldVaeNetworkConfig,
)
from peers.generating import PeerStage
from peers.latents import ACTOR, INR_MLP, NEMF, NEMF_PATH, InrMlpNetworkConfig, NemfNetworkConfig, NemfPathNetworkConfig
from peers.layers import TransformerSizes
from peers.motions import ConditionsConfig, MotionsConfig
from peers.recurrent import (
    HIER,
    JL2P,
    T2M,
    T2M_AUTOENCODER,
    HierNetworkConfig,
    Jl2pNetworkConfig,
    T2mAutoencoderNetworkConfig,
    T2mNetworkConfig,
)
from tests.helpers.nerm_corpus import analytic_positions

EVERY = (MDM, MDM_50, MLD_VAE, MLD, INR_MLP, ACTOR, T2M_AUTOENCODER, T2M, CAMDM, FLOW, JL2P, HIER, NEMF_PATH, NEMF)
STAGES: dict[str, PeerStage] = {stage.name: stage for stage in EVERY}
STEPS = 12
SIZES = TransformerSizes(3, 32, 2, 64, 0.0)
MOTIONS = MotionsConfig(max_frames=60, min_seconds=1.0, stride_seconds=1.0, mirrored=False)
ACTIONS = ConditionsConfig(kind="action")
SCHEDULE = Schedule(steps=STEPS, batch_size=8, learning_rate=2e-3)
NETWORKS: dict[str, Any] = {
    "mld-vae": MldVaeNetworkConfig(SIZES, longest=80),
    "mld": MldNetworkConfig(SIZES, time_features=32),
    "inr-mlp": InrMlpNetworkConfig(code=16, time_features=16, hidden=(64, 32), reseeds=0),
    "t2m-autoencoder": T2mAutoencoderNetworkConfig(width=32, dropout=0.0),
    "t2m": T2mNetworkConfig(width=32, value=16, latent=8, first_units=4, last_units=15),
    "camdm": CamdmNetworkConfig(SIZES, past=4, future=12),
    "jl2p": Jl2pNetworkConfig(width=32, lengths=(4, 15), mean_first=0.5),
    "hier": HierNetworkConfig(part=8, limb=16, width=32, critic=(8, 16), mean_first=0.5),
    "nemf-path": NemfPathNetworkConfig(widths=(16,), kernel=5),
    "nemf": NemfNetworkConfig(64, (16, 16), local_latent=16, turn_latent=8, width=32, local_layers=3, turn_layers=1),
    "flow": FlowNetworkConfig(TransformerSizes(2, 32, 2, 48, 0.0), sampling_steps=8, guidance_scale=2.0),
}
# Stages that see no condition.
UNCONDITIONAL = ("mld-vae", "t2m-autoencoder", "nemf-path", "nemf")


def tiny_config(name: str, **changed: Any) -> Any:
    """A stage's configuration, small; parts may be given."""
    stage = STAGES[name]
    published = stage.paper.motions
    frames = {"camdm": 16, "jl2p": 15, "hier": 15}.get(name, published.sampled_frames)
    parts = {
        "network": NETWORKS.get(name) or replace(stage.paper.network, transformer=SIZES),
        "motions": replace(
            MOTIONS,
            pose_vectors=published.pose_vectors,
            crops=published.crops,
            sampled_frames=frames,
        ),
        "conditions": ConditionsConfig(kind="none") if name in UNCONDITIONAL else ACTIONS,
        "schedule": SCHEDULE,
        "ema_decay": 0.9 if name == "mdm-50" else 0.0,
    }
    return stage.config_type(**(parts | changed))


def write_captioned_store(
    path: Path, motions: int = 4, seconds: int = 4, *, captioned: bool = True, held_out: int = 1
) -> Path:
    """Takes at 60 fps of other kinds, each with a caption and an action; the last, `held_out` times, for testing."""
    with mk.StoreWriter.create(path) as writer:
        for index in range(motions + held_out):
            kind = min(index, motions - 1)
            grid = mk.TimeGrid(Fraction(60), 60 * seconds + 1)
            writer.add(
                mk.Motion(
                    analytic_positions(grid.seconds(), kind),
                    mk.SMPL22,
                    grid,
                    split="test" if index >= motions else "train",
                    sequence_id=f"take-{index}",
                    action=f"kind-{kind}",
                    captions=(mk.Caption(f"motion of kind {kind}"),) if captioned else (),
                )
            )
    return path


def train_peer(name: str, store: Path, run: Path, config: Any = None, *, resume: bool = False) -> None:
    """Train one stage of a run on the CPU."""
    context = StageContext(store, RunFolder(run), "tiny", seed=1, resume=resume, device="cpu")
    stage, chosen = STAGES[name].stage, config or tiny_config(name)
    stage.check(context, chosen)
    stage.train(context, chosen)
