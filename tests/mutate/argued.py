"""Owns the arguments for mutants that nothing can notice: which change, and why it changes nothing.

The file ``equivalent.txt`` holds entries of the file and the function, the line before, the line after, and the argument,
indented. An entry begins where a line names a file and a function; the blank line before it is for people, so that a merge that
loses one loses nothing. An entry names lines by their text, so it survives when they move.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from tests.mutate.mutants import Mutant

FILE = Path(__file__).with_name("equivalent.txt")
PLACE = re.compile(r"(\S+) ·(?: (.*))?$")
"""The first line of an entry: a file, and the function in it or nothing."""


class Unreadable(Exception):
    """An entry of the file of arguments is not of the form that it must have."""


@dataclass(frozen=True, slots=True)
class Argument:
    """Why one mutant is equivalent."""

    path: str
    within: str
    before: str
    after: str
    why: str

    def meets(self, mutant: Mutant) -> bool:
        return (self.path, self.within, self.before, self.after) == (
            mutant.path,
            mutant.within,
            mutant.before,
            mutant.after,
        )


def read(text: str) -> list[Argument]:
    """Return all arguments of a text. Raises Unreadable, which names the entry."""
    entries: list[list[str]] = []
    for line in text.splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        if PLACE.match(line) or not entries:
            entries.append([])
        entries[-1].append(line)
    found = []
    for lines in entries:
        named = PLACE.match(lines[0])
        marks = [line[:2] for line in lines[1:3]]
        why = " ".join(line.strip() for line in lines[3:])
        if named is None or marks != ["- ", "+ "] or not why or not all(line.startswith("  ") for line in lines[3:]):
            raise Unreadable(f"{lines[0]!r}: wanted are 'FILE · FUNCTION', '- before', '+ after', and why, indented")
        before, after = (" ".join(line[2:].split()) for line in lines[1:3])
        found.append(Argument(named[1], (named[2] or "").strip(), before, after, why))
    return found


def why(arguments: list[Argument], mutant: Mutant) -> str | None:
    """The argument for a mutant, or None."""
    return next((one.why for one in arguments if one.meets(mutant)), None)
