"""A model whose motions need no training, and what its generated folders hold."""

import csv
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

import motionkit as mk
from motionkit.core.skeletons.mapping import rest_positions
from motionkit.fields.motion_field import Poses, check_times


@dataclass(frozen=True, eq=False)
class Drift:
    """The standing skeleton, drifting along z at 1 m/s from `offset`."""

    offset: float
    end_seconds: float
    skeleton = mk.SMPL22
    start_seconds = 0.0

    def query(self, times_seconds):
        check_times(self, times_seconds)
        positions = np.repeat(rest_positions(mk.SMPL22)[None], len(times_seconds), axis=0)
        positions[..., 2] += (self.offset + times_seconds[:, None]).astype(np.float32)
        return Poses(positions)


class DriftModel:
    name, skeleton, max_training_fps, max_duration_seconds = "Drift", mk.SMPL22, Fraction(120), 10.0

    def __init__(self, fails_at=None):
        self.fails_at = fails_at

    def text_encoder(self):
        return None

    def check(self, request, sampling=None):
        if request.action == "fly":
            raise mk.UsageError("the model knows no action 'fly'")

    def generate(self, requests, *, seed, sampling=None, first=0):
        if self.fails_at is not None and first >= self.fails_at:
            raise KeyboardInterrupt
        return [
            Drift(seed % 89 + index / 10, 3.0 if request.duration_seconds is None else request.duration_seconds)
            for index, request in enumerate(requests, start=first)
        ]


class GoesOn(DriftModel):
    """Goes on from the place of the first pose that it is held to, or along a path."""

    constraint_kinds = frozenset(("path", "pose"))

    def __init__(self):
        super().__init__()
        self.asked = []

    def generate(self, requests, *, seed, sampling=None, first=0):
        self.asked += [(first + row, request) for row, request in enumerate(requests)]
        made = super().generate(requests, seed=seed, first=first)
        for row, request in enumerate(requests):
            for each in request.constraints:
                made[row] = Drift(float(each.positions[0, 0, 2]), made[row].end_seconds)
        return made


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def rows_of(table):
    return list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
