"""Embeddings of texts, computed once and kept in a file."""

import numpy as np
import pytest
from safetensors.numpy import load_file

from motionkit.errors import MotionkitError
from motionkit.training.text_embeddings import embed_texts


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


def test_a_damaged_cache_is_explained(tmp_path):
    embed_texts(CountingEncoder(), ["walk"], tmp_path)
    [file] = tmp_path.iterdir()
    file.write_bytes(b"\x00" * 20)
    with pytest.raises(MotionkitError, match="delete it"):
        embed_texts(CountingEncoder(), ["walk"], tmp_path)
