"""The paper's ablations (Table 4, Figures 5 and 6) as settings over a recipe.

They share runs: the full model (ζ = 16, own activations, λ = 0.5, S = 3) is trained once for all three.
"""

from motionkit.training.ablations import Ablation, Ablations, Entry, Variant
from pahires.model import SYSTEM
from pahires.recipes import RECIPES

SINES = (1, 2, 4, 8, 16, 32)
VELOCITY_WEIGHTS = ("0", "0.1", "0.5", "1", "2")
# N_s for each number of scales, from the recipes' finest to their coarsest.
FRAMES_PER_SCALE = {1: (2,), 2: (2, 6), 3: (2, 6, 14), 4: (2, 6, 10, 14), 5: (2, 4, 6, 10, 14)}


# The paper's own values, set explicitly since a recipe may have others.
FULL_SETTINGS = (
    "network.num_sines=16",
    "network.shared_activation=false",
    "network.frames_per_scale=2,6,14",
    "training.loss.velocity_weight=0.5",
)


def _variant(name: str, *change: str) -> Variant:
    return Variant(name, change, needs=lambda recipe: FULL_SETTINGS, conditions=("training.where",))


FULL = _variant("full")


def _activation(num_sines: int, shared: bool) -> Variant:
    if num_sines == 16 and not shared:
        return FULL
    sharing = ("network.shared_activation=true",) if shared else ()
    return _variant(f"sines-{num_sines}{'-shared' if shared else ''}", f"network.num_sines={num_sines}", *sharing)


def _scales(count: int) -> Variant:
    frames = ",".join(map(str, FRAMES_PER_SCALE[count]))
    return FULL if count == 3 else _variant(f"scales-{count}", f"network.frames_per_scale={frames}")


def _velocity(weight: str) -> Variant:
    return FULL if weight == "0.5" else _variant(f"velocity-{weight}", f"training.loss.velocity_weight={weight}")


OWN, SHARED = "own parameters in every layer", "one activation shared by all layers"
TABLES: dict[str, Ablation] = {
    ablation.table: ablation
    for ablation in (
        Ablation(
            "4",
            "sines of the activation (ζ), shared or not",
            tuple(
                Entry(SHARED if shared else OWN, _activation(count, shared), column=f"ζ = {count}")
                for shared in (False, True)
                for count in SINES
            ),
            ("pahires",),
        ),
        Ablation(
            "figure5",
            "weight of the velocity loss (λ)",
            tuple(Entry("PA-HiRes", _velocity(weight), column=f"λ = {weight}") for weight in VELOCITY_WEIGHTS),
            ("pahires",),
        ),
        Ablation(
            "figure6",
            "number of temporal scales (S)",
            tuple(Entry("PA-HiRes", _scales(count), column=f"S = {count}") for count in FRAMES_PER_SCALE),
            ("pahires",),
        ),
    )
}
PAHIRES = Ablations("pahires", TABLES, RECIPES, {"pahires": SYSTEM.stage})
