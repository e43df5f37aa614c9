"""Ablations (the paper's Tables 5 to 9, and ours) as settings over a recipe.

A variant is one training run. Tables share variants, so the paper's full model is trained once for all five. The
paper's tables use its own layout of z, `global`; rows of our layout, `local`, are added where they apply.
"""

from motionkit.core.files import write_whole
from motionkit.training.ablations import Ablation, Ablations, Entry, Variant
from motionkit.training.run import RunFolder, StageContext, clear_stage
from nerm.recipes import CODEBOOK, DENOISER, FIELD, RECIPES, LatentLayout, NermConfig

# Overrides for a recipe made for the other layout.
LAYOUTS: dict[LatentLayout, tuple[str, ...]] = {
    "global": (
        "field.latents.layout=global",
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


def _row(layout: LatentLayout, label: str, name: str = "", change: str = "", reported: str = "") -> Entry:
    """A row that changes a setting of a layout; `name` is the variant's, "" for the layout as the recipe has it."""
    variant = _variant(layout, name, change) if name else _variant(layout)
    return Entry(f"{layout}: {label}", variant, reported)


_NO_TIME = ("no coordinate at all", "no-time", "field.encoder.kind=none")
_FOURIER = ("Fourier features", "fourier", "field.encoder.kind=fourier")
_POINT = ("one z a window, no distribution (Eq. 9)", "non-variational", "field.latents.variational=false")
_UNWARMED = ("no warm-up at one framerate", "warmup-0", "field.clips.warmup_fraction=0")
_WARMED = ("half of the steps at 20 fps", "warmup-50", "field.clips.warmup_fraction=0.5")
_FIXED = ("all steps at 20 fps (NeRM-fixed)", "fixed-20", "field.clips.fixed_fps=20")
_TABLES: tuple[tuple[str, str, tuple[str, ...], tuple[Entry, ...]], ...] = (
    (
        *("5", "time encoding", BOTH_STAGES),
        (
            _row("global", *_NO_TIME),
            _row("global", "the coordinate itself", "raw-time", "field.encoder.kind=raw", "no time encoding"),
            _row("global", *_FOURIER, "fourier"),
            _row("global", "Fourier features and codebook", reported="codebook"),
            _row("local", *_NO_TIME),
            _row("local", *_FOURIER),
            _row("local", "Fourier features and codebook"),
        ),
    ),
    (
        *("6", "variational latents", BOTH_STAGES),
        (
            _row("global", *_POINT, "non-variational"),
            _row("global", "variational", reported="variational"),
            _row("local", *_POINT),
            _row("local", "variational"),
        ),
    ),
    (
        *("7", "decoder", BOTH_STAGES),
        (
            _row("global", "transformer", "transformer", "field.decoder.kind=transformer", "transformer decoder"),
            _row("global", "MLP", reported="mlp decoder"),
        ),
    ),
    (
        *("8", "size of z and weight of the KL term", ("field",)),
        (
            _row("global", "d = 128", "d-128", "field.latents.dimension=128", "latent_dim=128"),
            _row("global", "d = 256", reported="latent_dim=256"),
            _row("global", "d = 512", "d-512", "field.latents.dimension=512", "latent_dim=512"),
            _row("global", "λ_KL = 1e-5", "kl-1e-5", "field.loss.kl_weight=1e-5", "kl_weight=1e-5"),
            _row("global", "λ_KL = 1e-4", reported="kl_weight=1e-4"),
            _row("global", "λ_KL = 1e-3", "kl-1e-3", "field.loss.kl_weight=1e-3", "kl_weight=1e-3"),
        ),
    ),
    (
        # Knots lie at normalised coordinates, so this table has no rows of the local layout.
        *("9", "time normalisation", BOTH_STAGES),
        (
            _row("global", "frame numbers 1 … T", "frame-numbers", "field.encoder.coordinates=frames"),
            _row("global", "normalised to [−1, 1]"),
        ),
    ),
    (
        *("ours", "layout of z, and framerates in training", BOTH_STAGES),
        (
            _row("global", "as the recipe"),
            *(_row("global", *change) for change in (_UNWARMED, _WARMED)),
            _row("global", *_FIXED, "NeRM-fixed"),
            _row("local", "as the recipe"),
            *(_row("local", *change) for change in (_UNWARMED, _WARMED, _FIXED)),
        ),
    ),
)
ABLATIONS = {table: Ablation(table, title, rows, stages) for table, title, stages, rows in _TABLES}


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
        clear_stage(target)
        for path in source.result_paths:  # The last one marks the stage as complete.
            if path.is_file():
                write_whole(target.path / path.name, path.read_bytes())


NERM = Ablations("nerm", ABLATIONS, RECIPES, {"field": FIELD, "denoiser": DENOISER}, share_codebook, is_default=True)
