"""For which takes samples were made: by name, by caption, or for nobody knows which."""

from fractions import Fraction

import numpy as np

from eval.sample_folder.folder import SampleFolder, SampleMotion
from eval.sample_folder.takes import takes_of_samples
from eval.sets.motions import RealMotion
from eval.sets.sets import Ragged

IDS = ("slow", "fast", "other")
RATES = tuple(map(Fraction, (20, 120, 120)))
FRAMES = np.zeros((40, 22, 3), dtype=np.float32)


def real(captions: tuple[str, ...] = ("walk", "walk", "jump")) -> RealMotion:
    return RealMotion("real", Ragged.of([FRAMES] * 3), RATES, IDS, captions, ("",) * 3)


def motion(sequence_id: str, caption: str = "", group: str = "") -> SampleMotion:
    return SampleMotion(sequence_id, FRAMES, Fraction(120), caption, group=group)


def folder(*motions: SampleMotion) -> SampleFolder:
    return SampleFolder.of("theirs", motions)


def test_names_say_it_with_or_without_folder_and_ending() -> None:
    samples = folder(motion("a/fast.npy"), motion("b/fast.npy"), motion("nobody.npy"))
    found = takes_of_samples(samples, real())
    assert found.takes == ("fast", "fast", "")
    assert found.num_without == 1
    column = found.of_column(samples.at(Fraction(120)), real().at(Fraction(120)))
    assert column is not None
    assert (column.takes, column.generations, column.num_takes) == (("fast", "fast"), (0, 1), 1)


def test_a_caption_goes_to_its_takes_in_turn_the_fastest_first() -> None:
    walks = [motion(f"{number}.npy", "walk") for number in range(3)]
    found = takes_of_samples(folder(*walks, motion("3.npy", "jump"), motion("4.npy", "swim")), real())
    assert found.takes == ("fast", "slow", "fast", "other", "")


def test_answers_to_one_prompt_have_one_take() -> None:
    walks = [motion(f"{number}.npy", "walk", group=f"prompt {number // 2}") for number in range(4)]
    assert takes_of_samples(folder(*walks), real()).takes == ("fast", "fast", "slow", "slow")


def test_a_column_has_the_samples_of_its_takes() -> None:
    samples = folder(motion("slow.npy"), motion("fast.npy"))
    found = takes_of_samples(samples, real())
    column = found.of_column(samples.at(Fraction(60)), real().at(Fraction(60)))
    assert column is not None
    assert (column.takes, column.generations) == (("fast",), ())
    alone = folder(motion("slow.npy"))
    assert takes_of_samples(alone, real()).of_column(alone.at(Fraction(60)), real().at(Fraction(60))) is None


def test_samples_that_name_no_take_stay_together_by_prompt() -> None:
    samples = folder(motion("x.npy", "swim", group="a"), motion("y.npy", "swim", group="a"))
    found = takes_of_samples(samples, real())
    column = found.of_column(samples.at(Fraction(120)), real().at(Fraction(120)))
    assert column is not None
    assert (column.num_sequences, column.takes, found.num_without) == (2, ("a", "a"), 0)
    assert not any(takes_of_samples(folder(motion("x.npy")), real(("", "", ""))).takes)
