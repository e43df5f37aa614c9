"""Stores, runs and captures on the Hugging Face Hub; nothing else talks to it.

Files are fetched into the Hub's own cache, where interrupted downloads are resumed. Tokens, the cache, the Hub's
address and progress bars are those of `huggingface_hub` (`hf auth login`, HF_HOME, HF_ENDPOINT). No code of a
repository is run.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from glob import escape
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from motionkit.core import __version__
from motionkit.core.errors import MissingExtraError, MotionkitError, UsageError
from motionkit.core.files import MANIFEST_FILE, MOTIONS_FOLDER, SEQUENCES_FILE

if TYPE_CHECKING:
    from huggingface_hub import HfUri

# Patterns of a store's files.
STORE_FILES = (MANIFEST_FILE, SEQUENCES_FILE, "skeletons.parquet", f"{MOTIONS_FOLDER}/part-*.parquet")


class HubError(MotionkitError):
    """A repository that cannot be reached, or lacks the requested content."""


def parse_address(address: str) -> "HfUri":
    """A repository by its address `hf://datasets/OWNER/NAME[@REVISION][/FOLDER]`; without `datasets/` one of models.

    Raises `UsageError` for anything else, `MissingExtraError` without the extra `hub`.
    """
    try:
        from huggingface_hub import parse_hf_uri
        from huggingface_hub.errors import HfUriError
    except ImportError:
        raise MissingExtraError("huggingface_hub", "hub") from None
    try:
        repository = parse_hf_uri(address)
    except HfUriError as error:
        raise UsageError(f"{address}: expected hf://datasets/OWNER/NAME or hf://OWNER/NAME ({error})") from None
    if repository.type not in ("dataset", "model"):
        raise UsageError(f"{address}: expected a repository of data sets or models, not a {repository.type}")
    return repository


def fetch(repository: "HfUri", patterns: Sequence[str]) -> Path:
    """Download the files of a repository that match `patterns`; returns its folder in the cache; raises `HubError`."""
    from huggingface_hub import snapshot_download

    inside = f"{escape(repository.path_in_repo)}/" if repository.path_in_repo else ""
    with _reporting(repository):
        snapshot = snapshot_download(
            repository.id,
            repo_type=repository.type,
            revision=repository.revision,
            allow_patterns=[inside + each for each in patterns],
        )
    return Path(snapshot, repository.path_in_repo)


def fetch_store(repository: "HfUri", patterns: Sequence[str] = STORE_FILES) -> Path:
    """Download the files of a store that match `patterns`; returns its folder in the Hub's cache.

    Checksums are compared when its files are read. Raises `HubError`.
    """
    folder = fetch(repository, patterns)
    if not (folder / MANIFEST_FILE).is_file():
        address = repository.to_uri()
        raise HubError(
            f"{address} holds no store (no {MANIFEST_FILE}); 'hf download' fetches captures and exported Parquet, "
            "'motionkit ingest FOLDER' reads them"
        )
    return folder


def fetch_tables(repository: "HfUri") -> tuple[Path, Callable[[str], None]]:
    """Download a store without its parts; returns its folder, and a function that downloads one part of that commit."""
    folder = fetch_store(repository, STORE_FILES[:-1])
    snapshot = [folder, *folder.parents][len(PurePosixPath(repository.path_in_repo).parts)]
    return folder, partial(_fetch_part, replace(repository, revision=snapshot.name))


def _fetch_part(repository: "HfUri", name: str) -> None:
    from huggingface_hub import hf_hub_download

    path = str(PurePosixPath(repository.path_in_repo, name))
    with _reporting(repository):
        hf_hub_download(repository.id, path, repo_type=repository.type, revision=repository.revision)


def push(repository: "HfUri", folder: Path, patterns: Sequence[str], card: str, *, public: bool) -> str:
    """Commit the card (README.md), then the files of a folder that match `patterns`; returns the commit's address.

    Other files of the repository that match are deleted by the same commit. A missing repository is created, private
    unless `public`. Raises `HubError`, also if it is public without `public`.
    """
    from huggingface_hub import HfApi

    api = HfApi(library_name="motionkit", library_version=__version__)
    where: dict[str, Any] = {"repo_id": repository.id, "repo_type": repository.type}
    chosen = list(patterns)
    with _reporting(repository):
        api.create_repo(**where, private=not public, exist_ok=True)
        if not public and not api.repo_info(**where).private:
            raise HubError(f"{repository.to_uri()} is public: --public allows everybody to download what is pushed")
        where |= {"revision": repository.revision, "commit_message": "motionkit push"}
        api.upload_file(path_or_fileobj=card.encode(), path_in_repo="README.md", **where)
        commit = api.upload_folder(folder_path=folder, allow_patterns=chosen, delete_patterns=chosen, **where)
    return str(commit.commit_url)


@contextmanager
def _reporting(repository: "HfUri") -> Iterator[None]:
    """Convert huggingface_hub's exceptions to `HubError`."""
    from huggingface_hub import errors

    address = repository.to_uri()
    try:
        yield
    except errors.RepositoryNotFoundError:  # also of a gated one
        raise HubError(
            f"{address} is not there, private, or gated: check the name (of data sets it begins with hf://datasets/), "
            "'hf auth whoami', and request access on its page"
        ) from None
    except (errors.HTTPError, errors.LocalEntryNotFoundError, ValueError) as error:  # type: ignore[attr-defined]
        reason = next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
        raise HubError(f"{address}: {reason}; 'hf auth login' logs in") from None
