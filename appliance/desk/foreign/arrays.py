"""Owns the arrays in NumPy's files: what each is by its header alone, and its numbers once their size is allowed.

Five megabytes of an ``.npz`` may unpack to as many gigabytes, so that nothing is unpacked to learn its shape. Format:
NEP 1, versions 1 to 3.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from appliance.base import refuse_irregular

HEADER_BYTES = 16 * 1024
"""Bytes that are read for a header; those of arrays of numbers have some hundred."""
MOST_ARRAYS = 1000
ZIPPED = ".npz"
_SUFFIX = ".npy"


class ArrayError(Exception):
    """A file is none of NumPy's, or an array in it is none that is read; the text says what of it, not whose."""


def array_heads(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of an ``.npz`` by name, or the one of an ``.npy``, whose name is empty. Raises ArrayError.

    Shapes and types are theirs; numbers are not read, and none has room of its own.
    """
    with _told(path):
        if path.suffix.lower() != ZIPPED:
            with path.open("rb") as file:
                return {"": _head(file)}
        with zipfile.ZipFile(path) as archive:
            names = [name for name in archive.namelist() if name.endswith(_SUFFIX)]
            if len(names) > MOST_ARRAYS:
                raise ArrayError(f"{len(names)} arrays; allowed are up to {MOST_ARRAYS}")
            found = {}
            for name in names:
                with archive.open(name) as member:
                    found[name.removesuffix(_SUFFIX)] = _head(member)
            return found


def load_array(path: Path, name: str, most_bytes: int) -> NDArray[Any]:
    """Return one of ``array_heads``; of an ``.npy`` the file is mapped, not read.

    Raises ArrayError for one of more than ``most_bytes``.
    """
    with _told(path):
        if path.suffix.lower() != ZIPPED:
            return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))
        head = array_heads(path)[name]
        size_bytes = head.size * head.itemsize
        if size_bytes > most_bytes:
            raise ArrayError(
                f"array {name} unpacks to {size_bytes / 1e9:.3g} GB; allowed are {most_bytes / 1e9:.3g} GB; save it as "
                ".npy, of which only "
                "what is needed is read"
            )
        with np.load(path, allow_pickle=False) as content:
            return np.asarray(content[name])


def _head(file: IO[bytes]) -> NDArray[Any]:
    # A header may state its own length in four bytes: no more than these few are unpacked for it.
    few = io.BytesIO(file.read(HEADER_BYTES))
    version = np.lib.format.read_magic(few)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(few)
    return np.broadcast_to(np.empty((), dtype), shape)


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Turn whatever a damaged file makes NumPy and zipfile raise into ArrayError."""
    try:
        refuse_irregular(path)
        yield
    except ArrayError:
        raise
    except Exception as error:
        raise ArrayError(f"not readable as NumPy's file ({str(error)[:120]})") from error
