"""Mutations of text: extreme numbers and words, tokens and lines lost, duplicated or swapped, other encodings."""

import re
from collections.abc import Callable
from random import Random

NUMBERS = (
    *(b"nan", b"NaN", b"inf", b"-inf", b"Infinity", b"1e999", b"-1e999", b"1e308", b"1e39", b"1e-320"),
    *(b"0", b"-0", b"-1", b"1", b"2", b"3.5", b"1e9", b"1e5", b"127", b"128", b"255", b"256", b"65535", b"65536"),
    *(b"2147483647", b"2147483648", b"4294967296", b"9223372036854775807", b"9223372036854775808"),
    *(b"-9223372036854775809", b"9" * 30, b"9" * 400, b"9" * 5000, b"0." + b"0" * 5000 + b"1", b"0" * 5000),
    *(b"1_000", b"0x10", b"0b1", "٣".encode(), "１".encode(), b"1,5", b"1e", b"--1", b"+5", b"1.2.3", b".", b"1/0"),
    *(b"30000/1001", b"0/1", b"1e400/3", b"true", b"null"),
)
WORDS = (
    *(b"", b"\0", b"\xff", b"\xe9", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"{", b"}", b"[", b"]", b"(", b")", b'"', b"'"),
    *(b"#", b",", b";", b"\t", b"\r", b"\n", b"\r\n", b"\x0b", b"\x0c", b"\x85", b"\xe2\x80\xa8", b"\x1b[31m", b"\x07"),
    *(b"..", b"../../etc/passwd", b"/etc/passwd", b"C:\\x", b"~", b"*", b"**/*", b"*" * 40 + b"z", b"(a+)+$", b"{any}"),
    *(b"{any}" * 20 + b"z", b"x" * 300, b"x" * 70_000, "e\u0301".encode(), "😀".encode(), b"\\u0000", b"\\ud800"),
    *(b"OFFSET", b"CHANNELS", b"JOINT", b"End Site", b"MOTION", b"HIERARCHY", b"ROOT", b"Frames:", b"Frame Time:"),
    *(b":root", b":bonedata", b"begin", b"end", b"dof", b"None", b"__proto__", b"<script>", b"%s%n", b"$(id)"),
)
SEPARATORS = b" \t\r\n\x0b\x0c,;:{}[]()\"'=|"
TOKEN = re.compile(rb"[^%s]+" % re.escape(SEPARATORS))
INTEGER = re.compile(rb"[-+]?\d{1,12}")
NUMBER = re.compile(rb"[-+]?(\d|\.\d)[\d.eE+-]*")
BRACKETS = (b"{", b"[", b"(", b'"', b"[[", b'{"a":', b"[1,", b"a.", b"(1,")
# Maximum size of a mutated file.
MOST_BYTES = 2 << 20


def mutate_text(rng: Random, content: bytes) -> bytes:
    """Text after one mutation."""
    return rng.choice(ACCIDENTS)(rng, content)


Span = tuple[int, int]


def _token(rng: Random, content: bytes, pattern: re.Pattern[bytes] = TOKEN) -> Span | None:
    """The span of a random token of this kind; None if none was found in a few tries."""
    for _ in range(8):
        place = rng.randint(0, len(content))
        while place and content[place - 1] not in SEPARATORS:
            place -= 1
        found = TOKEN.search(content, place)
        if found is not None and pattern.fullmatch(found[0]):
            return found.span()
    return None


def _put(content: bytes, span: Span, new: bytes) -> bytes:
    return content[: span[0]] + new + content[span[1] :]


def _wild_number(rng: Random, content: bytes) -> bytes:
    span = _token(rng, content, NUMBER)
    return _put(content, span, rng.choice(NUMBERS)) if span else _wild_word(rng, content)


def _near_number(rng: Random, content: bytes) -> bytes:
    # A wrong count: one more, one less, negative, a thousand times.
    span = _token(rng, content, INTEGER)
    if span is None:
        return _wild_word(rng, content)
    value = int(content[span[0] : span[1]])
    return _put(content, span, str(rng.choice((value + 1, value - 1, -value, 1000 * value, value // 2))).encode())


def _all_numbers(rng: Random, content: bytes) -> bytes:
    # Every n-th number, n from 1 to 7, becomes the same extreme one.
    wild, every = rng.choice(NUMBERS[:30]), rng.randint(1, 7)
    count = iter(range(1 << 30))

    def put(found: re.Match[bytes]) -> bytes:
        if not NUMBER.fullmatch(found[0]) or next(count) % every:
            return found[0]
        return wild

    return TOKEN.sub(put, content)[:MOST_BYTES]


def _wild_word(rng: Random, content: bytes) -> bytes:
    span, place = _token(rng, content), rng.randint(0, len(content))
    return _put(content, span if span and rng.random() < 0.7 else (place, place), rng.choice(WORDS))


def _lose_token(rng: Random, content: bytes) -> bytes:
    span = _token(rng, content)
    return _put(content, span, b"") if span else content


def _double_token(rng: Random, content: bytes) -> bytes:
    span = _token(rng, content)
    if span is None:
        return content
    between = rng.choice((b" ", b"", b",", b"\n", b":", b"="))
    return _put(content, span, between.join([content[span[0] : span[1]]] * rng.choice((2, 3, 50))))


def _swap_tokens(rng: Random, content: bytes) -> bytes:
    spans = {_token(rng, content), _token(rng, content)} - {None}
    if len(spans) < 2:
        return content
    first, second = sorted(span for span in spans if span)
    swapped = _put(content, second, content[first[0] : first[1]])
    return _put(swapped, first, content[second[0] : second[1]])


def _copy_token(rng: Random, content: bytes) -> bytes:
    # A duplicated name, or a number in place of a word.
    first, second = _token(rng, content), _token(rng, content)
    return _put(content, first, content[second[0] : second[1]]) if first and second else content


def _lines(rng: Random, content: bytes) -> bytes:
    lines = content.splitlines(keepends=True)
    if not lines:
        return content
    place, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    stop = min(len(lines), place + rng.choice((1, 1, 2, 5)))
    fate = rng.choice(("lose", "double", "many", "swap", "move", "cut"))
    if fate == "lose":
        del lines[place:stop]
    elif fate == "double":
        lines[place:place] = lines[place:stop]
    elif fate == "many":
        most = max(1, MOST_BYTES // 4 // max(1, len(lines[place])))
        lines[place:place] = [lines[place]] * min(most, rng.choice((50, 500, 5000)))
    elif fate == "swap":
        lines[place], lines[other] = lines[other], lines[place]
    elif fate == "move":
        lines.insert(other, lines.pop(place))
    else:
        lines[place] = lines[place][: rng.randint(0, len(lines[place]))]
    return b"".join(lines)


def _nest(rng: Random, content: bytes) -> bytes:
    # Deep nesting: a bracket, or a piece of the file itself, repeated many times.
    place = rng.randint(0, len(content))
    piece = rng.choice(BRACKETS) if rng.random() < 0.6 else content[place : place + rng.randint(1, 60)]
    times = rng.choice((10, 200, 2000, 60_000))
    return content[:place] + (piece * times)[: MOST_BYTES // 2] + content[place:]


def _encoding(rng: Random, content: bytes) -> bytes:
    text = content.decode("latin-1")
    changed = (
        content.replace(b"\n", b"\r\n"),
        content.replace(b"\n", b"\r"),
        content.replace(b"\n", b" "),
        b"\xef\xbb\xbf" + content,
        b"\xef\xbb\xbf" * 2 + content,
        text.encode("utf-16"),
        text.encode("utf-16-be"),
        text.encode("utf-32"),
        content.replace(b" ", b"\xa0"),
        content.replace(b" ", b"\t"),
        content.replace(b".", b","),
        content.replace(b",", b";"),
        content.upper(),
        content.lower(),
        content * 2,
        content[::-1],
        b"",
        b"\n" * 1000,
        b"\0" * 1000,
    )
    return rng.choice(changed)


ACCIDENTS: tuple[Callable[[Random, bytes], bytes], ...] = (
    *(_wild_number, _wild_number, _wild_number, _near_number, _near_number, _all_numbers),
    *(_wild_word, _wild_word, _lose_token, _double_token, _swap_tokens, _copy_token, _lines, _lines, _nest, _encoding),
)
