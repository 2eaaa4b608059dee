"""What a fuzz target is: how one input is made from a seed, what reads it, and how reading may end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

LONGEST_MESSAGE = 2000


@dataclass(frozen=True, slots=True)
class Target:
    """One parser of bytes from outside. An input is made from the random source alone, so its number finds it again."""

    name: str
    about: str
    make: Callable[[Random], Any]
    read: Callable[[Any, Path], object]
    """Reads an input, with an empty folder to write it to; asserts what must hold of whatever it accepts."""
    refusals: tuple[type[Exception], ...] = ()
    """The errors that the parser documents; empty: it never raises."""
    names: str = ""
    """What every refusal must name: the file, the device."""
    longest: int = LONGEST_MESSAGE
    """In characters: a refusal that lists many faults is longer."""
    cost: float = 1.0
    """How many inputs of a plain parser one of these takes the time of: the default tests take fewer of it."""


class Unclear(AssertionError):
    """A refusal that does not help the reader."""


def check_refusal(target: Target, case: Any, error: Exception) -> None:
    """Raises Unclear for a message that is empty, endless, or does not name the thing."""
    message = str(error)
    if not any(character.isalpha() for character in message):
        raise Unclear(f"{type(error).__name__} says nothing: {message!r}") from error
    said = len(case) if isinstance(case, str) else 0  # a sentence is quoted to who said it
    if len(message) > target.longest + 3 * said:
        raise Unclear(f"{type(error).__name__} of {len(message)} characters: {message[:200]!r}...") from error
    if target.names not in message:
        raise Unclear(f"{type(error).__name__} does not name {target.names!r}: {message[:200]!r}") from error
