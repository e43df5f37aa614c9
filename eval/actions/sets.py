"""Motions of actions that a recogniser knows: real ones, and generated ones for their actions and durations."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from eval.actions.recogniser import MIN_FRAMES, ActionRecogniser
from eval.actions.scores import Recognition
from eval.sets.motions import as_known, is_unconditional, refusal
from eval.sets.sets import Missing, RowId, SampleSet, Variant, sample_set
from motionkit.core.errors import MotionkitError, counted
from motionkit.core.shapes import Float32, Int64
from motionkit.core.skeleton import SMPL22
from motionkit.fields.contact.planted import planted
from motionkit.fields.motion_field import MotionField, to_motion
from motionkit.fields.resample import resample
from motionkit.generate.models import GenerationRequest, GenerativeModel
from motionkit.io.smpl_body import SMPL
from motionkit.store.reader import Store


class NoActionsError(MotionkitError):
    """Motions without an action that the recogniser knows."""


@dataclass(frozen=True, eq=False)
class ActionSet:
    """Motions with the indices of their actions, and a message for everything left out."""

    samples: SampleSet
    labels: Int64[np.ndarray, "sequences"]
    left_out: tuple[str, ...] = ()

    def recognised(self, recogniser: ActionRecogniser) -> Recognition:
        """The recogniser's output for these motions."""
        return Recognition(*recogniser.recognise(self.samples), self.labels)

    def at_most(self, limit: int, seed: int) -> "ActionSet":
        """All motions, or a random subset of `limit` in their order, without actions with a single motion in it.

        Raises `NoActionsError` if none remain.
        """
        if self.samples.num_sequences <= limit:
            return self
        chosen = np.sort(np.random.default_rng((seed, 3)).choice(self.samples.num_sequences, limit, replace=False))
        kept = _of_several(self.labels, chosen)
        if not len(kept):
            raise NoActionsError(f"{limit:,} randomly chosen motions have no action in common: increase --motions")
        return ActionSet(self.samples.select(kept), self.labels[kept])


def _of_several(labels: Int64[np.ndarray, "motions"], rows: Int64[np.ndarray, "some"]) -> Int64[np.ndarray, "kept"]:
    """The rows of which another one has the same label."""
    return np.asarray(rows[np.bincount(labels[rows], minlength=1)[labels[rows]] >= 2])


def plain_name(action: str) -> str:
    """An action's normalised name: lower case, words separated by single spaces."""
    return " ".join(action.lower().replace("_", " ").replace("-", " ").split())


def known_actions(samples: SampleSet, actions: Sequence[str]) -> ActionSet:
    """The motions whose action is one of `actions` (compared by `plain_name`), at least two of each.

    Raises `NoActionsError` if none remain.
    """
    label_of = {plain_name(action): label for label, action in enumerate(actions)}
    names = samples.actions or ("",) * samples.num_sequences
    labels = np.array([label_of.get(plain_name(name), -1) for name in names])
    usable = np.flatnonzero((labels >= 0) & (samples.sequences.num_frames >= MIN_FRAMES))
    kept, left_out = _of_several(labels, usable), []
    unknown = Counter(name or "no action" for name, label in zip(names, labels, strict=True) if label < 0)
    if unknown:
        listed = ", ".join(f"{action} ({count})" for action, count in sorted(unknown.items()))
        left_out.append(f"{counted(unknown.total(), 'motion')} of actions that it does not know: {listed}")
    if single := sorted(set(labels[usable].tolist()) - set(labels[kept].tolist())):
        left_out.append(f"actions with a single motion: {', '.join(actions[label] for label in single)}")
    if short := int((labels >= 0).sum()) - len(usable):
        left_out.append(f"{counted(short, 'motion')} of fewer than {counted(MIN_FRAMES, 'frame')}")
    if not len(kept):
        raise NoActionsError(
            f"{samples.name}: no motion has an action that the recogniser knows ({', '.join(actions)}); "
            + "; ".join(left_out)
        )
    return ActionSet(samples.select(kept), labels[kept], tuple(left_out))


def with_rotations(store: Store, samples: SampleSet) -> SampleSet:
    """The same motions with the store's true local rotations, resampled to their framerate if needed.

    Raises `NoActionsError` if a motion has none.
    """
    rotations: list[Float32[np.ndarray, "_frames _joints 4"]] = []
    for index, sequence_id in enumerate(samples.sequence_ids):
        motion = store.read(sequence_id)
        if motion.local_rotations is None or motion.skeleton.joint_names[: SMPL22.num_joints] != SMPL22.joint_names:
            raise NoActionsError(
                f"{sequence_id} has no rotations of SMPL's joints, which this recogniser needs: narrow the "
                'motions (--where "has_rotations") or ingest UESTC or AMASS'
            )
        resampled = motion if motion.fps == samples.fps else resample(motion, samples.fps)
        assert resampled.local_rotations is not None
        frames = np.minimum(np.arange(int(samples.sequences.num_frames[index])), resampled.num_frames - 1)
        has_hands = motion.skeleton.joint_names == SMPL.joint_names
        rotations.append(resampled.local_rotations[frames, : SMPL.num_joints if has_hands else SMPL22.num_joints])
    joints = min(each.shape[1] for each in rotations)
    return replace(samples, local_rotations=np.concatenate([each[:, :joints] for each in rotations]))


def known_to_all(real: ActionSet, models: Mapping[str, GenerativeModel], missing: Missing) -> ActionSet:
    """The motions of the actions that every model knows, at least two of each, so that rows are of the same motions.

    Models that know no action, or no condition at all, do not count. Where that leaves no motion, all of them.
    """
    actions = dict.fromkeys(real.samples.actions)
    unknown: dict[str, list[str]] = {}
    for name, model in models.items():
        if not is_unconditional(model):
            refused = [action for action in actions if refusal(model, GenerationRequest(None, action=action))]
            unknown |= {name: refused} if 0 < len(refused) < len(actions) else {}
    left_out = set(chain.from_iterable(unknown.values()))
    kept = _of_several(real.labels, np.flatnonzero([action not in left_out for action in real.samples.actions]))
    if not left_out or not len(kept):
        return real
    missing.add(*(f"{name} knows no {', '.join(each)}: no model is asked for that" for name, each in unknown.items()))
    return ActionSet(real.samples.select(kept), real.labels[kept])


def generated_like(real: ActionSet, model: GenerativeModel, draw: int, seed: int) -> dict[RowId, ActionSet]:
    """Generate a motion for every real one's action and duration (at most l_max): rows of the model, and of it planted.

    A model without conditions gets the durations alone. Every draw has its own seed. Raises what the model raises.
    """
    durations = (real.samples.sequences.num_frames - 1) / float(real.samples.fps)
    requests = [
        GenerationRequest(min(float(seconds), model.max_duration_seconds), action=action)
        for seconds, action in zip(durations, real.samples.actions, strict=True)
    ]
    fields = model.generate(as_known(model, requests), seed=seed, first=draw * len(requests))
    rows: dict[RowId, Sequence[MotionField]] = {
        RowId(model.name): fields,
        RowId(model.name, Variant.PLANTED): [planted(each, "free") for each in fields],
    }
    sets = {}
    for row, own in rows.items():
        motions = [to_motion(field, real.samples.fps) for field in own]
        positions = [motion.joint_positions for motion in motions]
        samples = sample_set(
            str(row), real.samples.fps, positions, real.samples.sequence_ids, actions=real.samples.actions
        )
        rotations = [motion.local_rotations for motion in motions if motion.local_rotations is not None]
        if len(rotations) == len(motions):
            samples = replace(samples, local_rotations=np.concatenate(rotations))
        sets[row] = ActionSet(samples, real.labels)
    return sets
