"""Runs of before settings were nested: their settings are read under today's names, they load and are resumed.

flat_settings.json holds what versions before wrote into config.json: every recipe of every stage, and `tiny` those of
tests/helpers/tiny.py.
"""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch

from motionkit.core.checksums import write_json
from motionkit.core.errors import UsageError
from motionkit.training.config import apply_overrides, flatten, from_plain, moved_names
from motionkit.training.run import RunError, RunFolder
from motionkit.training.stage import recorded_settings, registered_stages
from motionkit.training.tensors import load_tensors, save_tensors
from nerm.denoiser.trained import load_denoiser
from nerm.field.trained import load_field
from nerm.recipes import nano
from tests.helpers.tiny import NERM, STAGES, train_stage, write_store

FLAT: dict[str, dict[str, Any]] = json.loads(Path(__file__).with_name("flat_settings.json").read_text())
STAGE_OF = {"nerm": "field"}
# What recipes have changed since, as it was then.
SAMPLING = ["denoiser.diffusion.sampling_steps=50", "denoiser.diffusion.guidance_scale=1.5"]
SINCE = {
    ("nerm", "paper"): ["field.pose_vectors=field", "denoiser.ema_decay=0.9999"],
    ("nerm", "nano"): [
        *SAMPLING,
        "field.contacts.steps=0",
        "denoiser.schedule.steps=2500",
        "denoiser.conditions.paraphrases=0",
        "denoiser.precision=float32",
    ],
    ("nerm", "demo"): [*SAMPLING, "denoiser.precision=float32"],
    ("nerm", "base"): [*SAMPLING, "field.contacts.steps=0", "denoiser.conditions.paraphrases=0"],
}


@pytest.mark.parametrize("model", FLAT)
def test_recipes_are_those_that_were_written_flat(model: str) -> None:
    stage = registered_stages()[STAGE_OF.get(model, model)]
    written = {name: plain for name, plain in FLAT[model].items() if name != "tiny"}
    assert set(written) <= set(stage.recipes)
    for name, plain in written.items():
        recipe = apply_overrides(stage.recipe(name), SINCE.get((model, name), []))
        assert from_plain(type(recipe), plain) == recipe, name


def test_no_setting_has_the_old_name_of_another() -> None:
    for stage in registered_stages().values():
        for make in stage.recipes.values():
            assert not moved_names(make()).keys() & flatten(make()).keys()


def test_an_old_name_is_answered_with_the_new_one() -> None:
    with pytest.raises(UsageError, match=r"no setting is called 'field\.hidden', it is field\.decoder\.width now"):
        apply_overrides(nano(), ["field.hidden=64"])


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """A store, a run of today and the same run as versions before wrote it."""
    folder = tmp_path_factory.mktemp("flat")
    store, run, old = write_store(folder / "store"), folder / "run", folder / "old"
    for name in ("codebook", "field", "denoiser"):
        train_stage(name, store, run)
    shutil.copytree(run, old)
    for name in ("codebook", "field", "denoiser"):
        stage = RunFolder(old).stage(name)
        write_json(stage.config_path, stage.read_config() | {"config": FLAT["nerm"]["tiny"]})
        tensors, description = load_tensors(stage.model_path)
        if "config" in description:
            save_tensors(stage.model_path, tensors, description | {"config": FLAT["nerm"]["tiny"][name]})
    return store, run, old


def test_an_old_run_loads_as_it_was_trained(runs: tuple[Path, Path, Path]) -> None:
    _, run, old = runs
    field, same = load_field(old), load_field(run)
    assert field.config == same.config == NERM.field
    latents = same.posterior_mean[:2]
    times = torch.linspace(0, 2, 9).double().numpy()
    assert (
        field.decode(latents, times, field.max_training_fps) == same.decode(latents, times, same.max_training_fps)
    ).all()
    assert load_denoiser(RunFolder(old)).config == load_denoiser(RunFolder(run)).config == NERM.denoiser
    recorded = [from_plain(type(NERM), recorded_settings(RunFolder(each), "field")) for each in (old, run)]
    assert recorded == [NERM, NERM]


@pytest.mark.parametrize("name", ["codebook", "field", "denoiser"])
def test_an_old_run_is_resumed_with_the_same_settings_alone(
    name: str, runs: tuple[Path, Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, run, old = runs
    shutil.copytree(old, tmp_path / "old")
    stage = RunFolder(tmp_path / "old").stage(name)
    stage.summary_path.unlink()
    if name == "denoiser":  # it says upon which file of the field it was begun
        shutil.copy(run / "field" / "model.safetensors", tmp_path / "old" / "field" / "model.safetensors")
    train_stage(name, store, tmp_path / "old", resume=True)
    assert stage.model_path.read_bytes() == (run / name / "model.safetensors").read_bytes()
    other = apply_overrides(NERM, [f"{name}.schedule.learning_rate=0.5"])
    monkeypatch.setitem(STAGES, name, (STAGES[name][0], other))
    was = flatten(NERM)[f"{name}.schedule.learning_rate"]
    with pytest.raises(RunError, match=rf"other settings \({name}\.schedule\.learning_rate {was} → 0\.5\)"):
        train_stage(name, store, tmp_path / "old", resume=True)
