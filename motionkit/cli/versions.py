"""`motionkit --version [--verbose]`: versions, device, threads and extras, for reports of problems."""

import os
import re
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version

from motionkit.core import __version__

_REQUIREMENT = re.compile(r"""([\w.-]+)[^;]*;.*extra\s*==\s*["']([\w-]+)["']""")


def version_lines(verbose: bool) -> Iterator[str]:
    """Lines about the installation; with `verbose`, of packages, device, threads and extras too."""
    if not verbose:
        yield f"motionkit {__version__}"
        return
    import torch

    from motionkit.training.run import versions

    yield from (f"{name} {number}" for name, number in versions().items())
    for number in range(torch.cuda.device_count()):
        free, total = torch.cuda.mem_get_info(number)
        yield f"cuda:{number} {torch.cuda.get_device_name(number)}, {free / 1e9:.1f} of {total / 1e9:.1f} GB free"
    if not torch.cuda.is_available():
        yield f"device cpu (torch is built for {'CUDA ' + torch.version.cuda if torch.version.cuda else 'CPUs'})"
    stated = os.environ.get("OMP_NUM_THREADS", "not set")
    yield f"threads {torch.get_num_threads()} of {os.cpu_count()} processors (OMP_NUM_THREADS {stated})"
    yield from _extras()


def _extras() -> Iterator[str]:
    """Each extra with the versions of its packages."""
    extras: dict[str, list[str]] = {}
    for requirement in requires("motionkit") or ():
        found = _REQUIREMENT.match(requirement)
        if found and found[2] != "dev":
            extras.setdefault(found[2], []).append(found[1])
    for extra, packages in extras.items():
        yield f"extra {extra}: {', '.join(map(_installed, packages))}"


def _installed(package: str) -> str:
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return f"{package} not installed"
