"""Numbers of one trained model, which several tables show: its reconstruction and its generation, by framerate."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from eval.clip_fid.descriptor import VERSION as KINEMATIC_VERSION
from eval.clip_fid.score import KINEMATIC, REAL, ClipError, Comparison, describe_clips, draw_clips, feature_input
from eval.clip_fid.score import VERSION as CLIP_FID_VERSION
from eval.config import EvalConfig
from eval.detail import LEAST_FPS, RealDetail
from eval.detail import VERSION as DETAIL_VERSION
from eval.metrics.actions import diversity
from eval.metrics.number import over_replications
from eval.reconstruction import described_windows, mpjpe_cell, mre_cell
from eval.report.results import Cell, Row, cell_of, parse_cell
from eval.sets.motions import (
    NoRealMotionError,
    RealMotion,
    Window,
    generate_fields,
    low_passed,
    needs_a_condition,
    planted_fields,
    real_motion,
    refusal,
    sample_fields,
    training_motion,
    windows_of,
)
from eval.sets.sets import Missing, RowId, SampleSet, Variant
from eval.tables.columns import NOT_SO_FAST, P1, P2, ROW_NOTES, detail_cells, label, real_column, score_column
from eval.tables.models import Trained, TrainedModel, reconstructor
from eval.tables.table import cached
from motionkit.fields.motion_field import MotionEncoder, MotionField
from motionkit.generate.models import GenerationRequest, GenerativeModel, SamplingOptions
from motionkit.store.reader import Store

RECONSTRUCTION_VERSION = "reconstruction/2"
SYNTHESIS, DIVERSITY, REAL_DIVERSITY = "clip-FID", "diversity", "diversity of real motion"
DETAIL = "detail profile"
MPJPE, MRE = "root-aligned MPJPE (mm)", "MRE"
ERRORS = {MPJPE: mpjpe_cell, MRE: mre_cell}

Rows = Mapping[str, Mapping[str, Cell]]
_Fields = Mapping[Window, MotionField]


@dataclass(frozen=True, eq=False)
class Yardstick:
    """The common reference of a table's runs: a store's real motion at some framerates, a descriptor for each.

    Loading is lazy; numbers for the same terms are cached in RESULTS/parts. What is missing is added to the
    configuration's collector.
    """

    store: Store
    config: EvalConfig
    rates: tuple[Fraction, ...]

    @cached_property
    def real(self) -> RealMotion:
        """The compared sequences."""
        return real_motion(self.store, self.config.split, self.config.where)

    @property
    def labels(self) -> tuple[str, ...]:
        """The columns' names."""
        return tuple(map(label, self.rates))

    def floors(self) -> Rows:
        """clip-FID of real motion with itself: independent draws (P1), and disjoint halves of the takes (P2)."""
        return self._cached("floors", self._clip_terms(), self._floors)

    def floor_rows(self) -> list[Row]:
        """`floors` as rows of a block."""
        floors = self.floors()
        return [Row(str(row), "reference", floors[str(row)], ROW_NOTES[row]) for row in (P1, P2)]

    def synthesis(
        self, trained: TrainedModel, sampling: SamplingOptions = SamplingOptions(), *, planted: bool = False
    ) -> Rows:
        """clip-FID of a model's motions for the captions and durations of the real sequences.

        With `planted` also of the same motions planted, and the detail profile of both. Raises `RunError` if a stage of
        it is not trained.
        """
        terms = {**self._clip_terms(trained), "sampling": asdict(sampling), "planted": planted and DETAIL_VERSION}

        def compute(missing: Missing) -> Rows:
            windows = self._windows(trained.loaded)
            fields = generate_fields(trained.loaded, windows, self.config.seed, self.config.max_motions, sampling)
            variants = _and_planted(fields) if planted else {Variant.AS_IS: fields}
            rows: dict[str, dict[str, Cell]] = {}
            for variant, made in variants.items():
                cells = rows[str(RowId(SYNTHESIS, variant))] = {}
                for fps in self._comparisons(missing):
                    if (scored := self._scored(_row(trained, variant), made, fps, missing)) is not None:
                        cells[label(fps)], samples = scored
                        if planted and fps in self.details:
                            detail = str(RowId(f"{DETAIL}, {label(fps)}", variant))
                            rows[detail] = detail_cells(self.details[fps], samples)
            return rows

        return self._cached("synthesis", terms, compute)

    def unconditional(self, trained: TrainedModel) -> Rows:
        """clip-FID and diversity of a model's unconditional motions with the real sequences' durations.

        As generated, and planted. Raises `RunError` if a stage of it is not trained.
        """
        terms = self._clip_terms(trained)
        if needs_a_condition(trained.loaded):
            terms["conditions"] = "of random training motions"

        def compute(missing: Missing) -> Rows:
            windows = self._without_conditions(trained.loaded)
            fields = generate_fields(trained.loaded, windows, self.config.seed, self.config.max_motions)
            rows: dict[str, dict[str, Cell]] = {REAL_DIVERSITY: {}}
            for variant, made in _and_planted(fields).items():
                synthesis = rows[str(RowId(SYNTHESIS, variant))] = {}
                diversities = rows[str(RowId(DIVERSITY, variant))] = {}
                for fps, comparison in self._comparisons(missing).items():
                    if (scored := self._scored(_row(trained, variant), made, fps, missing)) is not None:
                        synthesis[label(fps)], samples = scored
                        diversities[label(fps)] = _diversity(samples, comparison)
            for fps, comparison in self._comparisons(missing).items():
                rows[REAL_DIVERSITY][label(fps)] = _diversity(comparison.real, comparison)
            return rows

        return self._cached("unconditional", terms, compute)

    @cached_property
    def details(self) -> dict[Fraction, RealDetail]:
        """The real side of the detail profile, at framerates of 40 fps or more; without those of frozen real motion."""
        found = {}
        for fps, comparison in self._made[0].items():
            if fps >= LEAST_FPS and comparison.training is not None:
                with self.config.missing.skipping(f"detail, {label(fps)}", (ClipError,)):
                    found[fps] = RealDetail.of(comparison.real, comparison.training, self.config.seed)
        return found

    def reconstruction(self, trained: Trained[MotionEncoder]) -> Rows:
        """Errors of an encoder's training windows, from their trained latents, and of held-out windows.

        A row is named by `error_of`. Raises `RunError` if a stage of it is not trained.
        """
        terms = {"version": RECONSTRUCTION_VERSION, "models": dict(trained.identity), **self._terms()}

        def compute(missing: Missing) -> Rows:
            encoder = reconstructor(trained, self.store)
            rows: dict[str, dict[str, Cell]] = {}
            for name, sample in described_windows(encoder, self.store, self.config, self.rates, missing).items():
                for fps in self.rates:
                    errors = list(sample.errors(np.arange(len(sample.windows)), fps).values())
                    if not errors:
                        missing.add(f"{name}, {label(fps)}: no take is that fast")
                    for error, mean in ERRORS.items():
                        if (cell := mean(errors)) is not None:
                            rows.setdefault(error_of(name, error), {})[label(fps)] = cell
            return rows

        return self._cached("reconstruction", terms, compute)

    def _cached(self, name: str, terms: Mapping[str, Any], compute: Callable[[Missing], Rows]) -> Rows:
        def values() -> dict[str, Any]:
            missing = Missing()
            rows = compute(missing)
            plain = {row: {column: asdict(cell) for column, cell in cells.items()} for row, cells in rows.items()}
            return {"rows": plain, "missing": missing.lines}

        found = cached(self.config.results, name, terms, values)
        self.config.missing.add(*found["missing"])
        return {row: {key: parse_cell(cell) for key, cell in cells.items()} for row, cells in found["rows"].items()}

    def _terms(self) -> dict[str, Any]:
        return {
            "store": self.store.fingerprint,
            "split": self.config.split,
            "where": self.config.where,
            "fps": [str(fps) for fps in self.rates],
            "motions": self.config.max_motions,
            "seed": self.config.seed,
        }

    def _clip_terms(self, trained: TrainedModel | None = None) -> dict[str, Any]:
        return {
            "versions": [CLIP_FID_VERSION, KINEMATIC_VERSION],
            "protocol": asdict(self.config.clips),
            "low_pass_hz": self.config.low_pass_hz,
            "models": {} if trained is None else dict(trained.identity),
            **self._terms(),
        }

    @cached_property
    def _made(self) -> tuple[dict[Fraction, Comparison], tuple[str, ...]]:
        """The comparison on the kinematic descriptor at each framerate, and the framerates that have none.

        Raises `NoRealMotionError` if none has.
        """
        train, source, missing = training_motion(self.store, self.real), KINEMATIC, Missing()
        found = {}
        for fps in self.rates:
            with missing.skipping(f"clip-FID, {label(fps)}"):
                column = real_column(fps, self.real, train).low_passed(self.config.low_pass_hz)
                if column.train is None:
                    raise NoRealMotionError("the training split has no motion at this framerate")
                found[fps] = source.comparison(column.real, column.train, self.config.clips)
        if not found:
            raise NoRealMotionError("; ".join(missing.lines))
        return found, missing.lines

    def _comparisons(self, missing: Missing) -> dict[Fraction, Comparison]:
        found, lines = self._made
        missing.add(*lines)
        return found

    def _floors(self, missing: Missing) -> Rows:
        rows: dict[str, dict[str, Cell]] = {str(P1): {}, str(P2): {}}
        for fps, comparison in self._comparisons(missing).items():
            for row, cell in score_column(comparison, {P1: comparison.real}, missing)[0].items():
                rows[str(row)][label(fps)] = cell
        return rows

    def _windows(self, model: GenerativeModel) -> list[Window]:
        """Requests with the real sequences' durations and conditions."""
        return windows_of(self.real.at(min(self._made[0])), model.max_duration_seconds)

    def _without_conditions(self, model: GenerativeModel) -> list[Window]:
        """Requests without conditions; a model that never learnt to do without gets random ones of training motion."""
        windows = self._windows(model)
        requests = [GenerationRequest(window.request.duration_seconds) for window in windows]
        if needs_a_condition(model):
            train = training_motion(self.store, self.real)
            known = [
                pair
                for pair in zip(train.captions, train.actions, strict=True)
                if any(pair) and not refusal(model, GenerationRequest(None, *pair))
            ]
            if not known:
                raise NoRealMotionError(f"{model.name} needs a condition, and no training motion has one that it knows")
            chosen = np.random.default_rng((self.config.seed, 11)).integers(len(known), size=len(requests))
            pairs = zip(requests, chosen.tolist(), strict=True)
            requests = [replace(request, text=known[row][0], action=known[row][1]) for request, row in pairs]
        return [replace(window, request=request) for window, request in zip(windows, requests, strict=True)]

    def _scored(self, row: RowId, fields: _Fields, fps: Fraction, missing: Missing) -> tuple[Cell, SampleSet] | None:
        """clip-FID of a row's motions at a framerate, and these, smoothed like the real ones; None without any."""
        comparison = self._comparisons(missing)[fps]
        samples = sample_fields(fields, comparison.real.sequence_ids, fps, str(row))
        if samples is None:
            missing.add(f"{row}, {label(fps)}: {NOT_SO_FAST}")
            return None
        if self.config.low_pass_hz is not None:
            samples = low_passed(samples, self.config.low_pass_hz)
        cells, _ = score_column(comparison, {row: samples}, missing, halves=False)
        return (cells[row], samples) if row in cells else None


def error_of(windows: str, error: str) -> str:
    """The row name of one error of one set of windows."""
    return f"{windows}: {error}"


def _and_planted(fields: _Fields) -> dict[Variant, _Fields]:
    return {Variant.AS_IS: fields, Variant.PLANTED: planted_fields(fields)}


def _row(trained: TrainedModel, variant: Variant) -> RowId:
    return RowId(f"{trained.loaded.name} of run {trained.run.name!r}", variant)


def _diversity(samples: SampleSet, comparison: Comparison) -> Cell:
    """Diversity of random clips in the features' space, over the protocol's replications."""
    protocol, features = comparison.protocol, comparison.features
    samples, values = feature_input(samples, features), []
    for replication in range(protocol.replications):
        clips = draw_clips(samples, protocol, replication, REAL)
        rng = np.random.default_rng((protocol.seed, replication, 5))
        values.append(diversity(describe_clips(samples, clips, features), rng))
    return cell_of(over_replications(values))
