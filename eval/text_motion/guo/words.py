"""Captions as Guo's text encoder reads them: GloVe vectors and parts of speech of `word/POS` tokens.

Files: our_vab_data.npy, our_vab_words.pkl and our_vab_idx.pkl, 4,199 words of 300 numbers. Source: text-to-motion,
utils/word_vectorizer.py and data/dataset.py.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eval.text_motion.guo.kind import GuoError
from motionkit.core.errors import FormatError
from motionkit.core.motion import Caption
from motionkit.core.shapes import Float64
from motionkit.io import npy, source_file
from motionkit.io.npy import PickleError, parse_pickle

PREFIX = "our_vab"
NUM_NUMBERS = 300
LARGEST_BYTES = 64 << 20
MAX_TOKENS = 20
"""Maximum number of a caption's tokens, without `sos` and `eos`."""
PARTS_OF_SPEECH = (
    *("VERB", "NOUN", "DET", "ADP", "NUM", "AUX", "PRON", "ADJ", "ADV"),
    *("Loc_VIP", "Body_VIP", "Obj_VIP", "Act_VIP", "Desc_VIP", "OTHER"),
)
OTHER = PARTS_OF_SPEECH.index("OTHER")
START, END, UNKNOWN = "sos", "eos", "unk"
# The tag of captions without tokens in exported folders. A tagger gives it to single words, hardly to whole sentences.
UNTAGGED, UNTAGGED_WORDS = "X", 3

_IMPORTANT = {
    "Loc_VIP": "left right clockwise counterclockwise anticlockwise forward back backward up down straight curve",
    "Body_VIP": "arm chin foot feet face hand mouth leg waist eye knee shoulder thigh",
    "Obj_VIP": "stair dumbbell chair window floor car ball handrail baseball basketball",
    "Act_VIP": (
        "walk run swing pick bring kick put squat throw hop dance jump turn stumble stop sit lift lower raise wash "
        "stand kneel stroll rub bend balance flap jog shuffle lean rotate spin spread climb"
    ),
    "Desc_VIP": "slowly carefully fast careful slow quickly happy angry sad happily angrily sadly",
}
IMPORTANT_WORDS: Mapping[str, int] = {
    word: PARTS_OF_SPEECH.index(part) for part, words in _IMPORTANT.items() for word in words.split()
}
"""Words with their own part of speech, which overrides the token's."""


@dataclass(frozen=True, eq=False)
class Sentence:
    """The text encoder's input for one caption: `words` [steps, 300], `parts` [steps, 15] one-hot."""

    words: Float64[np.ndarray, "steps 300"]
    parts: Float64[np.ndarray, "steps parts"]


@dataclass(frozen=True, eq=False)
class WordVectors:
    """GloVe vectors [words, 300] of a vocabulary; `row` is the index of a word."""

    vectors: Float64[np.ndarray, "words 300"]
    row: Mapping[str, int]

    def sentence(self, caption: Caption) -> Sentence:
        """The caption's first 20 tokens between `sos` and `eos`; words outside the vocabulary are `unk`/OTHER.

        Raises `GuoError` for a caption without tokens, or with one that is not `word/POS`.
        """
        known = [self._known(word, part) for word, part in (("sos", ""), *_tokens(caption), ("eos", ""))]
        rows, parts = zip(*known, strict=True)
        return Sentence(self.vectors[list(rows)], np.eye(len(PARTS_OF_SPEECH))[list(parts)])

    def _known(self, word: str, part: str) -> tuple[int, int]:
        if word not in self.row:
            return self.row[UNKNOWN], OTHER
        named = PARTS_OF_SPEECH.index(part) if part in PARTS_OF_SPEECH else OTHER
        return self.row[word], IMPORTANT_WORDS.get(word, named)


def _tokens(caption: Caption) -> list[tuple[str, str]]:
    tokens = caption.tokens.split()
    if not tokens:
        raise GuoError(
            f"caption {caption.text!r} has no word/POS tokens, which Guo's text encoder reads; HumanML3D's and KIT's "
            "texts/*.txt have them (spaCy's en_core_web_sm made them; docs/evaluators.md)"
        )
    pairs = []
    for token in tokens[:MAX_TOKENS]:
        word, slash, part = token.rpartition("/")
        if not slash or not word:
            raise GuoError(f"caption {caption.text!r}: token {token!r} is not of the form word/POS")
        pairs.append((word, part))
    if len(pairs) >= UNTAGGED_WORDS and all(part == UNTAGGED for _, part in pairs):
        raise GuoError(
            f"caption {caption.text!r}: all its tokens are /X, as motionkit writes them for captions that nobody "
            "tagged; take the tokens of HumanML3D's or KIT's own texts"
        )
    return pairs


def read_word_vectors(folder: Path) -> WordVectors:
    """The three published files of a folder, the pickles among them as plain data.

    Raises `GuoError` if one is missing, damaged, holds anything but words and numbers, or if they disagree.
    """
    words, places = (_read_plain(folder / f"{PREFIX}_{name}.pkl") for name in ("words", "idx"))
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
        raise GuoError(f"{folder / PREFIX}_words.pkl: expected a list of words")
    if not isinstance(places, dict) or not all(isinstance(row, int) for row in places.values()):
        raise GuoError(f"{folder / PREFIX}_idx.pkl: expected a dictionary from words to their rows")
    path = folder / f"{PREFIX}_data.npy"
    try:
        vectors = npy.parse_npy(path, source_file.read_bytes(path), (None, NUM_NUMBERS))
    except FormatError as error:
        raise GuoError(str(error)) from None
    if vectors.dtype.kind != "f" or not np.isfinite(vectors).all():
        raise GuoError(f"{path}: expected finite floating-point numbers")
    for word in (START, END, UNKNOWN, *words):
        if not 0 <= places.get(word, -1) < len(vectors):
            place = f"row {places[word]} of {len(vectors)}" if word in places else "missing"
            raise GuoError(f"{folder}: the word {word!r} is {place} in {PREFIX}_idx.pkl")
    return WordVectors(vectors.astype(np.float64), {word: places[word] for word in (START, END, UNKNOWN, *words)})


def _read_plain(path: Path) -> object:
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise GuoError(f"{path}: {path.stat().st_size:,} bytes are too many for a list of words")
        return parse_pickle(path.read_bytes())
    except (OSError, PickleError) as error:
        raise GuoError(f"{path}: {error}") from None
