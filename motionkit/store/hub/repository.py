"""Repositories of the Hub: addresses, snapshots, fetching and committing files.

Nothing else talks to the Hub. Files are fetched into the Hub's own cache, where interrupted downloads are resumed.
Tokens, the cache and the address of the Hub are those of `huggingface_hub` (`hf auth login`, HF_HOME, HF_ENDPOINT). A
repository's code is never run.
"""

import os
import re
import shutil
from collections.abc import Collection, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

from motionkit.core import __version__
from motionkit.core.errors import MissingExtraError, MotionkitError, UsageError
from motionkit.core.progress import OnProgress, ignore, task, tracked, warn

PREFIX = "hf://"
DATASET = "dataset"
# Of one part of a path, in bytes.
LONGEST_NAME = 255
# The Hub limits how many requests it answers at once.
DOWNLOADS_AT_ONCE = 8


class HubError(MotionkitError):
    """A repository that cannot be reached, or lacks the requested content."""


@dataclass(frozen=True)
class Repository:
    """A repository of data sets (`kind` "dataset") or models ("model"), called OWNER/NAME, and a folder inside it."""

    kind: str
    name: str
    revision: str | None = None
    folder: str = ""

    def __str__(self) -> str:
        revision = f"@{self.revision}" if self.revision else ""
        folder = f"/{self.folder}" if self.folder else ""
        return f"{PREFIX}{'datasets/' if self.kind == DATASET else ''}{self.name}{revision}{folder}"


@dataclass(frozen=True)
class Snapshot:
    """A commit of a repository: sizes in bytes of the files in its folder, by their paths from there."""

    repository: Repository
    commit: str
    sizes: Mapping[str, int]
    is_private: bool


def is_address(source: str | os.PathLike[str]) -> bool:
    """Whether this is an address of the Hub, not a path."""
    return isinstance(source, str) and source.startswith(PREFIX)


def parse_address(address: str) -> Repository:
    """The repository of `hf://datasets/OWNER/NAME[@REVISION][/FOLDER]`; without `datasets/` it is one of models.

    Raises `UsageError` for anything else, `MissingExtraError` without the extra `hub`.
    """
    _require_hub()
    from huggingface_hub import parse_hf_uri
    from huggingface_hub.errors import HfUriError

    try:
        found = parse_hf_uri(address)
    except HfUriError as error:
        raise UsageError(f"{address}: expected hf://datasets/OWNER/NAME or hf://OWNER/NAME ({error})") from None
    if found.type not in (DATASET, "model"):
        raise UsageError(f"{address}: expected a repository of data sets or models, not a {found.type}")
    return Repository(found.type, found.id, found.revision, found.path_in_repo.strip("/"))


def _require_hub() -> None:
    try:
        import huggingface_hub  # noqa: F401
    except ImportError:
        raise MissingExtraError("huggingface_hub", "hub") from None


def look_up(repository: Repository) -> Snapshot:
    """The repository's current content; raises `HubError` if it cannot be reached, or names a file outside itself."""
    from huggingface_hub import HfApi
    from huggingface_hub.hf_api import RepoFile

    with _asking(repository):
        api = HfApi()
        info = api.repo_info(repository.name, repo_type=repository.kind, revision=repository.revision)
        where: dict[str, Any] = {"repo_type": repository.kind, "revision": info.sha, "recursive": True}
        tree = list(api.list_repo_tree(repository.name, repository.folder or None, **where))
    sizes = {}
    for file in tree:
        path = PurePosixPath(file.path)
        if path.is_absolute() or ".." in path.parts:
            raise HubError(f"{repository} names a file outside itself: {file.path!r}")
        if isinstance(file, RepoFile):
            sizes[path.relative_to(repository.folder).as_posix()] = file.size
    return Snapshot(repository, info.sha or "", sizes, bool(info.private))


def fetch(snapshot: Snapshot, names: Collection[str], on_progress: OnProgress = ignore) -> Path:
    """Fetch files of a snapshot into the cache; returns its folder, which may have other files too.

    Raises `HubError` if the Hub cannot be reached.
    """
    from huggingface_hub import constants, hf_hub_download, try_to_load_from_cache

    repository = snapshot.repository
    where: dict[str, Any] = {
        "repo_id": repository.name,
        "repo_type": repository.kind,
        "revision": snapshot.commit,
        "cache_dir": constants.HF_HUB_CACHE,
    }
    inside = PurePosixPath(repository.folder)
    paths = {name: (inside / name).as_posix() for name in names}
    missing = [
        name for name, path in paths.items() if not isinstance(try_to_load_from_cache(filename=path, **where), str)
    ]

    def download(name: str) -> str:
        return str(hf_hub_download(filename=paths[name], **where))

    with _asking(repository), task(on_progress, "fetch", len(paths), done=len(paths) - len(missing)) as work:
        pool = ThreadPoolExecutor(DOWNLOADS_AT_ONCE)
        try:
            for _ in pool.map(download, missing):
                work.advance()
        finally:
            pool.shutdown(cancel_futures=True)
        first = next(iter(names))
        place = Path(download(first))  # from the cache
    return place.parents[len(PurePosixPath(first).parts) - 1]


@contextmanager
def as_folder(snapshot: Snapshot, on_progress: OnProgress = ignore) -> Iterator[Path]:
    """A temporary folder of all files of a snapshot, named as the repository or the folder in it.

    Its files are links into the cache. A file that cannot have its name here is left out with a warning.
    """
    names = []
    folders = {str(parent) for name in snapshot.sizes for parent in PurePosixPath(name).parents}
    for name in snapshot.sizes:
        if name in folders or not _can_be_stored(name):
            warn(f"{snapshot.repository}: {name!a} is left out: it cannot be the name of a file")
        elif not name.startswith("."):
            names.append(name)
    if not names:
        raise HubError(f"{snapshot.repository} holds no files")
    source = fetch(snapshot, names, on_progress)
    with TemporaryDirectory(prefix="motionkit-") as place:
        folder = Path(place) / PurePosixPath(snapshot.repository.folder or snapshot.repository.name).name
        for name in names:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).symlink_to(source / name)
        yield folder


def _can_be_stored(name: str) -> bool:
    try:
        return "\0" not in name and all(0 < len(part.encode()) <= LONGEST_NAME for part in name.split("/"))
    except UnicodeEncodeError:  # half a character
        return False


def copy_files(source: Path, names: Collection[str], target: Path) -> None:
    """Copy files of these names from one folder to another, the content of links."""
    for name in names:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source / name, target / name)


def push(
    repository: Repository,
    files: Mapping[str, Path | bytes],
    replaces: re.Pattern[str],
    public: bool,
    on_progress: OnProgress = ignore,
) -> str:
    """Commit these files to the repository in a single commit; returns its address.

    Other files of the repository whose path matches `replaces` are deleted in the same commit. A missing repository is
    created, private unless `public`. Raises `HubError`, also if it is public without `public`.
    """
    from huggingface_hub import CommitOperationAdd, CommitOperationDelete, HfApi

    api = HfApi(library_name="motionkit", library_version=__version__)
    where: dict[str, Any] = {"repo_id": repository.name, "repo_type": repository.kind}
    with _asking(repository):
        api.create_repo(**where, private=not public, exist_ok=True)
    there = look_up(repository)
    if not there.is_private and not public:
        raise HubError(f"{repository} is public: --public says that everybody may have what is pushed")
    where["revision"] = repository.revision
    additions = [CommitOperationAdd(path, content) for path, content in files.items()]
    gone = [CommitOperationDelete(path) for path in there.sizes if replaces.fullmatch(path) and path not in files]
    with _asking(repository):
        for each in tracked(on_progress, "push", additions, len(additions)):
            api.preupload_lfs_files(additions=[each], **where)
        made = api.create_commit(operations=[*additions, *gone], commit_message="motionkit push", **where)
    return str(made.commit_url)


@contextmanager
def _asking(repository: Repository) -> Iterator[None]:
    """Convert huggingface_hub's exceptions to `HubError`, and silence its progress bars and logs."""
    from huggingface_hub import errors
    from huggingface_hub import utils as untyped

    utils: Any = untyped
    drawn = not utils.are_progress_bars_disabled()
    utils.disable_progress_bars()
    verbosity = utils.logging.get_verbosity()
    utils.logging.set_verbosity_error()
    try:
        yield
    except errors.GatedRepoError:
        raise HubError(f"{repository} is given to those whom its owner lets in: ask for it on its page") from None
    except errors.RepositoryNotFoundError:
        raise HubError(
            f"{repository} is not there, or is private and not yours: check the name (of data sets it begins with "
            "hf://datasets/), and 'hf auth whoami'"
        ) from None
    except (errors.RevisionNotFoundError, errors.RemoteEntryNotFoundError) as error:
        raise HubError(f"{repository} is not there: {_first_line(error)}") from None
    except errors.HfHubHTTPError as error:
        raise HubError(f"{repository}: the Hub refuses: {_first_line(error)}; 'hf auth login' logs in") from None
    except (errors.HTTPError, errors.LocalEntryNotFoundError, errors.OfflineModeIsEnabled) as error:  # type: ignore[attr-defined]
        raise HubError(f"{repository}: the Hub cannot be reached ({_first_line(error)})") from None
    finally:
        utils.logging.set_verbosity(verbosity)
        if drawn:
            utils.enable_progress_bars()


def _first_line(error: Exception) -> str:
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
