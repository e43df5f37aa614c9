"""Action2Motion's GRU recognisers: HumanAct12's, which NeRM's Table 3 uses, and the one for the CMU database.

Two GRU layers of 128 over joint positions, Linear to 30 and tanh (the features of FID and Diversity), Linear to the
actions. The hidden state begins at zero; the published evaluation draws it anew from N(0, 1) for every batch, so that
its numbers differ from run to run (docs/deviations.md). Source: https://github.com/EricGuo5513/action-to-motion
(models/motion_gan.py, eval_scripts/load_classifier.py).
"""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from eval.evaluators.actions.clips import clip_rows
from eval.evaluators.actions.gru_kinds import GruKind
from eval.evaluators.actions.recogniser import Recognition, check_fps
from eval.evaluators.weights_digest import weights_digest
from eval.samples.sets import SampleSet
from motionkit.training.foreign import fill_checked, foreign_tensors, read_foreign

VERSION = "gru-recogniser/1"
HIDDEN, NUM_FEATURES = 128, 30
KEY = "model"
MOTIONS_AT_ONCE = 256


class GruNetwork(nn.Module):
    """The network; parameters have the published file's names."""

    def __init__(self, num_inputs: int, num_actions: int) -> None:
        super().__init__()
        self.recurrent = nn.GRU(num_inputs, HIDDEN, num_layers=2, batch_first=True)
        self.linear1 = nn.Linear(HIDDEN, NUM_FEATURES)
        self.linear2 = nn.Linear(NUM_FEATURES, num_actions)

    def forward(
        self, poses: Float[Tensor, "clips frames numbers"]
    ) -> tuple[Float[Tensor, "clips features"], Float[Tensor, "clips actions"]]:
        """Features and scores after the last frame."""
        states, _ = self.recurrent(poses)
        features = torch.tanh(self.linear1(states[:, -1]))
        return features, self.linear2(features)


@dataclass(frozen=True, eq=False)
class GruRecogniser:
    """A published recogniser with its weights; implements `ActionRecogniser`."""

    kind: GruKind
    network: GruNetwork
    fingerprint: str

    @property
    def name(self) -> str:
        """Name for tables."""
        return self.kind.name

    @property
    def fps(self) -> Fraction:
        """The framerate of its training data."""
        return self.kind.fps

    @property
    def actions(self) -> tuple[str, ...]:
        """Names of the actions, in the order of the scores."""
        return self.kind.actions

    def recognise(self, samples: SampleSet) -> Recognition:
        """Features [30] and scores of every sequence's clip (`action_clips.clip_frames`), its first root at the origin.

        Raises `MotionkitError` for another framerate or number of joints.
        """
        check_fps(self, samples)
        rows = clip_rows(samples, self.kind.clip_length)
        features, scores = [], []
        with torch.inference_mode():
            for start in range(0, len(rows), MOTIONS_AT_ONCE):
                clips = self.kind.joints(samples.positions[rows[start : start + MOTIONS_AT_ONCE]])
                clips = clips - clips[:, :1, :1]
                found = self.network(torch.from_numpy(clips.reshape(*clips.shape[:2], -1)))
                features.append(found[0].double().numpy())
                scores.append(found[1].double().numpy())
        return Recognition(np.concatenate(features), np.concatenate(scores))


def load_gru(path: Path, kind: GruKind) -> GruRecogniser:
    """Read action-to-motion's `model_file/action_recognition_model_….tar` without running its pickle.

    Raises `CheckpointError` for a file that is no such checkpoint, or one of another recogniser.
    """
    tensors = foreign_tensors(read_foreign(path), KEY, path, kind.title)
    network = GruNetwork(3 * kind.num_joints, len(kind.actions)).eval().requires_grad_(False)
    fill_checked(dict(network.named_parameters()), tensors, KEY, path, kind.title)
    terms = f"{VERSION} {kind.name} {kind.fps} {kind.clip_length}"
    return GruRecogniser(kind, network, weights_digest(terms, network.state_dict()))
