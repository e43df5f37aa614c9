"""Dependence of the physical metrics on the framerate, and their robustness to gaming.

    python -m benchmarks.eval.physical STORE [--results docs/results] [--json]

Both are of the test takes that were captured at 120 fps or faster, in the figures of `motionkit eval --table physical`.
`physical-framerates.json` has the same takes at six framerates; `physical-games.json` has them at 120 fps, sliding as a
whole, and manipulated to score better.
"""

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path

import numpy as np

from eval.metrics.intervals import half_width
from eval.metrics.metric import Metric
from eval.report.results import (
    Block,
    Cell,
    Measure,
    Result,
    Row,
    cell_of,
    measure,
    provenance,
    to_markdown,
    write_result,
)
from eval.sets.motions import RealMotion, real_motion, upsampled
from eval.sets.sets import SampleSet
from eval.tables.physical import OURS, PER_FRAME, TABLE, Measured, floors_of, measured
from eval.tables.systems import label
from motionkit.store import Store

NATIVE = Fraction(120)
RATES = tuple(Fraction(rate) for rate in (20, 30, 40, 60, 100, 120))
LAST, FIRST = label(RATES[-1]), label(RATES[0])
RATIO = f"{LAST} ÷ {FIRST}"
SLIDING = 0.3

Change = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def changed(samples: SampleSet, name: str, change: Change) -> SampleSet:
    """Every motion of a set after a change, each with its own random numbers."""
    made = [
        change(motion.astype(np.float64), np.random.default_rng((0, index))).astype(np.float32)
        for index, motion in enumerate(samples.sequences)
    ]
    return samples.with_positions(made, name=name)


def slide(motion: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The whole body drifts sideways at `SLIDING` metres a second."""
    direction = rng.uniform(0, 2 * np.pi)
    way = SLIDING * np.arange(len(motion))[:, None] / float(NATIVE)
    motion[..., ::2] += (way * [np.sin(direction), np.cos(direction)])[:, None]
    return motion


def freeze(motion: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The middle pose, held."""
    return np.repeat(motion[len(motion) // 2][None], len(motion), axis=0)


def rise(motion: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The body leaves the floor by half a metre from its first to its last frame."""
    motion[..., 1] += np.linspace(0.0, 0.5, len(motion))[:, None]
    return motion


def lift(motion: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The whole motion raised by ten centimetres."""
    motion[..., 1] += 0.1
    return motion


def shake(motion: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The body trembles up and down by 3 cm eight times a second, so that nothing stays low."""
    motion[..., 1] += 0.03 * np.sin(2 * np.pi * 8.0 * np.arange(len(motion)) / float(NATIVE))[:, None]
    return motion


def noise(motion: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """White noise of 0.3 mm."""
    return motion + 3e-4 * rng.standard_normal(motion.shape)


def slower(samples: SampleSet) -> SampleSet:
    """Every motion at half its speed."""
    made = upsampled(samples, 2 * samples.fps, samples.name)
    return samples.with_positions(list(made.sequences), name="half speed")


def at_the_fast(real: RealMotion, fps: Fraction) -> SampleSet:
    """The takes that were captured at 120 fps or faster, at a framerate."""
    samples, fast = real.at(fps), set(real.at(NATIVE).sequence_ids)
    return samples.select([index for index, name in enumerate(samples.sequence_ids) if name in fast])


def by_framerate(real: RealMotion) -> dict[str, Measured]:
    """The same takes at every framerate."""
    return {label(fps): measured(at_the_fast(real, fps)) for fps in RATES}


def games(real: RealMotion) -> dict[str, Measured]:
    """Metrics of real takes, the same sliding, and manipulated versions of these."""
    takes = real.at(NATIVE)
    sliding = changed(takes, "sliding", slide)
    low = upsampled(at_the_fast(real, RATES[0]), NATIVE, "upsampled")
    return {
        "real": measured(takes),
        "sliding": measured(sliding),
        "half speed": measured(slower(sliding)),
        "frozen": measured(changed(sliding, "frozen", freeze)),
        "rising": measured(changed(sliding, "rising", rise)),
        # As in published code, with the floor at 0 wherever the body is.
        "raised": measured(changed(sliding, "raised", lift), floors=floors_of(sliding)),
        "shaking": measured(changed(sliding, "shaking", shake)),
        "noise": measured(changed(sliding, "noise", noise)),
        "upsampled": measured(low),
        "upsampled, noise": measured(changed(low, "upsampled, noise", noise)),
    }


def framerate_rows(metrics: Sequence[Metric], columns: Mapping[str, Measured]) -> list[Row]:
    """A row for each metric, with the ratio of the last framerate to the first."""
    rows = []
    for metric in metrics:
        means = {name: each.mean(metric) for name, each in columns.items()}
        cells = {name: cell_of(mean) for name, mean in means.items() if mean is not None}
        first, last = means[FIRST], means[LAST]
        if first is not None and last is not None and first.value:
            pairs = zip(last.resampled, first.resampled, strict=True)
            drawn = tuple(a / b if a is not None and b else None for a, b in pairs)
            cells[RATIO] = Cell(last.value / first.value, half_width(drawn))
        rows.append(Row(row_name(metric), "reference", cells))
    return rows


def game_rows(metrics: Sequence[Metric], columns: Mapping[str, Measured]) -> list[Row]:
    """A row for each metric, without intervals: takes are the same in every column."""
    rows = []
    for metric in metrics:
        means = {name: each.mean(metric) for name, each in columns.items()}
        cells = {name: Cell(mean.value) for name, mean in means.items() if mean is not None}
        rows.append(Row(row_name(metric), "reference", cells))
    return rows


def row_name(metric: Metric) -> str:
    return f"{metric.title}, {metric.unit}" if metric.unit else metric.title


def framerates_result(real: RealMotion, store: Path) -> Result:
    """Every figure of the same takes at every framerate."""
    columns = by_framerate(real)
    names = (*columns, RATIO)
    blocks = [(OURS, "Figures of this project"), (PER_FRAME, "Figures of the field, as their projects compute them")]
    return Result(
        task="physical-framerates",
        version=TABLE.version,
        title="The same takes at six framerates",
        caption=f"{size_of(columns[LAST])}, brought down anti-aliased; ± half the 95 % interval over takes.",
        blocks=tuple(
            Block(title, names, tuple(framerate_rows(some, columns)), metrics=shown(some)) for some, title in blocks
        ),
        provenance=provenance(store),
    )


def games_result(real: RealMotion, store: Path) -> Result:
    """Every figure of every game."""
    columns = games(real)
    return Result(
        task="physical-games",
        version=TABLE.version,
        title="What wins physical figures",
        caption=f"{size_of(columns['real'])} at {LAST}, the same sliding at {SLIDING:g} m/s, what was made of these.",
        blocks=(
            Block(
                "Games",
                tuple(columns),
                tuple(game_rows((*OURS, *PER_FRAME), columns)),
                metrics=shown((*OURS, *PER_FRAME)),
            ),
        ),
        provenance=provenance(store),
    )


def shown(metrics: Sequence[Metric]) -> tuple[Measure, ...]:
    return tuple(map(measure, metrics))


def size_of(takes: Measured) -> str:
    return f"{len(takes.seconds)} real takes, {takes.seconds.sum():.0f} s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store", type=Path, help="a store whose split holds takes of 120 fps and more")
    parser.add_argument("--split", default="test")
    parser.add_argument("--results", type=Path, help="where both JSON files go; by default they are not written")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    real = real_motion(Store.open(options.store), options.split)
    results = (framerates_result(real, options.store), games_result(real, options.store))
    for result in results:
        if options.results is not None:
            write_result(result, options.results)
        print(json.dumps(asdict(result)) if options.json else to_markdown(result))


if __name__ == "__main__":
    main()
