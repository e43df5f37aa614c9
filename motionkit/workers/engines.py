"""Who computes: processes of this machine, or a Ray cluster."""

from motionkit.errors import UsageError
from motionkit.workers.parallel import Engine
from motionkit.workers.process_engine import Processes, ThisProcess
from motionkit.workers.ray_engine import RayEngine

LOCAL, RAY, RAY_ADDRESS = "local", "ray", "ray://"


def check_engine(name: str) -> None:
    """Raises `UsageError` for anything but `local`, `ray` and `ray://HOST:PORT`."""
    host, _, port = name.removeprefix(RAY_ADDRESS).rpartition(":")
    if name not in (LOCAL, RAY) and not (name.startswith(RAY_ADDRESS) and host and port.isdecimal()):
        raise UsageError(f"--engine {name}: expected local, ray (this machine, or RAY_ADDRESS) or ray://HOST:PORT")


def make_engine(name: str, num_workers: int | None) -> Engine:
    """The engine of that name, not yet started; Ray without a number of workers uses all that the cluster has."""
    check_engine(name)
    if name != LOCAL:
        return RayEngine(None if name == RAY else name, num_workers)
    return ThisProcess() if num_workers in (None, 1) else Processes(num_workers)
