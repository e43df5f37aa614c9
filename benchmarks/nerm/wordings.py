"""How well a run follows rephrased captions that are not in its training data.

    python -m benchmarks.nerm.wordings RUN --store STORE [--wordings FILE.csv] [--guidance 2] [--steps 10] [--seed 0]

Asks for the test split's captions, and for another wording of each (columns `caption` and `wording`; by default the 118
of the pack of docs/results/real-pack.md, written by hand), at 20 fps and as long as the real motions, planted. Both are
measured by the run's own evaluator under the protocol `native` with the original captions: it has
not read the wordings either. Real motion stands beside, with the evaluator asked with the captions and the wordings.
"""

import csv
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from benchmarks.command import arguments_parser
from eval.native_evaluator.evaluator import load_native
from eval.native_evaluator.text_motion import NativeTextMotion
from eval.sets.sets import sample_set
from eval.text_motion.pairs import TextMotionPairs
from eval.text_motion.protocol import find_text_motion_protocol
from eval.text_motion.real_pairs import CaptionedMotions, captioned_motions, limited
from eval.text_motion.scores import score_text_motion
from motionkit.fields.contact.planted import planted
from motionkit.fields.motion_field import to_motion
from motionkit.generate.models import GenerationRequest, SamplingOptions
from motionkit.store import Store
from nerm.model import NermModel, load

FPS = Fraction(20)
PROTOCOL = find_text_motion_protocol("native")
AT_ONCE = 128
SHOWN = ("r_precision_top1", "r_precision_top3", "fid", "diversity")


def second_wordings(path: Path) -> dict[str, str]:
    """The other wording of each caption."""
    with path.open(encoding="utf-8", newline="") as lines:
        return {row["caption"]: row["wording"] for row in csv.DictReader(lines)}


def made(
    model: NermModel, texts: Sequence[str], real: CaptionedMotions, sampling: SamplingOptions, seed: int
) -> list[np.ndarray]:
    """Planted joint positions [frames, 22, 3], one motion per text, each as long as the real one."""
    asked = [GenerationRequest(*each) for each in zip(real.durations_seconds, texts, strict=True)]
    positions = []
    for first in range(0, len(asked), AT_ONCE):
        fields = model.generate(asked[first : first + AT_ONCE], seed=seed, first=first, sampling=sampling)
        positions += [to_motion(planted(field, "free"), FPS).joint_positions for field in fields]
    return positions


def row(name: str, reference: TextMotionPairs, own: TextMotionPairs) -> str:
    """A line of the table."""
    values = score_text_motion(reference, [own], PROTOCOL, 0).values
    return f"| {name} | " + " | ".join(f"{np.mean(values[each].values):.3f}" for each in SHOWN) + " |"


def main() -> None:
    parser = arguments_parser(__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--wordings", type=Path, default=Path(__file__).with_name("second_wordings.csv"))
    parser.add_argument("--guidance", type=float, default=2.0)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    model, evaluator = load(options.run), NativeTextMotion(load_native(options.run))
    other = second_wordings(options.wordings)
    rule = limited(PROTOCOL.lengths, model.max_duration_seconds)
    real = captioned_motions(Store.open(options.store), "test", None, FPS, rule)
    real = real.select(np.flatnonzero([caption.text in other for caption in real.captions]))
    again = [replace(caption, text=other[caption.text]) for caption in real.captions]
    ids, motions = real.samples.sequence_ids, evaluator.embed_motions(real.samples)
    pairs = TextMotionPairs(evaluator.embed_texts(real.captions), motions, ids)
    print(f"{len(ids)} motions of {len({caption.text for caption in real.captions})} captions")
    print("| | top 1 | top 3 | FID | diversity |\n|---|---|---|---|---|")
    print(row("real, the evaluator asked with the captions", pairs, pairs))
    reworded = TextMotionPairs(evaluator.embed_texts(again), motions, ids)
    print(row("real, the evaluator asked with the wordings", reworded, reworded), flush=True)
    sampling = SamplingOptions(options.guidance, steps=options.steps)
    for name, captions in (("captions", real.captions), ("wordings", again)):
        positions = made(model, [caption.text for caption in captions], real, sampling, options.seed)
        embedded = evaluator.embed_motions(sample_set(name, FPS, positions, list(ids)))
        print(row(f"generated from the {name}", pairs, TextMotionPairs(pairs.texts, embedded, ids)), flush=True)


if __name__ == "__main__":
    main()
