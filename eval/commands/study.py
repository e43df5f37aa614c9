"""`motionkit study`: ask people which of two motions is better, and count what they say."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eval.commands.eval import framerates, named_samples
from motionkit.cli.console import print_json, progress, stderr, stdout
from motionkit.core.errors import MotionkitError
from motionkit.core.files import default_path
from motionkit.core.progress import task

if TYPE_CHECKING:
    from fractions import Fraction

    from eval.study.preference import Preference
    from eval.study.systems import System
    from motionkit.core.progress import OnProgress

STUDY = typer.Typer(
    help="""Ask people which of two motions is better: make a page of pairs, score the answers.

    Example: motionkit study make --samples "ours=takes" --samples "theirs=takes"
    """,
    no_args_is_help=True,
)

Samples = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=DIR", help="A system's motions; give two or more. The first is compared with each other one."
    ),
]
SamplesFps = Annotated[
    str | None, typer.Option(metavar="FPS", help="Framerate of samples whose files do not say it.", show_default=False)
]
RunName = Annotated[
    str | None, typer.Option(help="A run whose model generates for the others' captions; it then comes first.")
]
ModelName = Annotated[str | None, typer.Option(help="Which of the run's models, if it has several.")]
RunsFolder = Annotated[Path | None, typer.Option(help="Folder of all runs.", show_default="./runs")]
StorePath = Annotated[
    Path | None, typer.Option(help="Add real motion of this store as a system, up to its own framerates.")
]
Split = Annotated[str, typer.Option(help="Split of the real motion, or all.")]
Fps = Annotated[str, typer.Option(metavar="FPS,FPS", help="Framerates; the paper's are 20 and 40,60,100,120.")]
Cases = Annotated[int, typer.Option(min=1, help="Pairs of motions for each question, framerate and pair of systems.")]
Seconds = Annotated[float, typer.Option(min=0.1, help="Longer motions are cut to their middle.")]
Seed = Annotated[int, typer.Option(min=0, help="Random seed of motions, sides and order.")]
OutPage = Annotated[Path, typer.Option(help="The page's file; the key lies beside it, as NAME.key.json.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace the page and the key if they exist.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the outcome as JSON.")]


@STUDY.command()
def make(
    samples: Samples = None,
    samples_fps: SamplesFps = None,
    run: RunName = None,
    model: ModelName = None,
    runs: RunsFolder = None,
    store: StorePath = None,
    split: Split = "test",
    fps: Fps = "20,120",
    cases: Cases = 8,
    seconds: Seconds = 10.0,
    seed: Seed = 0,
    out: OutPage = Path("study.html"),
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Write a page on which people choose between two motions, and the key that says whose they are.

    Example: motionkit study make --samples "ours=takes" --samples "theirs=takes"
    """
    from eval.sets.sets import Missing
    from eval.study.draw import Design, draw_trials
    from eval.study.page import write_study
    from eval.study.systems import of_model, require_two
    from motionkit.generate.models import load_model, model_of

    key = out.with_suffix(".key.json")
    there = [path for path in (out, key) if path.exists()]
    if there and not overwrite:
        raise MotionkitError(f"{there[0]} exists: --overwrite replaces the page and its key, --out writes elsewhere")
    folder = None if run is None else (runs or default_path("runs")) / run
    named = named_samples(samples or [], folder)
    default_fps = framerates(samples_fps, "--samples-fps")[0] if samples_fps else None
    design = Design(framerates(fps, "--fps"), cases, seed)
    with progress() as show:
        systems = _systems(named, default_fps, store, split, show)
        if folder is not None and systems:
            loaded = load_model(model or model_of(folder), folder)
            systems = [of_model(loaded, systems, seed, seconds), *systems]
        require_two(systems)
        missing = Missing()
        trials = draw_trials(systems, design, missing)
        written = write_study(out, key, systems, trials, design, seconds, show)
    for line in missing.lines:
        stderr.print(f"motionkit: {line}")
    if as_json:
        print_json(
            {
                "page": str(out),
                "key": str(key),
                "bytes": written.num_bytes,
                "questions": written.num_trials,
                "missing": list(missing.lines),
            }
        )
        return
    stdout.print(str(out))
    stderr.print(f"{written.num_trials} questions, {written.num_bytes / 1e6:.1f} MB; keep {key} to yourself")
    stdout.print(f"next: motionkit study score ANSWERS.json --key {key}")


def _systems(
    samples: dict[str, Path], fps: "Fraction | None", store: Path | None, split: str, show: "OnProgress"
) -> "list[System]":
    from eval.sample_folder import SampleOptions, read_sample_folder
    from eval.sets.motions import real_motion
    from eval.study.systems import of_folder, of_real
    from motionkit.store import Store

    systems = []
    for name, folder in samples.items():
        with task(show, f"read {name}") as work:
            read = read_sample_folder(name, folder, SampleOptions(fps), work.set)
        for problem in read.left_out:
            stderr.print(f"left out of {name!r}: {problem}")
        systems.append(of_folder(read))
    return systems if store is None else [*systems, of_real(real_motion(Store.open(store), split))]


@STUDY.command()
def score(
    answers: Annotated[list[Path], typer.Argument(metavar="ANSWERS.json…", help="The files that people returned.")],
    key: Annotated[Path, typer.Option(help="The study's key.")] = Path("study.key.json"),
    as_json: AsJson = False,
) -> None:
    """Print how often the first system was preferred to each other one: per cent, 95 % interval, binomial test.

    Unusable files are listed, and the exit code is 1.

    Example: motionkit study score answers-*.json --key study.key.json
    """
    from dataclasses import asdict

    from eval.sets.sets import Missing
    from eval.study.preference import StudyError, preferences, read_answers, read_key

    known = read_key(key)
    missing = Missing()
    read = read_answers(answers, known, missing)
    for fault in missing.lines:
        stderr.print(f"left out: {fault}")
    found = preferences(known, read.values())
    given = sum(map(len, read.values()))
    if as_json:
        print_json(
            {"study": known.study, "people": len(read), "answers": given, "preferences": list(map(asdict, found))}
        )
    elif found:
        _print(found)
        stderr.print(f"{len(read)} people, {given} of {len(read) * len(known.trials)} questions answered")
    if missing.lines:
        raise StudyError(f"{len(missing.lines)} of {len(answers)} files were left out (see above)")


def _print(found: "list[Preference]") -> None:
    from eval.study.draw import QUESTIONS
    from motionkit.cli.console import print_table

    for question, text in QUESTIONS.items():
        rows = [
            (
                f"{each.first} over {each.second}",
                [
                    f"{each.fps} fps",
                    f"{100 * each.share:.1f} %",
                    f"{100 * each.low:.1f} to {100 * each.high:.1f}",
                    f"{each.num_first} of {each.num_answers}",
                    f"{each.p_value:.2g}",
                ],
            )
            for each in found
            if each.question == question
        ]
        if rows:
            stdout.print(text)
            print_table(["shown at", "preferred", "95 % interval", "answers", "p"], rows)
