"""Sidecar tables: what they say about generated motions."""

from pathlib import Path

from motionkit.formats.annotations import find_annotations, read_annotations


def test_a_table_names_the_prompt_and_the_length_of_generated_motions(tmp_path: Path) -> None:
    path = tmp_path / "samples.csv"
    path.write_text("file,group,num_frames\na.npy,7,40\nb.npy,7,\nc.npy,,0\nd.npy,,-3\ne.npy,,many\n")
    assert find_annotations(tmp_path) == (path,)
    table = read_annotations(path)
    rows = {target.name: row for target, row in table.rows.items()}
    assert {name: (row.group, row.num_frames) for name, row in rows.items()} == {
        "a.npy": ("7", 40),
        "b.npy": ("7", None),
    }
    assert [(problem.line, problem.reason) for problem in table.problems] == [
        (4, "annotations"),
        (5, "annotations"),
        (6, "annotations"),
    ]
    assert "expected how many frames are motion" in str(table.problems[0])
