"""A file with one object for all processes of this machine: a pickle, and large arrays that they map.

Arrays are not read: the system has their pages once, however many processes look at them. A process that
writes into one gets a copy of that page for itself.
"""

from __future__ import annotations

import mmap
import os
import pickle
import struct
from io import BufferedIOBase
from pathlib import Path
from typing import Any

# Bytes of a buffer from which on it stands beside the pickle.
_LARGE = 1 << 20
# Buffers begin at multiples of this.
_ALIGNED = 64
_NUMBER = struct.Struct("<Q")


def write_shared(value: Any, file: BufferedIOBase) -> None:
    """Write an object: the number of large buffers, their sizes, that of the pickle, then all of them."""
    large: list[pickle.PickleBuffer] = []
    pickled = pickle.dumps(value, protocol=5, buffer_callback=lambda buffer: _kept(buffer, large))
    views = [buffer.raw() for buffer in large]
    numbers = [len(views), *(view.nbytes for view in views), len(pickled)]
    file.write(b"".join(map(_NUMBER.pack, numbers)))
    at = _NUMBER.size * len(numbers)
    for part in (memoryview(pickled), *views):
        file.write(b"\0" * (-at % _ALIGNED))
        file.write(part)
        at += -at % _ALIGNED + part.nbytes
    file.flush()


def read_shared(path: Path) -> Any:
    """The object in a file, its large buffers mapped; they outlive the file's name."""
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if os.name == "posix":
            whole = memoryview(mmap.mmap(file.fileno(), size, access=mmap.ACCESS_COPY))
        else:  # a mapped file cannot be removed there
            whole = memoryview(bytearray(file.read()))
    n = _NUMBER.unpack_from(whole)[0]
    sizes = [_NUMBER.unpack_from(whole, _NUMBER.size * (1 + i))[0] for i in range(n + 1)]
    at = _NUMBER.size * (n + 2)
    parts = []
    for length in (sizes[-1], *sizes[:-1]):
        at += -at % _ALIGNED
        parts.append(whole[at : at + length])
        at += length
    return pickle.loads(parts[0], buffers=parts[1:])


def copied(value: Any) -> Any:
    """The object restored from its pickle, in this process; raises as pickle does."""
    large: list[pickle.PickleBuffer] = []
    pickled = pickle.dumps(value, protocol=5, buffer_callback=lambda buffer: _kept(buffer, large))
    # one copy of a large array, not that in a pickle besides
    return pickle.loads(pickled, buffers=[bytearray(buffer.raw()) for buffer in large])


def _kept(buffer: pickle.PickleBuffer, large: list[pickle.PickleBuffer]) -> bool:
    """Whether a buffer goes into the pickle; if not, it joins the large ones."""
    if buffer.raw().nbytes < _LARGE:
        return True
    large.append(buffer)
    return False
