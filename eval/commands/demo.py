"""`motionkit demo`: the whole job on the embedded corpus, by the commands' own functions."""

import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from motionkit.cli.console import print_json, stderr, stdout

if TYPE_CHECKING:
    from motionkit.core.motion import Motion
    from motionkit.store.reader import Store

RECIPE = "demo"
PICTURED_ACTIONS = ("walk", "jump", "wave")
PICTURED_SECONDS, PICTURED_FPS = 4.0, "60"
MARKER = "DEMO.txt"
# Every n-th sequence, settings on top of the recipe, the table's options, generated motions in the picture.
FULL: dict[str, Any] = {
    "every": 1,
    "overrides": [],
    "table": {"clips": 1024, "replications": 5, "motions": 256},
    "pictured": 3,
}
# Enough to see that every step works; its numbers mean nothing.
SMALLEST: dict[str, Any] = {
    "every": 2,
    "overrides": ["codebook.schedule.steps=8", "field.schedule.steps=40", "denoiser.schedule.steps=40"],
    "table": {"clips": 128, "replications": 2, "motions": 16},
    "pictured": 1,
}


def demo(
    folder: Annotated[Path, typer.Option(help="Folder for corpus, store, run, motions, table and picture.")] = (
        Path("demo")
    ),
    smallest: Annotated[
        bool, typer.Option("--smallest", help="Only to see that everything works: its numbers mean nothing.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Everything random follows from it.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print Table 2 and where everything lies as JSON.")] = False,
) -> None:
    """Do the whole job on an embedded corpus: ingest, train NeRM, generate, evaluate Table 2, draw it.

    Example: motionkit demo --smallest
    """
    from eval.report.results import read_result

    names = {"corpus": "corpus", "store": "store", "run": "runs", "motions": "generated", "table": "results"}
    names |= {"picture": "demo.png", "strips": "motions.png"}
    places = {name: folder / place for name, place in names.items()}
    # With --json, what the steps print is progress: stdout holds one document.
    with redirect_stdout(sys.stderr) if as_json else nullcontext():
        seconds = _run(places, SMALLEST if smallest else FULL, seed)
    if as_json:
        table = asdict(read_result(places["table"] / "nerm-table2.json"))
        print_json({"places": {name: str(place) for name, place in places.items()}, "seconds": seconds, "table": table})
        return
    stderr.print(f"demo: {', '.join(f'{name} {spent:.0f} s' for name, spent in seconds.items())}")
    for name, place in places.items():
        stdout.print(f"{name + ':':9} {place}")


def _run(places: dict[str, Path], size: dict[str, Any], seed: int) -> dict[str, float]:
    """The whole chain, replacing an earlier demo; returns the seconds of each step.

    The steps print what their commands print. Raises `UsageError` for a folder with other content, and
    `MissingExtraError` without the extra `text`.
    """
    from eval.commands.eval import evaluate
    from motionkit.cli.generate import generate
    from motionkit.cli.ingest import ingest
    from motionkit.cli.train import train
    from motionkit.demo_corpus import write_demo_corpus
    from motionkit.store.reader import Store
    from motionkit.training.config import flatten
    from motionkit.training.run import choose_stages
    from motionkit.training.text import load_text_encoder

    settings = flatten(choose_stages("denoiser")[0].recipe(RECIPE))
    load_text_encoder(str(settings["denoiser.conditions.text_encoder"]))  # fail now, not after minutes of training
    _prepare(places)
    seconds: dict[str, float] = {}

    @contextmanager
    def step(name: str) -> Iterator[None]:
        stderr.print(f"demo: {name} …")
        started = time.monotonic()
        yield
        seconds[name] = round(time.monotonic() - started, 1)

    of_run: dict[str, Any] = {"runs": places["run"], "seed": seed}
    with step("corpus"):
        write_demo_corpus(places["corpus"], size["every"])
    with step("ingest"):
        ingest([str(places["corpus"])], store=places["store"])
    with step("train"):
        for stage in ("codebook", "field", "denoiser"):
            train(stage=stage, recipe=RECIPE, store=places["store"], overrides=size["overrides"], **of_run)
    with step("generate"):
        real = _pictured(Store.open(places["store"]), size["pictured"])
        generate(
            [motion.captions[0].text for motion in real],
            fps=PICTURED_FPS,
            seconds=PICTURED_SECONDS,
            out=places["motions"],
            file_format="bvh",
            run=RECIPE,
            **of_run,
        )
    with step("eval"):
        evaluation = {"table": "2", "evaluator": "kinematic", **size["table"]}
        evaluate(store=places["store"], run=RECIPE, results=places["table"], **evaluation, **of_run)
    with step("picture"):
        _draw(places, real)
    return seconds


def _pictured(store: "Store", number: int) -> "list[Motion]":
    """Training motions to show beside generated ones: the longest of each pictured action."""
    table = store.sequences.sort_values("duration_seconds", ascending=False)
    table = table[(table["split"] == "train") & (table["duration_seconds"] >= 0.75 * PICTURED_SECONDS)]
    longest = table.drop_duplicates("action").set_index("action")["sequence_id"]
    return [store.read(longest[action]) for action in PICTURED_ACTIONS if action in longest][:number]


def _draw(places: dict[str, Path], real: "list[Motion]") -> None:
    """Table 2 as curves, and each caption's motion of the corpus above the generated one as strips of poses."""
    from eval.report.curves import curves_figure, panels_of, save
    from eval.report.results import read_result
    from motionkit.core.skeleton import SMPL22
    from motionkit.core.skeletons.mapping import map_joints
    from motionkit.io.bvh import read_bvh
    from motionkit.io.registry import ReadOptions
    from motionkit.viz.film import write_film
    from motionkit.viz.player import Panel

    panels = panels_of(read_result(places["table"] / "nerm-table2.json"), "clip-FID (lower is better)")
    save(curves_figure(panels), places["picture"])
    # A barely trained model makes bodies of no human size, from which the unit cannot be guessed.
    options = ReadOptions(unit_metres=0.01)
    generated = [read_bvh(path, options) for path in sorted(places["motions"].glob("*.bvh"))]
    strips = []
    for motion, answer in zip(real, generated, strict=True):
        for whose, shown in (("corpus", motion), ("NeRM", answer)):
            positions = map_joints(shown, SMPL22.name)[: int(PICTURED_SECONDS * shown.fps)]
            strips.append(Panel(f"{whose}: {motion.captions[0].text}", positions, SMPL22, shown.fps))
    write_film(places["strips"], strips)


def _prepare(places: dict[str, Path]) -> None:
    """Delete an earlier demo and nothing else."""
    from motionkit.core.errors import UsageError
    from motionkit.core.files import is_temporary, write_whole

    folder = places["corpus"].parent
    marker = folder / MARKER
    has_content = folder.is_dir() and any(not is_temporary(entry) for entry in folder.iterdir())
    if has_content and not marker.is_file():
        raise UsageError(f"{folder} has other content than an earlier demo; choose another folder with --folder")
    write_whole(marker, "motionkit demo made this folder, and deletes what is in it when it runs again.\n")
    for place in places.values():
        if place.is_dir():
            shutil.rmtree(place)
