"""Blocks of the completion tables: data sets together are all their clips, and forms of answers stand apart."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from eval.completion.encoders import HOLD, Completer
from eval.completion.scores import Scope, Scores, blocks_of, with_pools

SHOWN = (("×2",), {"psnr": "PSNR (dB)", "mpjpe_global": "MPJPE (cm)"}, {"psnr": {"mpjpe_global": "joints (cm)"}})


def scores(psnr: float, clips: float) -> Scores:
    return {
        ("psnr", "×2"): {f"{psnr}": [float(psnr * clips), float(clips)]},
        ("mpjpe_global", "×2"): {f"{psnr}": [0.02 * 9.0 * clips, 9.0 * clips]},
    }


def test_data_sets_of_a_framerate_are_pooled_before_all_others() -> None:
    scopes = [
        Scope("CMU, 30 fps", Fraction(30), {"hold": scores(30, 1)}),
        Scope("CMU, 120 fps", Fraction(120), {"hold": scores(50, 9)}),
        Scope("studio, 30 fps", Fraction(30), {"hold": scores(40, 4)}),
    ]
    blocks = blocks_of(with_pools(scopes), [HOLD], *SHOWN)
    titles = [block.title for block in blocks if block.title.endswith("(dB)")]
    assert titles == [
        f"{name}: PSNR (dB)" for name in ("all data sets, 30 fps", "CMU, 30 fps", "CMU, 120 fps", "studio, 30 fps")
    ]
    first = blocks[0].rows[0].cells["×2"]
    assert first.value == 38.0
    assert first.details == {"joints (cm)": pytest.approx(2.0)}
    assert "All clips of CMU, 30 fps, studio, 30 fps" in blocks[0].note
    assert with_pools(scopes[:2]) == scopes[:2]


def test_plain_answers_stand_in_blocks_of_their_own() -> None:
    def trained(name: str, form: str) -> Completer:
        return replace(HOLD, name=name, trained=True, form=form, note=f"run {name}")

    rows = [HOLD, trained("exact", "exact"), trained("plain", "plain"), trained("unknown", "")]
    scope = Scope("CMU, 30 fps", Fraction(30), {each.name: scores(30, 1) for each in rows})
    corrections, joints, plain, _ = blocks_of([scope], rows, *SHOWN)
    assert corrections.title == "CMU, 30 fps: PSNR (dB)" and plain.title == "CMU, 30 fps, plain answers: PSNR (dB)"
    assert [row.name for row in corrections.rows] == ["hold", "exact", "unknown"]
    assert [(row.name, row.note) for row in plain.rows] == [("hold", HOLD.note), ("plain", "run plain")]
    assert not any(row.note for row in joints.rows)
    assert joints.lower_is_better and not plain.lower_is_better
    # A run of plain answers alone still stands beside interpolators, and the others' block is there without it.
    assert [len(block.rows) for block in blocks_of([scope], rows[::2], *SHOWN)] == [1, 1, 2, 2]


def test_intervals_are_over_takes_and_trained_rows_are_compared_with_the_best_untrained_one() -> None:
    hard = np.random.default_rng(0).normal(30, 6, size=60)
    rows = {"low": hard - 9, "hold": hard, "ours": hard + 0.5, "theirs": hard + 0.5}
    rows["theirs"] = rows["theirs"] + np.random.default_rng(1).normal(0, 2, size=60)
    rows_of_takes: dict[str, Scores] = {
        name: {("psnr", "×2"): {f"take {take}": [2.0 * value, 2.0] for take, value in enumerate(values.tolist())}}
        for name, values in rows.items()
    }
    scope = Scope("all", Fraction(30), rows_of_takes)
    trained = [replace(HOLD, name=name, trained=True, form="correction") for name in ("ours", "theirs")]
    completers = [replace(HOLD, name="low"), HOLD, *trained]
    scores_block, differences = blocks_of([scope], completers, ("×2",), {"psnr": "PSNR (dB)"}, {})
    cells = {row.name: row.cells["×2"] for row in scores_block.rows}
    assert cells["hold"].ci95 == pytest.approx(1.96 * hard.std() / np.sqrt(60), rel=0.15)
    assert {row.name: row.note for row in differences.rows} == {
        "ours − theirs": "not told apart: ×2",
        "ours − hold": "better: ×2",
        "theirs − hold": "not told apart: ×2",
    }
