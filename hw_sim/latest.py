"""A cache of the latest values of expensive computations, shared by threads."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")


class Latest(Generic[Key, Value]):
    """The values of the last few keys. If several threads ask at once, one computes and the others wait.

    Callers may still hold a value after it has been replaced, so it must not be changed in place.
    """

    def __init__(self, keep: int = 1) -> None:
        self._keep = keep
        self._lock = threading.Lock()
        self._values: OrderedDict[Key, Value] = OrderedDict()

    def get(self, key: Key, compute: Callable[[], Value]) -> Value:
        """Return the value of ``key``, computed if it is not cached. Errors of ``compute`` are not cached."""
        with self._lock:
            if key not in self._values:
                value = compute()
                # The least recently used value goes first (``get`` moves what it returns to the end).
                while len(self._values) >= self._keep:
                    self._values.popitem(last=False)
                self._values[key] = value
            self._values.move_to_end(key)
            return self._values[key]
