"""The whole job on the embedded corpus by the commands' own functions: store, model, motions, table, picture."""

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from eval.commands.eval import evaluate
from eval.report.curves import panels_of
from eval.report.figures import Strip, curves_and_strips_figure, save, strip_of
from eval.report.results import read_result
from motionkit.cli.console import stderr
from motionkit.cli.generate import generate
from motionkit.cli.ingest import ingest
from motionkit.cli.train import train
from motionkit.core.errors import UsageError
from motionkit.core.files import is_temporary, write_whole
from motionkit.core.motion import Motion
from motionkit.demo_corpus import write_demo_corpus
from motionkit.io.bvh import read_bvh
from motionkit.io.registry import ReadOptions
from motionkit.store.reader import Store
from motionkit.training.config import flatten
from motionkit.training.stage import choose_stages
from motionkit.training.text import load_text_encoder

RECIPE = "demo"
STAGES = ("codebook", "field", "denoiser")
PICTURED_ACTIONS = ("walk", "jump", "wave")
PICTURED_SECONDS = 4.0
PICTURED_FPS = "60"
MARKER = "DEMO.txt"


@dataclass(frozen=True)
class DemoSize:
    """How much of everything: every n-th sequence, settings on top of the recipe, clips a score, generated motions."""

    every: int
    overrides: tuple[str, ...]
    num_clips: int
    replications: int
    max_motions: int
    num_pictured: int


FULL = DemoSize(every=1, overrides=(), num_clips=1024, replications=5, max_motions=256, num_pictured=3)
# Enough to see that every step works; its numbers mean nothing.
SMALLEST = DemoSize(
    every=2,
    overrides=("codebook.schedule.steps=8", "field.schedule.steps=40", "denoiser.schedule.steps=40"),
    num_clips=128,
    replications=2,
    max_motions=16,
    num_pictured=1,
)


class DemoFolder:
    """Paths of a demo's files and folders."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.corpus, self.store, self.runs = path / "corpus", path / "store", path / "runs"
        self.generated, self.results, self.picture = path / "generated", path / "results", path / "demo.png"


@dataclass(frozen=True)
class DemoOutcome:
    """A finished demo's folder, and the seconds of each step."""

    folder: DemoFolder
    seconds: dict[str, float]


def run_demo(folder: DemoFolder, size: DemoSize, seed: int) -> DemoOutcome:
    """Run the whole chain into a folder, replacing an earlier demo.

    The steps print what their commands print. Raises `UsageError` for a folder with other content, and
    `MissingExtraError` without the extra `text`.
    """
    settings = flatten(choose_stages("denoiser")[0].recipe(RECIPE))
    load_text_encoder(str(settings["denoiser.conditions.text_encoder"]))  # fail now, not after minutes of training
    _prepare(folder)
    seconds: dict[str, float] = {}
    with _step("corpus", seconds):
        write_demo_corpus(folder.corpus, size.every)
    with _step("ingest", seconds):
        ingest([str(folder.corpus)], store=folder.store)
    with _step("train", seconds):
        for stage in STAGES:
            train(
                stage=stage,
                recipe=RECIPE,
                store=folder.store,
                runs=folder.runs,
                overrides=list(size.overrides),
                seed=seed,
            )
    with _step("generate", seconds):
        real = pictured_motions(Store.open(folder.store), size.num_pictured)
        generate(
            [motion.captions[0].text for motion in real],
            fps=PICTURED_FPS,
            seconds=PICTURED_SECONDS,
            out=folder.generated,
            file_format="bvh",
            run=RECIPE,
            runs=folder.runs,
            seed=seed,
        )
    with _step("eval", seconds):
        evaluate(
            table="2",
            store=folder.store,
            runs=folder.runs,
            run=RECIPE,
            results=folder.results,
            clips=size.num_clips,
            replications=size.replications,
            motions=size.max_motions,
            evaluator="kinematic",
            seed=seed,
        )
    with _step("picture", seconds):
        # A barely trained model makes bodies of no human size, from which the unit cannot be guessed.
        options = ReadOptions(unit_metres=0.01)
        generated = [read_bvh(path, options) for path in sorted(folder.generated.glob("*.bvh"))]
        draw_picture(folder, real, generated)
    return DemoOutcome(folder, seconds)


def pictured_motions(store: Store, count: int) -> list[Motion]:
    """Training motions to show beside generated ones: the longest of each pictured action."""
    found = store.sequences
    known = found[(found["split"] == "train") & (found["duration_seconds"] >= 0.75 * PICTURED_SECONDS)]
    chosen = []
    for action in PICTURED_ACTIONS:
        of_action = known[known["action"] == action].sort_values("duration_seconds", ascending=False)
        chosen += of_action["sequence_id"].tolist()[:1]
    return [store.read(sequence_id) for sequence_id in chosen[:count]]


def draw_picture(folder: DemoFolder, real: list[Motion], generated: list[Motion]) -> Path:
    """Table 2 as curves, and below them each caption's motion of the corpus above the generated one."""
    strips: list[Strip] = []
    for truth, made in zip(real, generated, strict=True):
        caption = truth.captions[0].text
        strips.append(strip_of(truth, f"corpus: “{caption}”", seconds=PICTURED_SECONDS))
        strips.append(strip_of(made, f"NeRM, asked for “{caption}”", seconds=PICTURED_SECONDS))
    result = read_result(folder.results / "nerm-table2.json")
    return save(curves_and_strips_figure(panels_of(result, "clip-FID (lower is better)"), strips), folder.picture)


def _prepare(folder: DemoFolder) -> None:
    """Delete an earlier demo and nothing else."""
    marker = folder.path / MARKER
    there = folder.path.is_dir() and any(not is_temporary(entry) for entry in folder.path.iterdir())
    # Demos of earlier versions had no marker.
    if there and not marker.is_file() and not (folder.corpus / "LICENSE").is_file():
        raise UsageError(f"{folder.path} has other content than an earlier demo; choose another folder with --folder")
    parts = (folder.corpus, folder.store, folder.runs, folder.generated, folder.results)
    write_whole(marker, "motionkit demo made this folder, and deletes what is in it when it runs again.\n")
    for part in parts:
        if part.exists():
            shutil.rmtree(part)


@contextmanager
def _step(name: str, seconds: dict[str, float]) -> Iterator[None]:
    stderr.print(f"demo: {name} …")
    started = time.monotonic()
    yield
    seconds[name] = round(time.monotonic() - started, 1)
