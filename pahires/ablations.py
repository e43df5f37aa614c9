"""The paper's ablations (Table 4, Figures 5 and 6) as settings over a recipe.

They share runs: the full model (ζ = 16, own activations, λ = 0.5, S = 3) is trained once for all three.
"""

from motionkit.training.ablations import Ablation, Ablations, Entry, Variant
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
STAGES = (SYSTEM.stage.name,)


def _variant(name: str, *settings: str) -> Variant:
    """A variant; the full model if no setting differs from its own."""
    change = tuple(setting for setting in settings if setting not in FULL_SETTINGS)
    return Variant(name if change else "full", change, lambda recipe: FULL_SETTINGS)


def _activation(num_sines: int, shared: bool) -> Entry:
    return Entry(
        "one activation shared by all layers" if shared else "own parameters in every layer",
        _variant(
            f"sines-{num_sines}{'-shared' if shared else ''}",
            f"network.num_sines={num_sines}",
            f"network.shared_activation={str(shared).lower()}",
        ),
        f"ζ = {num_sines}",
    )


_TABLES = (
    Ablation(
        "4",
        "sines of the activation (ζ), shared or not",
        tuple(_activation(count, shared) for shared in (False, True) for count in (1, 2, 4, 8, 16, 32)),
        STAGES,
    ),
    Ablation(
        "figure5",
        "weight of the velocity loss (λ)",
        tuple(
            Entry(
                "PA-HiRes", _variant(f"velocity-{weight}", f"training.loss.velocity_weight={weight}"), f"λ = {weight}"
            )
            for weight in ("0", "0.1", "0.5", "1", "2")
        ),
        STAGES,
    ),
    Ablation(
        "figure6",
        "number of temporal scales (S)",
        tuple(
            Entry("PA-HiRes", _variant(f"scales-{count}", f"network.frames_per_scale={frames}"), f"S = {count}")
            for count, frames in FRAMES_PER_SCALE.items()
        ),
        STAGES,
    ),
)
PAHIRES = Ablations("pahires", {ablation.table: ablation for ablation in _TABLES}, {SYSTEM.stage.name: SYSTEM.stage})
