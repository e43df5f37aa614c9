"""`motionkit info`, `validate`, `query` as a person sees them."""

import json

import pytest

from motionkit.store import Store


@pytest.fixture
def store(motionkit, takes, tmp_path):
    (takes / "clips.csv").write_text("file,caption,split\nalpha.bvh,a person slides,train\nbeta.bvh,it slides,test\n")
    motionkit("ingest", takes, "--store", tmp_path / "store", "--workers", 1)
    return tmp_path / "store"


def test_info(motionkit, store):
    outcome = motionkit("info", "--store", store)
    assert outcome.code == 0
    lines = outcome.stdout.splitlines()
    assert lines[0] == f"{store}: 3 sequences, 0.00 h, 15 frames, 1 skeletons"
    for line in (
        "source      takes",
        "fps         30 (3)",
        "splits      none (1), test (1), train (1)",
        "captions    2 on 2 sequences",
        "skeletons   1 with 6 joints",
        "formats     bvh (3)",
    ):
        assert line in lines
    assert lines[-1] == f"fingerprint {Store.open(store).fingerprint}"


def test_query(motionkit, store):
    sql = "SELECT sequence_id, num_frames / fps AS seconds, split FROM sequences ORDER BY 1 LIMIT 2"
    as_table = motionkit("query", sql, "--store", store)
    assert as_table.code == 0
    assert "takes/alpha" in as_table.stdout
    assert "0.133333" in as_table.stdout
    as_json = json.loads(motionkit("query", sql, "--store", store, "--json").stdout)
    assert as_json[1] == {"sequence_id": "takes/beta", "seconds": pytest.approx(5 / 30), "split": "test"}


@pytest.mark.parametrize(
    "sql",
    [
        "SELECT nothing FROM sequences",
        "SELEC",
        "",
        "CREATE TABLE mine (a INTEGER)",
        "COPY sequences TO 'stolen.csv'",
        "SELECT * FROM read_text('/etc/passwd')",
        "ATTACH 'other.db'",
        "INSTALL httpfs",
    ],
)
def test_queries_that_fail_or_reach_out(motionkit, store, tmp_path, monkeypatch, sql):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    outcome = motionkit("query", sql, "--store", store)
    assert outcome.code == 2
    assert outcome.stderr.startswith("motionkit: ")
    assert sorted(tmp_path.rglob("*")) == before


def test_validate(motionkit, store):
    intact = motionkit("validate", "--store", store)
    assert (intact.code, intact.stdout) == (0, f"{store} is intact: 3 sequences, 3 files\n")
    part = store / "motions" / "part-00000.parquet"
    content = bytearray(part.read_bytes())
    content[len(content) // 2] ^= 1
    part.write_bytes(content)
    damaged = motionkit("validate", "--store", store)
    assert damaged.code == 1
    assert damaged.stdout == "motions/part-00000.parquet: its sha256 is not the manifest's\n"
    assert json.loads(motionkit("validate", "--store", store, "--json").stdout)["faults"] == [damaged.stdout.strip()]


@pytest.mark.parametrize("command", [("info",), ("validate",), ("query", "FROM sequences"), ("train",)])
def test_no_store(motionkit, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    outcome = motionkit(*command)
    assert outcome.code == 1
    assert outcome.stderr == (
        "motionkit: there is no store at store: make one with 'motionkit ingest SOURCE --store store'\n"
    )
