"""Writing a store anew in its place: the old state is there until the commit, and then the new one is."""

from collections.abc import Callable
from pathlib import Path

from motionkit.store.manifest import read_manifest
from motionkit.store.reader import Store
from motionkit.store.schema import FORMAT_VERSION
from motionkit.store.writer import StoreWriter

OnSequence = Callable[[], None]


def migrate(path: Path, on_sequence: OnSequence = lambda: None) -> bool:
    """Bring a store to the present format version; False where it has it already.

    Every motion is read and written again, so what the version adds is measured; until the commit the disk holds both.
    Raises `StoreError` where there is no store, or it is damaged or busy.
    """
    if read_manifest(path).format_version == FORMAT_VERSION:
        return False
    _write_anew(path, on_sequence)
    return True


def _write_anew(path: Path, on_sequence: OnSequence) -> None:
    with StoreWriter.create(path, overwrite=True) as writer:
        # Opened under the lock, so that no motion is missed that another writer adds.
        store = Store.open(path)
        for motion in store.read_many(range(store.num_sequences)):
            writer.add(motion)
            on_sequence()
