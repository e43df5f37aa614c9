"""JL2P (Ahuja and Morency 2019; chahuja/language2pose, src/model/model.py): a joint latent space of motions and texts.

A recurrent encoder gives a motion's code, a linear layer a condition's; a recurrent decoder makes poses of either.
"""

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss

from motionkit.core.shapes import Float, Int64
from motionkit.training.diffusion.settings import DiffusionConfig
from peers.generative.batches import ConditionSizes, MotionBatch, PoseSpace, SampleBatch, frames_within
from peers.generative.networks.layers import ConditionVector, first_poses, last_states
from peers.generative.settings import Jl2pNetworkConfig


class Jl2p(nn.Module):
    """Frames or a condition → a code, the initial state of an autoregressive decoder."""

    diffusion: DiffusionConfig | None = None

    def __init__(
        self, config: Jl2pNetworkConfig, space: PoseSpace, sizes: ConditionSizes, earlier: Mapping[str, nn.Module]
    ) -> None:
        super().__init__()
        numbers, width = space.num_features, config.width
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
        """Standardised rows, starting from `first`; each step predicts the change of pose."""
        pose, made = first, []
        for _ in range(frames):
            code = self.cell(pose, code)
            pose = pose + self.change(code)
            made.append(pose)
        return torch.stack(made, dim=1)

    def begin_step(self, step: int, steps: int) -> None:
        """The curriculum: training progress determines how many frames are used."""
        self._progress = step / steps

    def losses(self, batch: MotionBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Smooth L1 of the curriculum's frames, decoded from motion codes or, in half of the batches, conditions'."""
        rows = batch.rows[:, : self._curriculum_length()]
        lengths = batch.lengths.clamp(max=rows.shape[1])
        from_condition = bool(torch.rand((), generator=generator) < 0.5)
        code = self.sentence(batch.conditions).tanh() if from_condition else self.encode(rows, lengths)
        made = self.decode(code, first_poses(rows, self.config.mean_first, generator), rows.shape[1])
        mask = frames_within(lengths, rows.shape[1])
        return {"loss": smooth_l1_loss(made[mask], rows[mask])}

    def sample(self, batch: SampleBatch, diffusion: DiffusionConfig) -> Float[Tensor, "batch frames numbers"]:
        """Standardised rows, starting from the mean pose; deterministic."""
        code = self.sentence(batch.conditions.to(batch.device)).tanh()
        return self.decode(code, code.new_zeros(len(code), self.numbers), batch.frames)

    def _curriculum_length(self) -> int:
        """Number of frames used at this point of the curriculum."""
        lengths = self.config.lengths
        return lengths[min(int(self._progress / self.config.curriculum * (len(lengths) - 1)), len(lengths) - 1)]
