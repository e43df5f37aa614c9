"""The paper's ablations (Table 4, Figures 5 and 6) as settings over a recipe.

They share runs: the full model (ζ = 16, own activations, λ = 0.5, S = 3) is trained once for all three.
"""

from motionkit.training.ablations import Ablation, Ablations, Variant
from pahires.model import SYSTEM

# The paper's own values, set explicitly since a recipe may have others.
FULL_SETTINGS = (
    "network.num_sines=16",
    "network.shared_activation=false",
    "network.frames_per_scale=2,6,14",
    "training.loss.velocity_weight=0.5",
)
# N_s for each number of scales, from the recipes' finest to their coarsest.
FRAMES_PER_SCALE = {1: "2", 2: "2,6", 3: "2,6,14", 4: "2,6,10,14", 5: "2,4,6,10,14"}


def _variant(name: str, *settings: str, label: str = "PA-HiRes", column: str) -> Variant:
    """A variant; the full model if no setting differs from its own."""
    change = tuple(setting for setting in settings if setting not in FULL_SETTINGS)
    return Variant(name if change else "full", change, label, column, needs=lambda recipe: FULL_SETTINGS)


_ACTIVATIONS = tuple(
    _variant(
        f"sines-{count}{'-shared' if shared else ''}",
        f"network.num_sines={count}",
        f"network.shared_activation={str(shared).lower()}",
        label="one activation shared by all layers" if shared else "own parameters in every layer",
        column=f"ζ = {count}",
    )
    for shared in (False, True)
    for count in (1, 2, 4, 8, 16, 32)
)
_VELOCITY_WEIGHTS = tuple(
    _variant(f"velocity-{weight}", f"training.loss.velocity_weight={weight}", column=f"λ = {weight}")
    for weight in ("0", "0.1", "0.5", "1", "2")
)
_SCALES = tuple(
    _variant(f"scales-{count}", f"network.frames_per_scale={frames}", column=f"S = {count}")
    for count, frames in FRAMES_PER_SCALE.items()
)
_STAGES = (SYSTEM.stage.name,)
_TABLES = (
    Ablation("4", "sines of the activation (ζ), shared or not", _ACTIVATIONS, _STAGES),
    Ablation("figure5", "weight of the velocity loss (λ)", _VELOCITY_WEIGHTS, _STAGES),
    Ablation("figure6", "number of temporal scales (S)", _SCALES, _STAGES),
)
PAHIRES = Ablations("pahires", {ablation.table: ablation for ablation in _TABLES}, {SYSTEM.stage.name: SYSTEM.stage})
