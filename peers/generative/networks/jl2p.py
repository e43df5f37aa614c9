"""JL2P (Ahuja and Morency 2019; chahuja/language2pose, src/model/model.py): one space of motions and of what says them.

A motion's code is what a recurrent encoder ends with, a condition's a map of it; from either a cell makes the poses.
"""

from collections.abc import Mapping

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss

from motionkit.training.diffusion.settings import DiffusionConfig
from peers.generative.batches import ConditionSizes, MotionBatch, PoseSpace, Wanted, frames_within
from peers.generative.networks.layers import ConditionVector, first_poses, last_states
from peers.generative.settings import Jl2pNetworkConfig


class Jl2p(nn.Module):
    """Frames or a condition → a code, which is the first state of what makes each pose of the one before."""

    diffusion: DiffusionConfig | None = None

    def __init__(
        self, config: Jl2pNetworkConfig, space: PoseSpace, sizes: ConditionSizes, earlier: Mapping[str, nn.Module]
    ) -> None:
        super().__init__()
        numbers, width = space.num_numbers, config.width
        self.config, self.numbers = config, numbers
        self.sentence = ConditionVector(sizes, width)
        self.encoder = nn.GRU(numbers, width, batch_first=True)
        self.cell = nn.GRUCell(numbers, width)
        self.change = nn.Linear(width, numbers)
        self._progress = 1.0

    def encode(
        self, rows: Float[Tensor, "batch frames numbers"], lengths: Int64[Tensor, "batch"]
    ) -> Float[Tensor, "batch width"]:
        """Codes of motions."""
        return last_states(self.encoder(rows)[0], lengths)

    def decode(
        self, code: Float[Tensor, "batch width"], first: Float[Tensor, "batch numbers"], frames: int
    ) -> Float[Tensor, "batch frames numbers"]:
        """Standardised rows: every pose is the one before, moved; before all comes `first`."""
        pose, made = first, []
        for _ in range(frames):
            code = self.cell(pose, code)
            pose = pose + self.change(code)
            made.append(pose)
        return torch.stack(made, dim=1)

    def begin_step(self, step: int, steps: int) -> None:
        """How far the training is decides how much of a motion is in sight."""
        self._progress = step / steps

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Smooth L1 of the frames in sight, made of the motions' codes or, in every other batch, of the conditions'."""
        rows = batch.rows[:, : self._in_sight()]
        lengths = batch.lengths.clamp(max=rows.shape[1])
        said = bool(torch.rand((), generator=generator) < 0.5)
        code = self.sentence(batch.conditions).tanh() if said else self.encode(rows, lengths)
        made = self.decode(code, first_poses(rows, self.config.mean_first, generator), rows.shape[1])
        seen = frames_within(lengths, rows.shape[1])
        return {"loss": smooth_l1_loss(made[seen], rows[seen])}

    def sample(self, wanted: Wanted, diffusion: DiffusionConfig) -> Float[Tensor, "batch frames numbers"]:
        """Standardised rows, from the mean pose; nothing is drawn."""
        code = self.sentence(wanted.conditions.to(wanted.device)).tanh()
        return self.decode(code, code.new_zeros(len(code), self.numbers), wanted.frames)

    def _in_sight(self) -> int:
        """How many frames are learnt now: one after another of the settings' lengths."""
        lengths = self.config.lengths
        return lengths[min(int(self._progress / self.config.curriculum * (len(lengths) - 1)), len(lengths) - 1)]
