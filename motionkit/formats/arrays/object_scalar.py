"""The one constant inside a pickled numpy object array, read from the opcodes: nothing is unpickled or executed.

AMASS files store `gender` and the like as arrays of Python objects in some releases. Such an array is a pickle that
calls numpy's reconstruction with fixed arguments and appends one value. Here the opcodes are only listed
(`pickletools.genops`), each must be one that numpy writes, and every other string must be one of numpy's own words.
Source: numpy's `ndarray.__reduce__`, pickle protocols 2 to 5.
"""

import pickletools
import warnings

MEMO = frozenset({"MEMOIZE", "PUT", "BINPUT", "LONG_BINPUT"})
STRINGS = frozenset({"UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINSTRING", "SHORT_BINSTRING"})
BYTES = frozenset({"BINBYTES", "SHORT_BINBYTES"})
NUMBERS = frozenset({"INT", "BININT", "BININT1", "BININT2", "BINFLOAT", "NONE", "NEWTRUE", "NEWFALSE"})
CONSTANTS = STRINGS | BYTES | NUMBERS
TUPLES = frozenset({"MARK", "TUPLE", "EMPTY_TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_LIST", "APPEND"})
CALLS = frozenset({"GLOBAL", "STACK_GLOBAL", "REDUCE", "BUILD", "GET", "BINGET", "LONG_BINGET"})
OPCODES = frozenset({"PROTO", "FRAME", "STOP"}).union(CONSTANTS, TUPLES, CALLS)
GLOBALS = frozenset(
    f"{module} {name}"
    for module, name in (
        ("numpy._core.multiarray", "_reconstruct"),
        ("numpy.core.multiarray", "_reconstruct"),
        ("numpy", "ndarray"),
        ("numpy", "dtype"),
        ("_codecs", "encode"),
    )
)
WORDS = frozenset({"O8", "O4", "|", "b", "latin1", *(word for name in GLOBALS for word in name.split())})


def parse_scalar(content: bytes) -> str | int | float | None:
    """The string or number in the pickle of an object array of size 1; None where it is anything else."""
    try:
        with warnings.catch_warnings(action="ignore"):  # of odd escapes in protocol 0's strings
            steps = [(opcode.name, argument) for opcode, argument, _ in pickletools.genops(content)]
    except (ValueError, UnicodeError, IndexError):
        return None
    steps = [step for step in steps if step[0] not in MEMO]
    names = [name for name, _ in steps]
    if not OPCODES.issuperset(names) or names.count("EMPTY_LIST") != 1:
        return None
    place = names.index("EMPTY_LIST") + 1
    if names[place + 1 :] != ["APPEND", "TUPLE", "BUILD", "STOP"] or names[place] not in CONSTANTS:
        return None
    value = steps[place][1]
    for name, argument in (*steps[:place], *steps[place + 1 :]):
        words = GLOBALS if name == "GLOBAL" else WORDS
        text = argument.decode("latin-1") if isinstance(argument, bytes) else argument
        if isinstance(text, str) and text not in words:
            return None
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value if isinstance(value, (str, int, float)) else None
