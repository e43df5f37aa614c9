"""`motionkit doctor`: check the machine, the installation, the store and the runs."""

import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from motionkit.cli.console import print_json, stdout
from motionkit.core.settings import default_path

MARKS = {"good": " ", "note": "·", "problem": "!"}


def doctor(
    store: Annotated[Path | None, typer.Option(help="Store to look at.", show_default="./store")] = None,
    runs: Annotated[Path | None, typer.Option(help="Folder of all runs.", show_default="./runs")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was found as JSON.")] = False,
) -> None:
    """Check versions, devices, threads, disks, extras, store and runs, and say how to fix problems.

    Only quick checks; 'motionkit validate' reads a whole store. Exit code 1 if there is a problem (!); notes are
    marked by a point.

    Example: motionkit doctor --store store
    """
    import torch

    from motionkit.doctor import data, machine

    store_path, runs_path = store or default_path("store"), runs or default_path("runs")
    found = [
        *machine.version_findings(),
        *machine.device_findings(),
        *machine.thread_findings(os.environ, torch.get_num_threads(), machine.usable_processors()),
        *machine.disk_findings(store_path, runs_path),
        *machine.extra_findings(),
        *data.store_findings(store_path),
        *data.run_findings(runs_path, store_path),
    ]
    if as_json:
        print_json({"findings": [asdict(each) for each in found]})
    else:
        for each in found:
            stdout.print(f"{MARKS[each.state]} {each.topic:10}{each.fact}")
            if each.remedy:
                stdout.print(f"{'':12}→ {each.remedy}")
    problems = sum(each.state == "problem" for each in found)
    if problems:
        raise typer.Exit(1)
