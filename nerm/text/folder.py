"""A text encoder's local folder, looked over before `transformers` opens it: what is there, and what it is.

Weights are taken from safetensors alone: `pytorch_model.bin` is a pickle, a program that Python would run.
"""

import hashlib
from pathlib import Path

from motionkit.checksums import sha256_of
from motionkit.errors import MotionkitError
from motionkit.plain_text import parse_json

CONFIG = "config.json"
WEIGHTS = ("model.safetensors", "model.safetensors.index.json")
PICKLES = ("*.bin", "*.pt", "*.pth", "*.ckpt", "*.pkl", "*.h5", "*.msgpack")
# Either of the files is enough for the first, all are needed for the others.
TOKENIZERS = (("tokenizer.json",), ("vocab.json", "merges.txt"), ("vocab.txt",))
# What decides an embedding; a README or a pickle beside them does not.
FINGERPRINTED = ("*.safetensors", "*.json", "*.txt")


def check_folder(folder: Path) -> str:
    """The `model_type` that a folder's config states; raises `MotionkitError` where config, weights or tokenizer lack.

    Weights of another kind than safetensors are refused with the line that converts them.
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
                f"{folder}: its weights are {pickles[0]} alone, which can hold a program and is not loaded; take a "
                f"folder with {WEIGHTS[0]}, or, if you trust it, convert it once: AutoModel.from_pretrained(folder)"
                ".save_pretrained(other)"
            )
        raise MotionkitError(f"{folder}: has no {WEIGHTS[0]}; a text encoder's folder needs its weights")
    if not any(all((folder / name).is_file() for name in names) for names in TOKENIZERS):
        known = ", or ".join(" and ".join(names) for names in TOKENIZERS)
        raise MotionkitError(f"{folder}: has no tokenizer ({known}); copy it from where the weights are from")
    return model_type


def folder_fingerprint(folder: Path) -> str:
    """Hexadecimal sha256 over the names and contents of the files that decide an embedding."""
    digest = hashlib.sha256()
    for path in sorted({path for pattern in FINGERPRINTED for path in folder.glob(pattern) if path.is_file()}):
        digest.update(f"{path.name} {sha256_of(path)}\n".encode())
    return digest.hexdigest()
