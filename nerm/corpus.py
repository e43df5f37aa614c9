"""Training data of the denoiser: the field's posteriors N(μ_i*, Σ_i*), with durations, captions and actions."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from motionkit.core.shapes import Float32, Int64
from motionkit.data.captions import actions_of_windows, captions_of_windows
from motionkit.data.windows import Windows
from motionkit.store.cache import cache_root
from motionkit.store.reader import Store
from motionkit.training.conditions import Conditions, WindowConditions, window_conditions
from motionkit.training.text import TextEncoder, embed_texts
from nerm.conditions import unit_rows
from nerm.latents import LocalLatents, first_read
from nerm.paraphrases import with_paraphrases

DROP, ACTION_SHARE = 0.1, 0.25


@dataclass(frozen=True, eq=False)
class LatentCorpus:
    """n posteriors with their conditions; `banks` is the layout of z (None: global)."""

    means: Float32[Tensor, "windows latent"]
    log_variances: Float32[Tensor, "windows latent"]
    conditions: WindowConditions
    banks: LocalLatents | None = None

    def __len__(self) -> int:
        return len(self.means)

    @property
    def first_read(self) -> Float32[Tensor, "latent"]:
        """The earliest instant at which the field reads each number of z (`nerm.latents.first_read`)."""
        return first_read(self.means.shape[1], self.banks)

    def draw(self, rows: Int64[Tensor, "batch"], generator: torch.Generator) -> Float32[Tensor, "batch latent"]:
        """z ~ N(μ_i, Σ_i) for the windows `rows`, resampled at every call (§3.2)."""
        spread = torch.exp(0.5 * self.log_variances[rows])
        noise: Tensor = torch.randn(spread.shape, generator=generator)
        return self.means[rows] + spread * noise

    def draw_conditions(self, rows: Int64[Tensor, "batch"], generator: torch.Generator) -> Conditions:
        """One condition per window: none with probability 0.1, else one of its captions or its action.

        Windows with both get the action with probability 0.25.
        """
        chance = torch.rand((3, len(rows)), generator=generator)
        return self.conditions.draw(rows, chance, drop=DROP, action_share=ACTION_SHARE)


def corpus_of(
    posterior_mean: Float32[torch.Tensor, "windows latent"],
    posterior_log_variance: Float32[torch.Tensor, "windows latent"],
    windows: Windows,
    store: Store,
    encoder: TextEncoder | None,
    banks: LocalLatents | None = None,
    paraphrases: int = 0,
    seed: int = 0,
) -> LatentCorpus:
    """Posteriors with their windows' captions (embedded, and cached in the store's cache folder) and actions.

    Up to `paraphrases` rewordings of each caption are drawn from `seed`; they stand for it in half of its uses.
    """
    sequences = store.columns("captions", "action")
    captions = captions_of_windows(windows, sequences) if encoder is not None else [()] * len(windows)
    captions = with_paraphrases(captions, paraphrases, np.random.default_rng(seed))

    def embed(texts: list[str]) -> Float32[Tensor, "texts dimension"]:
        """Unit-length embeddings after a row of zeros; a single zero without an encoder."""
        if encoder is None:
            return torch.zeros((1, 1))
        rows = torch.from_numpy(unit_rows(embed_texts(encoder, texts[1:], cache_root(store.path, store.fingerprint))))
        return torch.cat((torch.zeros((1, rows.shape[1])), rows))

    duration = torch.from_numpy(windows.duration_seconds / windows.max_duration_seconds).to(torch.float32)
    conditions = window_conditions(captions, actions_of_windows(windows, sequences), duration, embed)
    return LatentCorpus(posterior_mean, posterior_log_variance, conditions, banks)
