"""Encoding motions that were not in training: z by optimisation against the frozen field (appendix B.2, B.3, Table 4).

There is no encoder: L-BFGS minimises Eq. 3's terms over z alone, starting from the linear model's fit (local latents)
or from zero. Numbers are scaled by their effect on the poses, which differs widely between banks of knots and paths.

Overlapping windows of l_max cover a longer motion, each with its own frame and its own z, fitted to the frames observed
in it; decoded windows are cross-faded. Long captures, gaps and uneven times need no special treatment.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from motionkit.core.motion import mirror_positions
from motionkit.core.shapes import Float, Float32, Float64, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import normalise_seconds
from motionkit.data.reconstruction import ModelWindows
from motionkit.data.windows import (
    FrameValues,
    PoseBatch,
    WindowPoses,
    Windows,
    chunks,
    cut_windows,
    open_frames,
)
from motionkit.features import field
from motionkit.fields.assembly import AssembledField, Piece, assemble, even_starts
from motionkit.fields.motion_field import MotionField, Observation
from motionkit.store.cache import PositionCache
from motionkit.store.reader import Store
from motionkit.training.run import RunFolder
from nerm.latents import LinearModel
from nerm.model import TrainedField, load_field
from nerm.network import EncodedCoordinates
from nerm.recipes import row_name

EVALUATIONS = 30
HISTORY = 10
SUFFICIENT_DECREASE, SMALLEST_CURVATURE = 1e-4, 1e-10
PROBES = 8
SMALLEST_EFFECT = 0.05


def encode_by_optimisation(trained: TrainedField, batch: PoseBatch) -> Float32[Tensor, "batch latent"]:
    """The z of each clip of a batch: argmin ‖f_θ(t, z, s) − x‖² + λ_KL·½‖z‖²/d, independent of the other clips.

    A clip's poses must be in order of time. ½‖z‖²/d is the KL term for a fixed posterior variance; a field without
    distributions has none (Eq. 9). The result is on the CPU.
    """
    config, device = trained.config, trained.device
    kl_weight = config.loss.kl_weight if config.latents.variational else 0.0
    vectors, coordinates = torch.from_numpy(batch.vectors), torch.from_numpy(batch.coordinates)
    start = torch.zeros(len(vectors), trained.posterior_mean.shape[1])
    if trained.linear_model is not None:
        start = trained.linear_model.fit(coordinates, vectors)
    start, target = start.to(device), trained.scaling.apply(vectors.to(device))
    fps = torch.from_numpy(batch.fps).to(device)
    with torch.no_grad():
        encoded = trained.network.encode_coordinates(coordinates.to(device), fps)
    unit = 1.0 / effect_of_numbers(trained, start, encoded, fps)

    @torch.enable_grad()
    def objective(moved: Tensor) -> tuple[Tensor, Tensor]:
        moved = moved.detach().requires_grad_()
        latents = start + unit * moved
        misfit = (trained.network.decode(latents, encoded, fps) - target).square().mean(dim=(1, 2))
        losses = misfit + 0.5 * kl_weight * latents.square().mean(dim=1)
        (gradients,) = torch.autograd.grad(losses.sum(), moved)
        return losses.detach(), gradients

    return (start + unit * minimise_each(objective, torch.zeros_like(start), EVALUATIONS)).cpu()


@torch.no_grad()
def minimise_each(
    objective: Callable[[Tensor], tuple[Tensor, Tensor]],
    start: Float[Tensor, "batch n"],
    evaluations: int,
) -> Float[Tensor, "batch n"]:
    """Minimise a function of each row by L-BFGS with backtracking (Nocedal & Wright 2006, algorithms 7.5 and 3.1).

    `objective` returns values [batch] and gradients [batch, n]. Rows are evaluated together, but each has its own step
    length and history: where a value does not decrease, a shorter step is evaluated next, elsewhere the next one.
    """
    point = start
    value, gradient = objective(point)
    # The latest steps of each row and the changes of its gradient, the newest last; zeros have no effect.
    steps = point.new_zeros((HISTORY, *point.shape))
    changes = torch.zeros_like(steps)
    length = torch.ones_like(value)
    for _ in range(evaluations - 1):
        direction = -_newton_step(gradient, steps, changes)
        trial = point + length[:, None] * direction
        trial_value, trial_gradient = objective(trial)
        expected = length * (gradient * direction).sum(dim=1)
        decreased = trial_value <= value + SUFFICIENT_DECREASE * expected
        step, change = trial - point, trial_gradient - gradient
        is_convex = (step * change).sum(dim=1) > SMALLEST_CURVATURE * change.square().sum(dim=1)
        (rows,) = torch.where(decreased & is_convex)
        steps[:, rows] = torch.cat((steps[1:, rows], step[None, rows]))
        changes[:, rows] = torch.cat((changes[1:, rows], change[None, rows]))
        # Towards the minimum of the parabola through both values and the slope.
        shorter = length * (0.5 * expected / (expected + value - trial_value)).nan_to_num(0.0).clamp(0.1, 0.5)
        length = torch.where(decreased, 1.0, shorter)
        value = torch.where(decreased, trial_value, value)
        point, gradient = (
            torch.where(decreased[:, None], new, old) for new, old in ((trial, point), (trial_gradient, gradient))
        )
    return point


def _newton_step(
    gradient: Float[Tensor, "batch n"],
    steps: Float[Tensor, "history batch n"],
    changes: Float[Tensor, "history batch n"],
) -> Float[Tensor, "batch n"]:
    """The inverse Hessian that L-BFGS estimates, times the gradient (Nocedal & Wright 2006, algorithm 7.4)."""
    curvature = (steps * changes).sum(dim=-1)
    inverse = torch.where(curvature > 0, 1.0 / curvature, 0.0)
    size = changes[-1].square().sum(dim=-1)
    # Without a step yet: of length 1 at most.
    first = 1.0 / gradient.abs().sum(dim=-1).clamp(min=1.0)
    result, weights = gradient, []
    for index in reversed(range(len(steps))):
        weights.append(inverse[index] * (steps[index] * result).sum(dim=-1))
        result = result - weights[-1][:, None] * changes[index]
    result = result * torch.where(size > 0, curvature[-1] / size, first)[:, None]
    for index, weight in enumerate(reversed(weights)):
        other = inverse[index] * (changes[index] * result).sum(dim=-1)
        result = result + (weight - other)[:, None] * steps[index]
    return result


def effect_of_numbers(
    trained: TrainedField,
    latents: Float32[Tensor, "batch latent"],
    encoded: EncodedCoordinates,
    fps: Float64[Tensor, "batch"],
) -> Float[Tensor, "batch latent"]:
    """The relative effect of a unit of each number of z on the poses of its clip.

    √diag(JᵀJ) by Hutchinson's estimator with random signs, the same for all clips; at least `SMALLEST_EFFECT`, to bound
    the steps of numbers with hardly any effect.
    """
    generator = torch.Generator().manual_seed(0)
    latents = latents.detach().requires_grad_()
    vectors = trained.network.decode(latents, encoded, fps)
    total = torch.zeros_like(latents)
    for _ in range(PROBES):
        signs = (torch.randint(0, 2, vectors.shape[1:], generator=generator) * 2.0 - 1.0).to(vectors.device)
        (gradient,) = torch.autograd.grad(vectors, latents, signs.expand_as(vectors), retain_graph=True)
        total += gradient.square()
    effect = total.sqrt()
    return (effect / effect.square().mean(dim=1, keepdim=True).sqrt()).clamp(min=SMALLEST_EFFECT)


POSES_TO_ENCODE_FROM = 100
WINDOWS_AT_ONCE, POSES_OF_VARIED = 64, 64


@dataclass(frozen=True, eq=False)
class NermEncoder:
    """A `MotionEncoder` that `ReconstructsWindows`: latents of a frozen field, one per window of at most l_max seconds.

    Neighbouring windows overlap by at least `overlap_seconds`; each z is fitted to at most 100 observed poses, evenly
    spaced among those of its window. `name` is its row in tables.
    """

    trained: TrainedField
    name: str = "NeRM"
    overlap_seconds: float = 1.0

    @property
    def store_fingerprint(self) -> str:
        """Fingerprint of the store that the field was trained on."""
        return self.trained.store_fingerprint

    def training_windows(self, store: Store) -> ModelWindows:
        """The training windows, decoded from their posterior means."""
        trained = self.trained
        source, _ = open_frames(trained.vectors, store, trained.config.where or None)

        def fields(rows: Int64[np.ndarray, "chosen"]) -> list[MotionField]:
            return self._fields(trained.windows.select(rows), trained.posterior_mean[torch.from_numpy(rows)])

        return ModelWindows(source, trained.windows, fields, "from their μ")

    def other_windows(self, store: Store, where: str | None) -> ModelWindows:
        """Windows of the sequences that match `where`, each z found by optimisation against the frozen field.

        Raises `UsageError` if there are none.
        """
        trained = self.trained
        source, frames = open_frames(trained.vectors, store, where)
        windows = cut_windows(source, max_duration_seconds=trained.max_duration_seconds)

        def fields(rows: Int64[np.ndarray, "chosen"]) -> list[MotionField]:
            chosen = windows.select(rows)
            poses = WindowPoses(chosen, frames)
            batches = (poses.evenly(some, POSES_TO_ENCODE_FROM) for some in chunks(len(chosen), WINDOWS_AT_ONCE))
            return self._fields(chosen, torch.cat([encode_by_optimisation(trained, batch) for batch in batches]))

        return ModelWindows(source, windows, fields, "encoded by optimisation")

    def _fields(self, windows: Windows, latents: Float32[Tensor, "windows latent"]) -> list[MotionField]:
        pairs = zip(latents, windows.duration_seconds.tolist(), strict=True)
        return [self.trained.as_motion_field(latent, seconds) for latent, seconds in pairs]

    def encode(
        self, observation: Observation, *, before_seconds: float = 0.0, after_seconds: float = 0.0
    ) -> AssembledField:
        """The motion as a field in the world's frame.

        Raises `ValueError` for a skeleton other than the 22-joint layout, and if a window has no observed pose (a gap,
        or extrapolation, about as long as l_max).
        """
        # By name: LaFAN1's skeleton has 22 joints too, but different ones.
        if observation.skeleton.joint_names != SMPL22.joint_names:
            raise ValueError(
                f"NeRM knows the {SMPL22.num_joints} joints of {SMPL22.name!r}, not those of "
                f"{observation.skeleton!r}: map the motion first (motionkit.core.skeletons.mapping.map_joints)"
            )
        start = observation.start_seconds - before_seconds
        span = observation.end_seconds + after_seconds - start
        length = min(span, self.trained.max_duration_seconds)
        starts = start + even_starts(span, self.trained.max_duration_seconds, self.overlap_seconds)
        parts = (self._pieces(observation, starts[rows], length) for rows in chunks(len(starts), WINDOWS_AT_ONCE))
        return assemble([piece for pieces in parts for piece in pieces])

    def _pieces(self, observation: Observation, starts: Float64[np.ndarray, "windows"], length: float) -> list[Piece]:
        # Observed frames to fit each window to; repeated if they are fewer than 100.
        first = np.searchsorted(observation.times_seconds, starts - 1e-9)
        last = np.searchsorted(observation.times_seconds, starts + length + 1e-9) - 1
        if (last < first).any():
            empty = float(starts[np.argmax(last < first)])
            raise ValueError(
                f"no pose is observed between {empty:.2f} and {empty + length:.2f} s: a window of "
                f"{self.trained.max_duration_seconds:g} s (l_max) needs at least one"
            )
        rows = np.rint(np.linspace(first, last, POSES_TO_ENCODE_FROM, axis=1)).astype(np.int64)
        positions = observation.poses.joint_positions[rows]
        yaw, origin = field.window_frame(positions[:, 0])
        seconds = observation.times_seconds[rows] - starts[:, None]
        fps = 1.0 / np.median(np.diff(observation.times_seconds)) if len(observation) > 1 else 30.0
        batch = PoseBatch(
            window=np.arange(len(starts)),
            coordinates=normalise_seconds(seconds, self.trained.max_duration_seconds),
            fps=np.full(len(starts), float(fps)),
            vectors=field.encode(positions, yaw, origin),
        )
        latents = encode_by_optimisation(self.trained, batch)
        placed = zip(latents, starts.tolist(), yaw.tolist(), origin.tolist(), strict=True)
        return [
            Piece(self.trained.as_motion_field(latent, length), start, turn, (x, z))
            for latent, start, turn, (x, z) in placed
        ]


def vary(windows: Windows, source: PositionCache, rng: np.random.Generator) -> tuple[Windows, Windows]:
    """The windows begun up to a second earlier or later, mirrored or not, at 0.9 to 1.1 times their tempo.

    The same windows twice: at the framerates of the new tempo, and at the sequences' own, which captions refer to.
    """
    sequence = np.searchsorted(source.sequence_index, windows.sequence_index)
    num_frames, percent = source.num_frames[sequence].astype(np.int64), rng.integers(90, 111, len(windows))
    longest = np.floor(windows.max_duration_seconds * windows.fps * percent / 100 + 1e-6).astype(np.int64) + 1
    length = np.minimum(longest, num_frames)
    moved = np.round(rng.integers(-4, 5, len(windows)) * 0.25 * windows.fps).astype(np.int64)
    start = np.clip(windows.start_frame + moved, 0, num_frames - length)
    start_row = source.start_row[sequence].astype(np.int64) + start
    mirrored = rng.random(len(windows)) < 0.5
    first_pose = np.array(source.positions[start_row])
    first_pose[mirrored] = mirror_positions(first_pose[mirrored], SMPL22.left_right_pairs)
    yaw, origin = field.window_frame(first_pose)
    at_own_tempo = replace(
        windows,
        start_row=start_row,
        start_frame=start,
        num_frames=length,
        mirrored=mirrored,
        yaw=yaw,
        origin=origin,
    )
    numerator, denominator = windows.fps_numerator * percent, windows.fps_denominator * 100
    return replace(at_own_tempo, fps_numerator=numerator, fps_denominator=denominator), at_own_tempo


def encode_varied(linear: LinearModel, windows: Windows, frames: FrameValues) -> Float32[Tensor, "windows latent"]:
    """The latents of many windows by the linear model's fit: optimisation moves them by a tenth of their deviation."""
    poses, latents = WindowPoses(windows, frames), []
    for rows in chunks(len(windows), WINDOWS_AT_ONCE):
        batch = poses.evenly(rows, POSES_OF_VARIED)
        latents.append(linear.fit(torch.from_numpy(batch.coordinates), torch.from_numpy(batch.vectors)))
    return torch.cat(latents)


def load(run: Path) -> NermEncoder:
    """The encoder of a run whose stage `field` is trained; raises what `load_field` raises."""
    trained = load_field(run)
    return NermEncoder(trained, row_name(RunFolder(run), trained.config))
