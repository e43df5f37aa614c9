"""Text encoders found by name: entry points of installed packages."""

from collections.abc import Callable

import numpy as np
import pytest

from motionkit.core.errors import UsageError
from motionkit.training import text as text_encoders
from motionkit.training.text import TextEncoder, load_text_encoder

LENGTHS = '''
"""An encoder that a package brings: a text's length."""
import numpy as np

class Lengths:
    fingerprint, dimension = "ab" * 32, 1

    def __init__(self, name):
        self.name = name

    def encode(self, texts):
        return np.array([[len(text)] for text in texts], dtype=np.float32).reshape(-1, 1)
'''


def test_an_encoder_that_a_package_brings_is_loaded_by_its_name(install: Callable[..., None]) -> None:
    install("length_encoder", LENGTHS, {"motionkit.text_encoders": "lengths = length_encoder:Lengths"})
    encoder = load_text_encoder("lengths")
    assert isinstance(encoder, TextEncoder)
    assert encoder.name == "lengths"
    np.testing.assert_array_equal(encoder.encode(["walk", "a"]), [[4], [1]])


def test_folders_and_hub_names_go_to_the_entry_point_for_them(
    install: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    install("length_encoder", LENGTHS, {"motionkit.texts": "transformers = length_encoder:Lengths"})
    monkeypatch.setattr(text_encoders, "GROUP", "motionkit.texts")
    assert load_text_encoder("./a-folder").name == "./a-folder"


def test_a_name_that_nobody_takes_is_a_usage_error(
    install: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    install("length_encoder", LENGTHS, {"motionkit.texts": "lengths = length_encoder:Lengths"})
    monkeypatch.setattr(text_encoders, "GROUP", "motionkit.texts")
    with pytest.raises(UsageError, match="no text encoder is called 'minilm'; installed: lengths"):
        load_text_encoder("minilm")
