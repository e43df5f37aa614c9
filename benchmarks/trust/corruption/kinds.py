"""All kinds of files that motionkit writes and reads again: origin, folder, and the commands that read them."""

from dataclasses import dataclass

from benchmarks.trust.scenarios import EVAL_PAHIRES, GENERATE, RUN, STORE, Arguments, ingest, train

CALL = "call:benchmarks.trust.corruption.uses:"
RUNS = "runs/drill"
EXPORT = ("export", "out", "--format", "npz", *STORE)
QUERY = ("query", "SELECT * FROM sequences ORDER BY 1", "--json", *STORE)
STORE_USES = (("validate", "--json", *STORE), QUERY, EXPORT, ingest("three"), ("compact", *STORE))
REPORT = (("report", "--format", "markdown", "--results", "results"), ("report", "--json", "--results", "results"))
COMPLETE = ("complete", "long/take-0.bvh", "--fps", "90", "--out", "completed", "--model", "pahires", *RUN)
STAGES = ("codebook", "field", "denoiser", "evaluator", "pahires")
# Whose training reads which other stage's result.
STARTS_OF_STAGES = {"codebook": "corpus", "field": "codebook", "denoiser": "field"}


@dataclass(frozen=True)
class Kind:
    """One kind of file: `pattern` names its files in the starting folder; `uses` are the commands that read it.

    `start` is a folder of `starts.make_start`. A use with the same result as for undamaged files is harmless.
    """

    name: str
    start: str
    pattern: str
    uses: tuple[Arguments, ...]


def _of_store() -> list[Kind]:
    reads = (STORE_USES[0], EXPORT, ("compact", *STORE))
    return [
        *(Kind(name, "gaps", f"store/{name}", STORE_USES) for name in ("manifest.json", "sequences.parquet")),
        Kind("skeletons.parquet", "gaps", "store/skeletons.parquet", STORE_USES),
        Kind("part", "gaps", "store/motions/*.parquet", reads),
    ]


def _of_interrupted_runs() -> list[Kind]:
    kinds = []
    for stage in STAGES:
        # A log is written with the last step, and of the last checkpoint the moments are not used any more.
        files = {"metrics.jsonl": "finished", "config.json": "half", "checkpoint.safetensors": "half"}
        if stage == "codebook":
            files |= {"vectors.f32": "half", "vectors.json": "half"}
        kinds += [
            Kind(
                f"{start} {stage}: {name}", f"{start} {stage}", f"{RUNS}/{stage}/{name}", ((*train(stage), "--resume"),)
            )
            for name, start in files.items()
        ]
    return kinds


def _of_runs() -> list[Kind]:
    uses = {
        "codebook": (GENERATE, (*train("field"), "--overwrite")),
        "field": (GENERATE, (*train("denoiser"), "--overwrite")),
        "denoiser": (GENERATE,),
        "evaluator": ((f"{CALL}evaluator", RUNS),),
        "pahires": (COMPLETE, EVAL_PAHIRES),
    }
    starts = {"evaluator": "evaluator", "pahires": "pahires"}
    kinds = []
    for stage in STAGES:
        again = (*train(stage), "--resume")
        for name in ("config.json", "metrics.jsonl", "model.safetensors", "summary.json"):
            commands = (*uses[stage], again, (f"{CALL}history", f"{RUNS}/{stage}"))
            kinds.append(Kind(f"{stage}: {name}", starts.get(stage, "model"), f"{RUNS}/{stage}/{name}", commands))
    return kinds


def _read(folder: str) -> Arguments:
    return (f"{CALL}motions", folder)


def _of_outputs() -> list[Kind]:
    return [
        Kind("result", "results", "results/*.json", REPORT),
        Kind("parts of tables", "results", "results/parts/*.json", (EVAL_PAHIRES,)),
        Kind("kinematic features", "caches", "caches/kinematic.npz", ((f"{CALL}kinematic", "caches"),)),
        Kind("embeddings", "caches", "caches/embeddings/*.safetensors", ((f"{CALL}embeddings", "caches"),)),
        Kind("text embeddings", "caches", "caches/text-embeddings-*.safetensors", ((f"{CALL}texts", "caches"),)),
        Kind("exported npz", "exported", "npz/**/*.npz", (_read("npz"),)),
        Kind("exported parquet", "exported", "rows/**/*.parquet", (_read("rows"),)),
    ]


KINDS: tuple[Kind, ...] = (*_of_store(), *_of_interrupted_runs(), *_of_runs(), *_of_outputs())
