"""Whether the people of compared takes were also learnt from: what a table has to say of its split."""

from typing import TYPE_CHECKING

from eval.completing.takes import TrueClips

if TYPE_CHECKING:
    from motionkit.store.reader import Store


def told_split(store: "Store", clips: TrueClips, split: str) -> str:
    """How many performers the takes of these clips have, and how many of them are in the training split too."""
    rows = store.columns("source", "subject", "split")
    chosen = rows.loc[sorted(set(clips.sequence_index.tolist()))]
    if (chosen["subject"] == "").all():
        return "the store does not know who performs, so the same people may be in the training split."
    performers = set(zip(chosen["source"], chosen["subject"], strict=True))
    training = rows[rows["split"] == "train"]
    shared = performers & set(zip(training["source"], training["subject"], strict=True))
    if not shared:
        return f"{len(performers)} performers, none of whom is in the training split."
    return (
        f"{len(performers)} performers, {len(shared)} of whom are in the training split too, with other takes "
        "(motionkit split holds out whole performers)."
    )
