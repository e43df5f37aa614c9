"""The published evaluators of text-to-motion: their files, their three networks, and what they embed.

Guo et al. 2022 trained one on HumanML3D and one on KIT; MARDM (Meng et al. 2024) retrained the same networks on the
numbers that a model generates. The size of the first layer distinguishes the four. They read `humanml3d` pose vectors
at one framerate; embeddings are not normalised, their distances are Euclidean. Rows come in the order of the input; the
published wrapper returns them sorted by length.

Networks compute in float64: a row then depends on its batch by rounding alone (1e-14), and lies within float32's
rounding of what the published code computes from the same weights. Source: text-to-motion, networks/modules.py.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.utils.rnn import pack_sequence

from eval.sets.sets import SampleSet
from motionkit.core.errors import FormatError, MissingExtraError, MotionkitError
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float, Float32, Float64, Int64
from motionkit.features import humanml3d
from motionkit.features.humanml3d import placed, process
from motionkit.features.layout import PoseLayout, pose_layout
from motionkit.features.statistics import Statistics
from motionkit.io import npy, source_file
from motionkit.io.humanml3d import HUMANML3D, KIT, Layout
from motionkit.training import loop

VERSION = "guo/2"
WHAT = "the evaluator of Guo et al."
ENCODERS = ("movement_encoder", "motion_encoder", "text_encoder")
FRAMES_PER_TOKEN = 4
MAX_FRAMES = 196
"""Frames of the longest motion in the published protocol, whose loaders drop motions of 200 frames and more."""
ROWS_AT_ONCE = 64
SLOPE = 0.2
SIGNATURE_TOLERANCE = 0.01
"""Relative: Std.npy divided by 25 is within 0.4 % of the evaluator's; Mean.npy's root height is 2.3 % from it."""
# Standardised heights are negative half of the time, heights above the floor hardly ever.
MAX_NEGATIVE_HEIGHTS = 0.1
# The root of a lying body is at a seventh of its usual height; a wrong unit is a factor of at least 39 (inches).
MOST_HEIGHT_FACTOR = 10.0


class GuoError(MotionkitError):
    """Files that are not a published evaluator's, or invalid motions and captions."""


@dataclass(frozen=True)
class GuoFiles:
    """What `load_guo` loads: `statistics` None means those beside the weights."""

    weights: Path
    glove: Path | None = None
    statistics: Path | None = None


@dataclass(frozen=True)
class GuoKind:
    """A published evaluator that reads the first `num_inputs` numbers of a data set's pose vectors.

    `root_height` is the mean of the root's height, `block_std` the std of each of the vector's blocks, in its files.
    """

    name: str
    dataset: str
    published: Layout
    num_inputs: int
    root_height: float
    block_std: tuple[float, ...]

    @property
    def layout(self) -> PoseLayout:
        """The layout of its pose vectors."""
        return pose_layout(self.published.skeleton.name)

    @property
    def num_statistics(self) -> int:
        """Numbers of mean.npy and std.npy."""
        return self.published.num_values if self.name == "guo" else self.num_inputs


# Sizes: text-to-motion, evaluator_wrapper.py; MARDM, utils/evaluators.py. Figures: the files of text-to-motion's
# checkpoints (Comp_v6_KLD01/meta, Comp_v6_KLD005/meta) and MARDM's utils/eval_mean_std.
KINDS = (
    GuoKind(
        *("guo", "HumanML3D", HUMANML3D, 259, 0.91752),
        (5.1467e-4, 6.7693e-4, 6.1208e-3, 0.122555, 0.300386, 0.0195406, 0.0140949),
    ),
    GuoKind(
        *("guo", "KIT", KIT, 247, 559.62),
        (9.9157e-4, 1.172767, 4.58643, 93.6202, 0.342471, 29.1116, 5.26644e-3),
    ),
    GuoKind("mardm", "HumanML3D", HUMANML3D, 67, 0.93862, (0.01283, 0.01693, 0.15378, 0.12224)),
    GuoKind("mardm", "KIT", KIT, 64, 559.62, (0.02479, 29.3192, 114.661, 93.6202)),
)


def kind_of(first: Tensor | None, names: tuple[str, ...], path: Path, what: str) -> GuoKind:
    """The kind of an evaluator by the weights of its first layer; raises `CheckpointError` if it is none of `names`."""
    shape = () if first is None else tuple(first.shape)
    known = {kind.num_inputs: kind for kind in KINDS if kind.name in names}
    if len(shape) < 2 or shape[1] not in known:
        sizes = ", ".join(map(str, known))
        raise loop.CheckpointError(f"{path}: the first layer is {shape or 'missing'}; {what} reads {sizes} numbers")
    return known[shape[1]]


def read_statistics(folder: Path, kind: GuoKind) -> Statistics:
    """mean.npy and std.npy that belong to an evaluator's weights.

    Raises `GuoError` if they are missing, of another size, or of another convention: a wrong file changes every
    number without any other error, so nothing is guessed or repaired.
    """
    # The names in Guo's archives, in MARDM's, and in MDM's copies of Guo's.
    pairs = [(folder / f"{prefix}mean.npy", folder / f"{prefix}std.npy") for prefix in ("", "eval_", "t2m_", "kit_")]
    pair = next((pair for pair in pairs if all(path.is_file() for path in pair)), None)
    if pair is None:
        raise GuoError(f"{folder}: there is no mean.npy and std.npy; they come with the evaluator (docs/evaluators.md)")
    try:
        mean, std = (npy.parse_npy(path, source_file.read_bytes(path), (kind.num_statistics,)) for path in pair)
        statistics = Statistics(mean.astype(np.float64), std.astype(np.float64))
    except (FormatError, ValueError) as error:
        raise GuoError(f"{folder}: {error}") from None
    signature = [("the mean root height", statistics.mean[kind.layout.vector.root_height], kind.root_height)]
    for block, block_std in zip(kind.layout.vector, kind.block_std, strict=False):
        signature.append((f"the std of numbers {block.start} to {block.stop - 1}", statistics.std[block], block_std))
    for what, numbers, expected in signature:
        if np.abs(numbers - expected).max() > SIGNATURE_TOLERANCE * expected:
            belong = f"in those of the {kind.name} evaluator of {kind.dataset}"
            raise GuoError(f"{folder}: {what} is {numbers.mean():.4g}, {expected:.4g} {belong}")
    return statistics


# Captions as the text encoder reads them: GloVe vectors and parts of speech of `word/POS` tokens (text-to-motion,
# utils/word_vectorizer.py and data/dataset.py).
WORD_SIZE = 300
MAX_TOKENS = 20
"""Maximum number of a caption's tokens, without `sos` and `eos`."""
PARTS_OF_SPEECH = (
    *("VERB", "NOUN", "DET", "ADP", "NUM", "AUX", "PRON", "ADJ", "ADV"),
    *("Loc_VIP", "Body_VIP", "Obj_VIP", "Act_VIP", "Desc_VIP", "OTHER"),
)
START, END, UNKNOWN = "sos", "eos", "unk"
# Words with their own part of speech, which overrides the token's.
IMPORTANT = {
    "Loc_VIP": "left right clockwise counterclockwise anticlockwise forward back backward up down straight curve",
    "Body_VIP": "arm chin foot feet face hand mouth leg waist eye knee shoulder thigh",
    "Obj_VIP": "stair dumbbell chair window floor car ball handrail baseball basketball",
    "Act_VIP": (
        "walk run swing pick bring kick put squat throw hop dance jump turn stumble stop sit lift lower raise wash "
        "stand kneel stroll rub bend balance flap jog shuffle lean rotate spin spread climb"
    ),
    "Desc_VIP": "slowly carefully fast careful slow quickly happy angry sad happily angrily sadly",
}


@dataclass(frozen=True, eq=False)
class WordVectors:
    """GloVe vectors [words, 300] of a vocabulary; `row` is the index of a word."""

    vectors: Float64[np.ndarray, "words 300"]
    row: Mapping[str, int]

    def sentence(self, caption: Caption) -> tuple[Float64[Tensor, "steps 300"], Float64[Tensor, "steps tags"]]:
        """The caption's first 20 tokens between `sos` and `eos`: word vectors, and parts of speech as one-hot rows.

        Words outside the vocabulary are `unk`/OTHER. Raises `GuoError` for a caption without tokens, or with one that
        is not `word/POS`.
        """
        tokens = [token.rpartition("/")[::2] for token in caption.tokens.split()[:MAX_TOKENS]]
        # A tagger gives X to single words; `motionkit export` writes it for captions that nobody tagged.
        untagged = len(tokens) > 2 and all(tag == "X" for _, tag in tokens)
        if not tokens or untagged or not all(word for word, _ in tokens):
            raise GuoError(
                f"caption {caption.text!r} has no word/POS tokens, which Guo's text encoder reads; take those of "
                "HumanML3D's or KIT's texts/*.txt (spaCy's en_core_web_sm wrote them; docs/evaluators.md)"
            )
        important = {word: tag for tag, words in IMPORTANT.items() for word in words.split()}
        rows, tags = [], []
        for word, tag in ((START, ""), *tokens, (END, "")):
            tag = important.get(word, tag) if word in self.row else "OTHER"
            rows.append(self.row.get(word, self.row[UNKNOWN]))
            tags.append(PARTS_OF_SPEECH.index(tag if tag in PARTS_OF_SPEECH else "OTHER"))
        one_hot = np.eye(len(PARTS_OF_SPEECH))[tags]
        return torch.from_numpy(self.vectors[rows]), torch.from_numpy(one_hot)


def read_word_vectors(folder: Path) -> WordVectors:
    """our_vab_data.npy, our_vab_words.pkl and our_vab_idx.pkl of a folder, the pickles as plain data.

    Raises `GuoError` if one is missing, damaged, holds anything but words and numbers, or if they disagree.
    """
    path = folder / "our_vab_data.npy"
    try:
        words, rows = (
            npy.parse_pickle(source_file.read_bytes(folder / f"our_vab_{name}.pkl")) for name in ("words", "idx")
        )
        vectors = npy.parse_npy(path, source_file.read_bytes(path), (None, WORD_SIZE), kinds="f")
    except (FormatError, npy.PickleError) as error:
        raise GuoError(f"{folder}: {error}") from None
    if not isinstance(words, list) or not isinstance(rows, dict):
        raise GuoError(f"{folder}: our_vab_words.pkl must hold a list of words, our_vab_idx.pkl the row of each")
    for word in (START, END, UNKNOWN, *words):
        if not isinstance(row := rows.get(word), int) or not 0 <= row < len(vectors):
            raise GuoError(f"{folder}: our_vab_idx.pkl has the word {word!r} in row {row} of {len(vectors)}")
    return WordVectors(vectors.astype(np.float64), {word: rows[word] for word in (START, END, UNKNOWN, *words)})


class MovementEncoder(nn.Module):
    """Two convolutions that halve time, and a linear layer: one token for every four frames."""

    def __init__(self, num_inputs: int, width: int) -> None:
        super().__init__()
        # The published dropouts are modules 1 and 4; at evaluation they do nothing.
        self.main = nn.Sequential(
            *(nn.Conv1d(num_inputs, width, 4, 2, 1), nn.Identity(), nn.LeakyReLU(SLOPE)),
            *(nn.Conv1d(width, width, 4, 2, 1), nn.Identity(), nn.LeakyReLU(SLOPE)),
        )
        self.out_net = nn.Linear(width, width)

    def forward(self, frames: Float64[Tensor, "frames numbers"]) -> Float64[Tensor, "tokens width"]:
        """Tokens of one motion's standardised frames."""
        tokens: Tensor = self.out_net(self.main(frames.T).T)
        return tokens


class SequenceEncoder(nn.Module):
    """A linear layer, a bidirectional GRU from a learned initial state, and two layers on its two last states."""

    def __init__(self, num_inputs: int, width: int, num_outputs: int) -> None:
        super().__init__()
        self.input_emb = nn.Linear(num_inputs, width)
        self.gru = nn.GRU(width, width, batch_first=True, bidirectional=True)
        self.output_net = nn.Sequential(
            nn.Linear(2 * width, width), nn.LayerNorm(width), nn.LeakyReLU(SLOPE), nn.Linear(width, num_outputs)
        )
        self.hidden = nn.Parameter(torch.zeros(2, 1, width))

    def forward(self, sequences: list[Tensor]) -> Float64[Tensor, "batch outputs"]:
        """One vector for each sequence [steps, numbers], in order; they are packed, so none is padded."""
        packed = pack_sequence(sequences, enforce_sorted=False)
        start = self.hidden.expand(-1, len(sequences), -1).contiguous()
        _, last = self.gru(packed._replace(data=self.input_emb(packed.data)), start)
        outputs: Tensor = self.output_net(torch.cat((last[0], last[1]), dim=-1))
        return outputs


class GuoNetworks(nn.Module):
    """The networks of one evaluator; parameters have the published names. Published widths: 512, 1024, 512, 512."""

    def __init__(self, num_inputs: int, movement: int, motion: int, text: int, shared: int) -> None:
        super().__init__()
        self.movement_encoder = MovementEncoder(num_inputs, movement)
        self.motion_encoder = SequenceEncoder(movement, motion, shared)
        self.text_encoder = SequenceEncoder(WORD_SIZE, text, shared)
        self.text_encoder.add_module("pos_emb", nn.Linear(len(PARTS_OF_SPEECH), WORD_SIZE))

    def embed_motions(self, motions: list[Tensor]) -> Float64[Tensor, "batch shared"]:
        """Embeddings of motions: standardised frames [frames, numbers] of whole tokens."""
        embeddings: Tensor = self.motion_encoder([self.movement_encoder(frames) for frames in motions])
        return embeddings

    def embed_texts(self, sentences: list[tuple[Tensor, Tensor]]) -> Float64[Tensor, "batch shared"]:
        """Embeddings of sentences: word vectors [steps, 300] and parts of speech [steps, tags] of each."""
        tag_encoder = self.text_encoder.get_submodule("pos_emb")
        steps = [words + tag_encoder(tags) for words, tags in sentences]
        embeddings: Tensor = self.text_encoder(steps)
        return embeddings


def fingerprint_of(
    terms: str, network: nn.Module, statistics: Statistics, *others: Float64[np.ndarray, "_rows _numbers"]
) -> str:
    """First 16 hex digits of the sha256 over everything that embeddings depend on."""
    arrays = map(torch.from_numpy, (statistics.mean, statistics.std, *others))
    return loop.weights_digest(
        f"{VERSION} {terms}", network.state_dict() | {f"array {n}": a for n, a in enumerate(arrays)}
    )


@dataclass(frozen=True, eq=False)
class GuoEvaluator:
    """A published evaluator of pose vectors, as a text–motion evaluator and a feature set of clips.

    `embed_frames` embeds motions of standardised frames [frames, inputs], a multiple of 4 frames each; `embed_captions`
    one batch of captions. `pair_score` names the score of pairs that its authors report, empty for Euclidean distances.
    """

    name: str
    kind: GuoKind
    statistics: Statistics
    fingerprint: str
    embed_frames: Callable[[list[Tensor]], Tensor]
    embed_captions: Callable[[list[Caption]], Tensor]
    pair_score: str = ""

    @property
    def fps(self) -> Fraction:
        """The required framerate of the motions: 20, or 12.5 for KIT."""
        return self.kind.published.fps

    @property
    def layout(self) -> str:
        """Joint layout of the motions that it reads: `smpl22`, or `kit21` for KIT."""
        return self.kind.layout.name

    def remark_at(self, fps: Fraction) -> str:
        """Empty: other framerates are refused."""
        return ""

    def embed_motions(self, samples: SampleSet) -> Float64[np.ndarray, "sequences features"]:
        """One row per sequence, in the order of the set, by way of `pose_vectors`.

        T poses are T − 1 frames here. Raises `GuoError` for another framerate or layout, and for a sequence of fewer
        than 5 or more than 200 poses.
        """
        self.check_fps(samples.fps, samples.name)
        return self.embed_vectors(list(map(self.pose_vectors, samples.sequences)), samples.sequence_ids)

    def describe(
        self, clips: Float[np.ndarray, "clips poses joints 3"], fps: Fraction
    ) -> Float64[np.ndarray, "clips features"]:
        """One embedding per clip, in order: each clip is put on the floor, rotated and converted by itself."""
        self.check_fps(fps, "clips")
        return self.embed_vectors(list(map(self.pose_vectors, clips)))

    def embed_vectors(
        self, motions: Sequence[Float[np.ndarray, "_frames numbers"]], names: Sequence[str] = ()
    ) -> Float64[np.ndarray, "motions features"]:
        """One row per motion given as pose vectors in their own units (not standardised), at the evaluator's framerate.

        As in published comparisons, a generator's vectors, times its std plus its mean, are passed directly to the
        evaluator. Lengths are truncated to a multiple of 4. Raises `GuoError`, by the motion's name or index, for
        vectors of another size, NaN, vectors that are still standardised or in another unit, and lengths under 4 or
        over 199.
        """
        kind = self.kind
        for index, motion in enumerate(motions):
            fault = ""
            if motion.ndim != 2 or motion.shape[1] not in (kind.published.num_values, kind.num_statistics):
                fault = f"vectors of shape {motion.shape}; {kind.dataset}'s have {kind.published.num_values} numbers"
            elif not FRAMES_PER_TOKEN <= len(motion) < MAX_FRAMES + FRAMES_PER_TOKEN:
                most = f"{MAX_FRAMES} ({float(MAX_FRAMES / self.fps):.1f} s)"
                fault = f"{len(motion)} frames; the evaluator knows motions of {FRAMES_PER_TOKEN} to {most}"
            elif not np.isfinite(motion).all():
                fault = "holds NaN or infinity"
            if fault:
                raise GuoError(f"{names[index] if names else f'motion {index}'}: {fault}")
        heights = [motion[:, kind.layout.vector.root_height] for motion in motions]
        below = float(np.mean(np.concatenate(heights) < 0))
        if below > MAX_NEGATIVE_HEIGHTS:
            raise GuoError(
                f"the root is below the floor in {below:.0%} of the frames, so these vectors are still "
                "standardised: multiply by the std and add the mean that they were standardised with"
            )
        usual = float(np.median([np.median(each) for each in heights]))
        if not 1 / MOST_HEIGHT_FACTOR < usual / kind.root_height < MOST_HEIGHT_FACTOR:
            raise GuoError(
                f"the root's height is {usual:.3g} in the typical motion, {kind.root_height:.3g} in "
                f"{kind.dataset}: these motions are in another unit"
            )
        whole = [len(motion) // FRAMES_PER_TOKEN * FRAMES_PER_TOKEN for motion in motions]
        mean, std = (each[: kind.num_inputs] for each in (self.statistics.mean, self.statistics.std))

        def embed(rows: list[int]) -> Tensor:
            frames = [motions[row][: whole[row], : kind.num_inputs].astype(np.float64) for row in rows]
            return self.embed_frames([torch.from_numpy((each - mean) / std) for each in frames])

        return _in_batches(whole, embed)

    def embed_texts(self, captions: Sequence[Caption]) -> Float64[np.ndarray, "texts features"]:
        """One row per caption, in order.

        Raises `GuoError` without word vectors, and for a caption without `word/POS` tokens.
        """
        sizes = [len(caption.tokens.split()) for caption in captions]
        return _in_batches(sizes, lambda rows: self.embed_captions([captions[row] for row in rows]))

    def pose_vectors(
        self, joint_positions: Float[np.ndarray, "poses joints 3"]
    ) -> Float32[np.ndarray, "frames numbers"]:
        """The pose vectors of one motion as HumanML3D makes them: T poses give T − 1, as velocities need a next pose.

        `joint_positions` in metres, y up, in the evaluator's `layout`; the clip is moved to the floor and the origin,
        facing Z+. Bones of the 22 joints are scaled to HumanML3D's lengths. Those of KIT's 21 are unchanged: KIT-ML's
        own files all have its reference lengths. Raises `GuoError` for another layout.
        """
        poses, joints, _ = joint_positions.shape
        if joints != self.kind.layout.num_joints or poses < 2:
            raise GuoError(
                f"{poses} poses of {joints} joints: {self.kind.dataset}'s evaluator reads two poses or more of "
                f"{self.kind.layout.num_joints} joints ({self.layout}; KIT's has no clip-FID, which compares 22 joints)"
            )
        if self.kind.published is HUMANML3D:
            return humanml3d.vectors(process(joint_positions, self.layout), self.layout)
        in_unit = joint_positions / np.float32(self.kind.published.unit_metres)
        return humanml3d.vectors(placed(in_unit, self.layout), self.layout)

    def check_fps(self, fps: Fraction, name: str) -> None:
        """Raise `GuoError` for a framerate other than the evaluator's."""
        if fps != self.fps:
            raise GuoError(
                f"{name}: {fps} fps, but {self.kind.dataset}'s evaluator was trained at {float(self.fps):g} fps and "
                f"means nothing at another: evaluate with --fps {float(self.fps):g}"
            )


def _in_batches(sizes: Sequence[int], embed: Callable[[list[int]], Tensor]) -> Float64[np.ndarray, "rows features"]:
    """Rows in the order of the input; batches have inputs of similar size."""
    by_size = np.argsort(sizes, kind="stable")
    starts = range(0, len(by_size), ROWS_AT_ONCE)
    with torch.inference_mode():
        rows = [embed(by_size[start : start + ROWS_AT_ONCE].tolist()).double().numpy() for start in starts]
    return np.concatenate(rows)[np.argsort(by_size)]


def load_guo(files: GuoFiles) -> GuoEvaluator:
    """Load `text_mot_match/model/finest.tar`, and the statistics and word vectors that belong to it.

    Without a folder of statistics (mean.npy, std.npy) the published archive's location is searched. The weights' sizes
    distinguish HumanML3D's evaluator from KIT's, and Guo's from MARDM's. Raises `CheckpointError` for invalid weights
    and `GuoError` for other invalid files.
    """
    path, loaded = files.weights, loop.read_foreign(files.weights)
    tensors = {
        f"{encoder}.{name}": tensor
        for encoder in ENCODERS
        for name, tensor in loop.foreign_tensors(loaded, encoder, path, WHAT).items()
    }
    kind = kind_of(tensors.get("movement_encoder.main.0.weight"), ("guo", "mardm"), path, WHAT)
    # The widths are the sizes of four biases; a name that is missing is reported with the others.
    biases = (f"{ENCODERS[0]}.out_net", f"{ENCODERS[1]}.input_emb", f"{ENCODERS[2]}.input_emb")
    widths = [len(tensors.get(f"{name}.bias", [0])) for name in (*biases, f"{ENCODERS[1]}.output_net.3")]
    networks = GuoNetworks(kind.num_inputs, *widths)
    loop.fill_checked(networks.state_dict(), tensors, "weights", path, WHAT)
    networks = networks.double().eval().requires_grad_(False)
    # Where the published archives have them: text-to-motion's models of both data sets, and T2M-GPT's.
    dataset = path.absolute().parent.parent.parent
    models = ("Comp_v6_KLD01", "Comp_v6_KLD005", "VQVAEV3_CB1024_CMT_H1024_NRES3")
    beside = next((dataset / model / "meta" for model in models if (dataset / model / "meta").is_dir()), None)
    folder = files.statistics or beside
    if folder is None:
        raise GuoError(
            f"{path}: the statistics that belong to these weights are not beside them; name their folder with "
            "--statistics DIR (Comp_v6_KLD01/meta of the published archive; docs/evaluators.md)"
        )
    statistics = read_statistics(folder, kind)
    words = None if files.glove is None else read_word_vectors(files.glove)
    vocabulary = {} if words is None else dict(words.row)
    vectors = () if words is None else (words.vectors,)
    fingerprint = fingerprint_of(f"{kind.name} {kind.dataset} {vocabulary}", networks, statistics, *vectors)

    def embed_captions(captions: list[Caption]) -> Tensor:
        if words is None:
            raise GuoError("the word vectors that Guo's text encoder reads were not given: --glove DIR (our_vab_*)")
        return networks.embed_texts(list(map(words.sentence, captions)))

    return GuoEvaluator(kind.name, kind, statistics, fingerprint, networks.embed_motions, embed_captions)


# MotionCLIP as trained by MARDM (neu-vi/MARDM @ 443313b, utils/evaluators.py): a text and a motion encoder; the cosine
# of their embeddings is its CLIP-score. It reads the numbers that MARDM's other evaluator reads. The text encoder has
# CLIP's vocabulary and token embeddings and a transformer of its own; it attends to all 77 places. The name is its
# class's, and it is not the MotionCLIP of Tevet et al. 2022.
MOTION_CLIP, KEY, NUM_HEADS = "MARDM's MotionCLIP", "contrast_model", 8


def _transformer(width: int, feedforward: int, layers: int) -> nn.TransformerEncoder:
    layer = nn.TransformerEncoderLayer(width, NUM_HEADS, feedforward, activation="gelu", batch_first=True)
    return nn.TransformerEncoder(layer, layers, enable_nested_tensor=False)


class MotionTransformer(nn.Module):
    """The output of a class token that is prepended to motions of one length."""

    def __init__(self, num_inputs: int, num_positions: int, sizes: tuple[int, int, int]) -> None:
        super().__init__()
        width = sizes[0]
        self.query_token = nn.Parameter(torch.zeros(1, width))
        self.embed_motion = nn.Linear(num_inputs, width)
        self.sequence_pos_encoder = nn.ParameterDict({"pe": torch.zeros(num_positions, width)})
        self.transformer = _transformer(*sizes)
        self.out_ln = nn.LayerNorm(width)
        self.out = nn.Linear(width, width)

    def forward(self, frames: Float[Tensor, "batch frames numbers"]) -> Float[Tensor, "batch width"]:
        """One vector per motion."""
        token = self.query_token.expand(len(frames), 1, -1)
        steps = torch.cat((token, self.embed_motion(frames)), dim=1)
        states = self.transformer(steps + self.sequence_pos_encoder["pe"][: steps.shape[1]])
        embedded: Tensor = self.out(self.out_ln(states[:, 0]))
        return embedded


class MotionClip(nn.Module):
    """Both encoders; parameters have the published names. `sizes`: width, width of feedforward layers, layers.

    Published sizes: 512, 1024, 8; 49,408 word pieces, 77 places of a text, 2,000 of a motion.
    """

    def __init__(
        self, num_inputs: int, num_positions: int, vocabulary: int, context: int, sizes: tuple[int, int, int]
    ) -> None:
        super().__init__()
        width = sizes[0]
        self.motion_encoder = MotionTransformer(num_inputs, num_positions, sizes)
        self.token_embedding = nn.Embedding(vocabulary, width)
        self.positional_embedding = nn.Parameter(torch.zeros(context, width))
        self.logit_scale = nn.Parameter(torch.zeros(()))
        self.textTransEncoder = _transformer(*sizes)
        self.text_ln = nn.LayerNorm(width)
        self.out = nn.Linear(width, width)

    def embed_motions(self, motions: list[Tensor]) -> Float[Tensor, "batch width"]:
        """Unit-length embeddings of standardised frames [frames, numbers]; motions of one length form a batch."""
        lengths = np.array([len(motion) for motion in motions])
        embedded = torch.empty(len(motions), len(self.out.bias))
        for length in np.unique(lengths).tolist():
            rows = np.flatnonzero(lengths == length).tolist()
            embedded[rows] = self.motion_encoder(torch.stack([motions[row] for row in rows]).float())
        return nn.functional.normalize(embedded, dim=1)

    def embed_texts(self, tokens: Int64[Tensor, "texts places"]) -> Float[Tensor, "texts width"]:
        """Unit-length embeddings: the state at the first end-of-text token, which has the highest id."""
        states = self.text_ln(self.textTransEncoder(self.token_embedding(tokens) + self.positional_embedding))
        embedded: Tensor = self.out(states[torch.arange(len(tokens)), tokens.argmax(dim=1)])
        return nn.functional.normalize(embedded, dim=1)


def load_motion_clip(folder: Path) -> GuoEvaluator:
    """Load a folder with MARDM's weights and statistics and CLIP's vocabulary, as an evaluator of cosines.

    finest.tar of its `text_mot_match_clip/model`; eval_mean.npy and eval_std.npy of `utils/eval_mean_std`; vocab.json
    and merges.txt.

    Raises `CheckpointError` for invalid weights, `GuoError` for other invalid files, and `MissingExtraError` without
    the extra `text`.
    """
    path = folder / "finest.tar"
    tensors = loop.foreign_tensors(loop.read_foreign(path), KEY, path, MOTION_CLIP)
    kind = kind_of(tensors.get("motion_encoder.embed_motion.weight"), ("mardm",), path, MOTION_CLIP)
    try:
        vocabulary, width = tensors["token_embedding.weight"].shape
        (context, _), (num_positions, _) = (
            tensors[name].shape for name in ("positional_embedding", "motion_encoder.sequence_pos_encoder.pe")
        )
        feedforward = len(tensors["textTransEncoder.layers.0.linear1.bias"])
    except (KeyError, ValueError, TypeError) as error:
        raise loop.CheckpointError(f"{path}: not {MOTION_CLIP} ({error})") from None
    layers = sum(name.startswith("textTransEncoder.") and name.endswith("linear1.bias") for name in tensors)
    network = MotionClip(kind.num_inputs, num_positions, vocabulary, context, (width, feedforward, layers))
    loop.fill_checked(network.state_dict(), tensors, KEY, path, MOTION_CLIP)
    network = network.eval().requires_grad_(False)
    try:
        from transformers import CLIPTokenizer
    except ImportError:
        raise MissingExtraError("transformers", "text") from None
    try:
        tokenizer = CLIPTokenizer.from_pretrained(folder, local_files_only=True)
    except Exception as error:  # the tokenizers library raises no narrower class
        raise GuoError(
            f"{folder}: vocab.json and merges.txt are not a CLIP tokenizer's ({loop.one_line(error)})"
        ) from None
    if len(tokenizer) != vocabulary or tokenizer.eos_token_id != vocabulary - 1:
        raise GuoError(
            f"{folder}: {len(tokenizer)} word pieces with the end of text at {tokenizer.eos_token_id}; CLIP's are "
            f"{vocabulary:,}, this one the last"
        )

    def embed_captions(captions: list[Caption]) -> Tensor:
        # As `clip.tokenize(…, truncate=True)` (openai/CLIP, clip/clip.py), which pads with zeros.
        texts = [caption.text for caption in captions]
        padded = tokenizer(texts, padding="max_length", truncation=True, max_length=context, return_tensors="pt")
        return network.embed_texts(padded["input_ids"] * padded["attention_mask"])

    statistics = read_statistics(folder, kind)
    fingerprint = fingerprint_of(f"motion-clip {kind.dataset}", network, statistics)
    return GuoEvaluator(
        "motion-clip", kind, statistics, fingerprint, network.embed_motions, embed_captions, "clip_score"
    )
