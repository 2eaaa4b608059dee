"""Owns a pretended installation: the folders that the setup makes, with a version in them that weighs nothing.

Only what is in a version is small; links, files and marks are the setup's own.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from kingfisher_setup import versions
from kingfisher_setup.layout import Layout

CHANGES = {"open", "os.rename", "os.remove", "os.symlink", "os.mkdir", "os.rmdir", "os.chmod"}
"""Audit events that may change a disk."""


@dataclass(frozen=True, slots=True)
class Installation:
    """Two versions that differ in every file that is placed."""

    layout: Layout

    def add(self, name: str, unit: str) -> None:
        folder = self.layout.version(name)
        (folder / "systemd").mkdir(parents=True)
        for source in ("kingfisher.service", "kingfisher-trial.service", "kingfisher.sysusers"):
            (folder / "systemd" / source).write_text(f"# {unit} {source}\n")
        (folder / versions.COMPLETE).write_text(name)

    def unit(self) -> str:
        """Of which version the placed files are; all of one."""
        system = self.layout.at("/etc/systemd/system")
        users = self.layout.at("/etc/sysusers.d/kingfisher.conf").read_text()
        owners = {path.read_text().split()[1] for path in system.glob("*.service")} | {users.split()[1]}
        assert len(owners) == 1, owners
        return owners.pop()

    def dying(self, change: Callable[[Layout], object], steps: int) -> bool:
        """Make a change in a process that dies before its n-th step on the disk; whether it got to its end."""
        child = os.fork()
        if child == 0:
            sys.addaudithook(_Death(str(self.layout.root), steps))
            try:
                change(self.layout)
            except BaseException:
                os._exit(1)
            os._exit(0)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        assert code in (0, -signal.SIGKILL)
        return code == 0


class _Death:
    """An audit hook: no cleaning up follows, as with the loss of power."""

    def __init__(self, below: str, steps: int) -> None:
        self._below, self._left = below, steps

    def __call__(self, event: str, arguments: tuple[object, ...]) -> None:
        if event in CHANGES and any(str(argument).startswith(self._below) for argument in arguments):
            self._left -= 1
            if self._left < 0:
                os.kill(os.getpid(), signal.SIGKILL)


def make(root: Path) -> Installation:
    """With ``old`` in use and ``new`` built beside it."""
    made = Installation(Layout(root))
    made.add("old", "old")
    made.add("new", "new")
    versions.switch(made.layout, "old")
    versions.trust(made.layout, "old")
    return made
