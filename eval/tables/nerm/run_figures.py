"""Scores of one trained model: its reconstruction and its generation, by framerate."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from eval.clip_fid.clips import REAL, describe_clips, draw_clips, place_clips, readable
from eval.clip_fid.features import Comparison, kinematic_source
from eval.clip_fid.kinematic import VERSION as KINEMATIC_VERSION
from eval.clip_fid.score import VERSION as CLIP_FID_VERSION
from eval.metrics.actions import diversity
from eval.metrics.number import over_replications
from eval.reconstruction.errors import mpjpe_cell, mre_cell, window_errors
from eval.report.results import Cell, cell_of
from eval.sets.generated import Window, generate_fields, needs_a_condition, refusal, sample_fields, windows_of
from eval.sets.partial import PartialResult, collect
from eval.sets.planted import planted_fields
from eval.sets.real import NoRealMotionError, RealMotion, real_motion, training_motion
from eval.sets.row_ids import RowId, Variant
from eval.sets.sets import SampleSet
from eval.sets.upsampled import low_passed
from eval.tables.models import Trained, TrainedModel, reconstructor
from eval.tables.nerm import table4
from eval.tables.nerm.clip_fid_column import NOT_SO_FAST, P1, P2, real_column, score_column
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
MPJPE, MRE = "root-aligned MPJPE (mm)", "MRE"
ERRORS = {MPJPE: mpjpe_cell, MRE: mre_cell}
_Fields = Mapping[Window, MotionField]


def _and_planted(fields: _Fields) -> dict[Variant, _Fields]:
    return {Variant.AS_IS: fields, Variant.PLANTED: planted_fields(fields)}


@dataclass(frozen=True, eq=False)
class Yardstick:
    """The common reference of a table's runs: a store's real motion at some framerates, a descriptor for each.

    Loading is lazy; results for the same request are cached in RESULTS/parts.
    """

    store: "Store"
    request: TableRequest
    rates: tuple[Fraction, ...]

    @cached_property
    def real(self) -> RealMotion:
        """The compared sequences."""
        return real_motion(self.store, self.request.real.split, self.request.real.where)

    def floors(self) -> Part:
        """clip-FID of real motion with itself: independent draws (P1), and disjoint halves of the takes (P2)."""
        return kept(self.request.results, "floors", self._clip_terms(), self._floors)

    def synthesis(
        self, trained: TrainedModel, sampling: SamplingOptions = SamplingOptions(), *, planted: bool = False
    ) -> Part:
        """clip-FID of a model's motions for the captions and durations of the real sequences.

        With `planted` also of the same motions planted. Raises `RunError` if a stage of it is not trained.
        """
        name = "synthesis-and-planted" if planted else "synthesis"
        terms = {**self._generated_terms(trained), "sampling": asdict(sampling)}
        return kept(self.request.results, name, terms, lambda: self._synthesis(trained, sampling, planted))

    def unconditional(self, trained: TrainedModel) -> Part:
        """clip-FID and diversity of a model's unconditional motions with the real sequences' durations.

        As generated, and planted. Raises `RunError` if a stage of it is not trained.
        """
        terms = self._generated_terms(trained)
        if needs_a_condition(trained.loaded):
            terms["conditions"] = "of random training motions"
        return kept(self.request.results, "unconditional", terms, lambda: self._unconditional(trained))

    def reconstruction(self, trained: Trained[MotionEncoder]) -> Part:
        """Errors of an encoder's training windows, from their trained latents, and of held-out windows.

        Raises `RunError` if a stage of it is not trained.
        """
        terms = {
            "version": RECONSTRUCTION_VERSION,
            "models": dict(trained.identity),
            "motions": self.request.evaluated.max_motions,
            **self._terms(),
        }
        return kept(self.request.results, "reconstruction", terms, lambda: self._reconstruction(trained))

    def _terms(self) -> dict[str, Any]:
        request = self.request
        return {
            "store": self.store.fingerprint,
            "split": request.real.split,
            "where": request.real.where,
            "fps": [str(fps) for fps in self.rates],
            "seed": request.seed,
        }

    def _generated_terms(self, trained: TrainedModel) -> dict[str, Any]:
        return {"models": dict(trained.identity), "motions": self.request.evaluated.max_motions, **self._clip_terms()}

    def _clip_terms(self) -> dict[str, Any]:
        versions = [CLIP_FID_VERSION, KINEMATIC_VERSION]
        protocol = asdict(self.request.clip_fid.protocol)
        return {
            "versions": versions,
            "protocol": protocol,
            "low_pass_hz": self.request.clip_fid.low_pass_hz,
            **self._terms(),
        }

    @cached_property
    def _columns(self) -> PartialResult[dict[Fraction, Comparison]]:
        """The comparison on the kinematic descriptor at each framerate.

        Raises `NoRealMotionError` if there is no motion to compare with at any.
        """
        train, source = training_motion(self.store, self.real), kinematic_source()

        def comparison(fps: Fraction) -> Comparison:
            column = real_column(fps, self.real, train).low_passed(self.request.clip_fid.low_pass_hz)
            return column.comparison(source, self.request.clip_fid.protocol)

        found = collect(self.rates, comparison, lambda fps: f"clip-FID, {label(fps)}")
        if not found.value:
            raise NoRealMotionError("; ".join(found.missing))
        return found

    def _floors(self) -> Part:
        missing = list(self._columns.missing)
        rows: dict[str, dict[str, Cell]] = {str(P1): {}, str(P2): {}}
        for fps, comparison in self._columns.value.items():
            found = score_column(comparison, {P1: comparison.real})
            missing += found.missing
            for row, cell in found.value.cells.items():
                rows[str(row)][label(fps)] = cell
        return Part(rows, tuple(missing))

    def _windows(self, model: GenerativeModel) -> list[Window]:
        """Requests with the real sequences' durations and conditions."""
        return windows_of(self.real.at(min(self._columns.value)), model.max_duration_seconds)

    def _synthesis(self, trained: TrainedModel, sampling: SamplingOptions, planted: bool) -> Part:
        model, request = trained.loaded, self.request
        fields = generate_fields(model, self._windows(model), request.seed, request.evaluated.max_motions, sampling)
        rows: dict[str, dict[str, Cell]] = {}
        missing = list(self._columns.missing)
        for variant, made in (_and_planted(fields) if planted else {Variant.AS_IS: fields}).items():
            cells = rows[str(RowId(SYNTHESIS, variant))] = {}
            for fps in self._columns.value:
                found = self._scored(RowId(_named(trained), variant), made, fps)
                missing += found.missing
                if found.value is not None:
                    cells[label(fps)], _ = found.value
        return Part(rows, tuple(missing))

    def _unconditional(self, trained: TrainedModel) -> Part:
        model, request = trained.loaded, self.request
        windows = self._without_conditions(model)
        variants = _and_planted(generate_fields(model, windows, request.seed, request.evaluated.max_motions))
        rows: dict[str, dict[str, Cell]] = {
            str(RowId(name, variant)): {} for variant in variants for name in (SYNTHESIS, DIVERSITY)
        }
        missing = list(self._columns.missing)
        for fps, comparison in self._columns.value.items():
            for variant, fields in variants.items():
                found = self._scored(RowId(_named(trained), variant), fields, fps)
                missing += found.missing
                if found.value is not None:
                    cell, samples = found.value
                    rows[str(RowId(SYNTHESIS, variant))][label(fps)] = cell
                    rows[str(RowId(DIVERSITY, variant))][label(fps)] = _diversity(samples, comparison)
            rows.setdefault(REAL_DIVERSITY, {})[label(fps)] = _diversity(comparison.real, comparison)
        return Part(rows, tuple(missing))

    def _without_conditions(self, model: GenerativeModel) -> list[Window]:
        """What a model is asked for without conditions; one that never learnt to do without has random ones.

        These are of training motion, so that what it makes is spread as all that it has learnt.
        """
        windows = self._windows(model)
        asked = [GenerationRequest(window.request.duration_seconds) for window in windows]
        if needs_a_condition(model):
            train = training_motion(self.store, self.real)
            known = [
                pair
                for pair in zip(train.captions, train.actions, strict=True)
                if any(pair) and not refusal(model, GenerationRequest(None, *pair))
            ]
            if not known:
                raise NoRealMotionError(f"{model.name} needs a condition, and no training motion has one that it knows")
            chosen = np.random.default_rng((self.request.seed, 11)).integers(len(known), size=len(asked))
            pairs = zip(asked, chosen.tolist(), strict=True)
            asked = [replace(request, text=known[row][0], action=known[row][1]) for request, row in pairs]
        return [replace(window, request=request) for window, request in zip(windows, asked, strict=True)]

    def _scored(
        self, row: RowId, fields: Mapping[Window, MotionField], fps: Fraction
    ) -> PartialResult[tuple[Cell, SampleSet] | None]:
        """clip-FID of a row's motions at a framerate, and these, smoothed like the real ones; None without any."""
        comparison, cutoff = self._columns.value[fps], self.request.clip_fid.low_pass_hz
        samples = sample_fields(fields, comparison.real.sequence_ids, fps, str(row))
        if samples is None:
            return PartialResult(None, (f"{row}, {label(fps)}: {NOT_SO_FAST}",))
        samples = samples if cutoff is None else low_passed(samples, cutoff)
        scored = score_column(comparison, {row: samples}, halves=False)
        cell = scored.value.cells.get(row)
        return PartialResult(None if cell is None else (cell, samples), scored.missing)

    def _reconstruction(self, trained: Trained[MotionEncoder]) -> Part:
        sets = described_windows(reconstructor(trained, self.store), self.store, self.request)
        missing = list(sets.missing)
        rows: dict[str, dict[str, Cell]] = {}
        for kind, name in WINDOW_SETS.items():
            if kind not in sets.value:
                continue
            every = np.arange(len(sets.value[kind].windows))
            for fps in self.rates:
                errors = [window_errors(window, fps) for window in sets.value[kind].reconstructed(every, fps)]
                if not errors:
                    missing.append(f"{name} windows, {label(fps)}: no take is that fast")
                for error, mean in ERRORS.items():
                    cell = mean(errors)
                    if cell is not None:
                        rows.setdefault(error_of(name, error), {})[label(fps)] = cell
        return Part(rows, tuple(missing))


def _named(trained: TrainedModel) -> str:
    return f"{trained.loaded.name} of run {trained.run.name!r}"


def _diversity(samples: SampleSet, comparison: Comparison) -> Cell:
    """Diversity of random clips in the features' space, over the protocol's replications."""
    protocol, features = comparison.protocol, comparison.features
    samples, values = readable(samples, features), []
    for replication in range(protocol.replications):
        places = place_clips(draw_clips(protocol, samples.fps, replication, REAL), samples)
        rng = np.random.default_rng((protocol.seed, replication, 5))
        values.append(diversity(describe_clips(samples, places, features), rng))
    return cell_of(over_replications(values))


def error_of(windows: str, error: str) -> str:
    """The row name, in a cached part, of one error of one set of windows."""
    return f"{windows}: {error}"


def label(fps: Fraction) -> str:
    """A framerate as a column's name."""
    return f"{fps} fps"
