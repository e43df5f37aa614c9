"""The generative peers as models; imports nothing heavy."""

from functools import partial

from motionkit.core.plugins import lazily
from motionkit.generate.models import ModelLoader
from peers.generative.peer import GenerativePeer
from peers.generative.recipes import PEERS


def _loader(peer: GenerativePeer) -> ModelLoader:
    stages = tuple(stage.name for stage in peer.stages)
    load = partial(lazily("peers.generative.model:load"), peer)
    return ModelLoader(peer.title, stages, load)


MDM, MDM_50, MLD, INR_MLP, ACTOR, T2M, CAMDM, FLOW, JL2P, HIER, NEMF = map(_loader, PEERS)
