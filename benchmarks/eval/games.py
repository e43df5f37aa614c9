"""Robustness of clip-FID to gaming: both versions of the kinematic descriptor, on held-out takes.

    python -m benchmarks.eval.games TRAINING_STORE STORE[:SPLIT] … [--fps 40 …] [--results docs/results] [--json]

Descriptors are fitted on the training split of the first store. Takes of the others (of their test split where none is
named, `all` for all) are upsampled or low-passed, and what that has cost is hidden by noise or by the fast part of
other takes: `games.json` holds the scores, how both versions stand in the rest of their calibration, and what white
noise of 3 mm on every joint of the takes themselves scores. The part of docs/results/games.md that holds figures is
printed.
"""

import argparse
import json
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from eval.clip_fid import kinematic, kinematic1
from eval.clip_fid.calibration import MAX_FLAT_RATIO, MIN_GAME_RATIO, Calibration, calibrate
from eval.clip_fid.clips import Protocol
from eval.clip_fid.features import kinematic1_source, kinematic_source
from eval.clip_fid.score import CLIP_FID
from eval.clip_fid.score import VERSION as CLIP_FID_VERSION
from eval.report.results import Block, Cell, Result, Row, measure, provenance, write_result
from eval.sets.corruptions import jitter
from eval.sets.games import TIMED
from eval.sets.real import real_motion
from eval.tables.nerm.clip_fid_column import framerate_label
from motionkit.store import Store

RATES = (40, 60, 100, 120)
REPLICATIONS = 4
NOISE_METRES = 0.003
SOURCES = {kinematic1.VERSION: kinematic1_source, kinematic.VERSION: kinematic_source}


@dataclass(frozen=True)
class Column:
    """A version's calibration at a framerate, and its score of real takes with white noise of 3 mm on every joint."""

    calibration: Calibration
    noisy: float


def played(training: Path, store: Path, split: str, rates: list[Fraction]) -> dict[str, Column]:
    """Columns of every version and framerate."""
    train, held_out = real_motion(Store.open(training), "train"), real_motion(Store.open(store), split)
    protocol, found = Protocol(replications=REPLICATIONS, resamplings=0, detailed_replications=0), {}
    for version, source in SOURCES.items():
        for fps in rates:
            real = held_out.at(fps)
            comparison = source().comparison(real, train.at(fps), protocol)
            rng = np.random.default_rng(0)
            takes = [jitter(take[None], float(fps), NOISE_METRES, rng)[0] for take in real.sequences]
            noisy = comparison.scores({"noisy": real.with_positions("noisy", fps, takes)})["noisy"].clip_fid.mean
            calibration = calibrate(comparison, held_out.at(fps, first_frame=1))
            found[f"{version}, {framerate_label(fps)}"] = Column(calibration, noisy)
    return found


def blocks(name: str, found: dict[str, Column]) -> list[Block]:
    """Scores and shares of every game by version and framerate; then the floors and the rest of the calibration."""
    games: dict[str, dict[str, Cell]] = {}
    for column, each in found.items():
        for game in each.calibration.games:
            scores = {game.parent: game.honest, **game.cheats}
            for row, score in scores.items():
                share = {} if row == game.parent else {"share": score.mean / game.honest.mean}
                games.setdefault(row, {})[column] = Cell(score.mean, score.ci95, share)
    rest = {column: summary(each) for column, each in found.items()}
    names = list(dict.fromkeys(key for cells in rest.values() for key in cells))
    size = next(iter(found.values())).calibration
    return [
        Block(
            f"{name}: games",
            tuple(rest),
            tuple(Row(row, "reference", cells) for row, cells in games.items()),
            note=f"{size.num_sequences} takes, {size.duration_seconds:.0f} s. A game is won where it scores below "
            f"{MIN_GAME_RATIO:g} times the row that it begins with.",
            metrics=(measure(CLIP_FID),),
        ),
        Block(
            f"{name}: calibration",
            tuple(rest),
            tuple(Row(key, "reference", {column: Cell(cells[key]) for column, cells in rest.items()}) for key in names),
            note=f"Harmless transforms may score {MAX_FLAT_RATIO:g} times P1; correlations are of severity and score.",
        ),
    ]


def summary(column: Column) -> dict[str, float]:
    """The figures of a calibration that its games do not show."""
    of = column.calibration
    ratios = {name: ratio for game in of.games for name, ratio in game.ratios.items()}
    timed = {name: ratio for name, ratio in ratios.items() if any(kind in name for kind in TIMED)}
    return {
        "independent draws (P1)": of.floor.mean,
        "disjoint halves of the takes (P2)": of.disjoint_floor.mean,
        f"white noise of {1000 * NOISE_METRES:g} mm on every joint": column.noisy,
        "the worst untimed game, share of what it hides": min(ratios[name] for name in ratios.keys() - timed.keys()),
        "the worst timed game, share of what it hides": min(timed.values()),
        "the worst harmless transform, multiple of P1": max(score.mean for score in of.flat.values()) / of.floor.mean,
        **{f"{family.family}: Spearman": family.spearman for family in of.graded},
    }


def page(result: Result) -> str:
    """Markdown of the shares that every game leaves, and of the scores of what it hides: version 1 → version 2."""
    lines: list[str] = []
    for block in result.blocks:
        labels = list(dict.fromkeys(column.split(", ")[1] for column in block.columns))
        lines += [f"## {block.title}", "", block.note, ""]
        lines += [f"| | {' | '.join(labels)} |", "|---" * (len(labels) + 1) + "|"]
        for row in block.rows:
            pairs = [[row.cells[f"{version}, {label}"] for version in SOURCES] for label in labels]
            shares = [" → ".join(f"{shown(cell):.2f}" for cell in pair) for pair in pairs]
            name = row.name if any("share" in cell.details for cell in row.cells.values()) else f"**{row.name}**"
            lines.append(f"| {name} | {' | '.join(shares)} |")
        lines.append("")
    return "\n".join(lines)


def shown(cell: Cell) -> float:
    """A game's share of what it hides; a score where nothing is hidden."""
    return cell.details.get("share", cell.value)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("training", type=Path, help="a store with a training split, captured fast enough")
    parser.add_argument("stores", nargs="+", help="STORE or STORE:SPLIT")
    parser.add_argument("--fps", type=Fraction, nargs="+", default=[Fraction(rate) for rate in RATES])
    parser.add_argument("--results", type=Path, help="where games.json goes; by default it is not written")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    made: list[Block] = []
    tested: dict[str, Any] = {}
    for asked in options.stores:
        path, _, split = asked.partition(":")
        name = f"{Path(path).name}, {split or 'test'}"
        made += blocks(name, played(options.training, Path(path), split or "test", options.fps))
        tested[name] = provenance(Path(path))["store"]["fingerprint"]
    result = Result(
        task="games",
        version=CLIP_FID_VERSION,
        title="Games that clip-FID was played at",
        caption=f"N = {Protocol().num_clips:,} clips, {REPLICATIONS} replications; descriptors of other takes.",
        blocks=tuple(made),
        provenance={**provenance(options.training), "tested": tested},
    )
    if options.results is not None:
        write_result(result, options.results)
    print(json.dumps(asdict(result)) if options.json else page(result))


if __name__ == "__main__":
    main()
