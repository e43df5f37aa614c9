"""The way through the code: how many of the project's files a job touches, counted by sys.setprofile.

    python -m benchmarks.paths [--json]

A file is touched if one of its functions is called; what runs while modules are imported does not count. Modules are
those that `import motionkit` has not loaded already. Each job runs in a process of its own, from the command line
inwards:

- BVH to manifest: `motionkit ingest walk.bvh`, until the store has its manifest
- to a training step: `motionkit train --stage field`, until the optimizer's first step
- caption to Table 2: `motionkit eval --table 2` with a trained NeRM, until the result is written
"""

import inspect
import json
import shutil
import subprocess
import sys
import tempfile
import threading
from functools import cache
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from benchmarks.command import arguments_parser, print_json
from motionkit.demo_corpus import write_demo_corpus

ROOT = Path(__file__).parent.parent
PACKAGES = ("motionkit", "nerm", "pahires", "peers", "eval")
# What each job may touch: files, and modules beyond the front door (DESIGN.md, Layout).
LIMITS = {"BVH to manifest": (25, 40), "to a training step": (25, None), "caption to Table 2": (45, None)}


class FirstStep(Exception):
    """The optimizer is about to take its first step."""


def stop_at_the_first_step() -> None:
    """Make the optimizer's first step raise `FirstStep`."""
    from torch.optim.optimizer import register_optimizer_step_pre_hook

    def stop(*_: Any) -> None:
        raise FirstStep

    register_optimizer_step_pre_hook(stop)


def trace(command: list[str], until_step: bool) -> dict[str, Any]:
    """Run a command in this process; the project's files whose functions it called, and the modules that it loaded."""
    import motionkit  # noqa: F401  the front door, whose own modules do not count

    before = set(sys.modules)
    if until_step:
        stop_at_the_first_step()
    called: set[CodeType] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code not in called and not _while_importing(frame):
            called.add(frame.f_code)

    from motionkit.cli.app import main

    sys.argv = ["motionkit", *command]
    threading.setprofile(note)
    sys.setprofile(note)
    try:
        main()
    except FirstStep:
        pass
    except SystemExit as end:
        if end.code:
            raise
    finally:
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type]
    # The bodies of modules and classes are not functions.
    functions = [code for code in called if code.co_flags & inspect.CO_OPTIMIZED]
    files = {path for code in functions if (path := _of_project(code.co_filename))}
    modules = {name for name in set(sys.modules) - before if name.split(".")[0] in PACKAGES}
    return {
        "files": sorted(files),
        "modules": sorted(modules),
        "num_functions": sum(_of_project(code.co_filename) is not None for code in functions),
        "num_lines": sum(len((ROOT / file).read_text("utf-8").splitlines()) for file in files),
    }


def _while_importing(frame: FrameType | None) -> bool:
    """Whether a module of the project is being imported below this frame."""
    while frame is not None:
        if frame.f_code.co_name == "<module>" and _of_project(frame.f_code.co_filename):
            return True
        frame = frame.f_back
    return False


@cache
def _of_project(filename: str) -> str | None:
    path = Path(filename)
    if not path.is_relative_to(ROOT) or path.relative_to(ROOT).parts[0] not in PACKAGES:
        return None
    return path.relative_to(ROOT).as_posix()


def trace_apart(command: list[str], *, until_step: bool = False) -> dict[str, Any]:
    """`trace` in a fresh process; what the command prints goes to stderr."""
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder, "trace.json")
        arguments = ["--trace", str(answer), *(["--until-step"] if until_step else []), "--", *command]
        subprocess.run([sys.executable, "-m", "benchmarks.paths", *arguments], check=True, cwd=ROOT, stdout=sys.stderr)
        return dict(json.loads(answer.read_text("utf-8")))


def measure(folder: Path) -> dict[str, dict[str, Any]]:
    """All jobs, on the demo's corpus."""
    corpus, store, runs = folder / "corpus", folder / "store", folder / "runs"
    bvh = corpus / f"{write_demo_corpus(corpus)[0].sequence_id}.bvh"
    run(["ingest", str(corpus), "--store", str(store)])
    walk = folder / "walk.bvh"
    shutil.copy(bvh, walk)

    def train(stage: str, *options: str) -> list[str]:
        return ["train", str(store), "--runs", str(runs), "--stage", stage, "--recipe", "nano", *options]

    def one_step(stage: str) -> list[str]:
        return train(stage, "--set", ("" if stage == "evaluator" else f"{stage}.") + "schedule.steps=1", "--overwrite")

    table = ["eval", "--store", str(store), "--table", "2", "--runs", str(runs), "--results", str(folder / "results")]
    manifest = trace_apart(["ingest", str(walk), "--store", str(folder / "one")])
    run(one_step("codebook"))
    step = trace_apart(train("field"), until_step=True)
    for stage in ("field", "denoiser", "evaluator"):
        run(one_step(stage))
    row = trace_apart(
        [*table, "--motions", "32", "--draws", "1", "--replications", "2", "--clips", "64", "--fps", "20"]
    )
    return {"BVH to manifest": manifest, "to a training step": step, "caption to Table 2": row}


def run(command: list[str]) -> None:
    """A motionkit command that has to end well."""
    subprocess.run([sys.executable, "-m", "motionkit", *command], check=True, stdout=sys.stderr)


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("--json", action="store_true", help="print the names of files and modules too")
    parser.add_argument("--trace", type=Path)
    parser.add_argument("--until-step", action="store_true")
    parser.add_argument("command", nargs="*")
    arguments = parser.parse_args()
    if arguments.trace:
        arguments.trace.write_text(json.dumps(trace(arguments.command, arguments.until_step)), "utf-8")
        return
    with tempfile.TemporaryDirectory() as folder:
        figures = measure(Path(folder))
    if arguments.json:
        print_json({"paths": figures, "limits": LIMITS})
        return
    print(f"{'path':20} {'files':>6} {'limit':>6} {'modules':>8} {'limit':>6} {'functions':>10} {'lines':>7}")
    for name, path in figures.items():
        files, modules = LIMITS[name]
        counts = f"{len(path['files']):6} {files:6} {len(path['modules']):8} {modules or '':>6}"
        print(f"{name:20} {counts} {path['num_functions']:10} {path['num_lines']:7}")


if __name__ == "__main__":
    main()
