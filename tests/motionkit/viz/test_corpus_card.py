"""The card of a corpus has every count of its summary, whole and escaped."""

from html.parser import HTMLParser
from pathlib import Path

from motionkit.store.reader import Store
from motionkit.store.reports import summarise
from motionkit.viz.corpus_card import corpus_card
from tests.helpers.tiny import write_store


class Items(HTMLParser):
    """The texts of list items, and whether every element is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.texts: list[list[str]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag != "meta":
            self.open.append(tag)
        if tag == "li":
            self.texts.append([])

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "li" in self.open and data.strip():
            self.texts[-1].append(data)


def test_every_count_is_drawn_and_a_strangers_names_are_text(tmp_path: Path) -> None:
    store = tmp_path / "<b>store"
    write_store(store)
    summary = summarise(Store.open(store))
    (source,) = summary.sources
    page, items = corpus_card(summary, whole_page=True), Items()
    items.feed(page)
    assert not items.open and "<b>store" not in page and "&lt;b&gt;store" in page
    for counts in (source.framerates, source.durations, source.splits, source.formats):
        drawn = [[name or "not stated", f"{count:,}"] for name, count in counts.items()]
        assert drawn and [each for each in drawn if each not in items.texts] == []
    assert sum(source.durations.values()) == source.num_sequences
    assert "src=" not in page and "http" not in page
    assert corpus_card(summary).lstrip().startswith("<article") and "<html" not in corpus_card(summary)
