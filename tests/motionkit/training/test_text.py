"""Text encoders found by name, and embeddings that are computed once and kept in a file."""

from collections.abc import Callable

import numpy as np
import pytest
from safetensors.numpy import load_file, save

from motionkit.core.errors import UsageError
from motionkit.training.text import TextEncoder, embed_texts, load_text_encoder
from tests.helpers.plugin_lists import install_only

LENGTHS = '''
"""An encoder that a package brings: a text's length."""
import numpy as np

class Lengths:
    fingerprint, dimension = "ab" * 32, 1

    def __init__(self, name):
        self.name = name

    def encode(self, texts):
        return np.array([[len(text)] for text in texts], dtype=np.float32).reshape(-1, 1)

TEXT_ENCODERS = {"lengths": Lengths}
'''


def test_an_encoder_that_a_package_brings_is_loaded_by_its_name(install: Callable[..., None]) -> None:
    install("length_encoder", LENGTHS)
    encoder = load_text_encoder("lengths")
    assert isinstance(encoder, TextEncoder)
    assert encoder.name == "lengths"
    np.testing.assert_array_equal(encoder.encode(["walk", "a"]), [[4], [1]])


class CountingEncoder:
    """Embeds a text as its length and its first letter, and counts what it was asked for."""

    name, fingerprint, dimension = "counting", "ab" * 32, 2

    def __init__(self):
        self.asked = []

    def encode(self, texts):
        self.asked.extend(texts)
        return np.array([[len(text), ord(text[0])] for text in texts], dtype=np.float32).reshape(-1, 2)


def test_texts_are_embedded_once(tmp_path):
    encoder = CountingEncoder()
    first = embed_texts(encoder, ["walk", "jump", "walk"], tmp_path)
    np.testing.assert_array_equal(first, [[4, ord("w")], [4, ord("j")], [4, ord("w")]])
    again = embed_texts(encoder, ["run", "walk"], tmp_path)
    np.testing.assert_array_equal(again, [[3, ord("r")], [4, ord("w")]])
    assert encoder.asked == ["walk", "jump", "run"]
    assert embed_texts(encoder, [], tmp_path).shape == (0, 2)
    [file] = tmp_path.iterdir()
    assert load_file(file)["embeddings"].shape == (3, 2)


@pytest.mark.parametrize("content", [bytes(20), save({"others": np.zeros(3)})], ids=["zeros", "other arrays"])
def test_a_damaged_cache_is_computed_anew_and_that_is_said(content, tmp_path, recwarn):
    expected = embed_texts(CountingEncoder(), ["walk", "jump"], tmp_path)
    [file] = tmp_path.iterdir()
    whole = file.read_bytes()
    file.write_bytes(content)
    encoder = CountingEncoder()
    np.testing.assert_array_equal(embed_texts(encoder, ["walk", "jump"], tmp_path), expected)
    assert encoder.asked == ["walk", "jump"]
    assert any("anew" in str(each.message) for each in recwarn)
    assert file.read_bytes() == whole


def test_folders_and_hub_names_go_to_the_encoder_for_them(monkeypatch: pytest.MonkeyPatch) -> None:
    encoder = CountingEncoder()
    install_only(monkeypatch, TEXT_ENCODERS={"transformers": lambda name: encoder})
    assert load_text_encoder("./a-folder") is encoder
    install_only(monkeypatch, TEXT_ENCODERS={"lengths": print})
    with pytest.raises(UsageError, match=r"'minilm'.*lengths"):
        load_text_encoder("minilm")
