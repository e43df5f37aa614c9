"""Changes of a store as a whole: remove sequences, compact, merge, split into train, val and test.

A split is by groups: performers, wordings, sources, or other values. All sequences of a group are in one split, so that
there is no leakage. Groups by several values are the connected components of sequences that share any of them. Only the
table of sequences is rewritten.
"""

import re
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from motionkit.core.errors import StoreError, UsageError, counted, describe
from motionkit.core.files import MANIFEST_FILE, SEQUENCES_FILE
from motionkit.core.shapes import Float, Int
from motionkit.store.cache import remove_stale_caches
from motionkit.store.commit import changing, committed, publish, read_manifest, write_pending
from motionkit.store.reader import Store
from motionkit.store.schema import PART_BYTES, part_name
from motionkit.store.writer import StoreWriter

if TYPE_CHECKING:
    import pandas as pd

OnSequence = Callable[[], None]
SHOWN_CONFLICTS = 5

# HumanML3D's own shares.
DEFAULT_SHARES = {"train": 0.8, "val": 0.05, "test": 0.15}
SPLITS = tuple(DEFAULT_SHARES)

# A subject's number means something inside its own source alone: one data set's 01 is not another's. The subset is left
# out, since it may be no more than a folder: the same person's takes as AMC and as BVH.
PERFORMER = "performer"
# The content words of a caption; a sequence has those of all its captions.
WORDING = "wording"
# Words that a paraphrase adds, drops or exchanges.
FUNCTION_WORD = re.compile(
    r"an?|and|the|is|are|in|with|person|human|being|figure|someone|subject|man|woman|boy|girl|s?he|it|his|her|their"
    r"|perform(s|ing|ed)?|do|does|doing|style|way|manner"
)
ENDING = re.compile(r"(?<=[^aeiou])(ying|ies|ie|y)$|(?<=..)(e?ing|ed|es|s|e)+$")
SHORTHANDS = {PERFORMER: "source || '/' || nullif(subject, '')"}
# Number of group orders to try; fewer if there are many groups, as orders then hardly differ.
MOST_ORDERS = 200
GROUPS_TRIED = 50_000


def remove(
    path: Path, sequence_ids: Sequence[str] = (), *, where: str | None = None, dry_run: bool = False
) -> tuple[str, ...]:
    """Remove the sequences with these ids and those that satisfy the SQL condition; returns the removed ids, in order.

    Only the table of sequences is written again. The others keep their `sequence_index`, and a removed number is not
    assigned again before the store is compacted. Parts that hold nothing else are deleted. With `dry_run` nothing is
    changed. Raises `StoreError` for an id that the store does not hold and for a missing store; `BusyError` while
    another process writes to it; `UsageError` for bad SQL.
    """
    if dry_run:
        return tuple(_divided(Store.open(path), sequence_ids, where)[0]["sequence_id"].to_pylist())
    with changing(path, must_exist=True) as previous:
        removed, kept = _divided(Store.open(path), sequence_ids, where)
        if removed.num_rows:
            unused = set(previous.parts) - set(map(part_name, kept["part"].unique().to_pylist()))
            entries = {name: entry for name, entry in previous.files.items() if name not in unused}
            entries[SEQUENCES_FILE] = write_pending(path, SEQUENCES_FILE, kept)
            publish(path, replace(previous, files=entries))
        return tuple(removed["sequence_id"].to_pylist())


def _divided(store: Store, sequence_ids: Sequence[str], where: str | None) -> tuple[pa.Table, pa.Table]:
    """The rows of the sequences to remove, and the other rows."""
    chosen = {store.index_of(sequence_id) for sequence_id in sequence_ids}
    if where is not None:
        chosen.update(store.select(where).tolist())
    is_chosen = pc.is_in(store.sequences_table["sequence_index"], pa.array(sorted(chosen), pa.int32()))
    return store.sequences_table.filter(is_chosen), store.sequences_table.filter(pc.invert(is_chosen))


def compact(path: Path, on_sequence: OnSequence = lambda: None, *, part_bytes: int = PART_BYTES) -> bool:
    """Rewrite a store into full parts without removed sequences, numbered 0, 1, 2 …; False if nothing changes.

    Figures and frames are copied as they are: the parts and rows are those of one ingest of the same motions, but for
    the numbers of the parts, which go on. Until the commit the disk holds both; then the old parts and the training
    caches of earlier states are deleted, also those that a stopped command left. Raises `StoreError` where there is no
    store, or it is damaged; `BusyError` while another process writes to it.
    """
    with changing(path, must_exist=True) as manifest:
        is_full = all(manifest.files[name].num_bytes >= part_bytes for name in manifest.parts[:-1])
        changes = not is_full or manifest.next_sequence_index > manifest.num_sequences
    if changes:
        with StoreWriter.create(path, overwrite=True, part_bytes=part_bytes) as writer:
            # Opened under the lock, so that sequences added by other writers aren't missed.
            store = Store.open(path)
            for motion in store.read_encoded(store.select()):
                writer.add_encoded(motion)
                on_sequence()
    try:
        remove_stale_caches(path, committed(path).fingerprint)
    except OSError as error:
        raise StoreError(
            f"the change of the store {path} is committed, but an old training cache cannot be deleted "
            f"({describe(error)}): delete its folder"
        ) from error
    return changes


def merge(
    out: Path,
    sources: Sequence[Path],
    *,
    where: str | None = None,
    on_start: Callable[[int], None] = lambda num_sequences: None,
    on_sequence: OnSequence = lambda: None,
) -> tuple[int, int]:
    """Copy the sequences of stores, or those for which a SQL condition holds, into one, which is created or added to.

    Returns the numbers of sequences stored, and of those already there.
    Order is that of the sources and of their sequences; frames and figures are copied as they are. A sequence that
    `out` or an earlier source holds from an equal file is left alone; the same id from another file is a conflict,
    and nothing is written. Raises `StoreError` for conflicts and for stores that are missing or damaged; `BusyError`
    while another process writes to `out`; `UsageError` for bad SQL or where nothing is chosen.
    """
    stores = [Store.open(path) for path in sources]
    chosen = [store.select(where) for store in stores]
    if not any(map(len, chosen)):
        raise UsageError("no sequence of the sources is chosen" + (f" by {where!r}" if where else ""))
    appends = (out / MANIFEST_FILE).exists()
    with StoreWriter.append(out) if appends else StoreWriter.create(out) as writer:
        sha256_of: dict[str, str] = {}
        new: list[Int[np.ndarray, new]] = []
        num_known, conflicts = 0, []
        for store, indices in zip(stores, chosen, strict=True):
            columns = store.columns("sequence_id", "source_sha256").loc[indices]
            kept = []
            for index, sequence_id, sha256 in columns.itertuples(name=None):
                if sequence_id not in sha256_of and not writer.holds(sequence_id):
                    sha256_of[sequence_id] = sha256
                    kept.append(index)
                elif (sha256 and sha256_of.get(sequence_id) == sha256) or writer.holds_from(sequence_id, sha256):
                    num_known += 1
                else:
                    conflicts.append(sequence_id)
            new.append(np.array(kept, np.int64))
        if conflicts:
            names = ", ".join(map(repr, conflicts[:SHOWN_CONFLICTS]))
            more = f" and {len(conflicts) - SHOWN_CONFLICTS} more" if len(conflicts) > SHOWN_CONFLICTS else ""
            raise StoreError(
                f"{counted(len(conflicts), 'id')} of two files each: {names}{more}: leave them out by --where"
            )
        on_start(len(sha256_of))
        for store, indices in zip(stores, new, strict=True):
            for motion in store.read_encoded(indices):
                writer.add_encoded(motion)
                on_sequence()
    return len(sha256_of), num_known


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
    num_captions_removed: int
    fingerprint: str


def split(
    path: Path,
    shares: Mapping[str, float] = DEFAULT_SHARES,
    *,
    by: str | Sequence[str] = PERFORMER,
    where: str | None = None,
    seed: int = 0,
    unseen_wordings: bool = False,
    dry_run: bool = False,
) -> SplitReport:
    """Assigns every sequence that satisfies the SQL condition to train, val or test, whole groups at a time.

    `by` is `performer` (source and subject together), `wording` (captions of the same words) or a SQL expression over
    the table of sequences; equal values are a group. Of several, sequences that share a value of any are one group, and
    so is all that hangs together by them; a sequence needs a value of one of them. With `unseen_wordings` the store's
    training sequences lose each caption whose wording val or test has; their motion stays. `shares` are those of the
    sequences' seconds, in any unit; how near they are come by depends on how large the groups are (`assign_groups`).
    With `dry_run` nothing is written. Raises `UsageError` for shares that are not positive, bad SQL, sequences without
    a group, fewer groups than splits, and a group that would be in two splits because `where` leaves out a part of it;
    `StoreError` for a store that is missing or of an earlier version; `BusyError` while another process writes to it.
    """
    target, columns = _checked(shares), (by,) if isinstance(by, str) else tuple(by)
    if dry_run:
        return _plan(Store.open(path), target, columns, where, seed, unseen_wordings)[0]
    with changing(path, must_exist=True) as previous:
        store = Store.open(path)
        report, changed = _plan(store, target, columns, where, seed, unseen_wordings)
        if not report.num_changed and not report.num_captions_removed:
            return report
        table = store.sequences_table
        for name, values in changed.items():
            field = table.schema.field(name)
            table = table.set_column(table.schema.get_field_index(name), field, pa.array(values, field.type))
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
    many orders drawn from the seed the one is taken that misses by least. There are at least as many groups as splits.
    """
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
        given = wrong[0] if wrong else "none"
        raise UsageError(f"shares are positive numbers, such as train=0.8,test=0.2, not {given}")
    return {name: shares[name] / sum(shares.values()) for name in SPLITS if name in shares}


def _plan(
    store: Store, shares: Mapping[str, float], by: tuple[str, ...], where: str | None, seed: int, unseen_wordings: bool
) -> tuple[SplitReport, dict[str, list[Any]]]:
    """The assignment of the chosen sequences, and the new columns `split` and `captions`."""
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
    num_removed = 0
    if unseen_wordings:
        held_out = set().union(*rows["wordings"][after.isin(["val", "test"])])
        for row in np.flatnonzero(after == "train"):
            kept = [caption for caption in captions[row] if wording(caption["text"]) not in held_out]
            num_removed += len(captions[row]) - len(kept)
            captions[row] = kept
            wordings[row] -= held_out
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
    report = SplitReport(store.path, name_of_by, tuple(splits), num_changed, num_removed, store.fingerprint)
    return report, {"split": after.tolist(), "captions": captions}


def wording(caption: str) -> str:
    """A caption's content words without endings, sorted: equal for a caption and its paraphrases by rule."""
    words = re.findall(r"[^\W_]+", caption.casefold())
    stems = (ENDING.sub("", word) for word in words if not FUNCTION_WORD.fullmatch(word))
    return " ".join(sorted(re.sub(r"([^aeiou])\1$", r"\1", stem) for stem in stems))


def _groups(store: Store, by: Sequence[str], wordings: Sequence[Set[str]]) -> list[str | None]:
    """The group of each sequence of the store, named by its first value; None if it has none."""
    from scipy.sparse import coo_array  # deferred: other changes do not need scipy
    from scipy.sparse.csgraph import connected_components

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
    num_without, num_groups = int(chosen["group"].isna().sum()), chosen["group"].nunique()
    if num_without:
        value = PERFORMER if by == PERFORMER else f"value of {by!r}"
        raise UsageError(
            f"{num_without:,} of {len(chosen):,} sequences of {store} have no {value}: leave them out with --where, "
            "hold out something else ('motionkit split --by sequence_id'), or name performers beside the files "
            "(docs/formats.md)"
        )
    if num_groups < num_splits:
        raise UsageError(
            f"{len(chosen):,} sequences of {store} have {num_groups} different values of {by!r}, which cannot fill "
            f"{num_splits} splits: choose fewer (motionkit split --shares train=0.8,test=0.2), or another --by, such "
            "as --by sequence_id"
        )


def _require_whole_groups(group: "pd.Series[str]", splits: "pd.Series[str]", chosen: Set[str], by: str) -> None:
    counts = splits[group.isin(chosen) & (splits != "")].groupby(group).nunique()
    divided = counts.index[counts > 1].tolist()
    if divided:
        raise UsageError(
            f"{len(divided):,} values of {by!r} would be in two splits, since --where leaves out a part of their "
            f"sequences ({divided[0]!r} is one): choose all of them, or split by something finer (--by sequence_id)"
        )
