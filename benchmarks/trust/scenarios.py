"""The commands of the drill, the folders that they start from, and how each is repeated."""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

Arguments = tuple[str, ...]
CALL = "call:benchmarks.trust.scenarios:"
ACTIONS = ("walk", "run", "squat", "bow")
SHORT, LONG = "2.0", "3.0"
STORE = ("--store", "store")
ONE_WORKER = (*STORE, "--workers", "1")
RUN = ("--runs", "runs", "--run", "drill")
TRAIN = (*STORE, *RUN, "--device", "cpu")
EVERY = ("operation", "bytes", "moment", "limit", "interrupt", "terminate")
TIMED = ("moment", "interrupt", "terminate")

# What makes a training last a second.
SETTINGS = {
    "codebook": (
        "codebook.schedule.steps=8 codebook.schedule.batch_size=2 codebook.network.width=8 codebook.window_frames=16 "
        "codebook.network.num_codes=8 "
        "field.precision=float32 field.windows.max_duration_seconds=3 field.decoder.width=16 field.schedule.steps=8 "
        "field.decoder.num_layers=2 field.schedule.batch_size=4 field.encoder.num_layers=1 field.encoder.num_queries=8 "
        "denoiser.schedule.steps=8 denoiser.schedule.batch_size=4 denoiser.network.num_layers=1 "
        "denoiser.network.width=16 denoiser.network.ffn_width=16 denoiser.diffusion.sampling_steps=2 "
        "denoiser.conditions.text_encoder=none"
    ),
    "evaluator": (
        "schedule.steps=8 schedule.batch_size=4 training.max_poses=24 training.statistics_batches=1 "
        "training.bank_seconds=10 training.framerates=20,60 "
        "network.convolution=8 network.recurrent=8 network.shared=4 network.text_hidden=8"
    ),
    "pahires": (
        "training.schedule.steps=8 training.schedule.batch_size=4 training.tasks.gap=0 network.hidden=8 network.code=8 "
        "training.tasks.longest_gap=10 training.tasks.num_frames=8 training.tasks.largest_factor=2 "
        "network.attention_tokens=4 network.embedding=8 network.decoder_layers=1 network.num_sines=4"
    ),
}


def train(stage: str) -> Arguments:
    """The command that trains a stage in a second."""
    # One recipe serves codebook, field and denoiser: the settings of all three are the run's.
    settings = SETTINGS.get(stage, SETTINGS["codebook"]).split()
    given = tuple(part for each in settings for part in ("--set", each))
    return ("train", "--stage", stage, *TRAIN, *given)


def ingest(folder: str, *options: str) -> Arguments:
    """The command that ingests takes with one worker."""
    return ("ingest", folder, *ONE_WORKER, *options)


def takes(folder: str, first: int, count: int, seconds: str = SHORT) -> Arguments:
    """The call that writes takes."""
    return (f"{CALL}write_takes", folder, str(first), str(count), seconds)


@dataclass(frozen=True)
class Scenario:
    """A command that is disturbed; all paths are relative to the folder that it runs in.

    `again` is the command to recover, by default the same. `refusal` is its message if it refuses to overwrite what it
    has already written. `whole` names files that are never partially written. `modes` are the kinds of `Fault` to try.
    """

    name: str
    start: str
    command: Arguments
    again: Arguments = ()
    refusal: str = ""
    store: str = "store"
    whole: tuple[str, ...] = ()
    modes: tuple[str, ...] = EVERY

    @property
    def repetition(self) -> Arguments:
        """The command to recover."""
        return self.again or self.command


def _training(stage: str, start: str) -> Scenario:
    whole = tuple(f"runs/drill/{stage}/{name}" for name in ("config.json", "model.safetensors", "summary.json"))
    command = train(stage)
    return Scenario(f"train {stage}", start, command, (*command, "--resume"), whole=whole)


def _export(kind: str) -> Scenario:
    # The folder appears only when it is complete, so every file in it is whole.
    command = ("export", "out", "--format", kind, *STORE)
    return Scenario(f"export {kind}", "store", command, refusal="is not empty", whole=("out/*", "out/*/*"))


GENERATE = ("generate", "--action", "walk", "--action", "squat", "--fps", "30", "--seconds", "1", "--out", "made", *RUN)
COMPLETE_BY_SPLINE = ("complete", "one", "--fps", "90", "--out", "made", "--overwrite")
COMPLETE = ("complete", "long/take-0.bvh", "--fps", "90", "--out", "completed", "--model", "pahires", *RUN)
EVAL = (*STORE, *RUN, "--results", "results", "--split", "all")
EVAL_PAHIRES = ("eval", "--paper", "pahires", "--table", "2", *EVAL, "--where", "fps = 60")
RESULTS = ("results/*.json", "results/*.md", "results/*.png")

# Each starting folder by its name: the one that it goes on from, and what is run in it.
STARTS: dict[str, tuple[str, tuple[Arguments, ...]]] = {
    "takes": ("", (takes("one", 0, 3), takes("two", 3, 3), takes("three", 6, 2))),
    "store": ("takes", (ingest("one"), ingest("two"))),
    "two stores": ("store", (("ingest", "three", "--store", "other", "--workers", "1"),)),
    "gaps": ("store", (ingest("three"), ("remove", "--where", "sequence_index IN (1, 4)", *STORE))),
    "corpus": ("", (takes("long", 0, 8, LONG), ingest("long"))),
    "codebook": ("corpus", (train("codebook"),)),
    "field": ("codebook", (train("field"),)),
    "model": ("field", (train("denoiser"),)),
    "pahires": ("corpus", (train("pahires"),)),
    "evaluator": ("corpus", (train("evaluator"),)),
    "results": ("pahires", (EVAL_PAHIRES,)),
    "exported": ("store", (("export", "npz", "--format", "npz", *STORE),)),
}

SCENARIOS: dict[str, Scenario] = {
    scenario.name: scenario
    for scenario in (
        Scenario("ingest", "takes", ingest("one")),
        Scenario("ingest, 2 workers", "takes", ("ingest", "one", *STORE, "--workers", "2"), modes=TIMED),
        Scenario("append", "store", ingest("three")),
        Scenario("append, 2 workers", "store", ("ingest", "three", *STORE, "--workers", "2"), modes=TIMED),
        Scenario("overwrite", "store", ingest("three", "--overwrite")),
        Scenario("remove", "gaps", ("remove", "--where", "sequence_index < 3", *STORE), refusal="no sequence of"),
        Scenario("remove a whole part", "gaps", ("remove", "--where", "part = 0", *STORE), refusal="no sequence of"),
        Scenario("compact", "gaps", ("compact", *STORE)),
        Scenario("merge into a new store", "two stores", ("merge", "new", "store", "other"), store="new"),
        Scenario("merge into a store", "two stores", ("merge", "store", "other")),
        Scenario("split", "store", ("split", "--by", "sequence_id", "--shares", "train=0.5,test=0.5", *STORE)),
        Scenario("cache", "corpus", (f"{CALL}build_cache", "store"), whole=("store/cache/*-*/*",)),
        _training("codebook", "corpus"),
        _training("field", "codebook"),
        _training("denoiser", "field"),
        _training("evaluator", "corpus"),
        _training("pahires", "corpus"),
        Scenario("eval nerm-4", "field", ("eval", "--table", "4", "--clips", "64", *EVAL), whole=RESULTS),
        Scenario("eval pahires-2", "pahires", EVAL_PAHIRES, whole=RESULTS),
        *map(_export, ("bvh", "npz", "humanml3d", "parquet")),
        Scenario("complete", "takes", COMPLETE_BY_SPLINE, store="", whole=("made/*",)),
        Scenario("complete by pahires", "pahires", (*COMPLETE, "--overwrite")),
        Scenario("generate", "model", GENERATE, (*GENERATE, "--resume"), whole=("made/*.npz", "made/*.json")),
        Scenario("generate again", "model", (*GENERATE, "--overwrite")),
    )
}


def write_takes(folder: str, first: str, count: str, seconds: str) -> None:
    """Write takes FIRST … FIRST + COUNT − 1 of so many seconds as BVH files, with a table of captions and splits."""
    from motionkit.fields.motion_field import to_motion
    from motionkit.io.bvh import write_bvh
    from tests.helpers.analytic import analytic_motion

    path, rows = Path(folder), ["file,fps,action,subject,caption,split\n"]
    path.mkdir(parents=True)
    for number in range(int(first), int(first) + int(count)):
        action, fps, split = ACTIONS[number % 4], (30, 60)[number // 2 % 2], "test" if number % 4 == 3 else "train"
        motion = to_motion(analytic_motion(action, float(seconds), number), Fraction(fps))
        write_bvh(motion, path / f"take-{number}.bvh")
        rows.append(f"take-{number}.bvh,{fps},{action},p{number % 3},a person does a {action},{split}\n")
    (path / "clips.csv").write_text("".join(rows), "utf-8")


def build_cache(store: str) -> None:
    """Build the training cache of a store."""
    from motionkit.store import Store
    from motionkit.store.cache import open_cache

    open_cache(Store.open(store))
