"""What one trained model scores: how it reconstructs and what it generates, by framerate."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from eval.clip_fid.features import fit_on
from eval.clip_fid.kinematic import BLOCKS, KinematicDescriptor
from eval.clip_fid.kinematic import VERSION as KINEMATIC_VERSION
from eval.clip_fid.score import (
    REAL,
    ClipError,
    check_lengths,
    describe_clips,
    draw_clips,
    place_clips,
    score_disjoint_halves,
    score_rows,
)
from eval.clip_fid.score import VERSION as CLIP_FID_VERSION
from eval.metrics.actions import diversity
from eval.metrics.checks import estimate
from eval.reconstruction.errors import mpjpe_cell, mre_cell, window_errors
from eval.report.results import Cell
from eval.sets.generated import Window, chosen_windows, sample_fields, windows_of
from eval.sets.real import NoRealMotionError, RealMotion, real_motion
from eval.sets.sets import SampleSet
from eval.sets.upsampled import low_passed
from eval.tables.models import Trained, TrainedModel, reconstructor
from eval.tables.nerm import table4
from eval.tables.nerm.clip_fid_column import P1, P2
from eval.tables.nerm.table2 import clip_fid_cell
from eval.tables.nerm.table4 import VERSION as RECONSTRUCTION_VERSION
from eval.tables.nerm.table4 import described_windows
from eval.tables.parts import Part, kept
from eval.tables.registry import TableRequest
from motionkit.fields.motion_field import MotionEncoder, MotionField
from motionkit.generate.models import GenerationRequest, GenerativeModel, SamplingOptions

if TYPE_CHECKING:
    from motionkit.store.reader import Store

TRAINING, HELD_OUT, SYNTHESIS = "training", "held out", "clip-FID"
WINDOW_SETS = {table4.TRAINING: TRAINING, table4.HELD_OUT: HELD_OUT}
DIVERSITY, REAL_DIVERSITY = "diversity", "diversity of real motion"
PARTS = {"slip": BLOCKS["slip"]}
MPJPE, MRE = "root-aligned MPJPE (mm)", "MRE"
ERRORS = {MPJPE: mpjpe_cell, MRE: mre_cell}


@dataclass(frozen=True, eq=False)
class _Columns:
    """The real set and the descriptor of each framerate that has both, and why others have not."""

    found: Mapping[Fraction, tuple[SampleSet, KinematicDescriptor]]
    missing: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Yardstick:
    """What all runs of a table are held against: a store's real motion at some framerates, a descriptor for each.

    Nothing is loaded before it is needed; what was computed once, for the same request, is read from RESULTS/parts.
    """

    store: "Store"
    request: TableRequest
    rates: tuple[Fraction, ...]

    @cached_property
    def real(self) -> RealMotion:
        """The compared sequences."""
        return real_motion(self.store, self.request.split, self.request.where)

    def floors(self) -> Part:
        """clip-FID of real motion with itself: independent draws (P1), and disjoint halves of the takes (P2)."""
        return kept(self.request.results, "floors", self._clip_terms(), self._floors)

    def synthesis(self, trained: TrainedModel, sampling: SamplingOptions = SamplingOptions()) -> Part:
        """clip-FID of what a model generates for the captions and durations of the real sequences.

        Raises `RunError` where a stage of it is not trained.
        """
        terms = {**self._generated_terms(trained), "sampling": asdict(sampling)}
        return kept(self.request.results, "synthesis", terms, lambda: self._synthesis(trained, sampling))

    def unconditional(self, trained: TrainedModel) -> Part:
        """clip-FID and diversity of what a model generates without any condition but the real sequences' durations.

        Raises `RunError` where a stage of it is not trained.
        """
        terms = self._generated_terms(trained)
        return kept(self.request.results, "unconditional", terms, lambda: self._unconditional(trained))

    def reconstruction(self, trained: Trained[MotionEncoder]) -> Part:
        """Errors of an encoder's training windows, as they were trained, and of held-out windows.

        Raises `RunError` where a stage of it is not trained.
        """
        terms = {
            "version": RECONSTRUCTION_VERSION,
            "models": dict(trained.identity),
            "motions": self.request.max_motions,
            **self._terms(),
        }
        return kept(self.request.results, "reconstruction", terms, lambda: self._reconstruction(trained))

    def _terms(self) -> dict[str, Any]:
        request = self.request
        return {
            "store": self.store.fingerprint,
            "split": request.split,
            "where": request.where,
            "fps": [str(fps) for fps in self.rates],
            "seed": request.seed,
        }

    def _generated_terms(self, trained: TrainedModel) -> dict[str, Any]:
        return {"models": dict(trained.identity), "motions": self.request.max_motions, **self._clip_terms()}

    def _clip_terms(self) -> dict[str, Any]:
        versions = [CLIP_FID_VERSION, KINEMATIC_VERSION]
        protocol = asdict(self.request.protocol)
        return {"versions": versions, "protocol": protocol, "low_pass_hz": self.request.low_pass_hz, **self._terms()}

    def _smoothed(self, samples: SampleSet) -> SampleSet:
        cutoff = self.request.low_pass_hz
        return samples if cutoff is None else low_passed(samples, cutoff)

    @cached_property
    def _columns(self) -> _Columns:
        has_training = bool((self.store.columns("split")["split"] == "train").any())
        train = real_motion(self.store, "train") if has_training else self.real
        found, missing = {}, []
        for fps in self.rates:
            try:
                real = self._smoothed(self.real.at(fps))
                check_lengths(real, self.request.protocol)
                found[fps] = (real, fit_on(self._smoothed(train.at(fps))))
            except (NoRealMotionError, ClipError) as error:
                missing.append(f"clip-FID, {label(fps)}: {error}")
        return _Columns(found, tuple(missing))

    def _floors(self) -> Part:
        protocol, missing = self.request.protocol, list(self._columns.missing)
        rows: dict[str, dict[str, Cell]] = {P1: {}, P2: {}}
        for fps, (real, descriptor) in self._columns.found.items():
            rows[P1][label(fps)] = clip_fid_cell(score_rows(real, {P1: real}, descriptor, protocol, PARTS)[P1])
            try:
                rows[P2][label(fps)] = clip_fid_cell(score_disjoint_halves(real, descriptor, protocol, PARTS))
            except ClipError as error:
                missing.append(f"{P2}, {label(fps)}: {error}")
        return Part(rows, tuple(missing))

    def _windows(self, model: GenerativeModel) -> list[Window]:
        """What is asked of a model: the real sequences' durations and conditions, a random choice of many."""
        windows = windows_of(self.real.at(min(self._columns.found)), model.max_duration_seconds)
        return chosen_windows(windows, self.request.seed, self.request.max_motions)

    def _synthesis(self, trained: TrainedModel, sampling: SamplingOptions) -> Part:
        model, columns, name = trained.loaded, self._columns, trained.run.name
        if not columns.found:
            return Part({SYNTHESIS: {}}, columns.missing)
        windows = self._windows(model)
        requests = [window.request for window in windows]
        fields = dict(zip(windows, model.generate(requests, seed=self.request.seed, sampling=sampling), strict=True))
        cells, missing = {}, list(columns.missing)
        for fps in columns.found:
            score = self._score(name, fields, fps)
            if score is None:
                missing.append(f"{name}, {label(fps)}: no generated motion is for a sequence this fast")
            else:
                cells[label(fps)] = score
        return Part({SYNTHESIS: cells}, tuple(missing))

    def _unconditional(self, trained: TrainedModel) -> Part:
        model, columns, name = trained.loaded, self._columns, trained.run.name
        if not columns.found:
            return Part({}, columns.missing)
        windows = self._windows(model)
        requests = [GenerationRequest(window.request.duration_seconds) for window in windows]
        fields = dict(zip(windows, model.generate(requests, seed=self.request.seed), strict=True))
        rows: dict[str, dict[str, Cell]] = {SYNTHESIS: {}, DIVERSITY: {}, REAL_DIVERSITY: {}}
        for fps, (real, _) in columns.found.items():
            score, samples = self._score(name, fields, fps), sample_fields(fields, real.sequence_ids, fps, name)
            if score is not None and samples is not None:
                rows[SYNTHESIS][label(fps)] = score
                rows[DIVERSITY][label(fps)] = self._diversity(self._smoothed(samples), fps)
            rows[REAL_DIVERSITY][label(fps)] = self._diversity(real, fps)
        return Part(rows, columns.missing)

    def _score(self, name: str, fields: Mapping[Window, MotionField], fps: Fraction) -> Cell | None:
        real, descriptor = self._columns.found[fps]
        samples = sample_fields(fields, real.sequence_ids, fps, name)
        if samples is None:
            return None
        rows = {name: self._smoothed(samples)}
        return clip_fid_cell(score_rows(real, rows, descriptor, self.request.protocol, PARTS)[name])

    def _diversity(self, samples: SampleSet, fps: Fraction) -> Cell:
        """Diversity of random clips in the descriptor's space, over the protocol's replications."""
        protocol, descriptor = self.request.protocol, self._columns.found[fps][1]
        values = []
        for replication in range(protocol.replications):
            places = place_clips(draw_clips(protocol, fps, replication, REAL), samples)
            rng = np.random.default_rng((protocol.seed, replication, 5))
            values.append(diversity(describe_clips(samples, places, descriptor), rng))
        found = estimate(values)
        return Cell(found.mean, found.ci95)

    def _reconstruction(self, trained: Trained[MotionEncoder]) -> Part:
        missing: list[str] = []
        sets = described_windows(reconstructor(trained, self.store), self.store, self.request, missing)
        rows: dict[str, dict[str, Cell]] = {}
        for kind, name in WINDOW_SETS.items():
            if kind not in sets:
                continue
            every = np.arange(len(sets[kind].windows))
            for fps in self.rates:
                errors = [window_errors(window, fps) for window in sets[kind].reconstructed(every, fps)]
                if not errors:
                    missing.append(f"{name} windows, {label(fps)}: no take is that fast")
                for error, cell_of in ERRORS.items():
                    cell = cell_of(errors)
                    if cell is not None:
                        rows.setdefault(error_of(name, error), {})[label(fps)] = cell
        return Part(rows, tuple(missing))


def error_of(windows: str, error: str) -> str:
    """The row of a reconstruction's part with one error of one set of windows."""
    return f"{windows}: {error}"


def label(fps: Fraction) -> str:
    """A framerate as a column's name."""
    return f"{fps} fps"
