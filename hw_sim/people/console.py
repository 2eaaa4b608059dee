"""The trainer's console: commands during a dive, executed and answered at once, with help.

It reads a descriptor in a thread of its own and ends with it. An invalid line changes nothing.
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
    "see": ("", "show the instrument's state in one line"),
    "faults": ("", "list the faults now"),
    "where": ("", "show object, pose and water before the instrument"),
    "help": ("[VERB]", "show this list, or more about one verb; help fault lists all faults"),
}
"""Verbs of the console alone → (arguments, help text)."""


class Console:
    """Answers one line after the other."""

    def __init__(self, world: World, status: Path) -> None:
        self._world = world
        self._status = status
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """Return the answers to the lines that these bytes complete.

        Of an incomplete line the last ``LONGEST_LINE`` bytes are kept.
        """
        *lines, incomplete = (self._rest + data).split(b"\n")
        self._rest = incomplete[-LONGEST_LINE:]
        return [text for line in lines for text in self.answer(line.decode("utf-8", "replace")).splitlines()]

    def answer(self, line: str) -> str:
        """Execute the line and return its result or error as text."""
        verb, *arguments = line.split("#", 1)[0].split() or [""]
        try:
            return self._do(verb, tuple(arguments))
        except (ValueError, OSError, commands.CommandError) as error:
            return f"no: {error}"

    def _do(self, verb: str, arguments: tuple[str, ...]) -> str:
        world = self._world
        match verb, arguments:
            case "", ():
                return ""
            case "help", _:
                return _help(arguments)
            case "see", ():
                return status_file.summary(status_file.read(self._status))
            case "faults", ():
                return "; ".join(world.broken) or "no fault"
            case "where", ():
                scene = world.scene
                pose = " ".join(f"{part:.0f}" for part in scene.start_pose)
                return f"{scene.object} at {pose}, texture {scene.texture}, {scene.water}"
            case "press", (key, *hold) if len(hold) <= 1:
                world.press(key, *(float(seconds) for seconds in hold))
                return "done"
        if not commands.check(verb, arguments):
            raise ValueError(f"'{' '.join((verb, *arguments))}' is not understood; type help")
        commands.do(world, verb, arguments, self._status)
        return "done"


def _help(arguments: tuple[str, ...]) -> str:
    verbs = {**commands.HELP, **OWN}
    match arguments:
        case ():
            width = max(len(f"{verb} {what}") for verb, (what, _) in verbs.items())
            return "\n".join(f"  {f'{verb} {what}'.ljust(width)}  {text}" for verb, (what, text) in verbs.items())
        case ("fault",):
            return f"  fault COMPONENT VERB [how=WORD] [frame=K] [at_s=T] [for_s=T] [count=N] [amount=X]\n  {faults.supported()}"
        case (verb,) if verb in verbs:
            return f"  {verb} {verbs[verb][0]}\n  {verbs[verb][1]}"
        case _:
            raise ValueError(f"help: '{' '.join(arguments)}' is no verb; there are {', '.join(verbs)}")


@contextmanager
def reading(world: World, status: Path, descriptor: int) -> Iterator[None]:
    """Run a console on ``descriptor`` as long as the context lasts; answers are logged."""
    console, closing = Console(world, status), threading.Event()

    def run() -> None:
        while not closing.is_set():
            # A blocking read could not be ended, so poll, and check whether the context has ended.
            if not select.select([descriptor], [], [], LOOK_S)[0]:
                continue
            data = os.read(descriptor, LONGEST_LINE)
            if not data:
                return
            for text in console.feed(data):
                LOG.info("%s", text)

    thread = threading.Thread(target=run, name="console", daemon=True)
    LOG.info("console: type help")
    thread.start()
    try:
        yield
    finally:
        closing.set()
        thread.join(5.0)
