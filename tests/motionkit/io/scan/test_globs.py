import pytest

from motionkit.io.scan.globs import parse_glob


@pytest.mark.parametrize(
    ("glob", "fits", "does_not"),
    [
        ("a.bvh", ["a.bvh", "x/a.bvh"], ["ba.bvh", "a.bvh/x", "a.bvh\n"]),
        ("*.bvh", ["a.bvh", "x/.bvh", "x/a\nb.bvh"], ["a.bvh.gz", "a.bvh/b"]),
        ("x/*/a*b*c", ["x/y/abc", "x/y/a_bcb_c", "w/x/y/abbc"], ["x/abc", "x/y/acb", "x/y/z/abc"]),
        ("**/a", ["a", "x/a", "x/y/a"], ["b"]),
        ("x/**/y/**/z", ["x/y/z", "x/1/y/2/3/z", "0/x/y/y/z"], ["x/z", "y/x/z", "x/y"]),
        ("x/**/a/b/**/a/c", ["x/a/b/a/c", "x/a/a/b/b/a/c"], ["x/a/b/c", "x/a/a/c"]),
        ("[!a]b", ["cb"], ["ab", "b"]),
        ("[z-a]", [], ["b", "z"]),
        ("[", ["["], ["a"]),
        ("a**b", ["ab", "axb"], ["ax/b"]),
    ],
)
def test_wildcards(glob: str, fits: list[str], does_not: list[str]) -> None:
    parsed = parse_glob(glob)
    assert [path for path in fits if not parsed.fits(path)] == []
    assert [path for path in does_not if parsed.fits(path)] == []


# Each of these took longer than anybody waits while globs were plain regular expressions.
@pytest.mark.parametrize(
    ("glob", "path"),
    [
        ("*" * 40 + "z", "a" * 250),
        ("*a" * 40 + "z", "a" * 250),
        ("*[!z]?" * 40 + "z", "a" * 250),
        ("**/" * 40 + "z", "a/" * 200 + "a"),
        ("**/*a*/" * 40 + "z", "aa/" * 200 + "a"),
        ("*a" * 2000, "a" * 1999),
    ],
)
def test_hostile_globs_come_to_an_end(glob: str, path: str) -> None:
    assert not parse_glob(glob).fits(path)


def test_a_glob_longer_than_any_path_is_refused() -> None:
    with pytest.raises(ValueError, match="5,000 letters"):
        parse_glob("*" * 5000)
