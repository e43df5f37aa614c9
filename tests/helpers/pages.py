"""The blocks of a page of the documentation, run one after the other as a reader would."""

import re
import shlex
import subprocess
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FENCE = re.compile(r"(?:<!-- not run: (?P<why>[^>]+) -->\n\n)?^```(?P<language>\w*)\n(?P<text>.*?)^```$", re.M | re.S)
COMMAND = re.compile(r"^(motionkit|python|pip|make|torchrun|srun|blender|import bpy)\b", re.M)


@dataclass(frozen=True)
class Block:
    """Code of a page: `bash` and `python` are run, others only shown; `why` says why commands are not run."""

    language: str
    text: str
    why: str = ""


def blocks(page: Path) -> list[Block]:
    """All blocks of a page, in order."""
    found = FENCE.finditer(page.read_text(encoding="utf-8"))
    return [Block(each["language"], each["text"], each["why"] or "") for each in found]


def unmarked(page: Path) -> list[Block]:
    """Blocks that hold commands, are not run, and do not say why."""
    shown = (each for each in blocks(page) if each.language not in ("bash", "python"))
    return [each for each in shown if COMMAND.search(each.text) and not each.why]


def run_page(page: Path, motionkit: Callable[[list[str]], None]) -> dict[str, Any]:
    """Run all blocks of a page that are to be run, as `run_blocks` does."""
    return run_blocks(blocks(page), page, motionkit)


def run_blocks(chosen: Iterable[Block], page: Path, motionkit: Callable[[list[str]], None]) -> dict[str, Any]:
    """Run blocks in the current folder; the names that their Python has in the end.

    `motionkit` takes the words behind a command's name; lines of other programs go to bash. Raises what Python raises,
    and `CalledProcessError` where a line of bash fails.
    """
    names: dict[str, Any] = {}
    for block in chosen:
        if block.language == "python":
            exec(compile(block.text, f"a block of {page.name}", "exec"), names)
        elif block.language == "bash":
            for piece in _pieces(block.text):
                words = shlex.split(piece.replace("\\\n", " "), comments=True)
                if words[:1] == ["motionkit"]:
                    motionkit(words[1:])
                elif words:
                    subprocess.run(["bash", "-euc", piece], check=True)
    return names


def _pieces(text: str) -> Iterator[str]:
    """Lines of bash, with those that go on after a backslash and with their here-documents."""
    yield from (found[0] for found in re.finditer(r"^.*<<'(\w+)'\n(?:.*\n)*?\1$|^(?:.*\\\n)*.*$", text, re.M))
