"""The action task's metrics from a recogniser's output on real and generated motions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_limits

from eval.metrics import intervals
from eval.metrics.actions import accuracy, diversity, multimodality_by_class, shares_of_hits
from eval.metrics.distributions import fit_gaussian, frechet_distance
from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float, Int

Features = Float[np.ndarray, "_samples features"]


@dataclass(frozen=True)
class ActionProtocol:
    """An evaluation protocol: how metrics are computed from a recogniser's features and scores.

    `num_motions`: generated motions per replication, None for all. `pairs` "different" draws Diversity without
    repetition (NeRM Eq. 7) and MultiModality from two different motions; "with replacement" draws both sides with
    replacement, as action-to-motion does.
    """

    name: str
    title: str
    source: str
    version: int = 1
    num_motions: int | None = None
    replications: int = 20
    diversity_pairs: int = 200
    class_pairs: int = 20
    pairs: Literal["different", "with replacement"] = "with replacement"
    remarks: tuple[str, ...] = ()


VARIANCE = 'What the source prints after "±" is 1.96 · variance over seeds, which is not an interval; it is in details.'
ACTION_PROTOCOLS = (
    ActionProtocol("native", "motionkit", "docs/metrics.md", pairs="different"),
    ActionProtocol("a2m", "Action2Motion", "Guo et al. 2020, eval_scripts/final_evaluation.py", num_motions=3000),
    ActionProtocol("actor", "ACTOR", "Petrovich et al. 2021, src/evaluate", remarks=(VARIANCE,)),
    ActionProtocol("mdm", "MDM", "Tevet et al. 2023, eval/eval_humanact12_uestc.py", num_motions=1000),
)


def find_action_protocol(name: str) -> ActionProtocol:
    """A protocol by name. Raises `UsageError` that lists the known names."""
    known = {protocol.name: protocol for protocol in ACTION_PROTOCOLS}
    if name not in known:
        raise UsageError(f"there is no action protocol {name!r}: {', '.join(known)}")
    return known[name]


@dataclass(frozen=True, eq=False)
class Recognition:
    """A recogniser's features and scores of motions with known actions; `labels` index its actions."""

    features: Float[np.ndarray, "motions features"]
    scores: Float[np.ndarray, "motions actions"]
    labels: Int[np.ndarray, "motions"]


def score_actions(
    references: Mapping[str, Features], draws: Sequence[Recognition], protocol: ActionProtocol, seed: int
) -> intervals.Scores:
    """Accuracy, FID, Diversity and MultiModality of generated (or real) motions under a protocol.

    `references` are features of real motions by set: "train" and "test" give `fid_train` and `fid_test`. `draws` are
    independent sets of motions; replication r uses draw r modulo their number, a random subset of it if the protocol
    has fewer motions. Remarks say where the data has less than the protocol. Raises `ValueError` for different numbers
    of features, or for non-finite values.
    """
    scores = intervals.Scores(remarks=list(protocol.remarks))
    # As in `fid`: one thread of the linear algebra library is the fastest for matrices of this size.
    with threadpool_limits(1, "blas"):
        gaussians = {name: fit_gaussian(features) for name, features in references.items()}
        for replication in range(protocol.replications):
            rng = np.random.default_rng((seed, replication))
            motions, counted = draws[replication % len(draws)], protocol.num_motions
            if counted is not None and counted < len(motions.labels):
                rows = rng.choice(len(motions.labels), size=counted, replace=False)
                motions = Recognition(motions.features[rows], motions.scores[rows], motions.labels[rows])
            elif counted is not None and counted > len(motions.labels):
                scores.remark(
                    f"protocol {protocol.name!r} counts {counted:,} motions, here are {len(motions.labels):,}: "
                    "FIDs of different N do not compare"
                )
            features, labels = motions.features, motions.labels
            scores.add("accuracy", accuracy(motions.scores, labels))
            for name, gaussian in gaussians.items():
                scores.add(f"fid_{name}", frechet_distance(gaussian, fit_gaussian(features)))
            replace = protocol.pairs == "with replacement"
            suffix = "_with_replacement" if replace else ""
            scores.add(f"diversity{suffix}", diversity(features, rng, protocol.diversity_pairs, replace=replace))
            spread = multimodality_by_class(features, labels, rng=rng, num_pairs=protocol.class_pairs, replace=replace)
            scores.add(f"multimodality_by_class{suffix}", spread)
        scores.resampled |= _resampled(references, draws, protocol)
    scores.remark_on_draws(len(draws), protocol.replications)
    return scores


def _resampled(
    references: Mapping[str, Features], draws: Sequence[Recognition], protocol: ActionProtocol
) -> dict[str, intervals.Resampled]:
    """Every metric's bootstrap values; motions are resampled jointly in all sets, and with them their draws."""
    takes = [[str(row) for row in range(len(draw.labels))] for draw in draws]
    units = intervals.units_of_draws(takes)
    weights, unit = units.weights(), units.unit
    features = np.concatenate([draw.features for draw in draws]).astype(np.float64)
    labels = np.concatenate([draw.labels for draw in draws])
    shares = np.concatenate([shares_of_hits(draw.scores, draw.labels) for draw in draws])
    suffix = "" if protocol.pairs == "different" else "_with_replacement"
    values = {
        "accuracy": intervals.weighted_means(shares, unit, weights),
        f"diversity{suffix}": intervals.resampled_mean_distance(features, unit, weights),
        f"multimodality_by_class{suffix}": intervals.resampled_mean_distance(features, unit, weights, labels),
    }
    for name, real in references.items():
        names = [str(row) for row in range(len(real))]
        values[f"fid_{name}"] = intervals.resampled_fid(real.astype(np.float64), names, features, takes)
    return values
