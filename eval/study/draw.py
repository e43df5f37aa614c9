"""Draws the pairs of motions of a study from a seed, with balanced sides and shuffled order."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from eval.sets.sets import Missing
from eval.study.systems import System
from motionkit.core.errors import MotionkitError

REALISTIC, CONSISTENT = "realistic", "consistent"
QUESTIONS = {
    REALISTIC: "Which of the two motions is more realistic?",
    CONSISTENT: "Which of the two motions is more consistent with the given text?",
}
"""The two questions of NeRM's study (appendix E.6)."""


@dataclass(frozen=True)
class Design:
    """The number of cases of each question, framerate and pair of systems."""

    fps: tuple[Fraction, ...] = (Fraction(20), Fraction(120))
    cases: int = 8
    seed: int = 0


@dataclass(frozen=True)
class Trial:
    """One question about two motions: indices of two systems and of a motion of each; A shows the first."""

    question: str
    fps: Fraction
    caption: str
    systems: tuple[int, int]
    motions: tuple[int, int]


def draw_trials(systems: Sequence[System], design: Design, missing: Missing) -> tuple[Trial, ...]:
    """Trials of the first system against each of the others, in random order with balanced sides.

    Two motions share a caption; if one of the systems has no captions, they are any two, without the question about the
    text. What is left out is added to `missing`. Raises `MotionkitError` if there are no pairs.
    """
    rng = np.random.default_rng(design.seed)
    trials: list[Trial] = []
    for other in range(1, len(systems)):
        trials += _of_pair(systems, other, design, rng, missing)
    if not trials:
        raise MotionkitError("; ".join(missing.lines))
    order = rng.permutation(len(trials)).tolist()
    return tuple(trials[number] for number in order)


def _of_pair(
    systems: Sequence[System], other: int, design: Design, rng: np.random.Generator, missing: Missing
) -> list[Trial]:
    """Trials of the first system against another one; what there are too few motions for is added to `missing`."""
    first, second = systems[0], systems[other]
    pair = f"{first.name} and {second.name}"
    captioned = any(first.captions) and any(second.captions)
    matched = list(_matched(first, second, captioned, rng))
    if not captioned:
        missing.add(f"{pair}: one of them has no captions: the question about the text is left out")
    if not matched:
        missing.add(f"{pair}: no caption is common to both, nothing is compared")
    trials: list[Trial] = []
    used = 0
    for fps in design.fps:
        there = [each for each in matched if first.has(each[0], fps) and second.has(each[1], fps)]
        questions = tuple(QUESTIONS) if captioned else (REALISTIC,)
        if len(there) < design.cases * len(questions):
            few = f"{len(there)} pairs of motions at {fps} fps for {design.cases * len(questions)} cases"
            missing.add(f"{pair}: {few}" + (", some are shown twice" if there else ", none is shown"))
        for question in questions if there else ():
            sides = rng.permutation(np.arange(design.cases) % 2).tolist()
            for swapped in sides:
                one, two = there[used % len(there)]
                caption = first.captions[one] if captioned else ""
                if swapped:
                    trials.append(Trial(question, fps, caption, (other, 0), (two, one)))
                else:
                    trials.append(Trial(question, fps, caption, (0, other), (one, two)))
                used += 1
    return trials


def _matched(first: System, second: System, captioned: bool, rng: np.random.Generator) -> Iterator[tuple[int, int]]:
    """Comparable pairs of motions in random order, each caption once."""
    if not captioned:
        yield from zip(
            rng.permutation(len(first.captions)).tolist(), rng.permutation(len(second.captions)).tolist(), strict=False
        )
        return
    of_first, of_second = _by_caption(first, rng), _by_caption(second, rng)
    common = [caption for caption in of_first if caption in of_second]
    for number in rng.permutation(len(common)).tolist():
        yield of_first[common[number]], of_second[common[number]]


def _by_caption(system: System, rng: np.random.Generator) -> dict[str, int]:
    """One motion of each caption."""
    found: dict[str, int] = {}
    for index in rng.permutation(len(system.captions)).tolist():
        if system.captions[index]:
            found.setdefault(" ".join(system.captions[index].casefold().split()), index)
    return dict(sorted(found.items()))
