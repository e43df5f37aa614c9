"""Initialisation of local latents: a linear model of the poses, fitted to a window by ridge regression.

The path bank is fitted to the root's path and heading, then the pose banks to the principal components of the poses
relative to the fitted path. The network starts as the same linear model.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from motionkit.core.shapes import Float, Float32, Float64, Int64
from motionkit.data.windows import WindowPoses, chunks
from motionkit.features import field
from motionkit.training.pose_vectors import ROOT_PATH, PoseTensors, VectorScaling
from nerm.latents import KnotLayout, LocalLatents, relative_to

TIMES_PER_WINDOW = 128
HELD_TIMES = 128
WINDOWS_AT_ONCE = 256


def ridge_knots(
    targets: Float[Tensor, "windows times width"],
    coordinates: Float64[Tensor, "windows times"],
    counts: Float[Tensor, "windows times"],
    layout: KnotLayout,
    ridge: float,
) -> Float32[Tensor, "windows knots width"]:
    """Fit knots to targets at given coordinates by ridge regression.

    `counts` weights the instants; the ridge is in units of one instant.
    """
    weights = layout.interpolant(coordinates.reshape(-1)).reshape(*coordinates.shape, layout.num_knots)
    counted = (weights * counts[..., None]).transpose(1, 2)
    gram = counted @ weights + ridge * torch.eye(layout.num_knots, dtype=torch.float64)
    knots: Tensor = torch.linalg.solve(gram, counted @ targets.double())
    return knots.float()


def measured_heading(
    vectors: Float32[Tensor, "windows times numbers"],
) -> Float64[Tensor, "windows times"]:
    """The unwrapped heading (radians) of `field` vectors in metres and in order of time."""
    heading = field.heading(field.decode(vectors.numpy())).astype(np.float64)
    return torch.from_numpy(np.unwrap(heading, axis=1))


@dataclass(frozen=True, eq=False)
class PoseComponents:
    """Principal components of standardised poses, scaled to unit variance."""

    mean: Float32[Tensor, "numbers"]
    directions: Float32[Tensor, "numbers components"]

    def scores(self, standardised: Float[Tensor, "*poses numbers"]) -> Float[Tensor, "*poses components"]:
        """Standardised vectors → component scores of unit variance."""
        return (standardised - self.mean) @ self.directions

    def inverse(self) -> Float32[Tensor, "components numbers"]:
        """Maps scores back to centred vectors (a pseudo-inverse)."""
        matrix: Tensor = torch.linalg.pinv(self.directions)
        return matrix


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Banks, scales and components of the linear model; `ridge` in units of one pose per knot."""

    banks: LocalLatents
    scaling: VectorScaling
    components: PoseComponents
    ridge: float

    def fit(self, batch: PoseTensors) -> Float32[Tensor, "batch latent"]:
        """Latents of windows from poses in order of time; the last pose is held beyond a window's end."""
        batch, counts = held(batch)
        path_knots, relative = _without_path(batch, counts, self.banks, self.scaling, self.ridge)
        scores = self.components.scores(relative)
        of_bank = torch.split(scores, [bank.numbers for bank in self.banks.pose], dim=-1)
        pose_knots = [
            ridge_knots(targets, batch.coordinates, counts, bank.knots, self.ridge)
            for targets, bank in zip(of_bank, self.banks.pose, strict=True)
        ]
        return self.banks.join([*pose_knots, *path_knots])


def measure_components(poses: WindowPoses, banks: LocalLatents, scaling: VectorScaling, ridge: float) -> PoseComponents:
    """Principal components of the windows' poses relative to their fitted paths; one pass, constant memory."""
    size = len(scaling.mean)
    count, total, outer = 0, torch.zeros(size).double(), torch.zeros(size, size).double()
    for rows in chunks(len(poses.windows), WINDOWS_AT_ONCE):
        batch = PoseTensors.of(poses.evenly(rows, TIMES_PER_WINDOW))
        counts = torch.ones_like(batch.coordinates)
        vectors = _without_path(batch, counts, banks, scaling, ridge)[1].double().flatten(0, 1)
        count += len(vectors)
        total, outer = total + vectors.sum(0), outer + vectors.T @ vectors
    mean = total / count
    values, axes = torch.linalg.eigh(outer / count - torch.outer(mean, mean))
    largest = torch.argsort(values, descending=True)[: banks.num_components]
    directions = axes[:, largest] / values[largest].clamp(min=1e-12).sqrt()
    return PoseComponents(mean.float(), directions.float())


def fit_windows(
    poses: WindowPoses, model: LinearModel, windows: Int64[np.ndarray, "chosen"]
) -> Float32[Tensor, "chosen latent"]:
    """Fit the latents of these windows."""
    return torch.cat(
        [
            model.fit(PoseTensors.of(poses.evenly(windows[rows], TIMES_PER_WINDOW)))
            for rows in chunks(len(windows), WINDOWS_AT_ONCE)
        ]
    )


def held(batch: PoseTensors) -> tuple[PoseTensors, Float64[Tensor, "batch times"]]:
    """Hold each window's last pose from its end to t = 1; returns the batch and the weight of each instant.

    Knots beyond a window's end then describe a body that stands still instead of being undetermined.
    """
    grid = torch.linspace(-1.0, 1.0, HELD_TIMES, dtype=torch.float64).expand(len(batch.window), -1)
    last = batch.vectors[:, -1:].expand(-1, HELD_TIMES, -1)
    counts = torch.cat((torch.ones_like(batch.coordinates), (grid > batch.coordinates[:, -1:]).double()), dim=1)
    coordinates = torch.cat((batch.coordinates, grid), dim=1)
    return PoseTensors(batch.window, coordinates, batch.fps, torch.cat((batch.vectors, last), dim=1)), counts


def _without_path(
    batch: PoseTensors,
    counts: Float64[Tensor, "batch times"],
    banks: LocalLatents,
    scaling: VectorScaling,
    ridge: float,
) -> tuple[list[Float32[Tensor, "batch knots 3"]], Float32[Tensor, "batch times numbers"]]:
    """The path bank's knots (empty without such a bank) and standardised poses relative to the path."""
    standardised = scaling.apply(batch.vectors)
    if banks.path is None:
        return [], standardised
    layout = banks.path.knots
    x, z = (standardised[..., number].double() for number in ROOT_PATH)
    measured = torch.stack((x, z, measured_heading(batch.vectors)), dim=-1)
    units = banks.path_units().double()
    knots = ridge_knots(measured / units, batch.coordinates, counts, layout, ridge)
    weights = layout.interpolant(batch.coordinates.reshape(-1)).reshape(*batch.coordinates.shape, -1)
    path = (weights @ knots.double()) * units
    return [knots], relative_to(standardised, path.float())
