"""`motionkit demo`: the whole job on the embedded corpus, by the commands' own functions."""

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from motionkit.cli.console import stderr, stdout

if TYPE_CHECKING:
    from motionkit.core.motion import Motion
    from motionkit.store.reader import Store

RECIPE = "demo"
PICTURED_ACTIONS = ("walk", "jump", "wave")
PICTURED_SECONDS = 4.0
MARKER = "DEMO.txt"
# Every n-th sequence, the training's settings, generated motions in the picture, the table's options.
FULL: dict[str, Any] = {"every": 1, "overrides": [], "pictured": 3}
FULL_TABLE: dict[str, Any] = {"clips": 1024, "replications": 5, "motions": 256}
# Enough to see that every step works; its numbers mean nothing.
FEW_STEPS = ["codebook.schedule.steps=8", "field.schedule.steps=40", "denoiser.schedule.steps=40"]
SMALLEST: dict[str, Any] = {"every": 2, "overrides": FEW_STEPS, "pictured": 1}
SMALLEST_TABLE: dict[str, Any] = {"clips": 128, "replications": 2, "motions": 16}


def demo(
    folder: Annotated[Path, typer.Option(help="Folder for everything from corpus to picture.")] = Path("demo"),
    smallest: Annotated[bool, typer.Option("--smallest", help="To see that all works: numbers mean nothing.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Everything random follows from it.")] = 0,
) -> None:
    """Do the whole job on an embedded corpus: ingest, train NeRM, generate, evaluate Table 2, draw it.

    Example: motionkit demo --smallest
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

    places = {name: folder / name for name in ("corpus", "store")}
    places |= {"run": folder / "runs", "motions": folder / "generated", "table": folder / "results"}
    places |= {"picture": folder / "demo.png", "strips": folder / "motions.png"}
    size, table = (SMALLEST, SMALLEST_TABLE) if smallest else (FULL, FULL_TABLE)
    settings = flatten(choose_stages("denoiser")[0].recipe(RECIPE))
    load_text_encoder(str(settings["denoiser.conditions.text_encoder"]))  # fail now, not after minutes of training
    _prepare(places)
    seconds: dict[str, float] = {}

    @contextmanager
    def step(name: str) -> Iterator[None]:
        stderr.print(f"demo: {name} …")
        started = time.monotonic()
        yield
        seconds[name] = time.monotonic() - started

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
        texts = [motion.captions[0].text for motion in real]
        shape: dict[str, Any] = {"fps": "60", "seconds": PICTURED_SECONDS, "file_format": "bvh"}
        generate(texts, out=places["motions"], run=RECIPE, **shape, **of_run)
    with step("eval"):
        of_run |= {"store": places["store"], "run": RECIPE, "results": places["table"]}
        evaluate("2", evaluator="kinematic", **table, **of_run)
    with step("picture"):
        _draw(places, real)
    stderr.print(f"demo: {', '.join(f'{name} {spent:.0f} s' for name, spent in seconds.items())}")
    for name, place in places.items():
        stdout.print(f"{name + ':':9} {place}")


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
