"""T2M-GPT's VQ-VAE from a file in its published layout, beside a plain computation from the published names."""

import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch

import nerm.stages.codebook
from motionkit.fields.motion_field import to_motion
from motionkit.store.writer import StoreWriter
from motionkit.training.config import apply_overrides
from motionkit.training.run import RunFolder
from motionkit.training.stage import StageContext
from motionkit.training.tensors import CheckpointError, load_tensors
from nerm.codebook.network import CodebookNetwork, load_codes
from nerm.codebook.published import PUBLISHED, load_published
from nerm.recipes import nano
from nerm.settings import CodebookNetworkConfig
from nerm.stages.codebook import train_codebook
from tests.helpers.analytic import analytic_motion

SMALL = CodebookNetworkConfig(width=10, code_dimension=8, num_codes=24)


def convolution(out: int, channels: int, size: int, rng: np.random.Generator) -> dict[str, torch.Tensor]:
    weight = rng.normal(0, (channels * size) ** -0.5, (out, channels, size))
    return {"weight": torch.tensor(weight).float(), "bias": torch.tensor(rng.normal(0, 0.1, out)).float()}


def published_state(config: CodebookNetworkConfig, numbers: int = 263) -> dict[str, torch.Tensor]:
    """A state dict with the names and shapes of models/vqvae.py (HumanVQVAE), down_t 2, depth 3, no norm."""
    rng, width = np.random.default_rng(0), config.width
    layers = {"encoder.model.0": (width, numbers, 3), "encoder.model.4": (config.code_dimension, width, 3)}
    layers |= {"decoder.model.0": (width, config.code_dimension, 3), "decoder.model.4": (width, width, 3)}
    layers["decoder.model.6"] = (numbers, width, 3)
    for block in (2, 3):
        layers[f"encoder.model.{block}.0"] = (width, width, 4)
        layers[f"decoder.model.{block}.2"] = (width, width, 3)
        for depth in range(3):
            for stack in (f"encoder.model.{block}.1", f"decoder.model.{block}.0"):
                layers[f"{stack}.model.{depth}.conv1"] = (width, width, 3)
                layers[f"{stack}.model.{depth}.conv2"] = (width, width, 1)
    state = {
        f"vqvae.{name}.{part}": tensor
        for name, shape in layers.items()
        for part, tensor in convolution(*shape, rng).items()
    }
    codes = torch.tensor(rng.normal(0, 0.3, (config.num_codes, config.code_dimension))).float()
    return {**state, "vqvae.quantizer.codebook": codes}


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    torch.save({"net": published_state(SMALL)}, tmp_path / "net_last.pth")
    return tmp_path / "net_last.pth"


def plain_convolution(
    x: np.ndarray, state: dict[str, torch.Tensor], name: str, *, stride: int = 1, padding: int = 1, dilation: int = 1
) -> np.ndarray:
    """y[o, t] = b[o] + Σ_{c, k} w[o, c, k] · x[c, stride · t + dilation · k − padding], in float64."""
    weight, bias = (state[f"vqvae.{name}.{part}"].double().numpy() for part in ("weight", "bias"))
    padded = np.pad(x, ((0, 0), (padding, padding)))
    frames = (padded.shape[1] - dilation * (weight.shape[2] - 1) - 1) // stride + 1
    taps = [padded[:, dilation * k : dilation * k + stride * (frames - 1) + 1 : stride] for k in range(weight.shape[2])]
    return bias[:, None] + np.einsum("ock,kct->ot", weight, np.stack(taps))


def plain_stack(x: np.ndarray, state: dict[str, torch.Tensor], name: str) -> np.ndarray:
    """Resnet1D with reversed dilations: 9, 3, 1."""
    for depth, dilation in enumerate((9, 3, 1)):
        inner = plain_convolution(
            np.maximum(x, 0), state, f"{name}.model.{depth}.conv1", padding=dilation, dilation=dilation
        )
        x = x + plain_convolution(np.maximum(inner, 0), state, f"{name}.model.{depth}.conv2", padding=0)
    return x


def plain_encode(vectors: np.ndarray, state: dict[str, torch.Tensor]) -> np.ndarray:
    x = np.maximum(plain_convolution(vectors.T, state, "encoder.model.0"), 0)
    for block in (2, 3):
        x = plain_convolution(x, state, f"encoder.model.{block}.0", stride=2)
        x = plain_stack(x, state, f"encoder.model.{block}.1")
    return plain_convolution(x, state, "encoder.model.4")


def plain_decode(features: np.ndarray, state: dict[str, torch.Tensor]) -> np.ndarray:
    x = np.maximum(plain_convolution(features, state, "decoder.model.0"), 0)
    for block in (2, 3):
        x = np.repeat(plain_stack(x, state, f"decoder.model.{block}.0"), 2, axis=1)
        x = plain_convolution(x, state, f"decoder.model.{block}.2")
    x = np.maximum(plain_convolution(x, state, "decoder.model.4"), 0)
    return plain_convolution(x, state, "decoder.model.6").T


def test_it_encodes_and_decodes_as_its_names_say(checkpoint: Path) -> None:
    state, published = published_state(SMALL), load_published(checkpoint, config=SMALL)
    vectors = np.random.default_rng(1).normal(size=(32, 263))
    read = torch.from_numpy(vectors).float()[None]
    expected = plain_encode(vectors, state)
    features = published.network.encode(read)
    np.testing.assert_allclose(features[0].numpy(), expected, atol=1e-5)
    codes = state["vqvae.quantizer.codebook"].double().numpy()
    nearest = np.square(expected.T[:, None] - codes).sum(-1).argmin(1)
    quantised = published.network.quantiser(features)
    np.testing.assert_array_equal(quantised.which[0].numpy(), nearest)
    decoded = published.network.decode(quantised.values)
    np.testing.assert_allclose(decoded[0].numpy(), plain_decode(codes[nearest].T, state), atol=1e-5)


def test_the_published_sizes_are_the_paper_s() -> None:
    names = published_state(replace(PUBLISHED, width=1, code_dimension=1, num_codes=1)).keys()
    with torch.device("meta"):
        network = CodebookNetwork(PUBLISHED, 263)
    sizes = [parameter.numel() for parameter in network.parameters()]
    assert len(sizes) + 1 == len(names)
    assert sum(sizes) == sum(
        out * (channels * size + 1)
        for out, channels, size in [
            *[(512, 263, 3), (512, 512, 3), (512, 512, 3), (512, 512, 3), (263, 512, 3)],
            *2 * [(512, 512, 4), (512, 512, 3), *2 * 3 * [(512, 512, 3), (512, 512, 1)]],
        ]
    )


def broken(change: Callable[[dict[str, torch.Tensor]], object]) -> dict[str, torch.Tensor]:
    state = published_state(SMALL)
    change(state)
    return state


FIRST, LAST = "vqvae.encoder.model.0.weight", "vqvae.decoder.model.6.bias"
FAULTS = {
    "another input": (lambda s: s.update({FIRST: torch.zeros(10, 66, 3)}), r"is \(10, 66, 3\); T2M-GPT's"),
    "no input": (lambda s: s.pop(FIRST), "is missing; T2M-GPT's VQ-VAE begins with"),
    "a lost tensor": (lambda s: s.pop(LAST), rf"of 67 tensors: it lacks net/{LAST}"),
    "a norm": (lambda s: s.update({"vqvae.encoder.model.9.weight": torch.zeros(3)}), "has net/.*9.weight besides"),
    "a shape": (lambda s: s.update({LAST: torch.zeros(5)}), rf"net/{LAST} is \(5,\), expected \(263,\)"),
    "not finite": (lambda s: s[LAST].fill_(torch.nan), rf"net/{LAST} holds numbers that are not finite"),
    "never trained": (lambda s: s["vqvae.quantizer.codebook"].zero_(), "was never trained"),
    "copies": (
        lambda s: s["vqvae.quantizer.codebook"].copy_(torch.arange(24)[:, None].expand(24, 8) % 2),
        "only 2 of 24 codes differ",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_is_not_that_checkpoint_is_refused(tmp_path: Path, name: str) -> None:
    change, message = FAULTS[name]
    torch.save({"net": broken(change)}, tmp_path / "net_last.pth")
    with pytest.raises(CheckpointError, match=message):
        load_published(tmp_path / "net_last.pth", config=SMALL)


class Program:
    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (Path("executed"),))


def test_a_file_that_would_run_something_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    torch.save({"net": Program()}, tmp_path / "net_last.pth")
    with pytest.raises(CheckpointError, match="without running its pickle"):
        load_published(tmp_path / "net_last.pth", config=SMALL)
    assert not (tmp_path / "executed").exists()


def test_other_files_are_explained(tmp_path: Path, checkpoint: Path) -> None:
    with pytest.raises(CheckpointError, match="there is no such file"):
        load_published(tmp_path / "absent.pth")
    (tmp_path / "cut.pth").write_bytes(checkpoint.read_bytes()[:5000])
    with pytest.raises(CheckpointError, match="without running its pickle"):
        load_published(tmp_path / "cut.pth")
    torch.save({"trans": {}}, tmp_path / "gpt.pth")
    with pytest.raises(CheckpointError, match="under the key 'net'"):
        load_published(tmp_path / "gpt.pth")
    with pytest.raises(CheckpointError, match=r"is \(10, 263, 3\), expected \(512, 263, 3\)"):
        load_published(checkpoint)


def write_statistics(folder: Path, weight: float) -> Path:
    """Files of the published sizes: root and joint speeds vary alike, root and contacts weighted as asked."""
    std = np.full(263, 0.1)
    std[0], std[1:3], std[3], std[193:259], std[259:] = 0.013, 0.017, 0.15, 0.02, 0.35
    std[[*range(4), *range(259, 263)]] /= weight
    folder.mkdir()
    np.save(folder / "mean.npy", np.linspace(0, 1, 263))
    np.save(folder / "std.npy", std)
    return folder


def test_statistics_are_the_evaluator_s(tmp_path: Path, checkpoint: Path) -> None:
    weighted = write_statistics(tmp_path / "meta", 25.0)
    published = load_published(checkpoint, weighted, config=SMALL)
    assert published.statistics is not None
    np.testing.assert_array_equal(published.statistics.std, np.load(weighted / "std.npy"))
    with pytest.raises(CheckpointError, match=r"plain.*these are published statistics"):
        load_published(checkpoint, write_statistics(tmp_path / "plain", 1.0), config=SMALL)
    with pytest.raises(CheckpointError, match=r"mean\.npy: .*No such file"):
        load_published(checkpoint, tmp_path / "nowhere", config=SMALL)
    np.save(weighted / "std.npy", np.ones(251))
    with pytest.raises(CheckpointError, match=r"std\.npy: array of shape \(251,\), expected \(263\)"):
        load_published(checkpoint, weighted, config=SMALL)


def test_the_real_statistics_pass(tmp_path: Path, checkpoint: Path, captures: Path) -> None:
    for name in ("mean", "std"):
        data = np.load(captures / "evaluator-statistics" / f"t2m_{name}.npy")
        np.save(tmp_path / f"{name}.npy", data)
    assert load_published(checkpoint, tmp_path, config=SMALL).statistics is not None


def test_the_stage_takes_it_in_place_of_training(
    tmp_path: Path, checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    performance = analytic_motion("walk", 2.0)
    with StoreWriter.create(tmp_path / "store") as writer:
        writer.add(replace(to_motion(performance, Fraction(20)), sequence_id="m", split="train"))
    loads = load_published
    monkeypatch.setattr(nerm.stages.codebook, "load_published", lambda *places: loads(*places, config=SMALL))
    statistics = write_statistics(tmp_path / "meta", 25.0)
    codebook = apply_overrides(
        nano().codebook, [f"published.weights={checkpoint!s}", f"published.statistics={statistics!s}"]
    )
    refused = replace(nano(), codebook=apply_overrides(codebook, [f"published.weights={tmp_path / 'absent.pth'!s}"]))
    context = StageContext(store=tmp_path / "store", run=RunFolder(tmp_path / "run"), recipe="nano")
    with pytest.raises(CheckpointError, match="no such file"):
        train_codebook(context, refused)
    assert not (tmp_path / "run").exists()
    train_codebook(context, replace(nano(), codebook=codebook))
    torch.testing.assert_close(load_codes(tmp_path / "run"), published_state(SMALL)["vqvae.quantizer.codebook"])
    tensors, description = load_tensors(tmp_path / "run" / "codebook" / "model.safetensors")
    assert (description["convention"], description["statistics"]) == ("T2M-GPT", "evaluator")
    np.testing.assert_allclose(tensors["scale"].numpy(), np.load(statistics / "std.npy"), rtol=1e-6)
    summary = json.loads((tmp_path / "run" / "codebook" / "summary.json").read_text())
    assert (summary["codes"], summary["numbers"]) == (24, 263)
