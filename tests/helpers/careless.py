"""A command that loses what it had when it is killed, and one that takes care: what the drill is to tell apart."""

from pathlib import Path

import numpy as np

from motionkit.core.errors import MotionkitError


def count_up(name: str) -> None:
    """Make a number greater by one, up to two, in its place."""
    path = Path(name)
    number = int(path.read_text()) if path.exists() else 0
    path.write_text("")
    with path.open("w") as handle:
        handle.write(str(min(number + 1, 2)))


def write_carefully(name: str) -> None:
    """Write a file beside its place first."""
    path = Path(name)
    pending = path.with_name(f".{path.name}.new")
    pending.write_text("x" * 10_000)
    pending.replace(path)


def write_through(name: str) -> None:
    """Write to a file, a link or not."""
    Path(name).write_text("mine now")


def write_beside(name: str) -> None:
    """Write a file into the folder above."""
    Path("..", name).write_text("mine now")


def show(name: str) -> None:
    """Print what a file holds, as it is."""
    print(Path(name).read_text())


def refuse(name: str) -> None:
    """Say what is wrong."""
    raise MotionkitError(f"{name} is damaged: write it again")


def refuse_in_silence(name: str) -> None:
    """Say nothing."""
    raise SystemExit(1)


def write_samples(folder: str) -> None:
    """Write a small folder of samples."""
    path = Path(folder)
    path.mkdir()
    for number in range(2):
        joints = np.cumsum(0.01 * np.random.default_rng(number).normal(size=(40, 22, 3)), axis=0)
        np.save(path / f"sample{number}.npy", (joints + np.arange(22)[:, None] / 13).astype(np.float32))
    (path / "samples.toml").write_text("fps = 20\n")
