"""The generative peers as trainable stages; imports nothing heavy."""

from functools import partial
from typing import Any

from motionkit.core.plugins import lazily
from motionkit.training.stage import Stage
from peers.generative.peer import GenerativePeer, PeerStage
from peers.generative.recipes import PEERS


def _stage(peer: GenerativePeer, stage: PeerStage) -> Stage[Any]:
    return Stage(
        stage.name,
        stage.description,
        stage.configs,
        partial(lazily("peers.generative.training:train_stage"), peer, stage),
        in_all=False,
        check=lazily("peers.generative.training:check_stage"),
        builds_on=lambda config: stage.builds_on,
        share=stage.share,
    )


STAGES = {stage.name: _stage(peer, stage) for peer in PEERS for stage in peer.stages}
MDM, MDM_50, MLD_VAE, MLD, INR_MLP, ACTOR, T2M_AUTOENCODER, T2M, CAMDM, FLOW, JL2P, HIER, *_NEMF = STAGES.values()
NEMF_PATH, NEMF = _NEMF
