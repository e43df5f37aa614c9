"""What names of files hold, by a pattern such as `sample{group}_repeat{repeat}`, matched in linear time."""

import re
from dataclasses import dataclass

ANY = "any"
# A field takes as few letters as it can; those of digits, all that there are.
TEXT_FIELDS, DIGIT_FIELDS = ("group", "caption", "action"), ("repeat", "num_frames")
FIELDS = (*TEXT_FIELDS, *DIGIT_FIELDS, ANY)
# Longer than any name that a system allows.
LONGEST_PATTERN = 1000


@dataclass(frozen=True)
class NamePattern:
    """Literal text and fields by turns: `literals[k]`, then `fields[k]`, …, then the last literal."""

    literals: tuple[str, ...]
    fields: tuple[str, ...]

    def match(self, name: str) -> dict[str, str] | None:
        """The fields of a name; None where it does not fit as a whole.

        The first field is as short as the rest allows (digits: as long), then the second, and so on: what a regular
        expression finds, without trying all ways there are.
        """
        length = len(name)
        # open_at[k][i]: the name from letter i on fits the pattern from field k on; starts[k]: from literal k on.
        starts = [[False] * (length + 2) for _ in self.literals]
        open_at = [[False] * (length + 2) for _ in self.fields]
        starts[-1][max(0, length - len(self.literals[-1]))] = name.endswith(self.literals[-1])
        for place in range(len(self.fields) - 1, -1, -1):
            self._look_back(name, place, open_at[place], starts[place + 1])
            literal = self.literals[place]
            for i in range(length - len(literal) + 1):
                starts[place][i] = open_at[place][i + len(literal)] and name.startswith(literal, i)
        return self._walk(name, starts) if starts[0][0] else None

    def _look_back(self, name: str, place: int, here: list[bool], rest: list[bool]) -> None:
        field = self.fields[place]
        for i in range(len(name), -1, -1):
            if field in DIGIT_FIELDS:
                here[i] = name[i : i + 1].isdecimal() and (rest[i + 1] or here[i + 1])
            elif field == ANY:
                here[i] = rest[i] or here[i + 1]
            else:
                here[i] = rest[i + 1] or here[i + 1]

    def _walk(self, name: str, starts: list[list[bool]]) -> dict[str, str]:
        found, at = {}, 0
        for place, field in enumerate(self.fields):
            at += len(self.literals[place])
            ends = range(at if field == ANY else at + 1, len(name) + 1)
            if field in DIGIT_FIELDS:
                digits = next((i for i in range(at, len(name)) if not name[i].isdecimal()), len(name))
                ends = range(digits, at, -1)
            end = next(i for i in ends if starts[place + 1][i])
            if field != ANY:
                found[field] = name[at:end]
            at = end
        return found


def parse_name_pattern(text: str) -> NamePattern:
    """The pattern of a text; raises `ValueError` for unknown fields, fields twice, and more than 1,000 letters."""
    if len(text) > LONGEST_PATTERN:
        raise ValueError(f"{len(text):,} letters, expected at most {LONGEST_PATTERN:,}")
    parts = re.split(r"\{(\w*)\}", text)
    literals, fields = parts[::2], parts[1::2]
    for number, field in enumerate(fields):
        if field not in FIELDS:
            raise ValueError(f"unknown field {{{field}}}, expected {', '.join(f'{{{name}}}' for name in FIELDS)}")
        if field != ANY and field in fields[:number]:
            raise ValueError(f"the field {{{field}}} stands in it twice")
    return NamePattern(tuple(literals), tuple(fields))
