"""Splits of sequences into train, val and test by groups: performers, wordings, sources, or other values.

All sequences of a group (a performer, say) are in one split, so that there is no leakage. Groups by several values are
the connected components of sequences that share any of them. Only the table of sequences is rewritten.
"""

import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from motionkit.core.errors import UsageError
from motionkit.core.shapes import Float, Int
from motionkit.store.commit import changing, publish, read_manifest, write_pending
from motionkit.store.reader import Store
from motionkit.store.schema import SEQUENCES_FILE

if TYPE_CHECKING:
    import pandas as pd

# HumanML3D's own shares.
DEFAULT_SHARES = {"train": 0.8, "val": 0.05, "test": 0.15}
SPLITS = tuple(DEFAULT_SHARES)

# A subject's number means something inside its own source alone: one data set's 01 is not another's. The subset is left
# out, since it may be no more than a folder: the same person's takes as AMC and as BVH.
PERFORMER = "performer"
# The words of a caption, whatever their case and punctuation; a sequence has those of all its captions.
WORDING = "wording"
SHORTHANDS = {PERFORMER: "source || '/' || nullif(subject, '')"}
# Number of group orders to try; fewer if there are many groups, as orders then hardly differ.
MOST_ORDERS = 200
GROUPS_TRIED = 50_000
SHOWN = 3


@dataclass(frozen=True)
class SplitShare:
    """One split after the assignment: its part of the chosen sequences, and the requested share of their seconds.

    `num_captioned` sequences have captions, of which those of `num_seen` have a wording of the training split too.
    """

    split: str
    num_sequences: int
    num_groups: int
    duration_seconds: float
    requested_share: float
    share: float
    num_captioned: int
    num_seen: int


@dataclass(frozen=True)
class SplitReport:
    """What `split` did; `num_changed` sequences are in another split than before."""

    store: Path
    by: str
    splits: tuple[SplitShare, ...]
    num_changed: int
    fingerprint: str


def split(
    path: Path,
    shares: Mapping[str, float] = DEFAULT_SHARES,
    *,
    by: str | Sequence[str] = PERFORMER,
    where: str | None = None,
    seed: int = 0,
    dry_run: bool = False,
) -> SplitReport:
    """Assigns every sequence that satisfies the SQL condition to train, val or test, whole groups at a time.

    `by` is `performer` (source and subject together), `wording` (captions of the same words) or a SQL expression over
    the table of sequences; equal values are a group. Of several, sequences that share a value of any are one group, and
    so is all that hangs together by them; a sequence needs a value of one of them. `shares` are those of the sequences'
    seconds, in any unit; how near they are come by depends on how large the groups are (`assign_groups`). With
    `dry_run` nothing is written. Raises `UsageError` for shares that are not positive, bad SQL, sequences without a
    group, fewer groups than splits, and a group that would be in two splits because `where` leaves out a part of it;
    `StoreError` for a store that is missing or of an earlier version; `BusyError` while another process writes to it.
    """
    target, columns = _checked(shares), (by,) if isinstance(by, str) else tuple(by)
    if dry_run:
        store = Store.open(path)
        return _plan(store, target, columns, where, seed)[0]
    with changing(path, must_exist=True) as previous:
        store = Store.open(path)
        report, column = _plan(store, target, columns, where, seed)
        if not report.num_changed:
            return report
        place = store.sequences_table.schema.get_field_index("split")
        table = store.sequences_table.set_column(place, store.sequences_table.schema.field(place), column)
        publish(
            path,
            replace(previous, files={**previous.files, SEQUENCES_FILE: write_pending(path, SEQUENCES_FILE, table)}),
        )
    return replace(report, fingerprint=read_manifest(path).fingerprint)


def assign_groups(
    seconds: Float[np.ndarray, "groups"], shares: Sequence[float], seed: int
) -> Int[np.ndarray, "groups"]:
    """For each group the split (its place in `shares`) that it comes into; every split gets one group at least.

    Groups come in a random order, each into the split that then lacks most of its share of the seconds, so a split has
    at most the largest group's length too much. Where groups are few and unequal one order may miss by that much: of
    many orders drawn from the seed the one is taken that misses by least. Raises `ValueError` for fewer groups than
    splits.
    """
    if len(seconds) < len(shares):
        raise ValueError(f"{len(seconds)} groups cannot fill {len(shares)} splits")
    target = np.asarray(shares) / np.sum(shares) * seconds.sum()
    generator = np.random.default_rng(seed)
    num_orders = max(1, min(MOST_ORDERS, GROUPS_TRIED // len(seconds)))
    tried = [_in_order(seconds, target, generator.permutation(len(seconds))) for _ in range(num_orders)]
    return min(tried, key=lambda split: np.abs(np.bincount(split, seconds, len(shares)) - target).max())


def _in_order(
    seconds: Float[np.ndarray, "groups"], target: Float[np.ndarray, "splits"], order: Int[np.ndarray, "groups"]
) -> Int[np.ndarray, "groups"]:
    lacking = target.copy()
    split = np.empty(len(seconds), dtype=np.int64)
    empty = set(range(len(target)))
    for num_left, group in zip(range(len(order), 0, -1), order, strict=True):
        # The last groups go to splits that would otherwise stay empty.
        open_to = sorted(empty) if num_left == len(empty) else range(len(target))
        chosen = max(open_to, key=lambda place: lacking[place])
        split[group] = chosen
        lacking[chosen] -= seconds[group]
        empty.discard(chosen)
    return split


def _checked(shares: Mapping[str, float]) -> dict[str, float]:
    unknown = [name for name in shares if name not in SPLITS]
    if unknown:
        raise UsageError(f"no split is called {unknown[0]!r}: there are {', '.join(SPLITS)}")
    wrong = [share for share in shares.values() if not 0 < share < float("inf")]
    if wrong or not shares:
        found = wrong[0] if wrong else "none"
        raise UsageError(f"shares are positive numbers, such as train=0.8,test=0.2, not {found}")
    return {name: shares[name] / sum(shares.values()) for name in SPLITS if name in shares}


def _plan(
    store: Store, shares: Mapping[str, float], by: tuple[str, ...], where: str | None, seed: int
) -> tuple[SplitReport, pa.Array]:
    """The assignment of the chosen sequences, and the new column `split`."""
    captions = store.sequences_table["captions"].to_pylist()
    wordings = [{wording(caption["text"]) for caption in each} - {""} for each in captions]
    added: dict[str, Any] = {"wordings": wordings, "group": _groups(store, by, wordings)}
    rows = store.columns("source", "duration_seconds", "split").assign(**added)
    chosen = rows.loc[store.select_some(where)]
    name_of_by = " and ".join(by)
    if len(shares) > 1:  # else all of them have one split, with or without a group
        _require_groups(store.path, chosen, name_of_by, len(shares))
    # By name, so that neither the order of the sequences nor what is left out moves a group.
    groups, group = np.unique(chosen["group"].fillna("").to_numpy(str), return_inverse=True)
    seconds = np.bincount(group, weights=chosen["duration_seconds"], minlength=len(groups))
    assigned = assign_groups(seconds, list(shares.values()), seed)
    after = rows["split"].copy()
    after[chosen.index] = np.array(list(shares), object)[assigned[group]]
    _require_whole_groups(rows["group"], after, set(groups) - {""}, name_of_by)
    training = set().union(*rows["wordings"][after == "train"])
    splits = []
    for number, name in enumerate(shares):
        own = chosen["wordings"][assigned[group] == number]
        own_seconds = float(seconds[assigned == number].sum())
        share = SplitShare(
            split=name,
            num_sequences=len(own),
            num_groups=int((assigned == number).sum()),
            duration_seconds=own_seconds,
            requested_share=shares[name],
            share=own_seconds / float(seconds.sum()),
            num_captioned=sum(map(bool, own)),
            num_seen=sum(bool(each & training) for each in own),
        )
        splits.append(share)
    num_changed = int((after != rows["split"]).sum())
    report = SplitReport(store.path, name_of_by, tuple(splits), num_changed, store.fingerprint)
    return report, pa.array(after.to_numpy(), pa.string())


def wording(caption: str) -> str:
    """A caption's words in lower case, without punctuation: equal for captions that say the same in the same words."""
    return " ".join(re.findall(r"[^\W_]+", caption.casefold()))


def _groups(store: Store, by: Sequence[str], wordings: Sequence[Set[str]]) -> list[str | None]:
    """The group of each sequence of the store, named by its first value; None if it has none."""
    values: list[set[tuple[str, str]]] = [set() for _ in wordings]
    for each in by:
        of_rows = wordings if each == WORDING else _values(store, each)
        for row, some in zip(values, of_rows, strict=True):
            row |= {(each, value) for value in some}
    # Rows and values are the two sides of a graph, whose connected components are the groups.
    number = {value: place for place, value in enumerate(sorted(set().union(*values)))}
    edges = np.array(
        [(row, len(values) + number[value]) for row, some in enumerate(values) for value in some], np.int64
    )
    size = len(values) + len(number)
    rows, columns = edges.reshape(-1, 2).T
    component = connected_components(coo_array((np.ones(len(rows)), (rows, columns)), shape=(size, size)))[1]
    first: dict[int, str] = {}
    for (_, value), place in number.items():
        first.setdefault(int(component[len(values) + place]), value)
    return [first[int(component[row])] if some else None for row, some in enumerate(values)]


def _values(store: Store, by: str) -> list[set[str]]:
    """The value of a SQL expression for each sequence, as a set; empty if null."""
    expression = f"nullif(CAST(({SHORTHANDS.get(by, by)}) AS VARCHAR), '')"
    try:
        table = store.query(f"SELECT {expression} AS value FROM sequences ORDER BY sequence_index")
    except UsageError as error:
        raise UsageError(f"--by {by!r} is not a valid expression: {error}") from None
    return [set() if value is None else {value} for value in table["value"].to_pylist()]


def _require_groups(store: Path, chosen: "pd.DataFrame", by: str, num_splits: int) -> None:
    unnamed = chosen[chosen["group"].isna()]
    if len(unnamed):
        sources = sorted(set(unnamed["source"].replace("", "unnamed")))
        without = f"{len(unnamed):,} of {len(chosen):,} sequences of {store} (sources: {_some(sources)}) "
        if by == PERFORMER:
            raise UsageError(
                f"{without}have no performer: 'motionkit split --by sequence_id' holds out sequences, whoever performs "
                f"them; or say who does in a column 'performer' of a table beside the files (docs/formats.md) and "
                f"ingest again with --overwrite; or leave them out (--where \"subject <> ''\"), or hold out something "
                f"else (--by source, or any SQL over their ids)"
            )
        raise UsageError(f"{without}have no value of {by!r}: leave them out with --where")
    if chosen["group"].nunique() < num_splits:
        raise UsageError(
            f"{len(chosen):,} sequences of {store} have {chosen['group'].nunique()} different values of {by!r}, which "
            f"cannot fill {num_splits} splits: choose fewer (motionkit split --shares train=0.8,test=0.2), or another "
            "--by, such as --by sequence_id"
        )


def _require_whole_groups(group: "pd.Series[str]", splits: "pd.Series[str]", chosen: Set[str], by: str) -> None:
    named = splits[group.isin(chosen) & (splits != "")]
    counts = named.groupby(group).nunique()
    divided = counts.index[counts > 1].tolist()
    if divided:
        raise UsageError(
            f"{len(divided):,} values of {by!r} would be in two splits, since --where leaves out a part of their "
            f"sequences ({_some(divided)}): choose all of them, or split by something finer (--by sequence_id)"
        )


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN:,} more" if len(names) > SHOWN else ""
    return ", ".join(map(repr, names[:SHOWN])) + more
