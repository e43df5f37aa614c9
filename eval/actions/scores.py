"""The action task's metrics from a recogniser's output on real and generated motions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_limits

from eval.actions.recogniser import Recognition
from eval.metrics.actions import (
    accuracy,
    diversity,
    multimodality_by_class,
    shares_of_hits,
)
from eval.metrics.distributions import fit_gaussian, frechet_distance
from eval.metrics.number import (
    Resampled,
    Resampling,
    Scores,
    Units,
    resampled_fid,
    resampled_mean_distance,
    units_of,
    weighted_means,
)
from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float, Int


@dataclass(frozen=True)
class ActionProtocol:
    """An evaluation protocol: how metrics are computed from a recogniser's features and scores.

    `num_motions`: generated motions per replication, None for all. `pairs` "different" draws Diversity without
    repetition (NeRM Eq. 7) and MultiModality from two different motions; "with replacement" draws both sides with
    replacement, as action-to-motion does. `spread`: what the source prints after "±"; ACTOR's is no interval.
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
    spread: Literal["95 % interval", "1.96 · variance"] = "95 % interval"
    remarks: tuple[str, ...] = ()


VARIANCE = 'What the source prints after "±" is 1.96 · variance over seeds, which is not an interval; it is in details.'

NATIVE = ActionProtocol("native", "motionkit", "docs/metrics.md", pairs="different")
A2M = ActionProtocol("a2m", "Action2Motion", "Guo et al. 2020, eval_scripts/final_evaluation.py", num_motions=3000)
ACTOR = ActionProtocol(
    "actor",
    "ACTOR",
    "Petrovich et al. 2021, src/evaluate",
    spread="1.96 · variance",
    remarks=(VARIANCE,),
)
MDM = ActionProtocol("mdm", "MDM", "Tevet et al. 2023, eval/eval_humanact12_uestc.py", num_motions=1000)
ACTION_PROTOCOLS = (NATIVE, A2M, ACTOR, MDM)


def find_action_protocol(name: str) -> ActionProtocol:
    """A protocol by name. Raises `UsageError` that lists the known names."""
    for protocol in ACTION_PROTOCOLS:
        if protocol.name == name:
            return protocol
    known = ", ".join(protocol.name for protocol in ACTION_PROTOCOLS)
    raise UsageError(f"there is no action protocol {name!r}: {known}")


@dataclass(frozen=True, eq=False)
class LabelledRecognition:
    """A recogniser's output for motions with known actions; `labels` index its actions."""

    recognition: Recognition
    labels: Int[np.ndarray, "labels"]

    def __post_init__(self) -> None:
        if not len(self.recognition.features) == len(self.recognition.scores) == len(self.labels):
            raise ValueError(
                f"{len(self.recognition.features)} rows of features, {len(self.recognition.scores)} of scores and "
                f"{len(self.labels)} labels: one each for every motion"
            )

    def select(self, rows: Int[np.ndarray, "chosen"]) -> "LabelledRecognition":
        """Some of the motions."""
        recognition = Recognition(self.recognition.features[rows], self.recognition.scores[rows])
        return LabelledRecognition(recognition, self.labels[rows])


def score_actions(
    references: Mapping[str, Float[np.ndarray, "_samples features"]],
    draws: Sequence[LabelledRecognition],
    protocol: ActionProtocol,
    seed: int,
    on_replication: Callable[[], None] = lambda: None,
) -> Scores:
    """Accuracy, FID, Diversity and MultiModality of generated (or real) motions under a protocol.

    `references` are features of real motions by set: "train" and "test" give `fid_train` and `fid_test`, "" gives
    `fid`. `draws` are independent sets of motions, each with its own seed; replication r uses draw r modulo their
    number. With fewer draws than replications the interval covers less than the protocol intends, which a remark
    states. If a draw has more motions than the protocol uses, each replication takes a random subset. Raises
    `ValueError` without any motions, for different numbers of features, or for non-finite values.
    """
    if not draws:
        raise ValueError("there is no set of motions to score")
    if unknown := set(references) - {"", "train", "test"}:
        raise ValueError(f'references are named "", "train" or "test", not {sorted(unknown)}')
    scores = Scores(remarks=list(protocol.remarks))
    # As in `fid`: one thread of the linear algebra library is the fastest for matrices of this size.
    with threadpool_limits(1, "blas"):
        gaussians = {name: fit_gaussian(features) for name, features in references.items()}
        for replication in range(protocol.replications):
            rng = np.random.default_rng((seed, replication))
            motions = _chosen(draws[replication % len(draws)], protocol, rng, scores)
            features, labels = motions.recognition.features, motions.labels
            scores.add("accuracy", accuracy(motions.recognition.scores, labels))
            fitted = fit_gaussian(features) if gaussians else None
            for name, gaussian in gaussians.items():
                assert fitted is not None
                scores.add(f"fid_{name}" if name else "fid", frechet_distance(gaussian, fitted))
            replace = protocol.pairs == "with replacement"
            suffix = "_with_replacement" if replace else ""
            spread = diversity(features, rng, protocol.diversity_pairs, replace=replace)
            scores.add(f"diversity{suffix}", spread)
            spread = multimodality_by_class(features, labels, rng=rng, num_pairs=protocol.class_pairs, replace=replace)
            scores.add(f"multimodality_by_class{suffix}", spread)
            on_replication()
        scores.resampled |= _resampled(references, draws, protocol)
    scores.remark_on_draws(len(draws), protocol.replications)
    scores.sizes = {f"real ({name})" if name else "real": len(features) for name, features in references.items()}
    counted = min(len(draws[0].labels), protocol.num_motions or len(draws[0].labels))
    scores.sizes |= {"generated": counted, "draws": len(draws)}
    return scores


def _resampled(
    references: Mapping[str, Float[np.ndarray, "_samples features"]],
    draws: Sequence[LabelledRecognition],
    protocol: ActionProtocol,
) -> dict[str, Resampled]:
    """Every metric's bootstrap values; motions are resampled jointly in all sets, and with them their draws."""
    takes = [str(row) for draw in draws for row in range(len(draw.labels))]
    number = [which for which, draw in enumerate(draws) for _ in draw.labels]

    def units_in(blocks: int | None) -> Units:
        return units_of(takes, number if len(draws) > 1 else (), blocks)

    units = units_in(None)
    weights, unit = units.weights(Resampling()), units.unit
    features = np.concatenate([draw.recognition.features for draw in draws]).astype(np.float64)
    labels = np.concatenate([draw.labels for draw in draws])
    shares = np.concatenate([shares_of_hits(draw.recognition.scores, draw.labels) for draw in draws])
    suffix = "" if protocol.pairs == "different" else "_with_replacement"
    found = {
        "accuracy": weighted_means(shares, unit, weights),
        f"diversity{suffix}": resampled_mean_distance(features, unit, weights),
        f"multimodality_by_class{suffix}": resampled_mean_distance(features, unit, weights, labels),
    }
    for name, real in references.items():
        names = [str(row) for row in range(len(real))]
        found[f"fid_{name}" if name else "fid"] = resampled_fid(real.astype(np.float64), names, features, units_in)
    return found


def _chosen(
    draw: LabelledRecognition, protocol: ActionProtocol, rng: np.random.Generator, scores: Scores
) -> LabelledRecognition:
    """As many motions as the protocol counts."""
    wanted, there = protocol.num_motions, len(draw.labels)
    if wanted is None or there == wanted:
        return draw
    if there < wanted:
        scores.remark(
            f"protocol {protocol.name!r} counts {wanted:,} motions, here are {there:,}: "
            "FIDs of different N do not compare"
        )
        return draw
    return draw.select(rng.choice(there, size=wanted, replace=False))
