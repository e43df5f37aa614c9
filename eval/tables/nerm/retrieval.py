"""Table 1: a block for each retrieval rule of a protocol."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eval.metrics.number import Number
from eval.metrics.retrieval import RECALL_RANKS
from eval.report.results import Block, Cell, Row, measure
from eval.tables.nerm.text_motion import ORACLE, ScoredRow, title_of
from eval.text_motion.pairs import TextMotionPairs
from eval.text_motion.protocol import RetrievalRule, TextMotionProtocol
from eval.text_motion.retrieval import SUFFIXES, no_distance, score_retrieval, share_of_same_texts
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float32
from motionkit.training.text import load_text_encoder

SENTENCES = "minilm"
CHANCE = "chance"


@dataclass(frozen=True, eq=False)
class RetrievalSets:
    """The real pairs used, and their captions' sentence embeddings."""

    pairs: TextMotionPairs
    sentences: Float32[np.ndarray, "pairs numbers"]


def sentence_embeddings(captions: Sequence[Caption]) -> Float32[np.ndarray, "captions numbers"]:
    """One embedding per caption, by an encoder independent of the evaluators. Raises `MissingExtraError` without it."""
    return load_text_encoder(SENTENCES).encode([caption.text for caption in captions])


def retrieval_blocks(
    rows: Sequence[ScoredRow],
    real: RetrievalSets,
    protocol: TextMotionProtocol,
    seed: int,
    head: str,
    provenance: Mapping[str, str],
) -> tuple[Block, ...]:
    """Recalls and median ranks of every row, between those of chance and of texts that stand for their motions."""
    return tuple(
        _block(rule, [(row, row.retrieval[index]) for row in rows if row.retrieval], real, seed, head, provenance)
        for index, rule in enumerate(protocol.retrieval)
    )


def _block(
    rule: RetrievalRule,
    rows: Sequence[tuple[ScoredRow, Mapping[str, Number]]],
    real: RetrievalSets,
    seed: int,
    head: str,
    provenance: Mapping[str, str],
) -> Block:
    names = [
        f"{name}{SUFFIXES[direction]}"
        for direction in rule.directions
        for name in (*(f"recall_at_{rank}" for rank in RECALL_RANKS), "median_rank")
    ]
    number = len(real.pairs.motions)
    oracle = TextMotionPairs(real.pairs.texts, real.pairs.texts)
    chance = score_retrieval(real.pairs, [real.pairs], rule, real.sentences, seed, no_distance)
    ceiling = score_retrieval(oracle, [oracle], rule, real.sentences, seed)
    same = share_of_same_texts(rule, real.pairs, real.sentences)
    merged = f" {same:.2%} of the other texts count as a text's own." if rule.same_above is not None else ""
    return Block(
        f"Retrieval, {rule.name}, N = {_chosen_among(rule, number)}: {head}",
        tuple(map(title_of, names)),
        (
            Row(CHANCE, "reference", _cells(chance, names), "an evaluator that sees nothing"),
            Row(ORACLE, "reference", _cells(ceiling, names), "captions that stand in the set twice are its ceiling"),
            *(Row(str(each.row), each.origin, _cells(values, names)) for each, values in rows),
        ),
        lower_is_better=False,
        note=(
            f"Shares, not per cent.{merged} Sentences are compared by {SENTENCES}; candidates at one distance share "
            "their ranks by expectation, where TMR's code takes their mean rank."
        ),
        provenance=provenance,
        metrics=tuple(measure(name, column=title_of(name)) for name in names),
    )


def _chosen_among(rule: RetrievalRule, number: int) -> int:
    return rule.pool or min(number, rule.least_similar or number)


def _cells(values: Mapping[str, Number], names: Sequence[str]) -> dict[str, Cell]:
    return {title_of(name): Cell(values[name].value) for name in names}
