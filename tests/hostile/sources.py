"""Hostile samples, captures and tables of a user: links and names that lead out, patterns without end."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.trust.scenarios import EVAL
from tests.hostile.scene import EVIL, Scene, Spoil, link, links, text

SAMPLES = (
    ("samples", "samples"),
    ("samples", "samples", "--json"),
    ("samples", "samples", "--init"),
    ("eval", "--table", "2", "--samples", "theirs=samples", "--motions", "64", "--clips", "64", *EVAL),
    ("ingest", "samples", "--store", "new", "--workers", "1", "--fps", "20"),
)
INGEST = (
    ("ingest", "one", "--store", "new", "--workers", "1"),
    ("ingest", "one", "--store", "new", "--workers", "2", "--json"),
    ("view", "one"),
    ("complete", "one", "--fps", "90", "--model", "slerp", "--overwrite"),
)
TOMLS: dict[str, str | bytes] = {
    "prompts above": 'fps = 20\nprompts = "../../outside/mine.txt"\n',
    "statistics above": 'statistics = "normalised"\nmean = "../../outside/mine.npy"\nstd = "/etc/passwd"\n',
    "files above": 'fps = 20\nfiles = ["../../outside/**/*.npy"]\n',
    "a pattern without end": f'fps = 20\nname = "{"{any}" * 40}zz"\n',
    "a glob of forty stars": f'fps = 20\nfiles = ["{"*a" * 40}z.npy"]\n',
    "a regular expression": 'fps = 20\nname = "(a+)+$"\n',
    "an enormous number": f"fps = {'9' * 5000}\n",
    "a key of 60,000 parts": "a." * 60_000 + "b = 1\n",
    "escape sequences": f'fps = 20\nup = "{"".join(f"{chr(92)}u{ord(letter):04x}" for letter in EVIL)}"\n',
    "not UTF-8": b"fps = 20 # \xff\xfe\n",
}
RULES = '[[rule]]\nfiles = "{}"\nstated = 30\nfps = {}\nsource = "x"\n'
USER_TOMLS = {
    "a glob of forty stars": RULES.format("*a" * 40 + "z", 60),
    "escape sequences": RULES.format("*", f'"{EVIL.encode("unicode_escape").decode().replace("x", "u00")}"'),
}
TABLE = "file,caption,split\n"
CAPTURES: dict[str, Spoil] = {
    "a table names files outside": lambda inside, outside: _table(inside, outside),
    "captions of escape sequences": text("one/clips.csv", f'{TABLE}take-10.bvh,"{EVIL}","{EVIL}"\n'),
    "a licence of escape sequences": text("one/LICENSE", EVIL),
    "a file is a link to a secret": links(
        {"one/secret.bvh": "mine.txt", "one/secret.npy": "mine.txt", "one/LICENSE": "mine.txt"}
    ),
    "outputs are links": links({f"one/take-{number}.completed.bvh": "mine.txt" for number in (9, 10, 11)}),
    "a name of escape sequences": lambda inside, outside: _named(inside / "one", EVIL.replace("/", "")),
    "a name that is not UTF-8": lambda inside, outside: _named(
        inside / "one", b"caf\xe9".decode("utf-8", "surrogateescape")
    ),
}


def _named(folder: Path, name: str) -> None:
    (folder / f"{name}.bvh").write_bytes((folder / "take-9.bvh").read_bytes())


def _table(inside: Path, outside: Path) -> None:
    rows = "".join(f"{path},x,train\n" for path in ("../../outside/mine.txt", outside / "mine.txt", "take-9.bvh"))
    (inside / "one/clips.csv").write_text(TABLE + rows)


def _linked_samples(inside: Path, outside: Path) -> None:
    link(inside / "samples" / "prompts.txt", outside / "mine.txt")
    (inside / "samples" / "samples.toml").write_text('fps = 20\nprompts = "prompts.txt"\n')


def _looping_samples(inside: Path, outside: Path) -> None:
    link(inside / "samples" / "again", inside / "samples")
    link(inside / "samples" / "everything", Path("/"))


def _odd_samples(inside: Path, outside: Path) -> None:
    np.save(inside / "samples" / f"{EVIL.replace('/', '')}.npy", np.full((30, 22, 3), np.nan, np.float32))
    (inside / "samples" / "rows.csv").write_text(
        f"file,caption,num_frames\n../../outside/mine.txt,x,5\nsample0.npy,{'9' * 5000},{'9' * 5000}\n"
    )


def _arrays(inside: Path, outside: Path) -> None:
    """Arrays, and a link where their completed ones are put."""
    (inside / "one/more").mkdir()
    shutil.copy(inside / "samples/sample0.npy", inside / "one/more")
    link(inside / "one/more/completed-90fps", outside / "folder")


def scenes() -> Iterator[Scene]:
    """All of them."""
    for name, content in TOMLS.items():
        yield Scene(f"samples.toml: {name}", text("samples/samples.toml", content), SAMPLES)
    complete = ("complete", "one", "--fps", "90", "--source-fps", "20", "--model", "slerp", "--overwrite")
    yield Scene("arrays: the folder of completed ones is a link", _arrays, (complete, (*complete, "--format", "bvh")))
    yield Scene("samples: prompts is a link", _linked_samples, SAMPLES)
    yield Scene("samples: samples.toml is a link", links({"samples/samples.toml": "mine.txt"}), SAMPLES)
    yield Scene("samples: folders are links", _looping_samples, SAMPLES)
    yield Scene("samples: odd names and rows", _odd_samples, SAMPLES)
    for name, content in USER_TOMLS.items():
        command = (*INGEST[0], "--fps-rules", "rules.toml")
        yield Scene(f"rules: {name}", text("rules.toml", content), (command,))
    for name, spoil in CAPTURES.items():
        yield Scene(f"captures: {name}", spoil, INGEST)
