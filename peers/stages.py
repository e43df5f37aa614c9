"""The peers as trainable stages; imports nothing heavy."""

from pahires.temporal.stage import temporal_stage
from peers.recipes import PEERS

LIIF, META_SR, A_LIIF, LMF, DELTA_INTERP, TS_FORMER = (
    temporal_stage(peer.name, peer.description, peer.configs, peer.make_network) for peer in PEERS
)
