"""clip-FID as a torchmetrics metric."""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torchmetrics import Metric

from eval.clip_fid.clips import Protocol
from eval.clip_fid.features import Comparison, kinematic_source
from eval.clip_fid.motions import Motions, samples_of
from eval.torch_metrics.arrays import array_of, rows_of
from motionkit.core.shapes import Float, Int
from motionkit.core.timegrid import Framerate, parse_fps

Some = Sequence[Float[Tensor, "_frames 22 3"]] | Float[Tensor, "motions frames 22 3"]


class ClipFID(Metric):
    """clip-FID of generated motions against real ones at one framerate, as `eval.clip_fid` computes it.

    `real` are the reference motions, and `train` those that the descriptor is fitted on (by default the real ones):
    `Motion`s of `fps`, or arrays [frames, 22, 3] in metres, y up. `update` takes motions of any lengths and keeps them,
    since clips are drawn in proportion to the duration of all of them. The value is that of `eval.clip_fid` on the same
    motions in the same order. Scores are comparable only for the same real motions, framerate and number of clips.

    Raises `UsageError`, `ClipError` and `MotionkitError` as `eval.clip_fid` does, for the real motions when the metric
    is first computed.

    >>> rng = np.random.default_rng(0)
    >>> walks = [rng.normal(size=(90, 22, 3)).cumsum(axis=0) / 100 for _ in range(4)]
    >>> metric = ClipFID(fps=60, real=walks, clips=128, replications=2)
    >>> metric.update([torch.from_numpy(walk) for walk in walks[:2]])
    >>> metric.update(torch.zeros(2, 90, 22, 3), num_frames=torch.tensor([90, 64]))
    >>> sorted(metric.compute())
    ['clip_fid', 'clip_fid_ci95']
    """

    full_state_update = False
    is_differentiable = False
    higher_is_better = False
    positions: list[Tensor]
    num_frames: list[Tensor]

    def __init__(
        self,
        fps: Framerate,
        real: Motions,
        *,
        train: Motions | None = None,
        clips: int = 4096,
        replications: int = 20,
        seed: int = 0,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        self.fps = parse_fps(fps)
        self._real = samples_of("real", real, self.fps)
        self._train = self._real if train is None else samples_of("train", train, self.fps)
        self._protocol = Protocol(num_clips=clips, replications=replications, detailed_replications=0, seed=seed)
        self.add_state("positions", [], dist_reduce_fx="cat")
        self.add_state("num_frames", [], dist_reduce_fx="cat")

    def update(self, motions: Some, num_frames: Int[Tensor, "motions"] | None = None) -> None:
        """Add motions [frames, 22, 3] of any lengths, or a padded batch with each motion's `num_frames`.

        Raises `UsageError` for other shapes, and `ValueError` for lengths beyond the batch or NaN.
        """
        lengths = [len(motion) for motion in motions] if num_frames is None else [int(each) for each in num_frames]
        if len(lengths) != len(motions) or any(
            not 0 < length <= len(motion) for length, motion in zip(lengths, motions, strict=False)
        ):
            raise ValueError(f"{len(motions)} motions of at most {max(map(len, motions), default=0)} frames: {lengths}")
        own = [motion[:length] for motion, length in zip(motions, lengths, strict=True)]
        samples = samples_of("generated", [array_of(motion) for motion in own], self.fps)
        self.positions.append(torch.from_numpy(samples.sequences.values).to(self.device))
        self.num_frames.append(torch.tensor(lengths, device=self.device))

    def compute(self) -> dict[str, Float[Tensor, ""]]:
        """`clip_fid` and half the width of its 95 % interval, `clip_fid_ci95`, float64."""
        ends = np.cumsum(rows_of(self.num_frames, "motions"))
        generated = np.split(rows_of(self.positions, "motions"), ends[:-1])
        samples = samples_of("generated", generated, self.fps)
        found = self._comparison.scores({"generated": samples})["generated"]
        values = {"clip_fid": found.value, "clip_fid_ci95": found.ci95}
        return {name: torch.tensor(value, dtype=torch.float64, device=self.device) for name, value in values.items()}

    @cached_property
    def _comparison(self) -> Comparison:
        return kinematic_source().comparison(self._real, self._train, self._protocol)
