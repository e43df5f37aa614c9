"""`motionkit study`: ask people which of two motions is better, and count what they say."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eval.commands.eval import framerates, named_samples
from motionkit.cli import console
from motionkit.core.errors import UsageError, counted
from motionkit.core.files import default_path, require_new

if TYPE_CHECKING:
    from eval.study.trials import Preference

STUDY = typer.Typer(
    help="""Ask people which of two motions is better: make a page of pairs, score the answers.

    Example: motionkit study make --samples "ours=takes" --samples "theirs=takes"
    """,
    no_args_is_help=True,
)


@STUDY.command()
def make(
    samples: Annotated[list[str] | None, typer.Option(metavar="NAME=DIR", help="A system's motions.")] = None,
    samples_fps: Annotated[str | None, typer.Option(metavar="FPS", help="Framerate of samples without one.")] = None,
    run: Annotated[str | None, typer.Option(help="A run that generates for the others' captions; comes first.")] = None,
    model: Annotated[str | None, typer.Option(help="Which of the run's models, if it has several.")] = None,
    runs: console.RunsFolder = None,
    store: Annotated[Path | None, typer.Option(help="Add real motion of this store as a system.")] = None,
    split: Annotated[str, typer.Option(help="Split of the real motion, or all.")] = "test",
    fps: Annotated[str, typer.Option(metavar="FPS,FPS", help="The paper's are 20 and 40,60,100,120.")] = "20,120",
    cases: Annotated[int, typer.Option(min=1, help="Pairs a question, framerate and pair of systems.")] = 8,
    seconds: Annotated[float, typer.Option(min=0.1, help="Longer motions are cut to their middle.")] = 10.0,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of motions, sides and order.")] = 0,
    out: Annotated[Path, typer.Option(help="The page; the key lies beside it, NAME.key.json.")] = Path("study.html"),
    overwrite: console.Overwrite = False,
    as_json: console.AsJson = False,
) -> None:
    """Write a page on which people choose between two motions, and the key that says whose they are.

    Example: motionkit study make --samples "ours=takes" --samples "theirs=takes"
    """
    from eval.sample_folder import SampleOptions, read_sample_folder
    from eval.sets.motions import real_motion
    from eval.sets.sets import Missing
    from eval.study.trials import draw_trials, of_model, of_motions, write_study
    from motionkit.generate.models import load_model, model_of
    from motionkit.store import Store

    key = out.with_suffix(".key.json")
    for path in (out, key):
        require_new(path, overwrite=overwrite, instead="--out writes elsewhere")
    if model is not None and run is None:
        raise UsageError("--model is one of a run's: give --run")
    folder = None if run is None else (runs or default_path("runs")) / run
    options = SampleOptions(console.parse_rate(samples_fps, "--samples-fps"))
    rates, missing = framerates(fps, "--fps"), Missing()
    with console.progress() as show:
        systems = []
        for name, path in named_samples(samples or [], folder).items():
            read = read_sample_folder(name, path, options, show)
            for problem in read.left_out:
                console.stderr.print(f"left out of {name!r}: {problem}")
            systems.append(of_motions(read))
        if store is not None:
            systems.append(of_motions(real_motion(Store.open(store), split)))
        if folder is not None and systems:
            loaded = load_model(model or model_of(folder), folder)
            systems = [of_model(loaded, systems, seed, seconds), *systems]
        trials = draw_trials(systems, rates, cases, seed, missing)
        num_bytes = write_study(out, key, systems, trials, seed, seconds, show)
    for line in missing.lines:
        console.stderr.print(f"motionkit: {line}")
    if as_json:
        places = {"page": str(out), "key": str(key), "bytes": num_bytes}
        console.print_json({**places, "questions": len(trials), "missing": list(missing.lines)})
    else:
        console.stderr.print(f"{counted(len(trials), 'question')}, {num_bytes / 1e6:.1f} MB; keep {key} to yourself")
        console.stdout.print(f"{out}\nnext: motionkit study score ANSWERS.json --key {key}")


@STUDY.command()
def score(
    answers: Annotated[list[Path], typer.Argument(metavar="ANSWERS.json…", help="The files that people returned.")],
    key: Annotated[Path, typer.Option(help="The study's key.")] = Path("study.key.json"),
    as_json: console.AsJson = False,
) -> None:
    """Print how often the first system was preferred to each other one: per cent, 95 % interval, binomial test.

    Example: motionkit study score answers-*.json --key study.key.json
    """
    from dataclasses import asdict

    from eval.sets.sets import Missing
    from eval.study.trials import QUESTIONS, StudyError, preferences, read_answers, read_key

    known, missing = read_key(key), Missing()
    read = read_answers(answers, known, missing)
    for fault in missing.lines:
        console.stderr.print(f"left out: {fault}")
    results = preferences(known, read.values())
    given = sum(map(len, read.values()))
    if as_json:
        outcome = {"study": known["study"], "people": len(read), "answers": given}
        console.print_json({**outcome, "preferences": list(map(asdict, results))})
    elif results:
        for question, text in QUESTIONS.items():
            if rows := [_row(each) for each in results if each.question == question]:
                console.stdout.print(text)
                console.print_table(["shown at", "preferred", "95 % interval", "answers", "p"], rows)
        console.stderr.print(f"{len(read)} people, {given} of {len(read) * len(known['trials'])} questions answered")
    if missing.lines:
        raise StudyError(f"{len(missing.lines)} of {len(answers)} files were left out (see above)")


def _row(each: "Preference") -> tuple[str, list[str]]:
    share, interval = f"{100 * each.share:.1f} %", f"{100 * each.low:.1f} to {100 * each.high:.1f}"
    answers = f"{each.num_first} of {each.num_answers}"
    return f"{each.first} over {each.second}", [f"{each.fps} fps", share, interval, answers, f"{each.p_value:.2g}"]
