"""Owns the watch over a version on trial: it stays if it passes its self-test, else the one before comes back.

Runs as a unit of its own before the service, from the last version that was accepted: a new one is not its own judge.
"""

from __future__ import annotations

import os
import socket
import sys
import time
from contextlib import suppress

from kingfisher_setup import target, versions
from kingfisher_setup.durable import read_json, remove
from kingfisher_setup.errors import SetupError
from kingfisher_setup.layout import Layout

LIMIT_S = 180.0
"""From the start of the service to its self-test; kernels are compiled, what takes time is the devices' start."""
CRASHES = 2
"""So many restarts by systemd end the trial."""
BEAT_S = 0.5
SERVICE = "kingfisher.service"


def failed_now(layout: Layout, version: str) -> tuple[str, ...]:
    """What failed in the last self-test of the version in use; nothing, where there was none."""
    mark = _mark(layout, version)
    return () if mark is None else mark


def watch(layout: Layout, limit_s: float = LIMIT_S) -> int:
    """Count the start, let the service start, wait up to ``limit_s`` for its self-test, decide. Returns the exit code."""
    with versions.locked(layout):
        before = versions.trial(layout)
        at = versions.settle(layout)
        if at is None:
            if before is not None:
                _tell(f"{before.version} is not in use: an interrupted change was undone")
                target.systemctl(layout, "daemon-reload")
            _ready()
            return 0
        if at.starts_left <= 0:
            _revert(layout, at, f"started {versions.STARTS} times without passing its self-test")
            _ready()
            return 0
        at = versions.started(layout, at)
        remove(layout.self_test)
    _tell(f"{at.version} is on trial, {at.starts_left} starts left")
    _ready()
    reason = _wait(layout, at, limit_s)
    with versions.locked(layout):
        if versions.trial(layout) != at:
            return 0  # somebody decided by hand
        if reason is None:
            versions.accept(layout, at)
            _tell(f"{at.version} has passed its self-test and stays")
            return 0
        _revert(layout, at, reason)
    with suppress(SetupError):  # nothing of it had failed
        target.systemctl(layout, "reset-failed", SERVICE)
    target.systemctl(layout, "restart", "--no-block", SERVICE)
    return 0


def _wait(layout: Layout, at: versions.Trial, limit_s: float) -> str | None:
    """``None`` when it has passed, else why it has not. A device may take its time: only the end of it decides."""
    end_s = time.monotonic() + limit_s
    worse: list[str] | None = None
    while time.monotonic() < end_s:
        failed = _mark(layout, at.version)
        worse = None if failed is None else sorted(set(failed) - set(at.may_fail))
        if worse == []:
            return None
        ended = ended_by_itself(target.systemctl(layout, "show", "-p", "NRestarts", "-p", "ActiveState", SERVICE))
        if ended is not None:
            return ended
        time.sleep(BEAT_S)
    return f"its self-test failed: {', '.join(worse)}" if worse else f"no self-test within {limit_s:g} s"


def ended_by_itself(shown: str) -> str | None:
    """Why the service cannot be waited for any longer, from what ``systemctl show`` says; ``None``: it can."""
    facts = dict(line.partition("=")[::2] for line in shown.splitlines())
    restarts = facts.get("NRestarts", "")
    if restarts.isdigit() and int(restarts) >= CRASHES:
        return f"it ended {restarts} times by itself"
    return "it failed to start" if facts.get("ActiveState") == "failed" else None


def _mark(layout: Layout, version: str) -> tuple[str, ...] | None:
    """What failed in the self-test of ``version``; ``None``: it has not ended."""
    content = read_json(layout.self_test)
    if content is None or content.get("installation") != version or not isinstance(content.get("failed"), list):
        return None
    return tuple(str(part) for part in content["failed"])


def _revert(layout: Layout, at: versions.Trial, reason: str) -> None:
    if versions.revert(layout, at, reason):
        target.systemctl(layout, "daemon-reload")
    print(f"<3>{at.version} was taken back: {reason}; {at.previous} is in use again", file=sys.stderr, flush=True)


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _ready() -> None:
    """sd_notify(3): what is ordered after this may start."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as to:
        try:
            to.sendto(b"READY=1", "\0" + address[1:] if address.startswith("@") else address)
        except OSError as error:
            raise SetupError(f"NOTIFY_SOCKET {address}: {error.strerror}") from error
