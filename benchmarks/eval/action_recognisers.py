"""Known answers for the published action recognisers: CMU's takes, and Action2Motion's own generated samples.

    python benchmarks/eval/action_recognisers.py --store STORE --cmu action_recognition_model_mocap_new.tar [--json]
    python benchmarks/eval/action_recognisers.py --repository ACTION-TO-MOTION [--json]

The first classifies every CMU take of a store (source 'cmu') whose description names one of the recogniser's actions,
and prints the accuracy by action, and the effect of other framerates and lengths of clips. The second needs a checkout
of https://github.com/EricGuo5513/action-to-motion, which holds 20 motions that its authors generated for HumanAct12's
actions: how many the recogniser knows as they are, in other axes, without their hands, and with the random initial
state of the published evaluation.
"""

import argparse
import json
from collections import Counter
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch

from eval.actions.gru import CMU_MOCAP, HUMANACT12, GruRecogniser, load_gru
from eval.metrics.actions import accuracy
from eval.report.results import provenance
from eval.sets.real import RealMotion, real_motion
from eval.sets.sets import SampleSet, sample_set
from motionkit.store import Store

DESCRIBED = {
    "walk": "walk",
    "slow walk": "walk",
    "walk on uneven terrain": "walk",
    "wash self": "wash",
    "run/jog": "run",
    "jump": "jump",
    "forward jump": "jump",
    "dance": "dance",
}
SAMPLES = "checkpoints/vae/humanact12/vanila_vae_tf/joints"
WEIGHTS = "model_file/action_recognition_model_humanact12.tar"
RANDOM_STATES = 30


def main() -> None:
    """Print the requested figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path)
    parser.add_argument("--cmu", type=Path, help="weights of the CMU recogniser")
    parser.add_argument("--repository", type=Path, help="checkout of action-to-motion")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    found: dict[str, object] = {}
    if arguments.store and arguments.cmu:
        found["cmu"] = cmu_takes(Store.open(arguments.store), load_gru(arguments.cmu, CMU_MOCAP))
    if arguments.repository:
        found["humanact12"] = own_samples(arguments.repository)
    if not found:
        parser.error("give --store and --cmu, or --repository")
    print(
        json.dumps(
            found | {"provenance": provenance(arguments.store)},
            indent=None if arguments.json else 1,
            ensure_ascii=False,
        )
    )


def cmu_takes(store: Store, recogniser: GruRecogniser) -> dict[str, object]:
    """Accuracy and confusion on the takes whose description names an action."""
    takes = real_motion(store, "all", "source = 'cmu'")
    actions = [_action(takes, index) for index in range(len(takes.fps))]
    figures: dict[str, object] = {}
    for name, kind in {
        "as trained: 12 fps, clips of 100 frames": CMU_MOCAP,
        "clips of 60 frames": replace(CMU_MOCAP, clip_length=60),
        "24 fps": replace(CMU_MOCAP, fps=Fraction(24)),
        "6 fps": replace(CMU_MOCAP, fps=Fraction(6)),
    }.items():
        samples = takes.at(kind.fps)
        known = [index for index, action in enumerate(actions) if action]
        scores = replace(recogniser, kind=kind).recognise(samples.select(known)).scores
        labels = np.array([kind.actions.index(actions[index]) for index in known])
        named = [kind.actions[best] for best in scores.argmax(axis=1)]
        confusion = {
            action: dict(
                Counter(said for said, label in zip(named, labels, strict=True) if kind.actions[label] == action)
            )
            for action in kind.actions
            if action in {actions[index] for index in known}
        }
        figures[name] = {"takes": len(known), "accuracy": round(accuracy(scores, labels), 4), "named": confusion}
    return figures


def _action(takes: RealMotion, index: int) -> str:
    if takes.actions[index] == "playground" and "climb" in takes.captions[index]:
        return "climb"
    return DESCRIBED.get(takes.actions[index], "")


def own_samples(repository: Path) -> dict[str, object]:
    """Accuracy on the authors' generated motions, and the effect of each step of the preprocessing."""
    folder = repository / SAMPLES
    motions = np.load(next(folder.glob("motion_joints*.npy")), allow_pickle=False)
    labels = np.load(folder / "motion_class.npy", allow_pickle=False).astype(np.int64)
    upright = motions.reshape(len(motions), -1, 24, 3).astype(np.float32) * np.array([1, -1, -1], np.float32)
    recogniser = load_gru(repository / WEIGHTS, HUMANACT12)
    variants = {
        "as prepared": upright,
        "hands left out": upright[:, :, :22],
        "y up instead of down": upright * np.array([1, -1, -1], np.float32),
        "facing away": upright * np.array([-1, 1, -1], np.float32),
        "mirrored": upright * np.array([-1, 1, 1], np.float32),
    }
    figures: dict[str, object] = {"motions": len(motions), "chance": round(1 / len(recogniser.actions), 4)}
    for name, positions in variants.items():
        figures[name] = accuracy(recogniser.recognise(_samples(positions)).scores, labels)
    figures[f"random initial state, mean and extremes of {RANDOM_STATES}"] = _with_random_states(
        recogniser, upright, labels
    )
    return figures


def _samples(positions: np.ndarray) -> SampleSet:
    return sample_set("published samples", HUMANACT12.fps, list(positions), [str(i) for i in range(len(positions))])


def _with_random_states(recogniser: GruRecogniser, upright: np.ndarray, labels: np.ndarray) -> list[float]:
    network, generator = recogniser.network, torch.Generator().manual_seed(0)
    clips = HUMANACT12.joints(upright)
    poses = torch.from_numpy((clips - clips[:, :1, :1]).reshape(*clips.shape[:2], -1))
    found = []
    with torch.inference_mode():
        for _ in range(RANDOM_STATES):
            states, _last = network.recurrent(poses, torch.randn(2, len(poses), 128, generator=generator))
            scores = network.linear2(torch.tanh(network.linear1(states[:, -1])))
            found.append(accuracy(scores.double().numpy(), labels))
    return [round(float(np.mean(found)), 4), min(found), max(found)]


if __name__ == "__main__":
    main()
