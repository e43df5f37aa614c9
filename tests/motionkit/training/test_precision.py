from dataclasses import dataclass, replace
from functools import partial

import pytest
import torch

from motionkit.core.errors import UsageError
from motionkit.training import precision as precision_module
from motionkit.training.config import Precision
from motionkit.training.precision import autocast, compile_each, float32_products, has_bfloat16, with_precision_of

CPU = torch.device("cpu")


@dataclass(frozen=True)
class Settings:
    precision: Precision = "auto"
    steps: int = 3


@pytest.mark.parametrize(("found", "chosen"), [(True, "bfloat16"), (False, "float32")])
def test_auto_is_bfloat16_only_where_the_processor_has_it(
    found: bool, chosen: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(precision_module, "has_bfloat16", lambda device: found)
    settings = with_precision_of(Settings(), CPU)
    assert settings == Settings(chosen)  # type: ignore[arg-type]
    assert with_precision_of(Settings("float32"), CPU).precision == "float32"
    with autocast("auto", CPU):
        assert (torch.ones(2, 2) @ torch.ones(2, 2)).dtype == getattr(torch, chosen)


@pytest.mark.parametrize(
    ("capabilities", "found"),
    [
        ({"avx512_bf16": True, "amx_bf16": False}, True),
        ({"avx512_bf16": False, "num_logical_cores": 2, "cpu_name": "bf16"}, False),
        ({}, False),
    ],
)
def test_processors_are_distinguished_by_what_torch_says(
    capabilities: dict[str, object], found: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: capabilities, raising=False)
    assert has_bfloat16.__wrapped__(CPU) is found


def test_tf32_needs_a_gpu() -> None:
    with pytest.raises(UsageError, match=r"cpu has no TF32 .*: precision=auto, or float32"):
        with_precision_of(replace(Settings(), precision="tf32"), CPU)


def test_the_process_gets_its_float32_products_back() -> None:
    before = torch.get_float32_matmul_precision()
    with float32_products("tf32"):
        assert torch.get_float32_matmul_precision() == "high"
        with float32_products("bfloat16"):
            assert torch.get_float32_matmul_precision() == "highest"
    assert torch.get_float32_matmul_precision() == before


def test_compiled_layers_keep_their_names_and_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "compile", partial(torch.compile, backend="eager"))
    layers = torch.nn.ModuleList(torch.nn.Linear(3, 3) for _ in range(2))
    inputs, names = torch.randn(4, 3), list(layers.state_dict())
    expected = layers[1](layers[0](inputs))
    compile_each(layers)
    torch.testing.assert_close(layers[1](layers[0](inputs)), expected)
    assert list(layers.state_dict()) == names
