"""Hostile runs: links where motionkit writes, configurations and logs signed again with values that fit nothing."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.trust.scenarios import COMPLETE, EVAL, EVAL_PAHIRES, GENERATE, RUN, train
from tests.hostile.scene import EVIL, Scene, Spoil, edited, link, links, text

FIELD = "runs/drill/field"
STAGE = ((*train("field"), "--resume"), (*train("field"), "--overwrite"))
PAHIRES = ((*train("pahires"), "--resume"), ("ablate", "5", "--paper", "pahires", "--list", "--runs", "runs"))
CODEBOOK = ((*train("codebook"), "--resume"), (*train("codebook"), "--overwrite"))
MAKE = (*GENERATE[:-6], "--out", "new", *RUN)
ABLATE = ("ablate", "5", "--list", "--run", "drill", "--store", "store", "--runs", "runs")
ALL = (
    *STAGE,
    MAKE,
    ABLATE,
    (*train("denoiser"), "--overwrite"),
    ("eval", "--table", "4", "--clips", "64", *EVAL),
)
FILES = ("config.json", "metrics.jsonl", "checkpoint.safetensors", "model.safetensors", "summary.json")


def unfinished(then: Spoil, stage: str = "field") -> Spoil:
    """A training that goes on with --resume."""

    def spoil(inside: Path, outside: Path) -> None:
        (inside / "runs/drill" / stage / "summary.json").unlink()
        then(inside, outside)

    return spoil


def _vectors(inside: Path, outside: Path) -> None:
    for name in ("vectors.f32", "vectors.json"):
        link(inside / "runs/drill/codebook" / name, outside / "mine.txt")


def _config(**changes: object) -> Callable[[dict[str, Any]], None]:
    return lambda document: document.update(changes)


def _setting(*keys: str, value: object) -> Callable[[dict[str, Any]], None]:
    def edit(document: dict[str, Any]) -> None:
        place = document["config"]
        for key in keys[:-1]:
            place = place[key]
        place[keys[-1]] = value

    return edit


def _nested(depth: int) -> dict[str, Any]:
    value: dict[str, Any] = {}
    for _ in range(depth):
        value = {"a": value}
    return value


CONFIGS: dict[str, Callable[[dict[str, Any]], None]] = {
    "a store above the folder": _config(store="../../outside/store"),
    "a recipe of escape sequences": _config(recipe=EVIL),
    "a seed of 400 digits": _config(seed=10**400),
    "settings nested deep": _config(config=_nested(400)),
    "settings of 100,000 letters": _config(config={"x" * 100_000: "y" * 100_000}),
    "settings of escape sequences": _config(config={EVIL: EVIL}),
    "what it builds on is a number": _config(builds_on={"codebook": 7}),
    "weights above the folder": _setting("codebook", "published_weights", value="../../outside/mine.txt"),
    "a width without end": _setting("field", "hidden", value=10**12),
    "layers that are a text": _setting("field", "layers", value=EVIL),
}
SUMMARIES: dict[str, dict[str, object]] = {
    "a log of 10³⁰ bytes": {"metrics.jsonl": {"bytes": 10**30, "sha256": "0" * 64}},
    "a log that is a text": {"metrics.jsonl": EVIL},
    "losses of escape sequences": {"loss": EVIL, "step": [1], "hours": {"a": 1}, "wall_seconds": EVIL},
}
LOGS = {
    "nested without end": "[" * 100_000 + "\n",
    "steps of 5,000 digits": f'{{"step": {"9" * 5000}}}\n',
    "losses of 1e999": '{"step": 1, "loss": 1e999}\n',
}


def scenes() -> Iterator[Scene]:
    """All of them."""
    yield Scene("run: a stage is a link", links({FIELD: FIELD}), ALL)
    for name in FILES:
        spoil = links({f"{FIELD}/{name}": f"{FIELD}/{name}"})
        yield Scene(f"run: {name} is a link", spoil, ALL)
        if name != "summary.json":
            yield Scene(f"unfinished run: {name} is a link", unfinished(spoil), STAGE)
    temporary = {f"{FIELD}/.{name}.tmp.{name.rpartition('.')[2]}": "mine.txt" for name in FILES}
    yield Scene("unfinished run: temporary files are links", unfinished(links(temporary)), STAGE)
    yield Scene("unfinished run: vectors are links", unfinished(_vectors, "codebook"), CODEBOOK)
    for name, edit in CONFIGS.items():
        yield Scene(f"run: {name}", edited(f"{FIELD}/config.json", edit), ALL)
        yield Scene(f"unfinished run: {name}", unfinished(edited(f"{FIELD}/config.json", edit)), STAGE[:1])
    for stage, commands in (("field", ALL), ("pahires", (COMPLETE, EVAL_PAHIRES, *PAHIRES))):
        for name, values in SUMMARIES.items():
            edit = _config(**values)
            yield Scene(f"{stage}: {name}", edited(f"runs/drill/{stage}/summary.json", edit), commands)
    for name, content in LOGS.items():
        log = text(f"{FIELD}/metrics.jsonl", content)
        yield Scene(f"log: {name}", log, ALL)
        yield Scene(f"unfinished run, log: {name}", unfinished(log), STAGE)
