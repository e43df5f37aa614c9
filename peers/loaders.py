"""The peers as motion encoders for their tasks; imports nothing heavy."""

from pathlib import Path

from motionkit.edit.encoders import EncoderLoader
from motionkit.fields.motion_field import MotionEncoder
from pahires.temporal.stage import load_encoder
from peers.recipes import PEERS, Peer


def _loader(peer: Peer) -> EncoderLoader:
    def load(run: Path) -> MotionEncoder:
        return load_encoder(run, peer.name, peer.config_type, peer.make_network, peer.title)

    return EncoderLoader(peer.title, (peer.name,), load, tasks=(peer.task,))


LIIF_ENCODER, META_SR_ENCODER, A_LIIF_ENCODER, LMF_ENCODER, DELTA_INTERP_ENCODER, TS_FORMER_ENCODER = (
    _loader(peer) for peer in PEERS
)
