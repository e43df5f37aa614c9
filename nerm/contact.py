"""Contact as an output of the field: probabilities that ankle and toe of both feet are on the ground, at any t.

A small network with the decoder's input, trained after it on noisy latents, with labels detected on the training
sequences (`motionkit.fields.contact.detection`). Feet of generated motions slide from residual noise, so their paths
say little about contacts; z still does (docs/results/trials.md).
"""

from collections.abc import Callable, Iterator

import numpy as np
import torch
from torch import Tensor, nn

from motionkit.core.progress import OnProgress, task
from motionkit.core.shapes import Float, Float32, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import normalise_seconds
from motionkit.data.windows import Windows, rows_by_duration, shuffled_batches
from motionkit.fields.contact.detection import find_contacts, ground_of
from motionkit.fields.contact.legs import legs_of
from motionkit.store.cache import PositionCache
from motionkit.training.loop import seeded_initialisation, set_rate, step_generator
from nerm.network import FieldNetwork

NUM_LOGITS = 4
WIDTH, BATCH_SIZE, LEARNING_RATE = 128, 256, 3e-3
CONTACT_ROWS = "contacts-1"
FEWEST_FRAMES = 4

Noisy = Callable[[Float32[Tensor, "batch latent"], torch.Generator], Float32[Tensor, "batch latent"]]
"""Latents of the field, with noise added."""


class ContactHead(nn.Module):
    """Logits of contact of left ankle, left toe, right ankle and right toe."""

    def __init__(self, num_read: int, width: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(num_read, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, NUM_LOGITS)
        )

    def forward(self, read: Float[Tensor, "batch poses read"]) -> Float[Tensor, "batch poses 4"]:
        """Logits from the output of `FieldNetwork.read`."""
        logits: Tensor = self.layers(read)
        return logits


def contact_head(network: FieldNetwork) -> ContactHead:
    """A head for this network."""
    return ContactHead(network.num_read, WIDTH)


def contact_rows(cache: PositionCache) -> Float32[np.ndarray, "total_frames 4"]:
    """Contact labels (1 or 0) of the foot joints for every row of the position cache, cached beside it."""

    def compute() -> Iterator[Float32[np.ndarray, "frames 4"]]:
        legs = legs_of(SMPL22)
        for sequence in range(cache.num_sequences):
            paths = legs.foot_paths(np.asarray(cache.sequence_positions(sequence))).astype(np.float64)
            down = np.zeros((len(paths), 2, 2), np.float32)
            if len(paths) >= FEWEST_FRAMES:
                fps = float(cache.exact_fps(sequence))
                down[:] = find_contacts(paths, fps, ground_of(paths, fps)).down
            yield down.reshape(-1, NUM_LOGITS)

    return cache.derived_rows(CONTACT_ROWS, NUM_LOGITS, compute)


class ContactTraining:
    """Training of the head on a frozen field, from noisy posterior means of its windows."""

    def __init__(
        self,
        network: FieldNetwork,
        means: Float32[Tensor, "windows latent"],
        windows: Windows,
        rows: Float32[np.ndarray, "total_frames 4"],
        noisy: Noisy,
        *,
        seed: int,
    ) -> None:
        self.network, self.means, self.windows, self.rows, self.noisy = network, means, windows, rows, noisy
        self.seed, self.config, self.device = seed, network.config, next(network.parameters()).device
        with seeded_initialisation(seed, "contacts"):
            self.head = contact_head(network).to(self.device)
        self.optimizer = torch.optim.AdamW(self.head.parameters(), lr=LEARNING_RATE, weight_decay=0.0)
        self.visits = rows_by_duration(windows, self.config.clips.seconds_per_visit)

    def run(self, on_progress: OnProgress) -> float:
        """Run all steps; return the mean loss of the last fifth, in nats per output."""
        steps, losses = self.config.contact_steps, []
        with task(on_progress, "contacts", steps) as work:
            for step in range(steps):
                losses.append(self.step(step, steps))
                work.advance()
        return float(torch.stack(losses[-max(1, steps // 5) :]).mean())

    def step(self, step: int, steps: int) -> Float[Tensor, ""]:
        """One of `steps` steps; returns the loss."""
        generator = step_generator(self.seed, "contacts", step)
        set_rate(self.optimizer, LEARNING_RATE * 0.5 * (1.0 + np.cos(np.pi * step / steps)))
        chosen = self.visits[shuffled_batches(len(self.visits), BATCH_SIZE, step, self.seed)]
        windows, poses = torch.from_numpy(chosen), self.config.clips.num_poses
        uniform = torch.rand(len(chosen), poses, generator=generator, dtype=torch.float64).numpy()
        frame = np.floor(uniform * self.windows.num_frames[chosen][:, None]).astype(np.int64)
        fps = torch.from_numpy(self.windows.fps[chosen]).to(self.device)
        seconds = frame / self.windows.fps[chosen][:, None]
        times = torch.from_numpy(normalise_seconds(seconds, self.windows.max_duration_seconds)).to(self.device)
        with torch.no_grad():
            latents = self.noisy(self.means[windows], generator).to(self.device)
            read = self.network.read(latents, self.network.encode_coordinates(times, fps))
        loss = nn.functional.binary_cross_entropy_with_logits(self.head(read), self._down(chosen, frame))
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        self.optimizer.step()
        return loss.detach()

    def _down(
        self, window: Int64[np.ndarray, "batch"], frame: Int64[np.ndarray, "batch poses"]
    ) -> Float32[Tensor, "batch poses 4"]:
        """Contact labels at frames of windows; left and right are swapped in mirrored windows."""
        down = self.rows[self.windows.start_row[window][:, None] + frame]
        mirrored = self.windows.mirrored[window]
        down[mirrored] = down[mirrored][..., [2, 3, 0, 1]]
        return torch.from_numpy(down).to(self.device)


def probabilities(head: ContactHead, read: Float[Tensor, "batch times read"]) -> Float32[np.ndarray, "batch times 2 2"]:
    """Contact probabilities of ankle and toe of left and right foot."""
    with torch.no_grad():
        flat = torch.sigmoid(head(read)).cpu().numpy()
    return np.asarray(flat.reshape(*flat.shape[:2], 2, 2))
