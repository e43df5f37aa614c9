"""motionkit's commands as processes with fault injection."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from benchmarks.trust.faults import UNDISTURBED, Fault

REPOSITORY = Path(__file__).parents[2]
TIMEOUT_SECONDS = 180.0
NO_VARIABLES: Mapping[str, str] = MappingProxyType({})
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "ARROW_NUM_THREADS")


@dataclass(frozen=True)
class Outcome:
    """How a process ended: exit code (minus the signal's number, None for a hang), its output, its seconds.

    `left` counts its descendants that were still running ten seconds later; `operations` are the changes of files
    beneath its folder, in order, if it ran undisturbed.
    """

    code: int | None
    out: str
    err: str
    seconds: float
    left: int
    operations: tuple[str, ...]

    @property
    def last_line(self) -> str:
        """The last line of stderr."""
        return (self.err.strip().splitlines() or [""])[-1]


class Commands:
    """Runs commands one after the other, each in a process of its own; a context manager that owns their server."""

    def __enter__(self) -> "Commands":
        self._server = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.trust.server"],
            cwd=REPOSITORY,
            env=one_thread(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        return self

    def __exit__(self, *exception: object) -> None:
        self._server.communicate()

    def run(
        self,
        folder: Path,
        arguments: Sequence[str],
        fault: Fault = UNDISTURBED,
        *,
        checkpoint_seconds: float | None = None,
        environment: Mapping[str, str] = NO_VARIABLES,
    ) -> Outcome:
        """Run `motionkit ARGUMENTS` in a folder, or the function that `call:MODULE:NAME` names with the rest of them.

        `checkpoint_seconds` is the interval of checkpoints, by default motionkit's; `environment` holds additional
        variables for the process.
        """
        request = {
            "folder": str(folder.absolute()),
            "arguments": list(map(str, arguments)),
            "fault": asdict(fault),
            "checkpoint_seconds": checkpoint_seconds,
            "environment": dict(environment),
            "timeout": TIMEOUT_SECONDS,
        }
        assert self._server.stdin is not None and self._server.stdout is not None
        print(json.dumps(request), file=self._server.stdin, flush=True)
        line = self._server.stdout.readline()
        if not line:
            raise RuntimeError(f"the server of commands has ended (exit code {self._server.wait()})")
        answer: dict[str, Any] = json.loads(line)
        return Outcome(**{**answer, "operations": tuple(answer["operations"])})


def one_thread() -> dict[str, str]:
    """The environment of a process of the drill: this code, one thread for each library, no settings of a user's."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("MOTIONKIT_")}
    path = [str(REPOSITORY), *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    return environment | dict.fromkeys(ONE_THREAD, "1") | {"PYTHONPATH": os.pathsep.join(path)}
