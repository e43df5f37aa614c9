"""A command that loses what it had when it is killed, and one that takes care: what the drill is to tell apart."""

from pathlib import Path

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


def write_letters(name: str) -> None:
    """Write letters, of which every second one is used, and their sum."""
    letters = bytes(65 + number % 26 for number in range(200))
    Path(name).write_bytes(letters)
    print(sum(letters[::2]))


def read_trustingly(name: str) -> None:
    """Use every second letter as it is."""
    print(sum(Path(name).read_bytes()[::2]))


def read_checked(name: str, told: str) -> None:
    """Use the letters where they are all what was written; else say that of something."""
    letters = Path(name).read_bytes()
    if letters != bytes(65 + number % 26 for number in range(200)):
        raise MotionkitError(f"{told} is damaged: write it again")
    print(sum(letters[::2]))


def read_strictly(name: str) -> None:
    """Fail somewhere on the way for a letter that is none."""
    print(sum(({number: number for number in range(65, 91)})[letter] for letter in Path(name).read_bytes()[::2]))


def read_and_lose(name: str) -> None:
    """Find the damage, but only after the file is gone."""
    letters = Path(name).read_bytes()
    Path(name).unlink()
    if letters != bytes(65 + number % 26 for number in range(200)):
        raise MotionkitError(f"{name} was damaged")
    Path(name).write_bytes(letters)


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
