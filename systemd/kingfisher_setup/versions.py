"""Owns which version is in use, which was before, and what is on trial: a few links and one small file.

Every step is atomic and durable, and every state between two steps is one from which ``settle`` or a second call goes on.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from kingfisher_setup import durable, placed
from kingfisher_setup.errors import SetupError
from kingfisher_setup.layout import Layout

COMPLETE = "complete"
"""The file of a version's folder that is written last; without it the folder was left half made."""
STARTS = 3
"""How often a version on trial may be started (by power-on or by hand) before it must have passed its self-test."""


@dataclass(frozen=True, slots=True)
class Trial:
    """A version that has not proved itself yet."""

    version: str
    previous: str
    starts_left: int = STARTS
    may_fail: tuple[str, ...] = ()
    """What failed in the last self-test of the version before; the new one is not to blame for it."""
    condemned: str = ""
    """Why it goes, once that is decided: an interrupted way back is gone to its end."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a trial ended."""

    version: str
    accepted: bool
    reason: str
    now: str
    """The version that is in use since."""


def current(layout: Layout) -> str | None:
    return _pointed(layout, "current")


def previous(layout: Layout) -> str | None:
    return _pointed(layout, "previous")


def complete(layout: Layout, name: str) -> bool:
    return (layout.version(name) / COMPLETE).exists()


def installed(layout: Layout) -> tuple[str, ...]:
    """Names of all whole versions."""
    if not layout.versions.is_dir():
        return ()
    return tuple(sorted(path.name for path in layout.versions.iterdir() if complete(layout, path.name)))


@contextmanager
def locked(layout: Layout) -> Iterator[None]:
    """Change versions, alone. Raises SetupError where another one is at it."""
    durable.make_folder(layout.program)
    descriptor = os.open(layout.lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise SetupError(f"{layout.lock}: another setup is at work; let it end first") from error
        yield
    finally:
        os.close(descriptor)


def trial(layout: Layout) -> Trial | None:
    """What is on trial; a file that cannot be read is none, and is taken away by ``settle``."""
    content = durable.read_json(layout.trial)
    try:
        return None if content is None else _trial(content)
    except (KeyError, TypeError, ValueError):
        return None


def outcome(layout: Layout) -> Outcome | None:
    """How the last trial ended; ``None``: there was none since the last switch."""
    content = durable.read_json(layout.outcome)
    try:
        return None if content is None else Outcome(**content)
    except TypeError:
        return None


def switch(layout: Layout, name: str) -> bool:
    """Use ``name`` from the next start on; whether units changed. Nothing watches it: see ``try_out``."""
    before = current(layout)
    changed = _use(layout, name)
    if before is not None and before != name:
        durable.point(layout.previous, f"versions/{before}")
    return changed


def try_out(layout: Layout, name: str, may_fail: tuple[str, ...] = ()) -> bool:
    """Use ``name`` on trial; whether units changed. What is in use now comes back if it does not prove itself."""
    before = current(layout)
    if before is None or before == name:
        raise SetupError(f"{name} is in use or nothing is; nothing to try out")
    durable.remove(layout.outcome)
    durable.write_json(layout.trial, _as_json(Trial(name, before, may_fail=may_fail)))
    return _use(layout, name)


def started(layout: Layout, at: Trial) -> Trial:
    """Count a start of what is on trial, before it is started."""
    counted = replace(at, starts_left=at.starts_left - 1)
    durable.write_json(layout.trial, _as_json(counted))
    return counted


def accept(layout: Layout, at: Trial) -> None:
    """It has proved itself: its own safe screen and setup are trusted from now on, versions before the last go."""
    trust(layout, at.version)
    durable.point(layout.previous, f"versions/{at.previous}")
    _end(layout, Outcome(at.version, True, "self-test passed", at.version))
    prune(layout)


def revert(layout: Layout, at: Trial, reason: str) -> bool:
    """Go back to the version before; whether units changed. The one that failed stays for whoever wants to look at it."""
    if not complete(layout, at.previous):
        raise SetupError(f"{layout.version(at.previous)}: the version to go back to is not there; install again")
    durable.write_json(layout.trial, _as_json(replace(at, condemned=reason)))
    changed = _use(layout, at.previous)
    _end(layout, Outcome(at.version, False, reason, at.previous))
    return changed


def settle(layout: Layout) -> Trial | None:
    """What is really on trial after a loss of power: a switch that was not finished is undone, a way back finished."""
    at, now = trial(layout), current(layout)
    if at is not None and at.condemned:
        revert(layout, at, at.condemned)
        return None
    if at is not None and at.version == now:
        return at
    if now is not None:
        placed.place(layout, now)
    durable.remove(layout.trial)
    return None


def trust(layout: Layout, name: str) -> None:
    """Let setup and safe screen be those of ``name``."""
    durable.point(layout.rescue, f"versions/{name}/systemd")


def prune(layout: Layout) -> None:
    """Remove versions that nobody goes back to, and what was left half made; the last that failed stays to be looked at."""
    kept = {current(layout), previous(layout), _pointed(layout, "rescue")}
    if (at := trial(layout)) is not None:
        kept |= {at.version, at.previous}
    if (ended := outcome(layout)) is not None:
        kept.add(ended.version)
    for path in layout.versions.iterdir() if layout.versions.is_dir() else ():
        if path.name not in kept:
            durable.remove(path / COMPLETE)
            durable.remove_tree(path)


def _use(layout: Layout, name: str) -> bool:
    if not complete(layout, name):
        raise SetupError(f"{layout.version(name)}: not a whole version; run the setup's `install` again")
    changed = placed.place(layout, name)
    durable.point(layout.current, f"versions/{name}")
    return changed


def _end(layout: Layout, how: Outcome) -> None:
    durable.write_json(
        layout.outcome, {"version": how.version, "accepted": how.accepted, "reason": how.reason, "now": how.now}
    )
    durable.remove(layout.trial)


def _trial(content: dict[str, Any]) -> Trial:
    return Trial(
        str(content["version"]),
        str(content["previous"]),
        int(content["starts_left"]),
        tuple(str(part) for part in content["may_fail"]),
        str(content["condemned"]),
    )


def _as_json(at: Trial) -> dict[str, Any]:
    return {
        "version": at.version,
        "previous": at.previous,
        "starts_left": at.starts_left,
        "may_fail": list(at.may_fail),
        "condemned": at.condemned,
    }


def _pointed(layout: Layout, link: str) -> str | None:
    """The version's name that a link of the program's folder leads to; ``None`` where it leads to no whole version."""
    try:
        parts = (layout.program / link).readlink().parts
    except OSError:
        return None
    match parts:
        case ("versions", name, *_) if complete(layout, name):
            return name
        case _:
            return None
