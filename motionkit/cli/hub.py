"""`motionkit pack`, `push` and `pull`: a run for generation alone; a store or a run onto the Hub, and from there."""

import re
from pathlib import Path
from shutil import copytree
from typing import TYPE_CHECKING, Annotated

import typer

from motionkit.cli import console
from motionkit.core.errors import StoreError, UsageError, counted
from motionkit.core.files import default_path, is_store, require_new, whole_folder, write_whole
from motionkit.core.progress import task

if TYPE_CHECKING:
    from motionkit.training.run import StageFolder

README = "README.md"


def pack(
    run: Annotated[str, typer.Argument(help="Run to pack.", show_default=False)],
    out: Annotated[Path, typer.Argument(help="Folder for the packed run.", show_default=False)],
    model: Annotated[str | None, typer.Option(help="Installed model.", show_default="the run's")] = None,
    runs: console.RunsFolder = None,
    overwrite: console.Overwrite = False,
    as_json: console.AsJson = False,
) -> None:
    """Pack a run's model for generation alone: half precision, without training latents, checkpoints and logs.

    The packed folder is a run: 'generate --run FOLDER' uses it, 'push' shares it. The stage 'detail' goes along. A
    README.md in the folder stays; without one a card is written.

    Example: motionkit pack nano walker
    """
    from motionkit.edit.export import render
    from motionkit.generate.models import model_of
    from motionkit.training import detail
    from motionkit.training.pack import pack_run
    from motionkit.training.run import RunFolder, find_run, loader_named

    place = find_run(run, runs)
    stages = list(loader_named("MODELS", model or model_of(place)).stages)
    stages += [detail.NAME] if RunFolder(place).stage(detail.NAME).is_complete else []
    files = pack_run(RunFolder(place), out, stages, overwrite=overwrite)
    if not (card := out / README).exists():
        code = f'motionkit generate "a person walks" --run {out}'
        write_whole(card, render("run_card.md.j2", stages=stages, packed=True, code=code))
    size = sum(path.stat().st_size for path in files)
    if as_json:
        console.print_json({"folder": str(out), "stages": stages, "bytes": size})
    else:
        console.stdout.print(f"packed {', '.join(stages)} into {out}: {size / 1e6:,.1f} MB")


def push(
    address: Annotated[
        str,
        typer.Argument(help="hf://datasets/OWNER/NAME for a store, hf://OWNER/NAME for a run.", show_default=False),
    ],
    store: Annotated[Path | None, typer.Option(help="Store to push.", show_default="./store")] = None,
    run: Annotated[str | None, typer.Option(help="Run to push: its complete stages, without checkpoints.")] = None,
    runs: console.RunsFolder = None,
    public: Annotated[bool, typer.Option("--public", help="Let everybody have it; else it is private.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be pushed; the Hub is not asked.")] = False,
    as_json: console.AsJson = False,
) -> None:
    """Validate a store, or a run, and push it with a card to a repository of the Hugging Face Hub.

    The files are a single commit; the repository is created if needed. Log in first ('hf auth login'). A run's
    config.json contains its store's path, and the platform it was trained on. Needs the extra 'hub'.

    Example: motionkit push hf://datasets/me/walks --dry-run
    """
    from motionkit.edit.export import render
    from motionkit.store import hub
    from motionkit.store.reader import Store
    from motionkit.store.reports import summarise

    repository = hub.parse_address(address)
    if repository.path_in_repo:
        raise UsageError(f"{address}: push to a whole repository, without /{repository.path_in_repo}")
    licences: list[str] = []
    patterns: tuple[str, ...]
    if repository.type == "dataset":
        if run is not None:
            raise UsageError(f"a run goes to hf://{repository.id}: hf://datasets/ is for stores")
        folder, patterns = store or default_path("store"), hub.STORE_FILES
        _require_intact(folder, f"'motionkit validate --store {folder}' says more")
        summary = summarise(Store.open(folder))
        card = render("store_card.md.j2", summary=summary, address=repository.to_uri())
        licences = summary["licences"]
    else:
        if store is not None or run is None:
            raise UsageError(f"{address} is for a run: name one with --run; a store goes to hf://datasets/OWNER/NAME")
        folder = (runs or default_path("runs")) / run
        stages = _complete_stages(folder)
        if not stages:
            raise UsageError(f"{folder} has no complete stage: motionkit train --run {run}")
        patterns = tuple(f"{stage.path.name}/{path.name}" for stage in stages for path in stage.result_paths)
        names = [stage.path.name for stage in stages]
        card = render("run_card.md.j2", stages=names, packed=False, code=f"motionkit pull {repository.to_uri()}")
        if (folder / README).is_file():  # of a packed run
            card = (folder / README).read_text(encoding="utf-8")
    url = "" if dry_run else hub.push(repository, folder, patterns, card, public=public)
    files = sorted(path for pattern in patterns for path in folder.glob(pattern))
    size = sum(path.stat().st_size for path in files)
    if as_json:
        names = [str(path.relative_to(folder)) for path in files]
        pushed = {"files": names, "bytes": size, "licences": licences, "dry_run": dry_run, "commit": url}
        console.print_json({"repository": repository.to_uri(), **pushed})
        return
    for name in licences:
        console.stdout.print(f"  licence: {name}")
    done = f"{'would push' if dry_run else 'pushed'} {counted(len(files), 'file')}, {size / 1e6:,.1f} MB, to {address}"
    console.stdout.print(f"{done} ({url})" if url else done)


def _require_intact(store: Path, hint: str) -> None:
    """Raise `StoreError` for a store that is not as its manifest says."""
    from motionkit.store.commit import read_manifest
    from motionkit.store.validate import faults

    with console.progress() as show, task(show, "check", len(read_manifest(store).files)) as work:
        fault = next(faults(store, lambda _: work.advance()), None)
    if fault:
        raise StoreError(f"{store} is damaged ({fault}): {hint}")


def _is_run(folder: Path) -> bool:
    return any(folder.glob("*/config.json"))


def _complete_stages(run: Path) -> "list[StageFolder]":
    """The complete stages of a run after verifying them, by name; raises `DamagedFileError`."""
    from motionkit.training.run import RunFolder

    stages = [RunFolder(run).stage(path.parent.name) for path in sorted(run.glob("*/summary.json"))]
    for stage in stages:
        stage.check()
    return stages


def pull(
    address: Annotated[
        str,
        typer.Argument(
            help="hf://datasets/OWNER/NAME for a store, hf://OWNER/NAME for a run; or with @REVISION.",
            show_default=False,
        ),
    ],
    store: Annotated[Path | None, typer.Option(help="Folder for the store.", show_default="./store")] = None,
    run: Annotated[str | None, typer.Option(help="Name of the run here; the repository's by default.")] = None,
    runs: console.RunsFolder = None,
    overwrite: console.Overwrite = False,
    as_json: console.AsJson = False,
) -> None:
    """Pull a store, or a run, from a repository of the Hugging Face Hub into a new folder.

    The folder appears once it is complete and its checksums match. An interrupted download continues when the command
    is repeated: files are kept in the Hub's cache ('hf cache' lists and frees it). Needs the extra 'hub'.

    Example: motionkit pull hf://datasets/me/walks --store walks
    """
    from motionkit.store import hub
    from motionkit.training.run import STAGE_NAME, StageFolder

    repository = hub.parse_address(address)
    if repository.type == "dataset":
        if run is not None:
            raise UsageError(f"{address} is a store: --run is for runs, hf://OWNER/NAME")
        folder = store or default_path("store")
        require_new(folder, overwrite=overwrite, replaced=is_store, instead="--store pulls elsewhere")
        source = hub.fetch_store(repository)
        with whole_folder(folder.absolute()) as partial:
            copytree(source, partial, dirs_exist_ok=True)
            _require_intact(partial, f"delete {source} and pull again")
    else:
        if store is not None:
            raise UsageError(f"{address} is a run: --store is for stores, hf://datasets/OWNER/NAME")
        folder = (runs or default_path("runs")) / (run or repository.id.partition("/")[2])
        require_new(folder, overwrite=overwrite, replaced=_is_run, instead="--run NAME keeps both")
        with whole_folder(folder.absolute()) as partial:
            names = [path.name for path in StageFolder(partial).result_paths]
            for summary in hub.fetch(repository, [f"*/{name}" for name in names]).glob("*/summary.json"):
                if re.fullmatch(STAGE_NAME, summary.parent.name):
                    copytree(summary.parent, partial / summary.parent.name)
            if not _complete_stages(partial):
                raise hub.HubError(f"{address} holds no run (no STAGE/summary.json)")
    if as_json:
        console.print_json({"repository": repository.to_uri(), "folder": str(folder)})
    else:
        console.stdout.print(f"pulled {address} to {folder}")
