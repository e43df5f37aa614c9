"""The available feature sets: the kinematic descriptor, and Guo's evaluator where its files are given."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from eval.clip_fid.channels import channels
from eval.clip_fid.clips import (
    REAL,
    ClipPlaces,
    FeatureSet,
    Protocol,
    check_lengths,
    describe_clips,
    draw_clips,
    place_clips,
    readable,
)
from eval.clip_fid.kinematic import VERSION, KinematicDescriptor, fit_kinematic, standardised
from eval.clip_fid.score import RowKey, score_disjoint_halves, score_rows
from eval.clip_fid.threads import in_threads
from eval.metrics.number import Number
from eval.sets.sets import Missing, Ragged, SampleSet
from eval.text_motion.guo.kind import GuoFiles
from motionkit.core.errors import UsageError

FIT_CLIPS = 8192
FIT_FRAMES = 100_000
GUO_REPLICATIONS = 5
FIT_REPLICATION = 1_000_000
"""The seed of the descriptor's fit, different from those of all replications."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """The comparison of sample sets with the real set at one framerate; the features were fitted on `training`."""

    real: SampleSet
    features: FeatureSet
    protocol: Protocol
    training: SampleSet | None = None

    @cached_property
    def _real(self) -> SampleSet:
        return readable(self.real, self.features)

    @property
    def num_features(self) -> int:
        """Number of features of a clip."""
        shortest = int(self.protocol.sizes.sizes(self.real.fps).min())
        clip = self._real.sequences.clips(np.zeros(1, dtype=np.int64), shortest)
        return int(self.features.describe(clip, self.real.fps).shape[1])

    def scores(
        self,
        rows: Mapping[RowKey, SampleSet],
        on_replication: Callable[[], None] = lambda: None,
        subset_sizes: Mapping[RowKey, int] | None = None,
    ) -> dict[RowKey, Number]:
        """clip-FID of every row; takes and raises what `score_rows` does."""
        rows = {name: self._real if samples is self.real else samples for name, samples in rows.items()}
        return score_rows(self._real, rows, self.features, self.protocol, on_replication, subset_sizes)

    def disjoint_halves(self, on_replication: Callable[[], None] = lambda: None) -> Number:
        """clip-FID between halves of the real takes; raises `ClipError` where there are too few."""
        return score_disjoint_halves(self._real, self.features, self.protocol, on_replication)


@dataclass(frozen=True)
class FeatureSource:
    """A kind of features; `fit` returns the feature set for one framerate, fitted on the real training set.

    `max_replications` bounds the cost of slow features.
    """

    name: str
    title: str
    fit: Callable[[SampleSet], FeatureSet]
    note: str = ""
    max_replications: int | None = None

    def protocol(self, asked: Protocol) -> Protocol:
        """The requested protocol, with at most `max_replications`."""
        if self.max_replications is None or asked.replications <= self.max_replications:
            return asked
        return replace(asked, replications=self.max_replications)

    def comparison(self, real: SampleSet, train: SampleSet, asked: Protocol) -> Comparison:
        """A comparison with the real set, on features fitted on the training set at its framerate.

        Raises `ClipError` if a set has no sequence for the largest clips, and what fitting raises.
        """
        protocol = self.protocol(asked)
        check_lengths(real, protocol)
        return Comparison(real, self.fit(train), protocol, train)


def feature_sources(wanted: Sequence[str] | None, guo: GuoFiles | None, missing: Missing) -> list[FeatureSource]:
    """All available feature sets, or the `wanted` ones.

    Raises `UsageError` for an unknown name and for `guo` without files; if none of the `wanted` is available, raises
    the last one's error.
    """
    known: dict[str, Callable[[], FeatureSource]] = {"kinematic": kinematic_source}
    if guo is not None:
        known["guo"] = partial(guo_source, guo)
    elif wanted is not None and "guo" in wanted:
        raise UsageError("--evaluator guo needs its weights: --weights finest.tar (docs/evaluators.md)")
    unknown = [name for name in wanted or () if name not in known]
    if unknown:
        raise UsageError(f"there is no feature set {unknown[0]!r}: {', '.join(known)}")
    chosen, found = [name for name in known if wanted is None or name in wanted], []
    for name in chosen:
        with missing.skipping(f"features {name!r}"):
            found.append(known[name]())
    if wanted and not found:
        known[chosen[-1]]()
    return found


def kinematic_source() -> FeatureSource:
    """The kinematic descriptor, fitted at each framerate on the training motion."""
    return FeatureSource(
        name="kinematic",
        title=f"clip-FID on the kinematic descriptor ({VERSION})",
        fit=fit_on,
        note=(
            "What bodies do below 8 Hz; finer motion is in the detail profile. 1 is the variance of a block of "
            "features on real training clips."
        ),
    )


def guo_source(files: GuoFiles) -> FeatureSource:
    """A published evaluator at its own framerate. Raises `MotionkitError` if its files are invalid."""
    from eval.text_motion.guo.evaluator import load_guo

    evaluator = load_guo(files)

    def at_its_framerate(train: SampleSet) -> FeatureSet:
        evaluator.check_fps(train.fps, train.name)
        return evaluator

    return FeatureSource(
        name="guo",
        title=f"clip-FID on the {evaluator.name} evaluator of {evaluator.kind.dataset}",
        fit=at_its_framerate,
        note=(
            f"At {float(evaluator.fps):g} fps alone, at most {GUO_REPLICATIONS} replications. This evaluator was "
            "trained to match motions with sentences: it scores upsampled and smoothed motion much like clean motion. "
            "Clips of m poses are m − 1 frames of pose vectors. These are not the FIDs of whole motions that papers "
            "print."
        ),
        max_replications=GUO_REPLICATIONS,
    )


def fit_on(train: SampleSet, seed: int = 0) -> KinematicDescriptor:
    """Fit the kinematic descriptor on random takes of a training set, and standardise it on clips of them."""
    order = np.random.default_rng((seed, FIT_REPLICATION)).permutation(train.num_sequences)
    passed = np.cumsum(train.sequences.num_frames[order])
    some = train.select(order[: 1 + int(np.searchsorted(passed, FIT_FRAMES))])
    motions = list(in_threads(partial(channels, fps=train.fps), some.sequences))
    fitted = fit_kinematic(motions, train.fps)
    rows = replace(some, sequences=Ragged.of(list(map(fitted.rows, motions))), local_rotations=None)
    return standardised(fitted, describe_clips(rows, _fit_places(rows, seed), fitted))


def _fit_places(train: SampleSet, seed: int) -> ClipPlaces:
    protocol = Protocol(num_clips=FIT_CLIPS, seed=seed)
    return place_clips(draw_clips(protocol, train.fps, FIT_REPLICATION, REAL), train)
