"""The denoiser's corpus, from a trained field and the store whose windows it describes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float32

from motionkit.clips.windows import Windows
from motionkit.store.cache_folder import cache_root
from motionkit.store.reader import Store
from motionkit.training.text_embeddings import embed_texts
from motionkit.training.text_encoders import TextEncoder
from nerm.conditions.batch import unit_rows
from nerm.conditions.captions import mirrored_text, overlapping_captions
from nerm.denoiser.corpus import LatentCorpus, latent_corpus
from nerm.latents.local import LocalLatents


def corpus_of(
    posterior_mean: Float32[torch.Tensor, "windows latent"],
    posterior_log_variance: Float32[torch.Tensor, "windows latent"],
    windows: Windows,
    store: Store,
    encoder: TextEncoder | None,
    banks: LocalLatents | None = None,
) -> LatentCorpus:
    """Posteriors with their windows' captions (embedded, cached inside the store's cache folder) and actions."""
    sequences = store.columns("captions", "action")
    captions = captions_of_windows(windows, sequences) if encoder is not None else [()] * len(windows)
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


def captions_of_windows(windows: Windows, sequences: pd.DataFrame) -> list[tuple[str, ...]]:
    """Each window's captions, in mirrored words where the window is mirrored."""
    captions: dict[Any, Sequence[Any]] = sequences["captions"].to_dict()
    ends = windows.start_seconds + windows.duration_seconds
    found = []
    for sequence, start, end, mirrored in zip(
        windows.sequence_index, windows.start_seconds, ends, windows.mirrored, strict=True
    ):
        texts = overlapping_captions(captions[int(sequence)], float(start), float(end))
        found.append(tuple(map(mirrored_text, texts)) if mirrored else texts)
    return found


def actions_of_windows(windows: Windows, sequences: pd.DataFrame) -> list[str]:
    """Each window's action, "" where its sequence has none, in mirrored words where the window is mirrored."""
    actions: dict[Any, str] = sequences["action"].to_dict()
    return [
        mirrored_text(actions[int(sequence)]) if mirrored else actions[int(sequence)]
        for sequence, mirrored in zip(windows.sequence_index, windows.mirrored, strict=True)
    ]


def _embeddings(encoder: TextEncoder | None, texts: Sequence[str], folder: Path) -> Float32[np.ndarray, "texts size"]:
    """Unit-length embeddings; one column of nothing without an encoder."""
    if encoder is None:
        return np.zeros((0, 1), dtype=np.float32)
    return unit_rows(embed_texts(encoder, texts, folder))
