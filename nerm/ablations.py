"""Ablations (the paper's Tables 5 to 9, and ours) as settings over a recipe.

A variant is one training run. Tables share variants, so the paper's full model is trained once for all five. The
paper's tables use its own layout of z, `global`; rows of our layout, `local`, are added where they apply.
"""

from motionkit.training.ablations import Ablation, Ablations, Entry, Variant
from motionkit.training.run import RunFolder, copy_stage
from motionkit.training.stage import StageContext
from nerm.recipes import RECIPES, NermConfig
from nerm.settings import LatentLayout
from nerm.stages import CODEBOOK, DENOISER, FIELD

# Overrides for a recipe made for the other layout.
LAYOUTS: dict[LatentLayout, tuple[str, ...]] = {
    "global": (
        "field.latents.layout=global",
        "field.latents.dimension=256",
        "field.optimizer.latent_learning_rate=1e-1",
        "denoiser.network.latent_tokens=1",
    ),
    "local": ("field.latents.layout=local",),
}
BOTH_STAGES = ("field", "denoiser")


def _variant(layout: LatentLayout, name: str = "", *change: str) -> Variant:
    """A variant with this layout of z, whichever layout the recipe has."""

    def needs(recipe: NermConfig) -> tuple[str, ...]:
        return () if recipe.field.latents.layout == layout else LAYOUTS[layout]

    either = tuple(setting for settings in LAYOUTS.values() for setting in settings)
    return Variant(f"{layout}-{name}" if name else layout, change, needs, either, ("codebook.where", "field.where"))


GLOBAL, LOCAL = _variant("global"), _variant("local")


def _both(label: str, name: str, change: str, reported: str = "") -> tuple[Entry, Entry]:
    """The same change to both layouts."""
    return (
        Entry(f"global: {label}", _variant("global", name, change), reported),
        Entry(f"local: {label}", _variant("local", name, change)),
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
                Entry("global: d = 128", _variant("global", "d-128", "field.latents.dimension=128"), "latent_dim=128"),
                Entry("global: d = 256", GLOBAL, "latent_dim=256"),
                Entry("global: d = 512", _variant("global", "d-512", "field.latents.dimension=512"), "latent_dim=512"),
                Entry(
                    "global: λ_KL = 1e-5", _variant("global", "kl-1e-5", "field.loss.kl_weight=1e-5"), "kl_weight=1e-5"
                ),
                Entry("global: λ_KL = 1e-4", GLOBAL, "kl_weight=1e-4"),
                Entry(
                    "global: λ_KL = 1e-3", _variant("global", "kl-1e-3", "field.loss.kl_weight=1e-3"), "kl_weight=1e-3"
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
                    "global: frame numbers 1 … T",
                    _variant("global", "frame-numbers", "field.encoder.coordinates=frames"),
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


def share_codebook(common: StageContext, run: RunFolder, config: NermConfig) -> None:
    """Give a run the codebook of the common run, trained first if it is missing.

    Variants differ in how the codes are used, not in the codes, so they share one codebook. A variant without codes
    gets none.
    """
    from motionkit.store.commit import read_manifest  # the list of ablations is read for --help

    if config.field.encoder.kind != "codebook":
        return
    source, target = common.run.stage(CODEBOOK.name), run.stage(CODEBOOK.name)
    with source.locked():
        if source.is_complete:
            CODEBOOK.check_kept(common, config, read_manifest(common.store).fingerprint)
        else:
            CODEBOOK.train(common, config)
    if target.is_complete and target.model_path.read_bytes() == source.model_path.read_bytes():
        return
    with target.locked():
        copy_stage(source, target)


NERM = Ablations("nerm", ABLATIONS, RECIPES, {"field": FIELD, "denoiser": DENOISER}, share_codebook, is_default=True)
