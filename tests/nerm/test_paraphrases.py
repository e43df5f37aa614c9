"""Paraphrases say the same: no side, number, direction or negation comes or goes."""

import re
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.data.captions import mirrored_text
from motionkit.store.life import wording
from nerm.paraphrases import (
    BASE_VERBS,
    RULES,
    paraphrased,
    participle,
    third_person,
    with_paraphrases,
)

KEPT = re.compile(
    r"\b(?:left|right|both|(?:counter|anti)?clockwise|\d+|one|two|three|four|once|twice|times|not|no|never|without|"
    r"\w+n't|forwards?|backwards?|sideways|up|down|straight|around|back|in place|slowly|quickly)\b"
)


def said(text: str) -> Counter[str]:
    """The words that no paraphrase may add, lose or change, with how often they stand."""
    return Counter(KEPT.findall(text.lower()))


def options(text: str) -> set[str]:
    """All that may be drawn."""
    found = {text}
    for rule in RULES:
        found = {other for each in found for other in rule(each)}
    return found - {text}


PHRASES = st.sampled_from(
    """forward|backwards for 3 steps|up left hand|their right foot|around twice|up both hands|in a clockwise circle
    |without moving the right arm|slowly|down with two hands|straight|the ball with his left foot|
    |sideways, the left hand in front""".replace("\n    ", "").split("|")
)
VERBS = st.sampled_from(BASE_VERBS)


@st.composite
def captions(draw: st.DrawFn) -> str:
    """Sentences, participles, titles and performed actions, of one clause or several."""
    subject = draw(st.sampled_from(["a person ", "The man ", "someone ", "she ", "", "two people "]))
    form = draw(st.sampled_from(["third", "is ing", "ing", "base", "performs", "does not"]))
    inflect = {"third": third_person, "is ing": participle, "ing": participle}.get(form, str)
    before = {"is ing": "is ", "performs": "performs ", "does not": "does not "}.get(form, "")
    before += draw(st.sampled_from(["", "", "slowly ", "quickly "]))
    joint = st.sampled_from([", ", " and ", ", then ", " and then ", " while "])
    clauses = draw(st.lists(st.tuples(VERBS, PHRASES, joint), min_size=1, max_size=3))
    text = subject + before
    for verb, phrase, _ in clauses[:1]:
        text += f"{inflect(verb)} {phrase}".rstrip()
    for (verb, phrase, _), (_, _, word) in zip(clauses[1:], clauses[:-1], strict=True):
        text += word + f"{participle(verb) if word == ' while ' else inflect(verb)} {phrase}".rstrip()
    return text + draw(st.sampled_from(["", ".", " in a happy style", " in an old manner."]))


@given(text=captions() | st.text(max_size=60), seed=st.integers(0, 2**32))
def test_no_rule_adds_or_removes_what_a_motion_depends_on(text, seed):
    for rule in RULES:
        for other in rule(text):
            assert said(other) == said(text), other
    assert said(paraphrased(text, np.random.default_rng(seed))) == said(text)


@given(text=captions(), seed=st.integers(0, 2**32))
def test_a_paraphrase_in_a_mirror_is_the_mirrored_captions(text, seed):
    here, there = (np.random.default_rng(seed) for _ in range(2))
    text = mirrored_text(text)  # "counter-clockwise" and its like in the one way that a mirror writes them
    assert mirrored_text(paraphrased(text, here)) == paraphrased(mirrored_text(text), there)


@pytest.mark.parametrize(
    ("text", "among"),
    [
        ("a person walks forward", {"someone is walking forward", "walking forward", "walk forward"}),
        ("jump, balance", {"a person jumps, balances", "jumping, balancing"}),
        ("a person runs and carries a box", {"the subject is running and carrying a box"}),
        ("a person slowly walks back", {"a person walks back slowly", "walking back slowly"}),
        ("a person hops, then sits", {"a person hops and then sits", "hopping, and then sitting"}),
        ("someone walks while waving", {"while waving, someone walks"}),
        (
            "a person performs raise up left hand in a active style",
            {
                "a person raises their left hand up in a active manner",
                "raising up the left hand, active",
                "a human performing raise up left hand in a active way",
            },
        ),
        ("a person performs walk turn right in a old style", {"a person walks and turns right in a old way"}),
    ],
)
def test_known_wordings(text, among):
    assert among <= options(text)


@given(text=captions())
def test_a_split_by_wording_knows_every_paraphrase(text):
    assert {wording(option) for option in options(text)} <= {wording(text)}


def test_captions_of_a_window_stay_equally_likely():
    captions = [("a person walks", "Empi"), (), ("a person walks",)]
    found = with_paraphrases(captions, 5, np.random.default_rng(0))
    both, none, walk = map(Counter, found)
    assert both["Empi"] == walk.total() == both.total() / 2 == 10
    assert walk["a person walks"] == 5
    assert len(walk) > 3
    assert not none
    assert with_paraphrases(captions, 0, np.random.default_rng(0)) == captions
