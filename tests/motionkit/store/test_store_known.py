"""What a writer remembers of sequences, beside a plain dictionary."""

from hypothesis import given
from hypothesis import strategies as st

from motionkit.store import writer
from motionkit.store.writer import KnownSequences

IDS = st.text(max_size=6)


@given(st.dictionaries(IDS, IDS, max_size=40), st.dictionaries(IDS, IDS, max_size=40), st.lists(IDS))
def test_as_a_dictionary_that_holds_everything(there: dict[str, str], added: dict[str, str], others: list[str]) -> None:
    before = writer.RECENT
    writer.RECENT = 7
    try:
        sequences = KnownSequences()
        sequences.add_all(there.items())
        expected = dict(there)
        for name, source in added.items():
            if name not in expected:
                sequences.add(name, source)
                expected[name] = source
    finally:
        writer.RECENT = before
    for name in [*there, *added, *others]:
        assert (name in sequences) == (name in expected)
        assert sequences.is_from(name, expected.get(name, "")) == (name in expected)
        assert not sequences.is_from(name, expected.get(name, "") + "x")


def test_two_ids_that_share_half_of_their_digest(monkeypatch) -> None:
    monkeypatch.setattr(writer, "_digest", lambda text: (7, len(text)))
    sequences = KnownSequences()
    sequences.add_all([("a", "s"), ("bb", "ss")])
    assert "a" in sequences and "bb" in sequences and "ccc" not in sequences
