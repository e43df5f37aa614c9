"""JL2P (Ahuja and Morency 2019; chahuja/language2pose, src/model/model.py): a joint latent space of motions and texts.

A recurrent encoder gives a motion's code, a linear layer a condition's; a recurrent decoder makes poses of either.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss

from motionkit.core.shapes import Float
from peers.generating import GIVEN, GIVEN_MINILM, SLOW, PeerConfig, PeerStage, cosine, dropping
from peers.layers import ConditionVector, Latents, NetworkInputs, PeerNetwork, first_poses, last_states
from peers.motions import MotionBatch, Rows, SampleBatch


@dataclass(frozen=True)
class Jl2pNetworkConfig:
    """JL2P: the width of its GRU; with probability `mean_first` the first pose is replaced by the mean pose.

    Over the share `curriculum` of the steps, training uses the numbers of frames in `lengths` in turn, then the last.
    """

    width: int = 1024
    lengths: tuple[int, ...] = (2, 4, 8, 16)
    curriculum: float = 0.5
    mean_first: float = 0.0


class Jl2p(PeerNetwork):
    """JL2P: frames or a condition → a code, the initial state of an autoregressive decoder."""

    def __init__(self, config: Jl2pNetworkConfig, inputs: NetworkInputs) -> None:
        super().__init__()
        numbers, width = inputs.space.num_features, config.width
        self.config, self.numbers = config, numbers
        self.sentence = ConditionVector(inputs.conditions, width)
        self.encoder = nn.GRU(numbers, width, batch_first=True)
        self.cell = nn.GRUCell(numbers, width)
        self.change = nn.Linear(width, numbers)

    def decode(self, code: Latents, first: Float[Tensor, "batch numbers"], frames: int) -> Rows:
        """Standardised rows, starting from `first`; each step predicts the change of pose."""
        pose, poses = first, []
        for _ in range(frames):
            code = self.cell(pose, code)
            pose = pose + self.change(code)
            poses.append(pose)
        return torch.stack(poses, dim=1)

    def losses(self, batch: MotionBatch) -> dict[str, Tensor]:
        """Smooth L1 of the curriculum's frames, decoded from motion codes or, in half of the batches, conditions'."""
        curriculum = self.config.lengths
        place = int(batch.progress / self.config.curriculum * (len(curriculum) - 1))
        rows = batch.rows[:, : curriculum[min(place, len(curriculum) - 1)]]
        frames = rows.shape[1]
        from_condition = bool(torch.rand((), generator=batch.generator) < 0.5)
        if from_condition:
            code = self.sentence(batch.conditions).tanh()
        else:
            code = last_states(self.encoder(rows)[0], batch.lengths.clamp(max=frames))
        predicted = self.decode(code, first_poses(rows, self.config.mean_first, batch.generator), frames)
        mask = batch.mask[:, :frames]
        return {"loss": smooth_l1_loss(predicted[mask], rows[mask])}

    def sample(self, batch: SampleBatch) -> Rows:
        """Standardised rows, starting from the mean pose; deterministic."""
        code = self.sentence(batch.conditions).tanh()
        return self.decode(code, code.new_zeros(len(code), self.numbers), batch.frames)


SIZES = Jl2pNetworkConfig(width=256, lengths=(2, 4, 8, 16, 32, 82), mean_first=0.5)
NANO = PeerConfig(SIZES, cosine(6000, 64, 1e-3), GIVEN_MINILM, SLOW, clip_norm=1.0)
PAPER = PeerConfig(Jl2pNetworkConfig(), dropping(1000, 100), GIVEN, replace(SLOW, sampled_frames=16))
JL2P = PeerStage("jl2p", Jl2p, NANO, PAPER)
