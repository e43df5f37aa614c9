"""A generative model behind the Motion Model Context Protocol (MMCP 1.4), by the package `motionmcp-sdk`.

A request's segments are a script: texts, or stretches without one. Its frames are at k / fps, and the motion is sampled
at that framerate. Constraints map to ours: `root_path` to a path, `pose_keyframe` to a pose, `effector_target` to
joints. The skeleton is the 22-joint layout with bones of the model; a motion's own are translations of its joints.
"""

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from motionmcp import Backbone, GenerateRequest, ModelSpec, MotionResult
from motionmcp.errors import ProtocolError
from motionmcp.schemas import Options

from motionkit.core import kinematics
from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float64
from motionkit.core.skeleton import SMPL22
from motionkit.core.timegrid import parse_fps
from motionkit.generate.constraints import PATH_DEVIATION, ROOT, Constraint, ConstraintKind
from motionkit.generate.long_motions import Script, check_script, generate_scripts
from motionkit.generate.models import FollowsConstraints, GenerationRequest, SamplingOptions
from motionkit.generate.motion import MotionModel
from motionkit.generate.output import motion_name, plant_generated, sample_motion
from motionkit.io.joint_rotations import joint_channels

KINDS: dict[ConstraintKind, str] = {"path": "root_path", "pose": "pose_keyframe", "joint": "effector_target"}
ROTATIONS_NOTE = {"code": "rotations_ignored", "severity": "info", "message": "effector targets are places alone"}
AT_REST = np.tile((1.0, 0.0, 0.0, 0.0), (1, SMPL22.num_joints, 1))
LONGEST_SECONDS, MOST_FRAMES, NUM_BODIES = 60.0, 60_000, 9


@dataclass(frozen=True, eq=False)
class ServedModel(Backbone):  # type: ignore[misc]
    """A model as the SDK's server calls it; `model_id` is its name in requests."""

    served: MotionModel
    model_id: str

    def capabilities(self) -> ModelSpec:
        """What the model answers to."""
        model = self.served.model
        kinds = model.constraint_kinds if isinstance(model, FollowsConstraints) else frozenset()
        return ModelSpec(
            id=self.model_id,
            fps=float(model.max_training_fps),
            canonical_skeleton={"joints": self._joints},
            supports_joint_translation=True,
            supported_constraints=[name for kind, name in KINDS.items() if kind in kinds],
            supported_guidance_types=["nocfg", "regular"],
            native_clip_seconds=model.max_duration_seconds,
            recommended_max_duration_seconds=model.max_duration_seconds,
            chunking="stitched",
            limits={"max_duration_seconds": LONGEST_SECONDS},
        )

    @cached_property
    def _joints(self) -> list[dict[str, Any]]:
        """The joints at rest, standing on the floor, with median bones of some motions of the model."""
        motions = self.served.generate(fps=20, seconds=min(2.0, self.served.max_duration_seconds), n=NUM_BODIES)
        standing = np.median([joint_channels(motion).skeleton.offsets for motion in motions], axis=0)
        standing[0, 1] -= kinematics.forward_kinematics(AT_REST, np.zeros((1, 3)), SMPL22, standing)[..., 1].min()
        above = [None, *(SMPL22.joint_names[parent] for parent in SMPL22.parents[1:])]
        return [
            {"name": name, "parent": parent, "rest_translation": place, "rest_rotation": (0.0, 0.0, 0.0, 1.0)}
            for name, parent, place in zip(SMPL22.joint_names, above, standing.tolist(), strict=True)
        ]

    def generate(self, request: GenerateRequest) -> MotionResult:
        """The motions of a request; raises `ProtocolError` for what the model does not support."""
        try:
            return self._generate(request)
        except (UsageError, ValueError) as error:
            raise ProtocolError("invalid_request", str(error)) from None

    def _generate(self, request: GenerateRequest) -> MotionResult:
        model, options = self.served.model, request.options or Options()
        if request.total_frames > MOST_FRAMES:
            raise UsageError(f"{request.total_frames:,} frames: a motion has up to {MOST_FRAMES:,}")
        fps = parse_fps(request.fps(float(model.max_training_fps)))
        script, sampling = _script(request, fps), _sampling(options)
        check_script(model, script, sampling)
        seed = int(np.random.default_rng().integers(2**31)) if options.seed is None else abs(options.seed)
        sampled: list[tuple[np.ndarray, np.ndarray]] = []
        for number, field in generate_scripts(model, [script] * options.num_samples, seed=seed, sampling=sampling):
            if options.post_processing:
                field = plant_generated(field, script)
            channels = joint_channels(sample_motion(field, motion_name(number, script), script, fps))
            turns = kinematics.continuous_quaternions(channels.rotations)[..., [1, 2, 3, 0]]
            places = np.tile(channels.skeleton.offsets, (len(turns), 1, 1))
            for joint, translation in channels.translations.items():
                places[:, joint] = translation
            sampled.append((turns.astype(np.float32), places))
        rotations, translations = map(np.stack, zip(*sampled, strict=True))
        ignored = any(getattr(each, "rotations", None) for each in request.constraints)
        return MotionResult(
            rotations=rotations,
            root_translations=translations[:, :, 0],
            translations=translations,
            notes=[ROTATIONS_NOTE] if ignored else [],
        )


def _sampling(options: Options) -> SamplingOptions:
    """Options that a request gives; the recipe's for others."""
    steps = options.diffusion_steps if "diffusion_steps" in options.model_fields_set else None
    if options.guidance is None:
        return SamplingOptions(steps=steps)
    if options.guidance.type == "separated":
        raise ProtocolError("invalid_options", "guidance is 'nocfg', or 'regular' with one weight")
    return SamplingOptions((*options.guidance.weight, 1.0)[0], steps=steps)


def _script(request: GenerateRequest, fps: Fraction) -> Script:
    """The segments as requests; the first has the constraints on the whole motion."""
    constraints = tuple(_constraint(each, fps, request) for each in request.constraints)
    pieces = [(each.duration_frames, getattr(each, "prompt", "")) for each in request.segments]
    (frames, text), *others = pieces or [(request.duration_frames, "")]
    later = (GenerationRequest(float(count / fps), prompt) for count, prompt in others)
    return (GenerationRequest(float(frames / fps), text, constraints=constraints), *later)


def _constraint(given: Any, fps: Fraction, request: GenerateRequest) -> Constraint:
    frames = [given.frame] if given.type == "pose_keyframe" else given.frames
    seconds, name = np.array(frames) / float(fps), f"{given.type} at frame {frames[0]}"
    free = np.full(len(frames), np.nan)
    if given.type == "root_path":
        if len(frames) > 1:
            return Constraint.path(given.positions_xz, seconds, given.heading_radians, name)
        (x, z), heading = given.positions_xz[0], free if given.heading_radians is None else given.heading_radians
        at, facing = np.array([[[x, np.nan, z]]]), np.array(heading, np.float64)
        return Constraint("path", name, seconds, (ROOT,), at, facing, "world", deviation=PATH_DEVIATION)
    if given.type == "effector_target":
        at = np.array(given.positions, np.float64)[:, None]
        return Constraint("joint", name, seconds, (given.joint,), at, free, "world")
    return _pose(given, float(seconds[0]), name, request)


def _pose(given: Any, seconds: float, name: str, request: GenerateRequest) -> Constraint:
    """A pose of rotations on the request's bones; joints below one that is not given are free, unless they rest.

    Without a place of the root it stands on the floor, anywhere.
    """
    rotations, known = AT_REST.copy(), np.ones(SMPL22.num_joints, bool)
    for joint, parent in enumerate(SMPL22.parents):
        above = SMPL22.joint_names[max(parent, 0)]
        known[joint] = parent < 0 or (known[parent] and (given.fill_mode == "rest" or above in given.joint_rotations))
        x, y, z, w = given.joint_rotations.get(SMPL22.joint_names[joint], (0.0, 0.0, 0.0, 1.0))
        length = float(np.linalg.norm((w, x, y, z)))
        if length == 0:
            raise ProtocolError("invalid_request", f"{name}: a rotation of length 0")
        rotations[0, joint] = np.array((w, x, y, z)) / length
    offsets = np.array([joint.rest_translation for joint in request.skeleton.joints], np.float64)
    root = np.zeros((1, 3)) if given.root_position is None else np.array([given.root_position], np.float64)
    positions: Float64[np.ndarray, "22 3"] = kinematics.forward_kinematics(rotations, root, SMPL22, offsets)[0]
    if not (placed := given.root_position is not None):
        positions[:, 1] -= positions[known, 1].min()
    joints = np.array(SMPL22.joint_names)[known].tolist()
    return Constraint.pose(positions, seconds, joints=joints, placed=placed, name=name)
