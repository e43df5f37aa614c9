"""A study's blinded page, and its key, which tells the systems."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from eval.sets.sets import middle
from eval.study.draw import QUESTIONS, Design, Trial
from eval.study.systems import Positions, System
from motionkit.core.errors import MotionkitError
from motionkit.core.files import write_json, write_whole
from motionkit.core.progress import OnProgress, task
from motionkit.core.skeleton import SMPL22
from motionkit.viz.player import MOST_PAGE_BYTES, Panel, data_of, player

KEY_FORMAT, ANSWERS_FORMAT = "motionkit-study-key/1", "motionkit-study-answers/1"


@dataclass(frozen=True)
class WrittenStudy:
    """A study on disk: its page and its key, the page's size in bytes, how many questions it asks."""

    page: Path
    key: Path
    num_bytes: int
    num_trials: int


def write_study(
    page: Path,
    key: Path,
    systems: Sequence[System],
    trials: Sequence[Trial],
    design: Design,
    longest_seconds: float,
    on_progress: OnProgress,
) -> WrittenStudy:
    """Write the page and the key of some trials; longer motions are cut to their middle `longest_seconds`.

    Raises `MotionkitError` for a page that is too large for a browser.
    """
    document = _key(systems, trials, design)
    shown = []
    with task(on_progress, "motions", len(trials)) as work:
        for trial in trials:
            takes = [
                Panel(letter, _positions(systems[system], motion, trial.fps, longest_seconds), SMPL22, trial.fps)
                for letter, system, motion in zip("AB", trial.systems, trial.motions, strict=True)
            ]
            shown.append({"question": trial.question, "caption": trial.caption, "player": data_of("", takes)})
            work.advance()
    text = _page({"format": ANSWERS_FORMAT, "study": document["study"], "questions": QUESTIONS, "trials": shown})
    written = text.encode("utf-8", "backslashreplace")
    if len(written) > MOST_PAGE_BYTES:
        raise MotionkitError(
            f"the page would have {len(written) / 1e6:,.0f} MB, at most {MOST_PAGE_BYTES / 1e6:,.0f} MB: fewer "
            "--cases, shorter motions (--seconds) or lower framerates (--fps)"
        )
    write_json(key, document)
    write_whole(page, written)
    return WrittenStudy(page, key, len(written), len(trials))


def _positions(system: System, motion: int, fps: Fraction, longest_seconds: float) -> Positions:
    shown = middle(system.positions(motion, fps), max(2, int(longest_seconds * fps)))
    # All stand on their lowest joint: a capture's floor height would reveal its system.
    return shown - np.array([0.0, shown[..., 1].min(), 0.0], dtype=np.float32)


def _key(systems: Sequence[System], trials: Sequence[Trial], design: Design) -> dict[str, Any]:
    content = {
        "format": KEY_FORMAT,
        "seed": design.seed,
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
    parts = resources.files("eval.study") / "templates"
    style, script, page, inside = (
        parts.joinpath(name).read_text(encoding="utf-8")
        for name in ("study.css", "study.js", "study.html", "inside.css")
    )
    shell = player("", "__DATA__").replace("</style>", f"{inside}</style>", 1)
    # A script must not contain anything like its closing tag.
    text = json.dumps({**data, "shell": shell}, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    head, tail = page.replace("__STYLE__", style).replace("__SCRIPT__", script).split("__STUDY__")
    return head + text + tail
