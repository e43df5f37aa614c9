"""Training data of generative peers: random crops of a store's windows at one framerate, with captions or actions."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float32, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.data.captions import actions_of_windows, captions_of_windows
from motionkit.data.corpus import open_frames, training_vectors
from motionkit.data.poses import WindowPoses
from motionkit.data.windows import Windows, cut_windows
from motionkit.features.convention import PoseVectors
from motionkit.store.cache import cache_root
from motionkit.store.reader import Store
from motionkit.training.pose_vectors import VectorScaling, measure_scaling
from motionkit.training.text import TextEncoder, embed_texts, load_text_encoder
from peers.generative.batches import NO_ACTION, Conditions, ConditionSizes, MotionBatch, frames_within
from peers.generative.settings import ConditionsConfig, MotionsConfig, PeerConfig

SHORTER_SHARE = 1 / 3


@dataclass(frozen=True, eq=False)
class MotionCorpus:
    """W windows of pose vectors; a window's captions are rows of `text`, whose row 0 is the null embedding.

    `last_tick` is the index of a window's last frame at the peer's framerate.
    """

    config: MotionsConfig
    vectors: PoseVectors
    scaling: VectorScaling
    poses: WindowPoses
    last_tick: Int64[np.ndarray, "windows"]
    text: Float32[Tensor, "texts dimension"]
    caption_rows: Int64[Tensor, "windows most"]
    num_captions: Int64[Tensor, "windows"]
    action: Int64[Tensor, "windows"]
    sizes: ConditionSizes

    def __len__(self) -> int:
        return len(self.last_tick)

    @property
    def windows(self) -> Windows:
        """Where crops lie."""
        return self.poses.windows

    def batch(self, rows: Int64[Tensor, "batch"], generator: torch.Generator, *, drop: float) -> MotionBatch:
        """A random crop of each window with one of its captions or its action, dropped with probability `drop`."""
        chance = torch.rand((4, len(rows)), generator=generator, dtype=torch.float64)
        lengths = available = self.last_tick[rows.numpy()] + 1
        if self.config.crops == "random":
            unit = self.config.crop_multiple
            units = available // unit - (chance[0].numpy() < SHORTER_SHARE)
            lengths = np.clip(units * unit, min(unit, self.config.max_frames), available)
        start = np.floor(chance[1].numpy() * (available - lengths + 1)).astype(np.int64)
        frames, made = self._seen_frames(lengths, generator)
        ticks = np.minimum(start[:, None] + frames.numpy(), self.last_tick[rows.numpy()][:, None])
        drawn = self.poses.at_rate(rows.numpy(), ticks, self.config.framerate)
        vectors = self.scaling.apply(torch.from_numpy(drawn.vectors))
        seen = frames_within(made, vectors.shape[1])
        return MotionBatch(vectors * seen[..., None], made, self._conditions(rows, chance[2:], drop), rows, frames)

    def _seen_frames(
        self, lengths: Int64[np.ndarray, "batch"], generator: torch.Generator
    ) -> tuple[Int64[Tensor, "batch frames"], Int64[Tensor, "batch"]]:
        """Frame indices of crops that the network sees, and their number: all, a random stretch, or scattered ones."""
        all_of_them, most = torch.from_numpy(lengths), self.config.seen_frames
        if self.config.seen == "all":
            return torch.arange(int(lengths.max())).expand(len(lengths), -1), all_of_them
        if self.config.seen == "scattered":
            chance = torch.rand((len(lengths), most), generator=generator, dtype=torch.float64)
            return (chance * all_of_them[:, None]).to(torch.int64), torch.full((len(lengths),), most)
        seen = all_of_them.clamp(max=most)
        chance = torch.rand(len(lengths), generator=generator, dtype=torch.float64)
        first = (chance * (all_of_them - seen + 1)).to(torch.int64)
        return first[:, None] + torch.arange(int(seen.max())), seen

    def _conditions(self, rows: Tensor, chance: Tensor, drop: float) -> Conditions:
        counts = self.num_captions[rows]
        choice = (chance[0] * counts).to(torch.int64).clamp(max=(counts - 1).clamp(min=0))
        known = (counts > 0) if self.sizes.text_dimension else (self.action[rows] >= 0)
        given = Conditions(self.text[self.caption_rows[rows, choice]], self.action[rows], known)
        return given.dropped(~known | (chance[1] < drop), self.text[0])


def open_corpus(store: Store, config: PeerConfig, encoder: TextEncoder | None) -> MotionCorpus:
    """Windows of the chosen sequences; raises `UsageError` if there are none, or none with the configured condition."""
    motions, conditions = config.motions, config.conditions
    vectors = training_vectors(motions.pose_vectors, store, motions.where or None)
    source, frames = open_frames(vectors, store, motions.where or None)
    windows = cut_windows(
        source,
        max_duration_seconds=motions.max_duration_seconds,
        stride_seconds=motions.stride_seconds,
        min_duration_seconds=motions.min_seconds,
        mirror_pairs=SMPL22.left_right_pairs if motions.mirrored else None,
    )
    poses = WindowPoses(windows, frames, motions.framerate)
    sequences = store.columns("captions", "action")
    captions = captions_of_windows(windows, sequences) if encoder is not None else [()] * len(windows)
    actions = actions_of_windows(windows, sequences) if conditions.kind == "action" else [""] * len(windows)
    names = tuple(sorted({action for action in actions if action}))
    _check_given(conditions, bool(any(captions)), names)
    texts = sorted({text for of_window in captions for text in of_window})
    row_of = {text: row for row, text in enumerate(texts, start=1)}
    caption_rows = torch.zeros((len(windows), max(1, *map(len, captions))), dtype=torch.int64)
    for window, of_window in enumerate(captions):
        caption_rows[window, : len(of_window)] = torch.tensor([row_of[text] for text in of_window], dtype=torch.int64)
    ticks = np.floor(windows.duration_seconds * float(motions.framerate) + 1e-6).astype(np.int64)
    text = torch.zeros((1, 0)) if encoder is None else embedded(encoder, conditions, ["", *texts], store)
    return MotionCorpus(
        config=motions,
        vectors=vectors,
        scaling=measure_scaling(poses, grouped=True),
        poses=poses,
        last_tick=ticks,
        text=text,
        caption_rows=caption_rows,
        num_captions=torch.tensor([len(of_window) for of_window in captions], dtype=torch.int64),
        action=torch.tensor([names.index(action) if action else NO_ACTION for action in actions], dtype=torch.int64),
        sizes=ConditionSizes(text.shape[1], names, len(windows)),
    )


def embedded(
    encoder: TextEncoder, config: ConditionsConfig, texts: list[str], store: Store | None = None
) -> Float32[Tensor, "texts dimension"]:
    """Text embeddings as configured, with the null embedding for empty texts.

    Those of a store's captions are kept in its cache.
    """
    if store is None:
        rows = encoder.encode(texts)
    else:
        rows = embed_texts(encoder, texts, cache_root(store.path, store.fingerprint))
    made = torch.from_numpy(np.asarray(rows, dtype=np.float32)).clone()
    if config.scaled:
        made *= made.shape[1] ** 0.5 / made.norm(dim=1, keepdim=True).clamp(min=1e-6)
    if config.nothing == "zeros":
        made[[row for row, text in enumerate(texts) if not text]] = 0.0
    return made


def text_encoder_of(config: ConditionsConfig) -> TextEncoder | None:
    """The text encoder of a configuration; None if it uses no captions."""
    return load_text_encoder(config.text_encoder) if config.kind == "text" else None


def check_captioned(store: Store, config: PeerConfig) -> None:
    """Raise `UsageError` if a configuration needs captions or actions and the store has none."""
    columns = store.columns("captions", "action")
    names = tuple(sorted(set(columns["action"]) - {""}))
    _check_given(config.conditions, bool(columns["captions"].map(len).any()), names)


def _check_given(config: ConditionsConfig, has_captions: bool, actions: tuple[str, ...]) -> None:
    if config.kind == "text" and not has_captions:
        raise UsageError(
            "no training motion has a caption: ingest with --captions, or train on actions or without conditions "
            "(--set conditions.kind=action, or none)"
        )
    if config.kind == "action" and not actions:
        raise UsageError(
            "no training motion has an action: train on texts or without (--set conditions.kind=text, or none)"
        )
