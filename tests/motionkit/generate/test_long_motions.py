"""Motions longer than a model makes: how long the pieces are, that they meet without a jump, that framerates agree."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motionkit.core.errors import UsageError
from motionkit.core.skeleton import SMPL22
from motionkit.generate.long_motions import OVERLAP_SECONDS, generate_joined, pieces_of
from motionkit.generate.models import GenerationRequest
from tests.helpers.analytic import analytic_motion


def script(*seconds, text="walks"):
    return tuple(GenerationRequest(each, text=f"{text} {number}") for number, each in enumerate(seconds))


class Performer:
    """Motions that follow from seed, number and length; every other one a walk."""

    name, skeleton, max_training_fps, max_duration_seconds = "Performer", SMPL22, Fraction(120), 4.0

    def generate(self, requests, *, seed, sampling=None, first=0):
        fields = []
        for number, request in enumerate(requests, start=first):
            field = analytic_motion("walk" if number % 2 else "squat", request.duration_seconds, (seed + number) % 100)
            fields.append(replace(field, skeleton=SMPL22))
        return fields


@given(seconds=st.lists(st.floats(0.6, 60.0), min_size=1, max_size=4), longest=st.floats(1.0, 12.0))
def test_pieces_make_up_the_script_to_the_second(seconds, longest):
    overlap, wanted = OVERLAP_SECONDS, script(*seconds)
    pieces = pieces_of(wanted, longest)
    lengths = np.array([piece.duration_seconds for piece in pieces])
    assert (lengths <= longest + 1e-9).all() and (lengths > overlap).all()
    assert lengths.sum() - (len(pieces) - 1) * overlap == pytest.approx(sum(seconds))
    # Where one request gives way to the next, the middle of the overlap is the end of its seconds.
    middles = np.cumsum(lengths - overlap) + overlap / 2
    of_request = [[piece for piece in pieces if piece.text == request.text] for request in wanted]
    last = np.cumsum([len(each) for each in of_request]) - 1
    np.testing.assert_allclose(middles[last][:-1], np.cumsum(seconds)[:-1])
    for each in of_request:
        assert len(set(each)) == 1
        # One piece fewer would not do.
        shorter = len(each) - 1
        span = each[0].duration_seconds * len(each) - (len(each) - 1) * overlap
        assert shorter == 0 or (span + (shorter - 1) * overlap) / shorter > longest


@pytest.mark.parametrize(
    ("seconds", "longest"), [((8.0,), 0.9), ((2.0, 0.4), 4.0), ((2.0, None), 4.0), ((float("inf"),), 4.0)]
)
def test_what_cannot_be_joined(seconds, longest):
    with pytest.raises(UsageError):
        pieces_of(script(*seconds), longest)


def test_a_motion_follows_from_its_seed_and_number():
    instants = np.linspace(0.0, 9.0, 50)

    def poses(**options):
        return generate_joined(Performer(), script(9.0), **options).query(instants).joint_positions

    np.testing.assert_array_equal(poses(seed=1, number=2), poses(seed=1, number=2))
    assert np.abs(poses(seed=1, number=2) - poses(seed=1, number=3)).max() > 1e-3
    assert np.abs(poses(seed=1, number=2) - poses(seed=2, number=2)).max() > 1e-3
