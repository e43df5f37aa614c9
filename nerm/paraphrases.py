"""Rule-based paraphrases of captions: subject, verb forms, positions of adverbs and clauses.

Words for side, direction, number and negation are kept: no rule adds or removes one. A caption that no rule matches has
no paraphrase.
"""

import re
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

SUBJECTS = ("a person", "someone", "the person", "a human", "a figure", "the subject")
SUBJECT = r"(?:(?:(?:a|the) )?(?:person|human being|human|figure|subject)|someone)(?= )"
ANY_SUBJECT = SUBJECT + r"|(?:(?:a|the) )?(?:man|woman|boy|girl)(?= )|s?he(?= )"
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
LIMB = r"(?:left|right) (?:hand|arm|foot|leg|knee|elbow)"

VerbForm = Literal["base", "third", "ing"]


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
        distinct: dict[str, None] = {}
        for _ in range(4 * count):
            if len(distinct) < count:
                distinct[paraphrased(text, rng)] = None
                distinct.pop(text, None)
        others = tuple(distinct) or (text,)
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


INFLECTED: dict[VerbForm, Callable[[str], str]] = {"base": str, "third": third_person, "ing": participle}
BASE_OF = {form: {inflect(verb): verb for verb in BASE_VERBS} for form, inflect in INFLECTED.items()}
# Positions of verbs of the same subject: first, and after a comma, "and" or "then".
VERB_PLACE = re.compile(r"((?:^|(?<=, )|(?<=\band )|(?<=\bthen ))(?:[a-z]+ly )*)([a-z]+)(?![\w/'-])", re.IGNORECASE)


def _verb_form(text: str) -> Sequence[str]:
    """a person walks → a person is walking, a person walking, walking, walk."""
    match = re.match(ANY_SUBJECT, text, re.IGNORECASE)
    subject = match[0] if match else "a person"
    predicate = text[match.end() + 1 :] if match else text
    if NEGATED.search(text) or " - " in text or (not match and TITLE.match(text)):
        return (text,)
    progressive = match is not None and predicate.startswith("is ")
    predicate = predicate[3 * progressive :]
    source = _form_of(predicate)
    if source is None or (progressive and source != "ing") or (match and source == "base"):
        return (text,)

    def inflected(form: VerbForm) -> str:
        """The predicate with each verb in the form `source` converted to another one."""

        def other(place: re.Match[str]) -> str:
            base = BASE_OF[source].get(place[2].lower())
            return place[0] if base is None else place[1] + INFLECTED[form](base)

        return VERB_PLACE.sub(other, predicate)

    base, third, ing = (inflected(form) for form in INFLECTED)
    return (f"{subject} {third}", f"{subject} is {ing}", f"{subject} {ing}", ing, base)


def _form_of(predicate: str) -> VerbForm | None:
    """The form of the first verb; None if the predicate doesn't begin with a known one."""
    match = VERB_PLACE.match(predicate)
    word = match[2].lower() if match else ""
    return next((form for form, bases in BASE_OF.items() if word in bases), None)


def _adverb(text: str) -> Sequence[str]:
    """a person slowly walks forward → a person walks forward slowly, where there is but one clause."""
    match = re.fullmatch(rf"((?:{ANY_SUBJECT}) (?:is )?)([a-z]+ly) ([^,;]+?)(\.?)", text, re.IGNORECASE)
    if match is None or re.search(r"\b(?:and|then|while|but|as|to)\b", text) or _form_of(match[3]) is None:
        return (text,)
    return (text, f"{match[1]}{match[3]} {match[2]}{match[4]}")


def _reworded(pattern: str, *others: str) -> Callable[[str], Sequence[str]]:
    """The rule that replaces what matches, everywhere, by each of some templates."""
    compiled = re.compile(pattern, re.IGNORECASE)
    return lambda text: (text, *(compiled.sub(other, text) for other in others if compiled.search(text)))


def _performed(text: str) -> Sequence[str]:
    """performs walk turn left → walks and turns left."""
    match = re.match(r"(.*)\bperforms ([a-z]+)\b(?: ([a-z]+)\b)?(.*)", text, re.IGNORECASE)
    if match is None or match[2] not in BASE_VERBS:
        return (text,)
    start, verb, second, rest = match.groups(default="")
    if second in BASE_VERBS:
        second = "and " + third_person(second)
    return (text, f"{start}{third_person(verb)}{' ' * bool(second)}{second}{rest}")


RULES: tuple[Callable[[str], Sequence[str]], ...] = (
    _performed,
    # … in a happy style → in a happy way, in a happy manner; happy style.
    _reworded(
        r"^(.*) in (an?) ([a-z ]+) (?:style|way|manner|fashion)(\.?)$",
        *(rf"\1 in \2 \3 {word}\4" for word in ("style", "way", "manner")),
        r"\1, \3 style\4",
        r"\1, \3\4",
    ),
    _adverb,
    _verb_form,
    _reworded(rf"^{SUBJECT}", *SUBJECTS),
    # raises left hand → raises the left hand, raises their left hand.
    _reworded(rf"(?<!the )(?<!their )(?<!his )(?<!her )(?<!a )(?<!and )(?<!or )\b(?={LIMB}\b)", "the ", "their "),
    # raises up both hands → raises both hands up.
    _reworded(rf"\b(rais\w+|lift\w*) up ((?:(?:the|their|his|her) )?{LIMB}|both hands|both arms)\b", r"\1 \2 up"),
    # A, then B → A and then B.
    _reworded(r"^(.*?)(?:,|, and| and) then ", r"\1, then ", r"\1 and then ", r"\1, and then "),
    # A while walking → while walking, A.
    _reworded(r"^([^,;.]+) (while [a-z]+ing\b[^,;.]*)(\.?)$", r"\2, \1\3"),
    # dance - jump, turn → dance: jump, turn; dance, jump, turn.
    _reworded(r"^(.*?) - ", r"\1: ", r"\1, "),
)
