"""Workers of a Ray cluster, or of a local Ray started for it (extra `ray`)."""

import os
import warnings
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any

from motionkit.core import __version__
from motionkit.core.errors import MissingExtraError, MotionkitError
from motionkit.store.engines.parallel import Function, WorkerDied, map_in_order, usable_cores


class RayEngine:
    """Workers of the Ray at `address` or RAY_ADDRESS, or else of one started here.

    Owns the connection, and the Ray that it started; an existing connection of this process is reused and kept open.
    Workers read files of their own machine's file system. Raises `MissingExtraError` without Ray, and `MotionkitError`
    if it cannot be reached or has another version of motionkit.
    """

    def __init__(self, address: str | None, num_workers: int | None) -> None:
        self._address = address
        self._wanted = num_workers
        self.num_workers = num_workers or 1  # until the cluster is known
        self._held = ExitStack()

    def __enter__(self) -> "RayEngine":
        # Before Ray is imported: nothing is reported to anyone.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        try:
            import ray as installed
        except ImportError:
            raise MissingExtraError("ray", "ray") from None
        ray: Any = installed
        if not ray.is_initialized():
            self._connect(ray)
            self._held.callback(ray.shutdown)
        with ExitStack() as held:
            held.push(self._held)
            self._faults: Any = ray.exceptions
            self._get: Callable[[Any], Any] = ray.get
            # A task that died is repeated by the map, input by input; Ray's own repetition would hide which one it was.
            self._remote = ray.remote(max_retries=0)(_compute)
            self._check_version()
            self.num_workers = self._wanted or max(1, int(ray.cluster_resources().get("CPU", 1)))
            self._held = held.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        self._held.close()

    def _connect(self, ray: Any) -> None:
        options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
        if self._address is not None:
            options["address"] = self._address
        elif "RAY_ADDRESS" not in os.environ:
            options |= {"num_cpus": self._wanted or usable_cores(), "include_dashboard": False}
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "Ray Client connection timed out", UserWarning)  # explained below
                ray.init(**options)
        except (OSError, ValueError, RuntimeError) as error:
            where = self._address or os.environ.get("RAY_ADDRESS", "on this machine")
            reason = next(iter(str(error).splitlines()), type(error).__name__)
            raise MotionkitError(f"Ray cannot be reached at {where} ({reason}): is it running there?") from None

    def _check_version(self) -> None:
        # A worker that dies meanwhile says nothing of the others: it is asked once more.
        ((_, version),) = map_in_order(self, _version, [[None]])
        if isinstance(version, WorkerDied):
            raise MotionkitError("two workers of Ray ended before they had done anything: killed, or out of memory?")
        if version != __version__:
            raise MotionkitError(
                f"Ray's workers have motionkit {version}, this is {__version__}: install the same everywhere"
            )

    def submit(self, function: Function, batch: Sequence[Any]) -> object:
        """Hand a batch to the cluster."""
        ticket: object = self._remote.remote(function, batch)
        return ticket

    def result(self, ticket: object) -> Any:
        """Wait for a batch; raises `WorkerDied` where its worker, its node or its result is gone."""
        faults = self._faults
        try:
            return self._get(ticket)
        except (faults.WorkerCrashedError, faults.OutOfMemoryError, faults.NodeDiedError, faults.ObjectLostError):
            raise WorkerDied from None
        except faults.RayError as error:
            cause = getattr(error, "cause", None)
            if isinstance(cause, (MotionkitError, OSError)):
                raise cause from None
            reason = str(error).strip().splitlines()[-1]
            raise MotionkitError(
                f"a worker of Ray failed ({reason}): motionkit {__version__} must be installed where it runs"
            ) from None


def _compute(function: Function, batch: Sequence[Any]) -> Any:
    return function(batch)


def _version(_: Sequence[None]) -> str:
    return __version__
