"""The library Aravis, of the tests' own, in place of the installed one."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator

import pytest

from drivers.aravis import library
from tests.drivers.aravis.foreign import ForeignLibrary
from tests.drivers.clock import SteppedClock


@pytest.fixture
def foreign(monkeypatch: pytest.MonkeyPatch) -> Iterator[ForeignLibrary]:
    made = ForeignLibrary(SteppedClock())
    files = {"libaravis-0.8.so.0": made, "libgobject-2.0.so.0": made}
    monkeypatch.setattr(ctypes, "CDLL", lambda file: files[file])
    library.load_library.cache_clear()
    yield made
    library.load_library.cache_clear()
