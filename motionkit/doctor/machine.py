"""Versions, devices, threads, disk space, optional packages."""

import os
import re
from collections.abc import Iterator, Mapping
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from motionkit.core.files import existing, free_bytes
from motionkit.core.settings import optional_path
from motionkit.doctor.finding import Finding
from motionkit.training.run import versions

GIGABYTE = 1e9
LEAST_FREE_BYTES = GIGABYTE
CPU_QUOTA = Path("/sys/fs/cgroup/cpu.max")
# Development packages are not reported.
UNTOLD_EXTRAS = ("dev",)
_REQUIREMENT = re.compile(r"""([\w.-]+)[^;]*;.*extra\s*==\s*["']([\w-]+)["']""")


def version_findings() -> Iterator[Finding]:
    """Python, platform, and the packages that affect results."""
    found = versions()
    yield Finding("python", f"{found.pop('python')} on {found.pop('platform')}")
    yield Finding("packages", ", ".join(f"{name} {number}" for name, number in found.items()))


def device_findings() -> Iterator[Finding]:
    """The GPUs that torch sees, if any."""
    import torch

    if not torch.cuda.is_available():
        built = f"torch is built for CUDA {torch.version.cuda}" if torch.version.cuda else "torch is built for CPUs"
        yield Finding("devices", f"cpu; no GPU is seen ({built})")
    for number in range(torch.cuda.device_count() if torch.cuda.is_available() else 0):
        free, total = torch.cuda.mem_get_info(number)
        name = torch.cuda.get_device_name(number)
        yield Finding("devices", f"cuda:{number} {name}, {free / GIGABYTE:.1f} of {total / GIGABYTE:.1f} GB free")


def usable_processors(quota: Path = CPU_QUOTA) -> float:
    """Processors available to this process: its affinity, or a container's quota if lower."""
    bound = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        share, period = quota.read_text(encoding="ascii").split()
        return float(bound) if share == "max" else min(float(bound), int(share) / int(period))
    except (OSError, ValueError, ZeroDivisionError):
        return float(bound)


def thread_findings(environment: Mapping[str, str], num_threads: int, processors: float) -> Iterator[Finding]:
    """Whether torch uses more threads than there are available processors."""
    stated = environment.get("OMP_NUM_THREADS", "not set")
    fact = f"torch computes with {num_threads}, of {processors:g} processors (OMP_NUM_THREADS {stated})"
    if num_threads > max(1.0, processors):
        remedy = f"export OMP_NUM_THREADS={max(1, int(processors))}: threads that share a processor wait for each other"
        yield Finding("threads", fact, "problem", remedy)
    else:
        yield Finding("threads", fact)


def disk_findings(store: Path, runs: Path) -> Iterator[Finding]:
    """Free disk space and write permission for stores, runs and caches."""
    elsewhere = optional_path("cache")
    for name, path in (("store", store), ("runs", runs), ("cache", elsewhere)):
        if path is None:
            continue
        there, free = existing(path), free_bytes(path)
        fact = f"{path} ({name}): {free / GIGABYTE:,.1f} GB free"
        other = f"name another place with {'MOTIONKIT_CACHE' if name == 'cache' else f'--{name}'}"
        if not os.access(there, os.W_OK):
            aside = "set MOTIONKIT_CACHE, so that trainings can keep their caches elsewhere"
            remedy = aside if name == "store" else other
            yield Finding("disk", f"{fact}; {there} may not be written to", "problem", remedy)
        elif free < LEAST_FREE_BYTES:
            yield Finding("disk", fact, "problem", f"make room, or {other}")
        else:
            yield Finding("disk", fact)


def extra_findings() -> Iterator[Finding]:
    """Whether the packages of each extra are installed."""
    extras: dict[str, list[str]] = {}
    for requirement in requires("motionkit") or ():
        found = _REQUIREMENT.match(requirement)
        if found and found[2] not in UNTOLD_EXTRAS:
            extras.setdefault(found[2], []).append(found[1])
    for extra, packages in extras.items():
        have, lack = [], []
        for package in packages:
            try:
                have.append(f"{package} {version(package)}")
            except PackageNotFoundError:
                lack.append(package)
        if lack:
            remedy = f"if needed, in a checkout of motionkit: pip install '.[{extra}]'"
            yield Finding("extras", f"{extra}: {', '.join(lack)} not installed", "note", remedy)
        else:
            yield Finding("extras", f"{extra}: {', '.join(have)}")
