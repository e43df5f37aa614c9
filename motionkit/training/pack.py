"""A trained run for generation alone: a run folder a fraction as large, which can be shared or shipped in a package.

Weight matrices become float16, which `load_tensors` reads as float32. What training needs is left out: checkpoints and
logs, stages that others build on, and what a stage's `packed` drops from its model, such as training latents.
"""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch

from motionkit.core import plugins
from motionkit.core.files import require_new, sha256_of, write_json
from motionkit.training.loop import load_tensors, save_tensors
from motionkit.training.run import RunFolder


def pack_run(run: RunFolder, out: Path, stages: Iterable[str], *, overwrite: bool = False) -> list[Path]:
    """Write complete stages of a run into the run folder `out`, for generation alone; returns the files.

    Other files of `out`, such as a README.md, stay. Its config.json names neither the store's place nor the platform.
    Raises `UsageError` if `out` holds one of the stages, unless `overwrite`; `RunError` if one of the run is not
    complete, `DamagedFileError`.
    """
    files: list[Path] = []
    packed: dict[str, str] = {}  # by the sha256 of each model, the packed one's: later stages name what they build on
    for name in stages:
        stage, own = run.stage(name), RunFolder(out).stage(name)
        require_new(own.path, overwrite=overwrite, replaced=Path.is_dir, instead="another folder keeps both")
        stage.check()
        tensors, description = load_tensors(stage.model_path)
        kept = plugins.load("STAGES", name).packed(tensors)
        # Vectors, such as scales in metres, and other types stay as they are.
        kept = {each: t.half() if t.dtype == torch.float32 and t.ndim > 1 else t for each, t in kept.items()}
        own.path.mkdir(parents=True, exist_ok=True)
        save_tensors(own.model_path, kept, _with_names(description, packed))
        packed[sha256_of(stage.model_path)] = sha256_of(own.model_path)
        config = stage.read_config()
        versions = {each: version for each, version in config["versions"].items() if each != "platform"}
        write_json(own.config_path, _with_names({**config, "store": "", "versions": versions}, packed))
        own.finish(stage.read_summary())
        files += [path for path in own.result_paths if path.is_file()]
    return files


def _with_names(values: Mapping[str, Any], packed: Mapping[str, str]) -> dict[str, Any]:
    """The same values, with the sha256 of packed models in place of those that they were packed from."""
    text = json.dumps(dict(values))
    for before, after in packed.items():
        text = text.replace(before, after)
    renamed: dict[str, Any] = json.loads(text)
    return renamed
