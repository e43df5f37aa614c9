"""Motions that a model generates for the captions and durations of a real set, as sample sets at any framerate."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil

import numpy as np

from eval.sets.sets import SampleSet, sample_set
from motionkit.core.errors import UsageError
from motionkit.fields.interpolation import InterpolatedField
from motionkit.fields.motion_field import MotionField, to_motion
from motionkit.generate.models import ChecksRequests, GenerationRequest, GenerativeModel, SamplingOptions

AT_ONCE = 256


@dataclass(frozen=True)
class Window:
    """A stretch of one real sequence for which a motion is generated; `number` counts the sequence's windows from 0.

    `draw` counts generations of the same window, each with a seed of its own.
    """

    sequence_id: str
    number: int
    request: GenerationRequest
    draw: int = 0


def windows_of(real: SampleSet, max_duration_seconds: float) -> list[Window]:
    """Requests with the captions, actions and durations of a real set; the model uses those it was trained with.

    A sequence longer than the model supports becomes several windows of equal length with its caption, so that a
    caption's share of the generated seconds is its share of the real ones.
    """
    windows: list[Window] = []
    for index in range(real.num_sequences):
        duration = float((int(real.sequences.num_frames[index]) - 1) / real.fps)
        count = max(1, ceil(duration / max_duration_seconds - 1e-9))
        text = real.captions[index] if real.captions else ""
        action = real.actions[index] if real.actions else ""
        request = GenerationRequest(duration / count, text, action)
        windows.extend(Window(real.sequence_ids[index], number, request) for number in range(count))
    return windows


def is_unconditional(model: GenerativeModel) -> bool:
    """Whether a model declares by an attribute `unconditional` that it was trained without texts and actions."""
    return bool(getattr(model, "unconditional", False))


def needs_a_condition(model: GenerativeModel) -> bool:
    """Whether a model declares by an attribute `always_conditioned` that it was never trained without one."""
    return bool(getattr(model, "always_conditioned", False))


def refusal(model: GenerativeModel, request: GenerationRequest) -> str:
    """Why a model with a `check` refuses a request; empty if it does not."""
    if isinstance(model, ChecksRequests):
        try:
            model.check(request)
        except UsageError as error:
            return str(error)
    return ""


def as_known(model: GenerativeModel, requests: Sequence[GenerationRequest]) -> list[GenerationRequest]:
    """Requests as a model can take them: one that knows no conditions is asked for durations alone."""
    if is_unconditional(model):
        return [GenerationRequest(request.duration_seconds) for request in requests]
    return list(requests)


def generate_fields(
    model: GenerativeModel,
    windows: Sequence[Window],
    seed: int,
    limit: int,
    sampling: SamplingOptions = SamplingOptions(),
    draws: int = 1,
    on_motions: Callable[[int], None] = lambda count: None,
) -> dict[Window, MotionField]:
    """A motion field per window and draw, or for a random subset of `limit` windows.

    An unconditional model gets the windows' durations alone. `on_motions` is called after each `AT_ONCE` motions.
    """
    chosen = list(windows)
    if len(windows) > limit:
        picked = np.random.default_rng((seed, 7)).choice(len(windows), size=limit, replace=False)
        chosen = [windows[index] for index in np.sort(picked).tolist()]
    requests = as_known(model, [window.request for window in chosen])
    made: dict[Window, MotionField] = {}
    for draw in range(draws):
        for first in range(0, len(requests), AT_ONCE):
            some = slice(first, first + AT_ONCE)
            fields = model.generate(requests[some], seed=seed + draw, sampling=sampling, first=first)
            made |= zip((replace(window, draw=draw) for window in chosen[some]), fields, strict=True)
            on_motions(len(fields))
    return made


def is_framed(fields: Mapping[Window, MotionField]) -> bool:
    """Whether a model generates frames at its own framerate, with interpolation in between."""
    return all(isinstance(field, InterpolatedField) for field in fields.values())


def sample_fields(
    fields: Mapping[Window, MotionField], sequence_ids: Sequence[str], fps: Fraction, name: str
) -> SampleSet | None:
    """Fields of the given sequences' windows, sampled at exactly fps; None where there are none.

    Nothing is resampled: the field is asked for every instant. The take of a motion is the sequence it was made for.
    """
    wanted = set(sequence_ids)
    chosen = [(window, field) for window, field in fields.items() if window.sequence_id in wanted]
    if not chosen:
        return None
    windows = [window for window, _ in chosen]
    made = sample_set(
        name,
        fps,
        [to_motion(field, fps).joint_positions for _, field in chosen],
        [f"{window.sequence_id}#{window.number}" + (f"@{window.draw}" if window.draw else "") for window in windows],
        [window.request.text for window in windows],
        [window.request.action for window in windows],
    )
    draws = tuple(window.draw for window in windows)
    takes = tuple(window.sequence_id for window in windows)
    return replace(made, takes=takes, generations=draws if any(draws) else ())
