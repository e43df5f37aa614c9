"""Protocols of text-to-motion, one row of a table each: what a published evaluation draws, pairs, drops and repeats.

They follow the sources, which were not run. The published loaders also draw one of a motion's captions and a random
crop to a multiple of four frames in every replication; that is not part of a protocol here.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from math import floor
from typing import Literal

from motionkit.core.errors import UsageError

KIT_FPS = Fraction(25, 2)
NUM_GENERATIONS = 30
"""Motions of a text for MultiModality in every protocol."""


@dataclass(frozen=True)
class MultiModalityRule:
    """How MultiModality draws: `num_texts` None is every text; `pairs` "distinct" is Eq. 8 of the NeRM paper.

    "shared" takes the same index pairs for every text, and a motion may be paired with itself (text-to-motion).
    """

    num_texts: int | None = 100
    pairs: Literal["distinct", "shared"] = "shared"
    replications: int = 20

    @property
    def metric(self) -> str:
        """Its name in `eval.metrics.metric`."""
        return "multimodality" if self.pairs == "distinct" else "multimodality_shared_pairs"


@dataclass(frozen=True)
class LengthRule:
    """Durations of the real motions used: `shortest_seconds` to `longest_seconds`, and what happens to longer ones.

    Seconds count from the first pose to the last: T poses at s fps, of which there are T − 1 pose vectors, last
    (T − 1)/s.
    """

    shortest_seconds: float
    longest_seconds: float
    longer: Literal["cropped", "left out"]

    def most_frames(self, fps: Fraction) -> int:
        """Number of poses of the longest uncropped motion."""
        return floor(self.longest_seconds * float(fps) + 1e-6) + 1

    def limited(self, longest_seconds: float) -> "LengthRule":
        """The rule for a model of shorter motions: real ones are cropped to its longest duration."""
        shorter = LengthRule(min(self.shortest_seconds, longest_seconds), longest_seconds, "cropped")
        return shorter if longest_seconds < self.longest_seconds else self


@dataclass(frozen=True)
class RetrievalRule:
    """One table of retrieval: the candidates, and which of them are relevant.

    All pairs are ranked together, or in random pools of `pool`, or only the `least_similar` ones by their sentences.
    Texts with a score above `same_above` (½ + ½ · cosine; None: never) count as the same: by an independent sentence
    encoder (`same_by` "sentences"), or by the evaluator's own embeddings ("texts"), by which an evaluator with equal
    embeddings for all texts is always right.
    """

    name: str
    pool: int | None = None
    least_similar: int | None = None
    same_above: float | None = None
    same_by: Literal["sentences", "texts"] = "sentences"
    directions: tuple[str, ...] = ("text asks for motion", "motion asks for text")


# 40 to 199 pose vectors at 20 fps, 24 to 199 at KIT-ML's 12.5 (text-to-motion, data/dataset.py).
PUBLISHED_LENGTHS, PUBLISHED_KIT_LENGTHS = LengthRule(2.0, 9.95, "left out"), LengthRule(1.92, 15.92, "left out")
# The longest that Guo's evaluators read, 196 pose vectors.
OWN_LENGTHS, OWN_KIT_LENGTHS = LengthRule(0.6, 9.8, "cropped"), LengthRule(0.6, 15.68, "cropped")
SHARED, DISTINCT = MultiModalityRule(), MultiModalityRule(pairs="distinct")


@dataclass(frozen=True)
class TextMotionProtocol:
    """Protocol from embeddings of texts and motions to a table's numbers.

    `pool`: number of candidates per text, in a random order of all motions (in published code, a batch of a shuffled
    loader). `remainder`: metrics that leave out the last, incomplete pool. `num_motions`: number of generated motions
    used, None for all. `reference`: FID against the whole real set ("whole"), the real motions of the same texts
    ("paired") or another random order of the real set with its own remainder ("redraw"). `asks`: the direction of the
    source's R-Precision; both are computed. `details`: metrics that are computed once, on the first draw. `kit_lengths`
    are the `lengths` of KIT-ML.
    """

    name: str
    title: str
    source: str
    num_motions: int | None = None
    remainder: Literal["R-Precision", "every metric"] = "every metric"
    reference: Literal["whole", "paired", "redraw"] = "paired"
    multimodality: MultiModalityRule = SHARED
    asks: Literal["text", "motion"] = "text"
    pool: int = 32
    replications: int = 20
    lengths: LengthRule = PUBLISHED_LENGTHS
    kit_lengths: LengthRule = PUBLISHED_KIT_LENGTHS
    details: tuple[str, ...] = ()
    retrieval: tuple[RetrievalRule, ...] = ()
    remarks: tuple[str, ...] = ()

    def lengths_at(self, fps: Fraction) -> LengthRule:
        """The rule of lengths for motions at a framerate: KIT-ML's at its 12.5 fps, HumanML3D's at any other."""
        return self.kit_lengths if fps == KIT_FPS else self.lengths


NATIVE = TextMotionProtocol(
    *("native", "motionkit", "docs/metrics.md"),
    remainder="R-Precision",
    reference="whole",
    multimodality=DISTINCT,
    lengths=OWN_LENGTHS,
    kit_lengths=OWN_KIT_LENGTHS,
    details=("fid_infinity", "kid"),
)
TMR = replace(
    NATIVE,
    name="tmr",
    title="TMR",
    source="Mathux/TMR @ 6d74688, retrieval.py and src/model/metrics.py",
    reference="paired",
    details=(),
    retrieval=(
        RetrievalRule("all"),
        RetrievalRule("all, texts of a score above 0.95 are one", same_above=0.95),
        RetrievalRule("100 dissimilar texts", least_similar=100),
        RetrievalRule("pools of 32", pool=32),
    ),
    remarks=(
        "The number of motions that a text chooses among is in the table's name: recalls of different N do not "
        "compare.",
    ),
)
KIMODO = replace(
    TMR,
    name="kimodo",
    title="Kimodo",
    source="nv-tlabs/kimodo @ 7330e7e, kimodo/metrics/tmr.py",
    retrieval=(
        RetrievalRule(
            "all, texts that the evaluator scores above 0.99 are one",
            same_above=0.99,
            same_by="texts",
            directions=("text asks for motion", "motion asks for real motion"),
        ),
    ),
)
TEXT_MOTION_PROTOCOLS = (
    NATIVE,
    TextMotionProtocol(
        *("nerm", "NeRM", "Wei et al. 2024, appendix C.1"),
        num_motions=1000,
        remainder="R-Precision",
        reference="whole",
        asks="motion",
        multimodality=DISTINCT,
        remarks=("The paper's words: its code is not published. How many texts MultiModality has it does not say.",),
    ),
    TextMotionProtocol("t2m", "text-to-motion", "Guo et al. 2022, final_evaluations.py", reference="redraw"),
    TextMotionProtocol(
        *("mdm", "MDM", "Tevet et al. 2023, eval/eval_humanml.py"),
        num_motions=1024,
        reference="redraw",
        multimodality=MultiModalityRule(128, replications=5),
        remarks=("MDM generates 1,024 motions: its FID does not compare with that of 4,640.",),
    ),
    TextMotionProtocol(
        *("mld", "MLD", "Chen et al. 2023, mld/models/metrics/tm2t.py and mm.py"), remainder="R-Precision"
    ),
    TextMotionProtocol(
        *("t2m-gpt", "T2M-GPT", "Zhang et al. 2023, utils/eval_trans.py"),
        multimodality=MultiModalityRule(None),
        remarks=("Its models choose the length of a motion; here a motion is as long as the sample is.",),
    ),
    TextMotionProtocol(
        *("momask", "MoMask", "Guo et al. 2024, utils/eval_t2m.py"), multimodality=MultiModalityRule(96)
    ),
    TextMotionProtocol(
        *("mardm", "MARDM", "neu-vi/MARDM @ 443313b, evaluation_MARDM.py and utils/eval_utils.py"),
        multimodality=MultiModalityRule(96),
        remarks=("MARDM's evaluators read 67 numbers (KIT-ML: 64): --evaluator guo,motion-clip with its own weights.",),
    ),
    TMR,
    KIMODO,
)


def find_text_motion_protocol(name: str) -> TextMotionProtocol:
    """A protocol by name. Raises `UsageError` that lists the names."""
    known = {protocol.name: protocol for protocol in TEXT_MOTION_PROTOCOLS}
    if name not in known:
        raise UsageError(f"there is no text-to-motion protocol {name!r}: {', '.join(known)}")
    return known[name]
