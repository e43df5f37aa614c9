"""`motionkit demo`: the whole job on the embedded corpus, by the commands' own functions."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer

from motionkit.cli.console import stderr, stdout

if TYPE_CHECKING:
    from motionkit.core.motion import Motion
    from motionkit.core.progress import Progress
    from motionkit.store.reader import Store
    from motionkit.training.run import Stage

RECIPE = "demo"
PICTURED_ACTIONS = ("walk", "jump", "wave")
PICTURED_SECONDS = 4.0
MARKER = "DEMO.txt"
MEASURED_STEPS = 10
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
    from motionkit.demo_corpus import read_demo_corpus, write_demo_corpus
    from motionkit.store.reader import Store
    from motionkit.training.config import flatten
    from motionkit.training.run import choose_stages
    from motionkit.training.text import load_text_encoder

    places = {name: folder / name for name in ("corpus", "store")}
    places |= {"run": folder / "runs" / RECIPE, "motions": folder / "generated"}
    places |= {"table": folder / "results" / "nerm-table2.md", "picture": folder / "demo.png"}
    size, table = (SMALLEST, SMALLEST_TABLE) if smallest else (FULL, FULL_TABLE)
    stages = [choose_stages(name)[0] for name in ("codebook", "field", "denoiser")]
    settings = flatten(stages[-1].configured(RECIPE))
    load_text_encoder(str(settings["denoiser.conditions.text_encoder"]))  # fail now, not after minutes of training
    _claim(folder, places)
    seconds: dict[str, float] = {}

    @contextmanager
    def step(name: str) -> Iterator[None]:
        stderr.print(f"demo: {name} …")
        started = time.monotonic()
        yield
        seconds[name] = time.monotonic() - started

    of_run: dict[str, Any] = {"runs": places["run"].parent, "seed": seed}
    with step("corpus"):
        for motion in read_demo_corpus():  # an earlier demo may have had more of them
            (places["corpus"] / f"{motion.sequence_id}.bvh").unlink(missing_ok=True)
        write_demo_corpus(places["corpus"], size["every"])
    with step("ingest"):
        ingest([places["corpus"]], store=places["store"], overwrite=True)
    with step("measure this machine"):
        minutes = _training_seconds(stages, places["store"], size["overrides"], seed) / 60
    stderr.print(f"demo: training will take about {minutes:.1f} min on this machine, all after it a small part of that")
    with step("train"):
        for stage in stages:
            options = {"recipe": RECIPE, "store": places["store"], "overrides": size["overrides"], "overwrite": True}
            train(stage=stage.name, **options, **of_run)
    with step("generate"):
        real = _pictured(Store.open(places["store"]), size["pictured"])
        texts = [motion.captions[0].text for motion in real]
        shape: dict[str, Any] = {"fps": "60", "seconds": PICTURED_SECONDS, "file_format": "bvh", "overwrite": True}
        generate(texts, out=places["motions"], run=RECIPE, **shape, **of_run)
    with step("eval"):
        of_run |= {"store": places["store"], "run": RECIPE, "results": places["table"].parent}
        evaluate("2", evaluator="kinematic", **table, **of_run)
    with step("picture"):
        _draw(places, real)
    stderr.print(f"demo: {', '.join(f'{name} {spent:.0f} s' for name, spent in seconds.items())}")
    for name, place in places.items():
        stdout.print(f"{name + ':':9} {place}")


def _training_seconds(stages: "Sequence[Stage[Any]]", store: Path, overrides: list[str], seed: int) -> float:
    """How long the stages will train here: of each the time for all but its steps, and of a few steps, measured."""
    from motionkit.training.config import flatten
    from motionkit.training.run import RunFolder, StageContext

    total = 0.0
    with TemporaryDirectory() as folder:
        for stage in stages:
            moments: dict[int, float] = {}

            def note(progress: "Progress", name: str = stage.name, moments: dict[int, float] = moments) -> None:
                if progress.name == name:
                    moments.setdefault(progress.done, time.monotonic())

            key, started = f"{stage.name}.schedule.steps", time.monotonic()
            steps = int(flatten(stage.configured(RECIPE, overrides))[key])
            config = stage.configured(RECIPE, [*overrides, f"{key}={min(steps, MEASURED_STEPS)}"])
            stage.train(StageContext(store, RunFolder(Path(folder)), RECIPE, seed=seed, on_progress=note), config)
            # The first steps are slower, and the last one is saved.
            first, last = min(3, max(moments) - 2), max(moments) - 1
            step_seconds = (moments[last] - moments[first]) / (last - first)
            total += time.monotonic() - started + (steps - max(moments)) * step_seconds
    return total


def _pictured(store: "Store", number: int) -> "list[Motion]":
    """Training motions to show beside generated ones: the longest of each pictured action."""
    table = store.sequences.sort_values("duration_seconds", ascending=False)
    table = table[(table["split"] == "train") & (table["duration_seconds"] >= 0.75 * PICTURED_SECONDS)]
    longest = table.drop_duplicates("action").set_index("action")["sequence_id"]
    return [store.read(longest[action]) for action in PICTURED_ACTIONS if action in longest][:number]


def _draw(places: dict[str, Path], real: "list[Motion]") -> None:
    """Table 2 as curves, and below, in the colours of its rows, motions of the corpus and those of their captions."""
    from matplotlib.colors import to_hex, to_rgb
    from matplotlib.figure import Figure

    from eval.report.curves import draw_panels, panels_of, row_colours, save
    from eval.report.results import read_result
    from motionkit.core.files import read_json
    from motionkit.core.skeleton import SMPL22
    from motionkit.core.skeletons.mapping import map_joints
    from motionkit.generate.output import MANIFEST
    from motionkit.io.bvh import read_bvh
    from motionkit.io.registry import ReadOptions
    from motionkit.viz.film import STRIP_POSES, draw_strips
    from motionkit.viz.player import Panel

    ours, papers = panels_of(read_result(places["table"].with_suffix(".json")), "clip-FID (lower is better)")
    panels = (replace(ours, title="Measured here, against people who are in no training"), papers)
    colours = row_colours(panels)[0]
    # A barely trained model makes bodies of no human size, from which the unit cannot be guessed.
    options = ReadOptions(unit_metres=0.01)
    names = read_json(places["motions"] / MANIFEST, "run the demo again")["files"]
    generated = [read_bvh(places["motions"] / name, options) for name in names]
    strips = []
    for motion, planted in zip(real, generated, strict=True):
        for row, shown in (("training takes", motion), ("planted", planted)):
            name, colour = next((name, colour) for name, colour in colours.items() if row in name)
            positions = map_joints(shown, SMPL22.name)[: int(PICTURED_SECONDS * shown.fps)]
            red, green, blue = to_rgb(colour)
            light = to_hex(((1 + red) / 2, (1 + green) / 2, (1 + blue) / 2))
            strip = Panel(f"{name.partition(',')[0]}: {motion.captions[0].text}", positions, SMPL22, shown.fps)
            strips.append((strip, {-1: colour, 0: colour, 1: light}))
    width, curves_height = 12.0, 4.6
    heights = (curves_height, len(strips) * width / STRIP_POSES)
    figure = Figure(figsize=(width, sum(heights)), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=heights, squeeze=False).ravel()
    draw_panels(above, panels)
    draw_strips(below, strips)
    save(figure, places["picture"])


def _claim(folder: Path, places: dict[str, Path]) -> None:
    """Mark a folder as a demo's; raises `UsageError` if what no demo made has one of the places."""
    from motionkit.core.errors import UsageError
    from motionkit.core.files import write_whole

    marker = folder / MARKER
    if not marker.is_file() and (existing := [place for place in places.values() if place.exists()]):
        raise UsageError(f"{existing[0]} is not of an earlier demo: choose another folder with --folder")
    write_whole(marker, "motionkit demo made this folder. When it runs again, it replaces its own files alone.\n")
