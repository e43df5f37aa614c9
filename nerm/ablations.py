"""The rows of the paper's tables that differ from NeRM itself in its first stage, as settings (Tables 1 and 5–9).

`motionkit train --stage field --set SETTING` trains a row; every row is the recipe plus these values. Rows whose value
is the recipe `paper`'s own are listed too, so that a table can be walked through whole.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Ablation:
    """One row: the paper's table and name for it (as in its reported figures), and what to `--set`."""

    table: str
    row: str
    settings: tuple[str, ...]


ABLATIONS: tuple[Ablation, ...] = (
    Ablation("1", "NeRM-fixed", ("field.fixed_fps=20",)),
    Ablation("5", "no time encoding", ("field.time_encoding=raw",)),
    Ablation("5", "fourier", ("field.time_encoding=fourier",)),
    Ablation("5", "codebook", ("field.time_encoding=codebook",)),
    Ablation("6", "non-variational", ("field.variational=false",)),
    Ablation("6", "variational", ("field.variational=true",)),
    Ablation("7", "transformer decoder", ("field.decoder=transformer",)),
    Ablation("7", "mlp decoder", ("field.decoder=mlp",)),
    Ablation("8", "latent_dim=128", ("field.latent_dimension=128",)),
    Ablation("8", "latent_dim=256", ("field.latent_dimension=256",)),
    Ablation("8", "latent_dim=512", ("field.latent_dimension=512",)),
    Ablation("8", "kl_weight=1e-5", ("field.kl_weight=1e-5",)),
    Ablation("8", "kl_weight=1e-4", ("field.kl_weight=1e-4",)),
    Ablation("8", "kl_weight=1e-3", ("field.kl_weight=1e-3",)),
    # Frame numbers 1 … T have no knots to lie between: this row reads z as the paper does.
    Ablation("9", "frame numbers", ("field.coordinates=frames", "field.latent_layout=global")),
    Ablation("9", "normalised time", ("field.coordinates=normalised",)),
)
