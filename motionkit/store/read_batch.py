"""What a worker does: read sequences and encode them for the store."""

import os
import socket
from collections.abc import Sequence

from motionkit.errors import FormatError
from motionkit.formats.items import ReadOptions, SourceItem
from motionkit.formats.registry import read
from motionkit.store.encode import EncodedMotion, RefusedMotion, encode


def read_batch(items: Sequence[SourceItem], options: ReadOptions) -> list[EncodedMotion | FormatError]:
    """Read and encode sequences; a fault is returned, so that it travels between processes like a result."""
    return [read_or_fault(item, options) for item in items]


def read_or_fault(item: SourceItem, options: ReadOptions) -> EncodedMotion | FormatError:
    """Read and encode one sequence, or say what is wrong with it.

    An exception that no reader foresaw becomes a fault too (`unexpected`): one odd file must not end an ingest of a
    million.
    """
    try:
        return encode(read(item, options))
    except FormatError as problem:
        return problem if os.path.lexists(item.path) else _not_visible(item)
    except RefusedMotion as refused:
        return FormatError(str(refused), path=item.path, reason=refused.reason)
    except Exception as error:
        text = f"{type(error).__name__}: {error}".splitlines()[0]
        return FormatError(f"the {item.format} reader failed: {text}", path=item.path, reason="unexpected")


def _not_visible(item: SourceItem) -> FormatError:
    return FormatError(
        f"there is no such file on {socket.gethostname()}, where it was to be read, but there was when the source was "
        "scanned: removed since, or not in a folder that all machines share",
        path=item.path,
        reason="not-visible",
    )
