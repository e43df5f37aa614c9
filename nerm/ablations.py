"""The ablations of the paper (Tables 5 to 9) and ours, as settings over a recipe: which runs a table is made of.

A variant is one training; tables share them, so the paper's full model is trained once for all five. The paper's
tables are about its own layout of z, `global`; rows of the `local` layout (ours) stand beside them where the question
makes sense there too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from motionkit.store.sql import conjunction
from motionkit.training.ablations import Ablation, Ablations, Entry, Sweep, check_not_varied, check_unchanged
from motionkit.training.config import apply_overrides, parse_override
from motionkit.training.run import RunFolder, copy_stage
from nerm.recipes import RECIPES, NermConfig
from nerm.settings import LatentLayout
from nerm.stages import CODEBOOK, DENOISER, FIELD

# What a recipe that was made for the other layout needs; its own layout needs nothing.
LAYOUTS: dict[LatentLayout, tuple[str, ...]] = {
    "global": (
        "field.latents.layout=global",
        "field.latents.dimension=256",
        "field.latents.initialisation=normal",
        "field.decoder.linear_path=false",
        "field.optimizer.latent_learning_rate=1e-1",
        "denoiser.network.latent_tokens=1",
    ),
    "local": ("field.latents.layout=local",),
}
BOTH_STAGES = ("field", "denoiser")


@dataclass(frozen=True)
class Variant:
    """One training: a layout of z, and what it changes in a recipe that has this layout."""

    name: str
    layout: LatentLayout
    change: tuple[str, ...] = ()

    @property
    def varied(self) -> frozenset[str]:
        """Keys of its change, and of what the two layouts need."""
        settings = (*self.change, *(setting for layout in LAYOUTS.values() for setting in layout))
        return frozenset(parse_override(setting)[0] for setting in settings)

    def configure(self, recipe: NermConfig, overrides: Sequence[str] = (), where: str | None = None) -> NermConfig:
        """A recipe's configuration with the layout, overrides that all variants share, and this one's change.

        `where` (SQL) narrows the sequences of all stages. Raises `UsageError` for an override of what is varied.
        """
        check_not_varied(self, overrides)
        narrowed = [
            f"{stage}.where={conjunction(getattr(recipe, stage).where, where)}"
            for stage in ("codebook", "field")
            if where
        ]
        return apply_overrides(recipe, [*self.settings(recipe), *narrowed, *overrides])

    def settings(self, recipe: NermConfig) -> tuple[str, ...]:
        """What is set in a recipe: the layout's settings where it has the other layout, and the change."""
        layout = () if recipe.field.latents.layout == self.layout else LAYOUTS[self.layout]
        return (*layout, *self.change)


GLOBAL = Variant("global", "global")
LOCAL = Variant("local", "local")


def _changed(base: Variant, name: str, *change: str) -> Variant:
    return Variant(f"{base.name}-{name}", base.layout, change)


def _both(label: str, name: str, change: str, reported: str = "") -> tuple[Entry, Entry]:
    """The same change to either layout."""
    return (
        Entry(f"global: {label}", _changed(GLOBAL, name, change), reported),
        Entry(f"local: {label}", _changed(LOCAL, name, change)),
    )


_NO_TIME = _both("no coordinate at all", "no-time", "field.encoder.kind=none")
_RAW_TIME = _both("the coordinate itself", "raw-time", "field.encoder.kind=raw", "no time encoding")
_FOURIER = _both("Fourier features", "fourier", "field.encoder.kind=fourier", "fourier")
_POINT = _both(
    "one z a window, no distribution (Eq. 9)", "non-variational", "field.latents.variational=false", "non-variational"
)
_TRANSFORMER = _both("transformer", "transformer", "field.decoder.kind=transformer", "transformer decoder")
_WARMUP_NONE = _both("no warm-up at one framerate", "warmup-0", "field.clips.warmup_fraction=0")
_WARMUP_HALF = _both("half of the steps at 20 fps", "warmup-50", "field.clips.warmup_fraction=0.5")
_FIXED = _both("all steps at 20 fps (NeRM-fixed)", "fixed-20", "field.clips.fixed_fps=20", "NeRM-fixed")

ABLATIONS: dict[str, Ablation] = {
    ablation.table: ablation
    for ablation in (
        Ablation(
            "5",
            "time encoding",
            (
                _NO_TIME[0],
                _RAW_TIME[0],
                _FOURIER[0],
                Entry("global: Fourier features and codebook", GLOBAL, "codebook"),
                _NO_TIME[1],
                _FOURIER[1],
                Entry("local: Fourier features and codebook", LOCAL),
            ),
            BOTH_STAGES,
        ),
        Ablation(
            "6",
            "variational latents",
            (
                _POINT[0],
                Entry("global: variational", GLOBAL, "variational"),
                _POINT[1],
                Entry("local: variational", LOCAL),
            ),
            BOTH_STAGES,
        ),
        Ablation("7", "decoder", (_TRANSFORMER[0], Entry("global: MLP", GLOBAL, "mlp decoder")), BOTH_STAGES),
        Ablation(
            "8",
            "size of z and weight of the KL term",
            (
                Entry("global: d = 128", _changed(GLOBAL, "d-128", "field.latents.dimension=128"), "latent_dim=128"),
                Entry("global: d = 256", GLOBAL, "latent_dim=256"),
                Entry("global: d = 512", _changed(GLOBAL, "d-512", "field.latents.dimension=512"), "latent_dim=512"),
                Entry(
                    "global: λ_KL = 1e-5", _changed(GLOBAL, "kl-1e-5", "field.loss.kl_weight=1e-5"), "kl_weight=1e-5"
                ),
                Entry("global: λ_KL = 1e-4", GLOBAL, "kl_weight=1e-4"),
                Entry(
                    "global: λ_KL = 1e-3", _changed(GLOBAL, "kl-1e-3", "field.loss.kl_weight=1e-3"), "kl_weight=1e-3"
                ),
            ),
            ("field",),
        ),
        Ablation(
            "9",
            "time normalisation",
            (
                # Knots lie at normalised coordinates, so this table has no rows of the local layout.
                Entry(
                    "global: frame numbers 1 … T", _changed(GLOBAL, "frame-numbers", "field.encoder.coordinates=frames")
                ),
                Entry("global: normalised to [−1, 1]", GLOBAL),
            ),
            BOTH_STAGES,
        ),
        Ablation(
            "ours",
            "layout of z, and framerates in training",
            (
                Entry("global: as the recipe", GLOBAL),
                _WARMUP_NONE[0],
                _WARMUP_HALF[0],
                _FIXED[0],
                Entry("local: as the recipe", LOCAL),
                _WARMUP_NONE[1],
                _WARMUP_HALF[1],
                _FIXED[1],
            ),
            BOTH_STAGES,
        ),
    )
}


CODEBOOK_SEED = 0


def share_codebook(sweep: Sweep, run: RunFolder, config: NermConfig) -> None:
    """Give a run the codebook of RUNS/PREFIX, which is trained first where there is none.

    The variants differ in how the codes are used, not in the codes, so they have the same ones. One that uses none gets
    none.
    """
    if config.field.encoder.kind != "codebook":
        return
    common = RunFolder(sweep.runs / sweep.prefix)
    context = sweep.context(common, CODEBOOK_SEED, overwrite=False)
    source, target = common.stage(CODEBOOK.name), run.stage(CODEBOOK.name)
    if source.is_complete:
        check_unchanged(context, CODEBOOK, config)
    else:
        CODEBOOK.train(context, config)
    if target.is_complete and target.model_path.read_bytes() == source.model_path.read_bytes():
        return
    copy_stage(source, target)


NERM = Ablations("nerm", ABLATIONS, RECIPES, {"field": FIELD, "denoiser": DENOISER}, share_codebook, is_default=True)
