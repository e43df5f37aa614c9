"""Folders as published repositories write their samples: names, shapes and orders, with analytic motions in them."""

from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np

from eval.sets.sets import Ragged
from motionkit.core.skeleton import SMPL22
from motionkit.core.skeletons.mapping import map_joints
from motionkit.features import humanml3d
from motionkit.fields.motion_field import to_motion
from tests.helpers.analytic import ACTIONS, analytic_motion
from tests.helpers.format_samples import bvh_hierarchy, bvh_text

FPS = Fraction(20)
NUM_PROMPTS, NUM_REPEATS = 3, 2
# How high a body of KIT-ML's files is in their unit; the motions' is 1.
KIT_HEIGHT = 1000.0
CAPTIONS = ("a person walks", "a person waves, slowly", "someone jumps")


@cache
def motions(layout: str = "smpl22", fps: Fraction = FPS) -> tuple[np.ndarray, ...]:
    """Six analytic motions, by repetition, each as a published dataset processes it (metres; KIT: body heights)."""
    made = []
    for index in range(NUM_PROMPTS * NUM_REPEATS):
        field = analytic_motion(list(ACTIONS)[index % len(ACTIONS)], 2.6 + 0.2 * index, index)
        joints = map_joints(to_motion(field, fps), layout)
        made.append(humanml3d.process(joints, layout))
    return tuple(made)


def vectors() -> list[np.ndarray]:
    """263-number vectors of the motions."""
    return [humanml3d.vectors(joints, "smpl22") for joints in motions()]


def write_mdm(folder: Path, *, export: bool = False) -> Path:
    """motion-diffusion-model, sample/generate.py: a pickled dictionary, motion [N, 22, 3, T], by repetition."""
    folder.mkdir(parents=True, exist_ok=True)
    lengths = np.array([len(joints) for joints in motions()])
    motion = np.random.default_rng(0).normal(size=(len(lengths), 22, 3, lengths.max())).astype(np.float32)
    for index, joints in enumerate(motions()):
        motion[index, :, :, : len(joints)] = joints.transpose(1, 2, 0)
    results = {
        "motion": motion,
        "text": list(CAPTIONS) * NUM_REPEATS,
        "lengths": lengths,
        "num_samples": NUM_PROMPTS,
        "num_repetitions": NUM_REPEATS,
    }
    if export:
        np.savez(folder / "results.npz", **results)  # type: ignore[arg-type]
    else:
        np.save(folder / "results.npy", results)  # type: ignore[arg-type]
    (folder / "results.txt").write_text("\n".join(results["text"]))  # type: ignore[arg-type]
    (folder / "results_len.txt").write_text("\n".join(map(str, lengths)))
    (folder / "sample00_rep00.mp4").write_bytes(b"\0" * 8)
    return folder


def write_mld_demo(folder: Path) -> Path:
    """motion-latent-diffusion, demo.py, task text_motion: joints, the real ones (_ref), and the text beside them."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, joints in enumerate(motions()):
        name = f"text_motion_{len(joints)}_batch0_{index}"
        np.save(folder / f"{name}.npy", joints)
        np.save(folder / f"{name}_ref.npy", joints + 1)
        (folder / f"{name}.txt").write_text(CAPTIONS[index % NUM_PROMPTS])
    return folder


def write_mld_test(folder: Path) -> Path:
    """motion-latent-diffusion, test.py with SAVE_PREDICTIONS: KEY_REPLICATION.npy, filled up to the batch's longest.

    The filling is the mean pose, which stands still while the root moves on.
    """
    folder.mkdir(parents=True, exist_ok=True)
    longest = max(len(joints) for joints in motions()) + 15
    for index, joints in enumerate(motions()):
        steps = np.arange(1, longest - len(joints) + 1)[:, None, None]
        padding = joints[:1] + steps * np.array([0, 0, 0.0087], np.float32)
        key = f"{index % NUM_PROMPTS:06d}_{index // NUM_PROMPTS}"
        np.save(folder / f"{key}.npy", np.concatenate((joints, padding)).astype(np.float32))
    rows = [
        f"{index % NUM_PROMPTS:06d}_{index // NUM_PROMPTS}.npy,{len(joints)},{index % NUM_PROMPTS:06d}\n"
        for index, joints in enumerate(motions())
    ]
    (folder / "lengths.csv").write_text("file,num_frames,group\n" + "".join(rows))
    return folder


def write_t2m_gpt(folder: Path) -> Path:
    """T2M-GPT, utils/eval_trans.py with savenpy: NAME_pred.npy and NAME_gt.npy, [1, T, 22, 3]; no texts."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, joints in enumerate(motions()):
        np.save(folder / f"{index:06d}_pred.npy", joints[None])
        np.save(folder / f"{index:06d}_gt.npy", joints[None] + 1)
    return folder


def write_t2m_gpt_vectors(folder: Path, mean: np.ndarray, std: np.ndarray) -> Path:
    """What T2M-GPT's decoder gives, saved as it is: [1, T, 263], normalised with its VQ-VAE's mean.npy and std.npy."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, rows in enumerate(vectors()):
        np.save(folder / f"{index:06d}.npy", ((rows - mean) / std)[None].astype(np.float32))
    np.save(folder / "mean.npy", mean)
    np.save(folder / "std.npy", std)
    (folder / "samples.toml").write_text('statistics = "normalised"\nmean = "mean.npy"\nstd = "std.npy"\n')
    return folder


def write_momask(folder: Path) -> Path:
    """momask-codes, gen_t2m.py: joints/K/sampleK_repeatR_lenL.npy and _ik.npy, animations/K/….bvh."""
    for index, joints in enumerate(motions()):
        prompt, repeat = index % NUM_PROMPTS, index // NUM_PROMPTS
        name = f"sample{prompt}_repeat{repeat}_len{len(joints)}"
        for kind in ("joints", "animations"):
            (folder / kind / str(prompt)).mkdir(parents=True, exist_ok=True)
        for ending in ("", "_ik"):
            np.save(folder / "joints" / str(prompt) / f"{name}{ending}.npy", joints + (1 if ending else 0))
            (folder / "animations" / str(prompt) / f"{name}{ending}.bvh").write_text(momask_bvh(joints))
    lines = [f"{caption}#{40 + k}\n" for k, caption in enumerate(CAPTIONS)]
    (folder / "prompts.txt").write_text("".join(lines))
    (folder / "samples.toml").write_text('fps = 20\nprompts = "prompts.txt"\n')
    return folder


MOMASK_ORDER = (0, 1, 4, 7, 10, 2, 5, 8, 11, 3, 6, 9, 12, 15, 13, 16, 18, 20, 14, 17, 19, 21)
MOMASK_NAMES = (
    *("Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToe", "RightUpLeg", "RightLeg", "RightFoot", "RightToe"),
    *("Spine", "Spine1", "Spine2", "Neck", "Head", "LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand"),
    *("RightShoulder", "RightArm", "RightForeArm", "RightHand"),
)


def momask_bvh(joints: np.ndarray) -> str:
    """A body of the template's names in metres at 0.050000 s a frame, its root where the joints have theirs."""
    names = dict(zip(MOMASK_ORDER, MOMASK_NAMES, strict=True))
    body = {
        names[joint]: (names.get(SMPL22.parents[joint], ""), tuple(SMPL22.offsets[joint].tolist()))
        for joint in MOMASK_ORDER
    }
    rows = [[*root.tolist(), *[0.0] * 66] for root in joints[:, 0]]
    return bvh_text(rows, "0.050000", bvh_hierarchy(body, "Zrotation Yrotation Xrotation"))


def write_kit_joints(folder: Path, unit_metres: float | None) -> Path:
    """A KIT-ML model's joints, [T, 21, 3] at 12.5 fps in KIT-ML's unit; `unit_metres` goes into the manifest."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, joints in enumerate(motions("kit21", Fraction(25, 2))):
        np.save(folder / f"{index}.npy", joints * np.float32(KIT_HEIGHT))
    unit = "" if unit_metres is None else f"unit_metres = {unit_metres}\n"
    (folder / "samples.toml").write_text("fps = 12.5\n" + unit)
    return folder


def same_order(found: Ragged, order: Sequence[int], atol: float = 0.0) -> None:
    """Assert that the motions found are those at these places."""
    assert len(found) == len(order)
    for positions, index in zip(found, order, strict=True):
        np.testing.assert_allclose(positions, motions()[index], rtol=0, atol=atol)
