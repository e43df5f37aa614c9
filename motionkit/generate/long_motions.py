"""Motions longer than a model's limit, and several requests in one motion: generated in pieces, then joined.

A model generates at most l_max seconds at once. A longer motion consists of several pieces of equal length. A model
that supports pose constraints generates them in sequence, each constrained to the end of the previous one, so that
strides stay in phase; the remaining gap of about a centimetre is cross-faded. For other models pieces are generated
independently, and `motionkit.fields.assembly.chain` aligns and cross-fades them.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import accumulate, groupby, pairwise

import numpy as np

from motionkit.core.errors import UsageError
from motionkit.core.motion import Caption
from motionkit.core.skeleton import SMPL22
from motionkit.fields.assembly import Piece, assemble, chain
from motionkit.fields.motion_field import MotionField
from motionkit.generate.constraints import JOINT_INSTANTS_PER_SECOND, Constraint
from motionkit.generate.models import (
    ChecksRequests,
    FollowsConstraints,
    GenerationRequest,
    GenerativeModel,
    SamplingOptions,
    check_constraints,
)

OVERLAP_SECONDS = 0.5
# Motions whose latents are sampled in one batch; their poses are decoded one by one.
MOTIONS_AT_ONCE = 64
# Poses of a whole motion are in memory at once: an hour at 120 fps is 114 MB of positions.
LONGEST_SECONDS = 3600.0
# Standard deviation, in metres, of a motion's start from the end of the previous one.
END_DEVIATION = 0.01

# A motion as a sequence of requests. Each has a duration, except a single one.
Script = tuple[GenerationRequest, ...]


def is_joined(script: Script, longest_seconds: float) -> bool:
    """Whether a script needs more than one generated motion."""
    return len(script) > 1 or (script[0].duration_seconds or 0.0) > longest_seconds + 1e-9


def pieces_of(script: Script, longest_seconds: float) -> list[GenerationRequest]:
    """The pieces of a script, none longer than `longest_seconds`.

    With overlaps of 0.5 s they last exactly as long as the script, and requests change at their own second,
    in the middle of an overlap. The pieces of a request have equal length. Raises `UsageError` for a request without a
    duration or no longer than the overlap, and for a model of motions shorter than two overlaps.
    """
    if longest_seconds < 2 * OVERLAP_SECONDS:
        raise UsageError(f"motions of up to {longest_seconds:g} s are too short to overlap by {OVERLAP_SECONDS:g} s")
    pieces: list[GenerationRequest] = []
    for number, request in enumerate(script):
        seconds = request.duration_seconds
        if seconds is None or not OVERLAP_SECONDS < seconds < float("inf"):
            lasting = "has no length" if seconds is None else f"lasts {seconds:g} s"
            raise UsageError(
                f"part {number + 1} of {len(script)} of a joined motion {lasting}: each lasts longer than the "
                f"{OVERLAP_SECONDS:g} s by which they overlap"
            )
        inner_ends = (number > 0) + (number < len(script) - 1)
        span = seconds + inner_ends * OVERLAP_SECONDS / 2
        count = max(1, int(np.ceil((span - OVERLAP_SECONDS) / (longest_seconds - OVERLAP_SECONDS) - 1e-9)))
        pieces += [
            replace(request, constraints=(), duration_seconds=(span + (count - 1) * OVERLAP_SECONDS) / count)
        ] * count
    return pieces


def generate_joined(
    model: GenerativeModel, script: Script, *, seed: int, number: int = 0, sampling: SamplingOptions = SamplingOptions()
) -> MotionField:
    """The motion of a script, number `number` of its seed.

    Alignment depends on the pieces alone, not on the framerate at which they are sampled afterwards. Raises what
    `pieces_of` and the model raise.
    """
    requests = pieces_of(script, model.max_duration_seconds)
    own_seed = int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1, np.uint64)[0] >> np.uint64(1))
    if not supports_continuation(model):
        return chain(model.generate(requests, seed=own_seed, sampling=sampling), OVERLAP_SECONDS)
    constraints, pieces, start = constraints_of(script), list[Piece](), 0.0
    for piece, request in enumerate(requests):
        own = [each.between(start, start + (request.duration_seconds or 0.0)) for each in constraints]
        if pieces:
            own.append(_end_of(pieces[-1]))
        constrained = replace(request, constraints=tuple(each for each in own if each is not None))
        [field] = model.generate([constrained], seed=own_seed, sampling=sampling, first=piece)
        pieces.append(Piece(field, start))
        start = pieces[-1].end_seconds - OVERLAP_SECONDS
    return assemble(pieces)


def supports_continuation(model: GenerativeModel) -> bool:
    """Whether a model supports continuing from another motion's end."""
    return isinstance(model, FollowsConstraints) and "pose" in model.constraint_kinds


def _end_of(piece: Piece) -> Constraint:
    """A constraint to begin with the last seconds of a motion in the 22-joint layout."""
    since = np.linspace(0.0, OVERLAP_SECONDS, 1 + int(np.ceil(OVERLAP_SECONDS * JOINT_INSTANTS_PER_SECOND)))
    times = np.clip(piece.end_seconds - OVERLAP_SECONDS + since, piece.start_seconds, piece.end_seconds)
    joints = piece.query(times).joint_positions[:, : SMPL22.num_joints].astype(np.float64)
    faces = np.full(len(since), np.nan)
    return Constraint(
        "pose", "the motion before", since, SMPL22.joint_names, joints, faces, "world", deviation=END_DEVIATION
    )


def check_script(model: GenerativeModel, script: Script, sampling: SamplingOptions) -> None:
    """Raise `UsageError` for a script that the model does not support, or of more than an hour."""
    pieces, whole = list(script), script[0]
    if is_joined(script, model.max_duration_seconds):
        seconds = sum(request.duration_seconds or 0.0 for request in script)
        if seconds > LONGEST_SECONDS:
            raise UsageError(f"{seconds:g} s: a motion lasts up to {LONGEST_SECONDS:g} s; ask for several")
        pieces = pieces_of(script, model.max_duration_seconds)
        whole = GenerationRequest(seconds, constraints=constraints_of(script))
    check_constraints(model, whole)
    if len(pieces) > 1 and whole.constraints and not supports_continuation(model):
        raise UsageError(
            f"the model {model.name!r} supports no poses: motions joined from several cannot be constrained"
        )
    if isinstance(model, ChecksRequests):
        for piece in dict.fromkeys(pieces):
            model.check(piece, sampling)


def generate_scripts(
    model: GenerativeModel,
    scripts: Sequence[Script],
    *,
    seed: int,
    skip: Collection[int] = (),
    sampling: SamplingOptions = SamplingOptions(),
) -> Iterator[tuple[int, MotionField]]:
    """The motions of scripts with their numbers, in order, but not those to `skip`; script i is number i of the seed.

    Neighbours of a single piece are sampled in one batch. Batches are the same whatever is skipped, so a resumed call
    gives the same motions. Raises what `pieces_of` and the model raise.
    """
    for start in range(0, len(scripts), MOTIONS_AT_ONCE):
        batch = enumerate(scripts[start : start + MOTIONS_AT_ONCE], start=start)
        for joined, group in groupby(batch, lambda each: is_joined(each[1], model.max_duration_seconds)):
            numbered = dict(group)
            missing = [number for number in numbered if number not in skip]
            if joined:
                for number in missing:
                    yield number, generate_joined(model, numbered[number], seed=seed, number=number, sampling=sampling)
            elif missing:
                requests, first = [request for (request,) in numbered.values()], min(numbered)
                fields = model.generate(requests, seed=seed, sampling=sampling, first=first)
                yield from ((number, fields[number - first]) for number in missing)


def constraints_of(script: Script) -> tuple[Constraint, ...]:
    """The constraints of a script, in the whole motion's time."""
    starts = accumulate((request.duration_seconds or 0.0 for request in script), initial=0.0)
    return tuple(
        each.later(start) for request, start in zip(script, starts, strict=False) for each in request.constraints
    )


def captions_of(script: Script) -> tuple[Caption, ...]:
    """The texts of a script as captions with their seconds; a single one is of the whole motion."""
    if len(script) == 1:
        return (Caption(script[0].text),) if script[0].text else ()
    bounds = pairwise(accumulate((request.duration_seconds or 0.0 for request in script), initial=0.0))
    return tuple(
        Caption(request.text, start, end) for request, (start, end) in zip(script, bounds, strict=True) if request.text
    )
