"""Engines for an ordered parallel map: local processes, or a Ray cluster."""

from collections.abc import Sequence

from motionkit.core.errors import UsageError
from motionkit.store.engines.parallel import Engine, ThisProcess

LOCAL, RAY, RAY_ADDRESS = "local", "ray", "ray://"


def check_engine(name: str) -> None:
    """Raises `UsageError` for anything but `local`, `ray` and `ray://HOST:PORT`."""
    host, _, port = name.removeprefix(RAY_ADDRESS).rpartition(":")
    if name not in (LOCAL, RAY) and not (name.startswith(RAY_ADDRESS) and host and port.isdecimal()):
        raise UsageError(f"--engine {name}: expected local, ray (this machine, or RAY_ADDRESS) or ray://HOST:PORT")


def make_engine(name: str, num_workers: int | None, preload: Sequence[str] = ()) -> Engine:
    """The engine of that name, not yet started; Ray without a number of workers uses the whole cluster.

    `preload` names modules that local processes import once for all.
    """
    check_engine(name)
    if name != LOCAL:
        from motionkit.store.engines.ray_engine import RayEngine

        return RayEngine(None if name == RAY else name, num_workers)
    if num_workers is None or num_workers == 1:
        return ThisProcess()

    from motionkit.store.engines.process_engine import Processes

    return Processes(num_workers, preload)
