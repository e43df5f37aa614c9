"""Whatever is in an index, what comes out is an index or the project's own error."""

import json
from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from motionkit.core.errors import FormatError
from motionkit.io.indexes import read_index

HEADER = b"source_path,start_frame,end_frame,new_name\n"
MANY = settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])

cells = st.one_of(
    st.text(max_size=12),
    st.integers(-(10**12), 10**12).map(str),
    st.sampled_from(["KIT/3/a_poses.npy", "../x.npy", "0", "-1", "1.0", "nan", '"', "a,b", "\r", "\0", "humanact12/a"]),
)  # fmt: skip
scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(["KIT/3/a", "../a", "M/a"]),
)
KEYS = (
    "path", "duration", "annotations", "text", "start", "end", "feat_p", "seq_ann", "seq_anns", "frame_ann",
    "frame_anns", "labels", "raw_label", "act_cat", "start_t", "end_t",
)  # fmt: skip
values = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(KEYS), inner), max_leaves=8
)
sequences = st.dictionaries(st.sampled_from(KEYS), values)


def try_reading(path: Path) -> None:
    try:
        index = read_index(path)
    except FormatError as problem:
        assert problem.path == path
        return
    for entry in index.entries:
        assert ".." not in entry.parts
        assert not Path(*entry.parts).is_absolute()
        assert Path(entry.name).name == entry.name
    assert all(problem.path == path for problem in index.problems)
    assert len({entry.name for entry in index.entries}) == len(index.entries)


@MANY
@given(rows=st.lists(st.lists(cells, max_size=6), max_size=5))
def test_tables(tmp_path, rows):
    path = tmp_path / "index.csv"
    path.write_bytes(HEADER + "\n".join(",".join(row) for row in rows).encode("utf-8", "surrogatepass"))
    try_reading(path)


@settings(MANY, max_examples=50)
@given(value=st.dictionaries(st.text(max_size=6), sequences | values, min_size=1), first=st.sampled_from(KEYS))
def test_json(tmp_path, value, first):
    path = tmp_path / "index.json"
    # A first value that is recognised, so that the others are looked at.
    known = {"path": "KIT/3/a", "annotations": []} if first != "feat_p" else {"feat_p": "KIT/KIT/3/a.npz"}
    path.write_text(json.dumps({"known": known, **value}))
    try_reading(path)


@MANY
@given(data=st.binary(max_size=200), head=st.sampled_from([b"", HEADER, b'{"a": {"path": "KIT/3/a", "annotations": ']))
def test_bytes(tmp_path, data, head):
    path = tmp_path / "index"
    path.write_bytes(head + data)
    try_reading(path)
