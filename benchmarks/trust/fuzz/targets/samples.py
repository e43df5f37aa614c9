"""Readers of other systems' samples, evaluators' files, checkpoints of other projects, and results."""

from collections.abc import Iterator
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.trust.fuzz.target import Make, Target, every_file, named
from eval.actions.gru import HUMANACT12, load_gru
from eval.report.render import to_csv, to_html, to_latex, to_markdown
from eval.report.results import Block, Cell, Result, ResultError, Row, find_results, write_result
from eval.sample_folder import SampleOptions, read_sample_folder
from eval.sample_folder.findings import lines, summarise
from eval.text_motion.guo.evaluator import load_guo
from eval.text_motion.guo.kind import GuoFiles
from eval.text_motion.guo.networks import GuoWidths
from tests.helpers import published_layouts as published

SMALL = GuoWidths(movement=6, motion=5, text=4, shared=3)


def read_samples(folder: Path) -> None:
    """Read a folder of samples as `motionkit samples` does."""
    read = read_sample_folder("mine", folder, SampleOptions(Fraction(20), keep_published=True))
    assert np.isfinite(read.sequences.values).all(), "a number that is not finite was read"
    assert all(1 <= fps <= 10_000 for fps in read.fps), f"{read.fps} fps were read"
    list(lines(summarise(read)))
    if read.left_out:
        raise read.left_out[0]


def report(folder: Path) -> None:
    """Read all results of a folder and render them in every format, as `motionkit report` does."""
    found = find_results(folder)
    for result in found.results:
        to_markdown(result), to_latex(result), to_csv(result)
    to_html(found.results)
    if found.faults:
        raise ResultError(found.faults[0])


def _small(write: Make, *, kept: int = 2) -> Make:
    """Of the motions of a folder of samples the first few: each is read for every input."""

    def make(folder: Path) -> None:
        write(folder)
        arrays = sorted(path for path in folder.rglob("*.npy") if path.stem not in ("mean", "std", "results"))
        for path in arrays[2 * kept :] if len(arrays) > 2 * kept else []:
            path.unlink()
        for path in sorted(folder.rglob("*.bvh"))[kept:]:
            path.unlink()

    return make


def _vectors(folder: Path) -> None:
    rows = np.concatenate(published.vectors())
    published.write_t2m_gpt_vectors(folder, rows.mean(axis=0), rows.std(axis=0) + 1e-3)


def _named(folder: Path) -> None:
    published.write_mld_test(folder)
    (folder / "samples.toml").write_text(
        'fps = 20\nfiles = ["**/*.npy"]\nexclude = ["old/*"]\nup = "y"\nunit_metres = 1.0\n'
        'name = "{group}_{repeat}"\nprompts = "prompts.txt"\n'
    )
    (folder / "prompts.txt").write_text("a person walks\nsomeone jumps#40\n")


def _result(folder: Path) -> None:
    cells = {"20": Cell(0.5, 0.1, {"recall": 0.25, "samples": 12}), "60": Cell(3)}
    rows = (Row("NeRM", "ours", cells, note="a note"), Row("real", "reference", {"20": Cell(0.0)}))
    block = Block("clip-FID", ("20", "60"), rows, provenance={"store": "abc", "seeds": [1, 2]})
    write_result(Result("nerm-table2", "1", "Table 2", "a caption", (block,), missing=("a row",)), folder)


def _guo(folder: Path) -> None:
    from tests.helpers.published_guo import write_archive, write_glove

    write_archive(folder / "t2m", SMALL)
    write_glove(folder / "glove")


def _load_guo(folder: Path) -> None:
    load_guo(GuoFiles(folder / "t2m" / "text_mot_match" / "model" / "finest.tar", folder / "glove"), SMALL)


def _gru(folder: Path) -> None:
    from tests.eval.actions.test_gru_recogniser import random_weights

    random_weights(folder / "gru.tar", HUMANACT12)


def targets() -> Iterator[Target]:
    """All of them."""
    folders = (
        *(_small(published.write_mld_demo), _small(published.write_t2m_gpt), _small(_vectors), _small(_named)),
        _small(partial(published.write_kit_joints, unit_metres=0.001)),
    )
    yield Target("samples", folders, read_samples)
    yield Target("samples.toml", folders[2:], read_samples, named("samples.toml", "*.csv", "prompts.txt"))
    yield Target("samples-mdm-pickle", (published.write_mdm,), read_samples, named("results.npy"))
    exported = partial(published.write_mdm, export=True)
    yield Target("samples-mdm-archive", (exported,), read_samples, named("results.npz"))
    yield Target("result", (_result,), report, every_file)
    yield Target("guo-evaluator", (_guo,), _load_guo)
    yield Target("gru-recogniser", (_gru,), lambda folder: _use(load_gru(folder / "gru.tar", HUMANACT12)))


def _use(loaded: object) -> None:
    assert loaded is not None
