"""Which windows of a corpus a field is trained on, and what a person should be told about them."""

import numpy as np
from jaxtyping import Float64

from motionkit.clips.windows import PositionSource, Windows, cut_windows
from motionkit.errors import UsageError
from motionkit.skeleton import SMPL22
from nerm.settings.field import FieldConfig


def training_windows(source: PositionSource, config: FieldConfig) -> Windows:
    """The windows that have a latent each; with `fixed_fps` slower ones are left out, as fixed-framerate models do.

    Raises `UsageError` where none is left.
    """
    windows = cut_windows(
        source,
        max_duration_seconds=config.max_duration_seconds,
        stride_seconds=config.stride_seconds,
        min_duration_seconds=config.min_duration_seconds,
        mirror_pairs=SMPL22.left_right_pairs if config.mirrored else None,
    )
    if config.fixed_framerate is None:
        return windows
    fast = windows.fps >= float(config.fixed_framerate) - 1e-6
    if not fast.any():
        raise UsageError(
            f"no training sequence has {float(config.fixed_framerate):g} fps (field.fixed_fps); the fastest has "
            f"{windows.fps.max():g}"
        )
    return windows.select(fast)


def remarks(source: PositionSource, windows: Windows, config: FieldConfig) -> list[str]:
    """What limits a training on these windows, a sentence each; empty where nothing does."""
    found = []
    fps = source.fps_numerator / source.fps_denominator
    if config.fixed_framerate is not None:
        slow = int((fps < float(config.fixed_framerate) - 1e-6).sum())
        if slow:
            found.append(f"{slow} of {len(fps)} sequences are slower than field.fixed_fps and are left out")
    elif len(np.unique(windows.fps)) == 1:
        found.append(
            f"every training sequence has {windows.fps[0]:g} fps: the field cannot learn what other framerates hold"
        )
    if config.fixed_framerate is None:
        found += _rate_remarks(windows, config)
    short = windows.duration_seconds * _slowest_rate(windows, config) + 1 < config.num_poses - 1e-6
    if config.contiguous and short.any():
        found.append(
            f"{int(short.sum())} of {len(windows)} windows are shorter than a clip of field.num_poses="
            f"{config.num_poses} poses; their last pose is repeated"
        )
    return found


def _rate_remarks(windows: Windows, config: FieldConfig) -> list[str]:
    """What is said of framerates that the windows do not have."""
    found = []
    slower = int((windows.fps < config.warmup_fps - 1e-6).sum())
    if config.warmup_fraction > 0 and slower:
        found.append(
            f"{slower} of {len(windows)} windows are slower than field.warmup_fps={config.warmup_fps}: during the "
            "warm-up their poses are interpolated between their own"
        )
    if config.lowest_fps is not None and config.lowest_fps > windows.fps.max() + 1e-6:
        found.append(
            f"field.lowest_fps={config.lowest_fps:g} has no effect: the fastest training sequence has "
            f"{windows.fps.max():g} fps, and each is drawn at its own"
        )
    return found


def _slowest_rate(windows: Windows, config: FieldConfig) -> Float64[np.ndarray, "windows"]:
    """The lowest framerate at which clips of each window are drawn."""
    if config.fixed_framerate is not None:
        return np.full(len(windows), float(config.fixed_framerate))
    slowest = config.warmup_fps if config.warmup_fraction > 0 else np.inf
    return np.asarray(np.minimum(windows.fps, slowest))
