"""The peers as other packages find them: motion encoders (`motionkit.encoders`), each for its own task.

Nothing heavy is imported before something is loaded.
"""

from pathlib import Path
from typing import Any

from motionkit.complete.encoders import EncoderLoader, Task
from motionkit.fields.motion_field import MotionEncoder
from motionkit.training.stage import Stage
from peers.stages import A_LIIF, DELTA_INTERP, LIIF, LMF, META_SR, TS_FORMER


def _loader(title: str, stage: Stage[Any], task: Task) -> EncoderLoader:
    def load(run: Path) -> MotionEncoder:
        from peers.networks import load_peer

        return load_peer(stage.name, run)

    return EncoderLoader(title, (stage.name,), load, order=stage.order, tasks=(task,))


LIIF_ENCODER = _loader("LIIF", LIIF, "interpolation")
META_SR_ENCODER = _loader("Meta-SR", META_SR, "interpolation")
A_LIIF_ENCODER = _loader("A-LIIF", A_LIIF, "interpolation")
LMF_ENCODER = _loader("LMF", LMF, "interpolation")
DELTA_INTERP_ENCODER = _loader("Δ-Interp", DELTA_INTERP, "inbetweening")
TS_FORMER_ENCODER = _loader("TS-Former", TS_FORMER, "inbetweening")
