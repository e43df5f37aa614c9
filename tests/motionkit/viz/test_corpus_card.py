"""The card of a corpus has every count of its summary, whole and escaped."""

from pathlib import Path
from xml.etree import ElementTree

from motionkit.store.reader import Store
from motionkit.store.reports import summarise
from motionkit.viz.corpus_card import corpus_card
from tests.helpers.tiny import write_store


def test_every_count_is_drawn_and_a_strangers_names_are_text(tmp_path: Path) -> None:
    write_store(tmp_path / "<b>store")
    summary = summarise(Store.open(tmp_path / "<b>store"))
    (source,) = summary.sources
    article = corpus_card(summary).strip()
    assert "<b>store" not in article and "&lt;b&gt;store" in article and "src=" not in article and "http" not in article
    items = [[text for text in each.itertext() if text.strip()] for each in ElementTree.fromstring(article).iter("li")]
    for counts in (source.framerates, source.durations, source.splits, source.formats):
        drawn = [[name or "not stated", f"{count:,}"] for name, count in counts.items()]
        assert drawn and [each for each in drawn if each not in items] == []
    assert sum(source.durations.values()) == source.num_sequences
    assert article.startswith("<article") and "<html" not in article
