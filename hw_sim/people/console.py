"""Owns the trainer's console: lines typed while somebody dives, each done at once, each answered, with help.

It reads a descriptor in a thread of its own and ends with it. A line that is not understood changes nothing.
"""

from __future__ import annotations

import logging
import os
import select
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from hw_sim import faults
from hw_sim.people import commands, status_file

if TYPE_CHECKING:
    from hw_sim.world import World

LOG = logging.getLogger(__name__)
LOOK_S = 0.1
LONGEST_LINE = 4096
OWN = {
    "press": ("KEY [S]", "press a glove key: scan back up down, held for S seconds"),
    "see": ("", "what the instrument shows, in one line"),
    "faults": ("", "what is broken now"),
    "where": ("", "object, pose and water before the instrument"),
    "help": ("[VERB]", "this list, or more about one verb; help fault lists what can break and how"),
}
"""Verbs that only a console has: (what follows, what it does)."""


class Console:
    """Answers one line after the other."""

    def __init__(self, world: World, status: Path) -> None:
        self._world = world
        self._status = status
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """Return the answers to the lines that these bytes complete; of a line without end the last ``LONGEST_LINE`` bytes are kept."""
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[-LONGEST_LINE:]
        return [said for line in lines for said in self.answer(line.decode("utf-8", "replace")).splitlines()]

    def answer(self, line: str) -> str:
        """Carry out the line and return what was done; errors are answers too."""
        verb, *words = line.split("#", 1)[0].split() or [""]
        try:
            return self._do(verb, tuple(words))
        except (ValueError, OSError, commands.CommandError) as error:
            return f"no: {error}"

    def _do(self, verb: str, words: tuple[str, ...]) -> str:
        world = self._world
        match verb, words:
            case "", ():
                return ""
            case "help", _:
                return _help(words)
            case "see", ():
                return status_file.summary(status_file.read(self._status))
            case "faults", ():
                return "; ".join(world.broken) or "nothing is broken"
            case "where", ():
                scene = world.scene
                pose = " ".join(f"{part:.0f}" for part in scene.start_pose)
                return f"{scene.object} at {pose}, texture {scene.texture}, {scene.water}"
            case "press", (key, *hold) if len(hold) <= 1:
                world.press(key, *(float(seconds) for seconds in hold))
                return "done"
        if not commands.check(verb, words):
            raise ValueError(f"'{' '.join((verb, *words))}' is not understood; type help")
        commands.do(world, verb, words, self._status)
        return "done"


def _help(words: tuple[str, ...]) -> str:
    known = {**commands.HELP, **OWN}
    match words:
        case ():
            width = max(len(f"{verb} {what}") for verb, (what, _) in known.items())
            return "\n".join(f"  {f'{verb} {what}'.ljust(width)}  {text}" for verb, (what, text) in known.items())
        case ("fault",):
            return f"  fault COMPONENT VERB [how=WORD] [frame=K] [at_s=T] [for_s=T] [count=N] [amount=X]\n  {faults.supported()}"
        case (verb,) if verb in known:
            return f"  {verb} {known[verb][0]}\n  {known[verb][1]}"
        case _:
            raise ValueError(f"help: '{' '.join(words)}' is no verb; there are {', '.join(known)}")


@contextmanager
def reading(world: World, status: Path, descriptor: int) -> Iterator[None]:
    """A console on ``descriptor`` as long as the context lasts; answers are logged."""
    console, closing = Console(world, status), threading.Event()

    def run() -> None:
        while not closing.is_set():
            # A read that blocks could not be ended: look first, and look again whether the context has ended.
            if not select.select([descriptor], [], [], LOOK_S)[0]:
                continue
            data = os.read(descriptor, LONGEST_LINE)
            if not data:
                return
            for said in console.feed(data):
                LOG.info("%s", said)

    thread = threading.Thread(target=run, name="console", daemon=True)
    LOG.info("console: type help")
    thread.start()
    try:
        yield
    finally:
        closing.set()
        thread.join(5.0)
