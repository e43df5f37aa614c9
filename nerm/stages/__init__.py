"""NeRM's trainable stages, from a store to what each leaves in the run folder, one file each."""

from nerm.stages.registered import CODEBOOK, DENOISER, FIELD

__all__ = ["CODEBOOK", "DENOISER", "FIELD"]
