"""The pairs of motions of a study, its blinded page, and its key, which tells the systems."""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from eval.sample_folder import SampleFolder
from eval.sets.motions import RealMotion, is_unconditional, upsampled_positions
from eval.sets.sets import Missing, middle
from motionkit.core.errors import MotionkitError, UsageError
from motionkit.core.files import write_json, write_whole
from motionkit.core.progress import OnProgress, task
from motionkit.core.shapes import Float32
from motionkit.core.skeleton import SMPL22
from motionkit.fields.contact.planted import planted
from motionkit.fields.motion_field import to_motion
from motionkit.fields.resample import resample_positions
from motionkit.generate.models import GenerationRequest, GenerativeModel
from motionkit.viz.player import MOST_PAGE_BYTES, Panel, data_of, player

REALISTIC, CONSISTENT = "realistic", "consistent"
QUESTIONS = {
    REALISTIC: "Which of the two motions is more realistic?",
    CONSISTENT: "Which of the two motions is more consistent with the given text?",
}
"""The two questions of NeRM's study (appendix E.6)."""
KEY_FORMAT, ANSWERS_FORMAT = "motionkit-study-key/1", "motionkit-study-answers/1"
Positions = Float32[np.ndarray, "frames 22 3"]


@dataclass(frozen=True, eq=False)
class System:
    """One system's motions: id, caption ("" for none), seconds and highest framerate of each.

    `positions(i, fps)` are motion i's 22 joints in metres, y up, at a framerate. `fastest` None is any framerate.
    """

    name: str
    motion_ids: tuple[str, ...]
    captions: tuple[str, ...]
    seconds: tuple[float, ...]
    positions: Callable[[int, Fraction], Positions]
    fastest: tuple[Fraction, ...] | None = None

    def has(self, index: int, fps: Fraction) -> bool:
        """Whether motion `index` is available at a framerate."""
        return self.fastest is None or self.fastest[index] >= fps


def of_motions(motions: SampleFolder | RealMotion) -> System:
    """Samples, upsampled by SLERP or anti-aliased as in tables; or real motion, up to the framerate of its capture."""

    def positions(index: int, fps: Fraction) -> Positions:
        own, frames = motions.fps[index], motions.sequences[index]
        return upsampled_positions(frames, own, fps) if own < fps else resample_positions(frames, own, fps)

    lengths = zip(motions.sequences.num_frames, motions.fps, strict=True)
    seconds = tuple(float(int(frames) / fps) for frames, fps in lengths)
    is_real = isinstance(motions, RealMotion)
    name, fastest = ("real motion", motions.fps) if is_real else (motions.name, None)
    return System(name, motions.sequence_ids, motions.captions, seconds, positions, fastest)


def of_model(model: GenerativeModel, beside: Sequence[System], seed: int, longest_seconds: float) -> System:
    """A model's planted motions for the captions and lengths of other systems, as `motionkit generate` writes them.

    Motions are generated lazily.
    """
    longest = min(longest_seconds, model.max_duration_seconds)
    prompts: dict[str, float] = {}
    for system in beside:
        for caption, length in zip(system.captions, system.seconds, strict=True):
            prompts.setdefault(caption, min(length, longest))
    prompts.pop("", None)
    if not prompts or is_unconditional(model):
        requests = [GenerationRequest(min(length, longest)) for length in beside[0].seconds]
    else:
        requests = [GenerationRequest(length, caption) for caption, length in prompts.items()]

    def positions(index: int, fps: Fraction) -> Positions:
        (field,) = model.generate([requests[index]], seed=seed, first=index)
        return to_motion(planted(field, "free"), fps).joint_positions

    ids = tuple(f"{model.name}#{number}" for number in range(len(requests)))
    captions, seconds = tuple(each.text for each in requests), tuple(each.duration_seconds or 0.0 for each in requests)
    return System(model.name, ids, captions, seconds, positions)


@dataclass(frozen=True)
class Trial:
    """One question about two motions: indices of two systems and of a motion of each; A shows the first."""

    question: str
    fps: Fraction
    caption: str
    systems: tuple[int, int]
    motions: tuple[int, int]


def draw_trials(
    systems: Sequence[System], rates: Sequence[Fraction], cases: int, seed: int, missing: Missing
) -> tuple[Trial, ...]:
    """Trials of the first system against each of the others, in random order with balanced sides.

    `cases` are those of each question, framerate and pair of systems. Two motions share a caption; if one of the
    systems has no captions, they are any two, without the question about the text. What is left out is added to
    `missing`. Raises `UsageError` for fewer than two systems or two of one name, `MotionkitError` without any pair.
    """
    names = [system.name for system in systems]
    if len(names) < 2 or len(set(names)) < len(names):
        raise UsageError(
            f"a study compares two systems of different names (here: {', '.join(names) or 'none'}): name folders with "
            "--samples NAME=DIR, a --run, a --store"
        )
    rng, first = np.random.default_rng(seed), systems[0]
    trials: list[Trial] = []
    for other, second in enumerate(systems[1:], start=1):
        label = f"{first.name} and {second.name}"
        captioned = any(first.captions) and any(second.captions)
        if not captioned:
            missing.add(f"{label}: one of them has no captions: the question about the text is left out")
        pairs = _pairs(first, second, captioned, rng)
        if not pairs:
            missing.add(f"{label}: no caption is common to both, nothing is compared")
        questions, num_before = tuple(QUESTIONS) if captioned else (REALISTIC,), len(trials)
        for fps in rates:
            there = [(one, two) for one, two in pairs if first.has(one, fps) and second.has(two, fps)]
            if len(there) < cases * len(questions):
                few = f"{len(there)} pairs of motions at {fps} fps for {cases * len(questions)} cases"
                missing.add(f"{label}: {few}" + (", some are shown twice" if there else ", none is shown"))
            for question in questions if there else ():
                for swapped in rng.permutation(np.arange(cases) % 2).tolist():
                    one, two = there[(len(trials) - num_before) % len(there)]
                    caption = first.captions[one] if captioned else ""
                    sides = ((other, 0), (two, one)) if swapped else ((0, other), (one, two))
                    trials.append(Trial(question, fps, caption, *sides))
    if not trials:
        raise MotionkitError("; ".join(missing.lines))
    return tuple(trials[number] for number in rng.permutation(len(trials)).tolist())


def _pairs(first: System, second: System, captioned: bool, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Comparable motions in random order, each caption once."""
    orders = [rng.permutation(len(system.captions)).tolist() for system in (first, second)]
    if not captioned:
        return list(zip(*orders, strict=False))
    by_caption: list[dict[str, int]] = [{}, {}]
    for system, order, found in zip((first, second), orders, by_caption, strict=True):
        for index in order:
            if system.captions[index]:
                found.setdefault(" ".join(system.captions[index].casefold().split()), index)
    common = sorted(by_caption[0].keys() & by_caption[1].keys())
    return [(by_caption[0][common[n]], by_caption[1][common[n]]) for n in rng.permutation(len(common)).tolist()]


def write_study(
    page: Path,
    key: Path,
    systems: Sequence[System],
    trials: Sequence[Trial],
    seed: int,
    longest_seconds: float,
    on_progress: OnProgress,
) -> int:
    """Write the page and the key of some trials, and return the page's size in bytes.

    Longer motions are cut to their middle `longest_seconds`. Raises `MotionkitError` for a page that is too large for a
    browser.
    """
    document = _key(systems, trials, seed)
    shown = []
    with task(on_progress, "motions", len(trials)) as work:
        for trial in trials:
            panels = []
            for letter, system, motion in zip("AB", trial.systems, trial.motions, strict=True):
                positions = middle(
                    systems[system].positions(motion, trial.fps), max(2, int(longest_seconds * trial.fps))
                )
                # All stand on their lowest joint: a capture's floor height would reveal its system.
                floor = np.array([0.0, positions[..., 1].min(), 0.0], dtype=np.float32)
                panels.append(Panel(letter, positions - floor, SMPL22, trial.fps))
            shown.append({"question": trial.question, "caption": trial.caption, "player": data_of("", panels)})
            work.advance()
    data = {"format": ANSWERS_FORMAT, "study": document["study"], "questions": QUESTIONS, "trials": shown}
    written = _page(data).encode("utf-8", "backslashreplace")
    if len(written) > MOST_PAGE_BYTES:
        raise MotionkitError(
            f"the page would have {len(written) / 1e6:,.0f} MB, at most {MOST_PAGE_BYTES / 1e6:,.0f} MB: fewer "
            "--cases, shorter motions (--seconds) or lower framerates (--fps)"
        )
    write_json(key, document)
    write_whole(page, written)
    return len(written)


def _key(systems: Sequence[System], trials: Sequence[Trial], seed: int) -> dict[str, Any]:
    content = {
        "format": KEY_FORMAT,
        "seed": seed,
        "systems": [system.name for system in systems],
        "trials": [
            {
                "question": trial.question,
                "fps": str(trial.fps),
                "caption": trial.caption,
                "systems": [systems[system].name for system in trial.systems],
                "motions": [
                    systems[system].motion_ids[motion]
                    for system, motion in zip(trial.systems, trial.motions, strict=True)
                ],
            }
            for trial in trials
        ],
    }
    return {**content, "study": hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]}


def _page(data: dict[str, Any]) -> str:
    folder = resources.files("eval.study") / "templates"
    names = ("study.css", "study.js", "study.html", "inside.css")
    style, script, page, inside = (folder.joinpath(name).read_text(encoding="utf-8") for name in names)
    shell = player("", "__DATA__").replace("</style>", f"{inside}</style>", 1)
    # A script must not contain anything like its closing tag.
    text = json.dumps({**data, "shell": shell}, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    head, tail = page.replace("__STYLE__", style).replace("__SCRIPT__", script).split("__STUDY__")
    return head + text + tail
