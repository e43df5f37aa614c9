"""What a reader says of a bad file."""

from collections.abc import Callable

import pytest

from motionkit.core.errors import FormatError


def refusal(read: Callable[..., object], *arguments: object, **options: object) -> FormatError:
    """The error, in one line, with which a file is refused."""
    with pytest.raises(FormatError) as caught:
        read(*arguments, **options)
    assert "\n" not in str(caught.value)
    return caught.value
