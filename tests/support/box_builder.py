"""Somebody who builds an instrument in the simulated world: does what the guide asks for, and mends what it names, and nothing else."""

from __future__ import annotations

import io
import json
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from appliance.cli import main
from hw_sim.people.commands import do
from hw_sim.world import World

MOST_ENTERS = 200


class _Ears(io.TextIOBase):
    """The terminal's error stream: each whole line that begins with ``DO:`` is done before the writer goes on."""

    def __init__(self, hands: Callable[[str], None]) -> None:
        self._hands = hands
        self._rest = ""
        self.asked: list[str] = []

    def write(self, text: str) -> int:
        *lines, self._rest = (self._rest + text).split("\n")
        for line in lines:
            # A line of progress is written over from its beginning.
            wish = line.rpartition("\r")[2]
            if wish.startswith("DO: "):
                self.asked.append(wish.removeprefix("DO: "))
                self._hands(self.asked[-1])
        return len(text)

    def isatty(self) -> bool:
        return False


@dataclass
class BoxBuilder:
    """Stands at the instrument of ``world``, whose rig file is ``rig``."""

    world: World
    rig: Path
    folder: Path
    monkeypatch: pytest.MonkeyPatch
    asked: list[str] = field(default_factory=list)
    """Everything that the guide asked for so far."""

    def call(self, *arguments: str) -> dict[str, Any]:
        """Call the guide once and return what its ``--json`` says."""
        ears, said = _Ears(self._do), io.StringIO()
        with self.monkeypatch.context() as patch:
            patch.setattr(sys, "stdin", io.StringIO("\n" * MOST_ENTERS))
            patch.setattr(sys, "stderr", ears)
            patch.setattr(sys, "stdout", said)
            code = main(["setup", "guide", "--rig", str(self.rig), "--out", str(self.folder), "--json", *arguments])
        self.asked += ears.asked
        report: dict[str, Any] = json.loads(said.getvalue())
        assert code == (0 if report["good"] else 1)
        return report

    def deed(self, line: str) -> None:
        """Do something to the world, as docs/protocols/world.md spells it."""
        verb, *words = line.split()
        do(self.world, verb, tuple(words), self.folder / "no-status")

    def edit(self, table: str, pattern: str, line: str) -> None:
        """Replace the one line of a table of the rig file that matches ``pattern``, as a person would."""
        head, found, rest = self.rig.read_text(encoding="utf-8").partition(f"[{table}]\n")
        assert found, table
        mine, bracket, others = rest.partition("\n[")
        changed, count = re.subn(rf"(?m)^{pattern}.*$", line, mine)
        assert count == 1, (table, pattern, mine)
        self.rig.write_text(head + found + changed + bracket + others, encoding="utf-8")

    def add(self, table: str, line: str) -> None:
        """Add a line to a table of the rig file, which is made if it is not there."""
        text = self.rig.read_text(encoding="utf-8")
        head, found, rest = text.partition(f"[{table}]\n")
        self.rig.write_text(
            f"{head}[{table}]\n{line}\n{rest}" if found else f"{text}\n[{table}]\n{line}\n", encoding="utf-8"
        )

    def _do(self, wish: str) -> None:
        pressed = re.match(r"press (\w+) once", wish)
        if pressed:
            self.world.press(pressed[1].lower(), 0.2)
        elif "put the caps on both lenses" in wish:
            self.deed("cap both on")
        elif "take the caps off" in wish:
            self.deed("cap both off")
        else:
            assert "turn both laser windows away" in wish, f"nobody knows how to do: {wish}"
