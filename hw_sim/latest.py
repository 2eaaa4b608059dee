"""Owns a cache of the latest values that take long to compute: computed once, whoever asks first."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")


class Latest(Generic[Key, Value]):
    """The values of the last few keys. Threads may ask at once: one computes, the others wait for it.

    A value that is dropped for a newer one stays with those who hold it, so it must not be changed in place.
    """

    def __init__(self, keep: int = 1) -> None:
        self._keep = keep
        self._lock = threading.Lock()
        self._values: OrderedDict[Key, Value] = OrderedDict()

    def get(self, key: Key, compute: Callable[[], Value]) -> Value:
        """Return the value of ``key``, from ``compute`` if it is not kept. What ``compute`` raises is passed on and not kept."""
        with self._lock:
            if key not in self._values:
                value = compute()
                # The least recently used value goes first (``get`` moves what it returns to the end).
                while len(self._values) >= self._keep:
                    self._values.popitem(last=False)
                self._values[key] = value
            self._values.move_to_end(key)
            return self._values[key]
