"""Training data of the denoiser: the field's posteriors N(μ_i*, Σ_i*), with durations, captions and actions."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from motionkit.core.shapes import Float32, Int64
from motionkit.data.captions import actions_of_windows, captions_of_windows
from motionkit.data.windows import Windows
from motionkit.store.cache import cache_root
from motionkit.store.reader import Store
from motionkit.training.text import TextEncoder, embed_texts
from nerm.conditions import NO_ACTION, ConditionLayout, Conditions, unit_rows
from nerm.latents import LocalLatents, first_read
from nerm.paraphrases import with_paraphrases

DROP, ACTION_SHARE = 0.1, 0.25


@dataclass(frozen=True, eq=False)
class LatentCorpus:
    """n posteriors with their conditions.

    `caption_rows` [n, most] indexes `text` [texts, dimension] (unit length); the first `num_captions` of each row are
    valid. `action` is `NO_ACTION` where there is none; `duration` is in units of l_max. `banks` is the layout of z
    (None: global).
    """

    means: Float32[Tensor, "windows latent"]
    log_variances: Float32[Tensor, "windows latent"]
    duration: Float32[Tensor, "windows"]
    text: Float32[Tensor, "texts dimension"]
    caption_rows: Int64[Tensor, "windows most"]
    num_captions: Int64[Tensor, "windows"]
    action: Int64[Tensor, "windows"]
    layout: ConditionLayout
    banks: LocalLatents | None

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
        counts, actions = self.num_captions[rows], self.action[rows]
        has_text, has_action = counts > 0, actions >= 0
        use_action = has_action & (~has_text | (chance[0] < ACTION_SHARE))
        choice = (chance[1] * counts).to(torch.int64).clamp(max=(counts - 1).clamp(min=0))
        text = self.text[self.caption_rows[rows, choice]]
        given = Conditions(
            text=torch.where((has_text & ~use_action)[:, None], text, torch.zeros_like(text)),
            action=torch.where(use_action, actions, torch.full_like(actions, NO_ACTION)),
            duration=self.duration[rows],
        )
        return given.dropped(chance[2] < DROP)


def latent_corpus(
    means: Float32[Tensor, "windows latent"],
    log_variances: Float32[Tensor, "windows latent"],
    duration: Float32[Tensor, "windows"],
    captions: Sequence[Sequence[str]],
    actions: Sequence[str],
    texts: Sequence[str],
    embeddings: Float32[np.ndarray, "texts dimension"],
    banks: LocalLatents | None = None,
) -> LatentCorpus:
    """Index captions and actions of all windows; `embeddings` belong to the distinct `texts`."""
    row_of = {text: row for row, text in enumerate(texts)}
    names = tuple(sorted({action for action in actions if action}))
    index_of = {name: index for index, name in enumerate(names)} | {"": NO_ACTION}
    most = max((len(of_window) for of_window in captions), default=0)
    rows = torch.zeros((len(means), max(most, 1)), dtype=torch.int64)
    for window, of_window in enumerate(captions):
        rows[window, : len(of_window)] = torch.tensor([row_of[text] for text in of_window], dtype=torch.int64)
    text = torch.from_numpy(embeddings) if len(texts) else torch.zeros((1, embeddings.shape[1]))
    return LatentCorpus(
        means=means,
        log_variances=log_variances,
        duration=duration,
        text=text,
        caption_rows=rows,
        num_captions=torch.tensor([len(of_window) for of_window in captions], dtype=torch.int64),
        action=torch.tensor([index_of[action] for action in actions], dtype=torch.int64),
        layout=ConditionLayout(embeddings.shape[1], names),
        banks=banks,
    )


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
    texts = sorted({text for of_window in captions for text in of_window})
    return latent_corpus(
        means=posterior_mean,
        log_variances=posterior_log_variance,
        duration=torch.from_numpy(windows.duration_seconds / windows.max_duration_seconds).to(torch.float32),
        captions=captions,
        actions=actions_of_windows(windows, sequences),
        texts=texts,
        embeddings=_embeddings(encoder, texts, cache_root(store.path, store.fingerprint)),
        banks=banks,
    )


def _embeddings(encoder: TextEncoder | None, texts: Sequence[str], folder: Path) -> Float32[np.ndarray, "texts size"]:
    """Unit-length embeddings; a single zero column without an encoder."""
    if encoder is None:
        return np.zeros((0, 1), dtype=np.float32)
    return unit_rows(embed_texts(encoder, texts, folder))
