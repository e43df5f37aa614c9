"""`motionkit --version [--verbose]`: versions, device, threads and extras, for reports of problems."""

import os
import re
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version

from motionkit.core import __version__


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
    for requirement in requires("motionkit") or ():
        package, extra = re.match(r"[\w.-]+", requirement), re.search(r"extra == [\"'](?!dev)([\w-]+)", requirement)
        if package and extra:
            try:
                yield f"extra {extra[1]}: {package[0]} {version(package[0])}"
            except PackageNotFoundError:
                yield f"extra {extra[1]}: {package[0]} not installed"
