"""Owns what is known of the starts before this one: whether the last run ended well, and what became of an update."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from appliance.measure import Fault, FaultCode

log = logging.getLogger("kingfisher")

RUNNING = "running"
"""A file in the service's run-time folder, which is memory: there while a run has not ended well."""
MOST_BYTES = 1 << 16


def installation(prefix: Path) -> str:
    """Return the name of the installed version that runs from ``prefix``; of a source tree "source"."""
    return prefix.name if _is_installed(prefix) else "source"


@contextmanager
def this_run(environment: Mapping[str, str], prefix: Path) -> Iterator[tuple[Fault, ...]]:
    """Find what the diver is to be told of the run before; a block that is left without an error has ended well.

    Nothing is remembered where ``environment`` is not a service's.
    """
    runtime = environment.get("RUNTIME_DIRECTORY")
    mark = None if not runtime else Path(runtime.split(":")[0]) / RUNNING
    news = [fault for fault in (_undone(prefix), _restarted(mark)) if fault is not None]
    for fault in news:
        log.warning("%s: %s", fault.code.value, fault.detail)
    if mark is not None:
        with suppress(OSError):
            mark.touch()
    # No `finally`: an error must leave the mark behind.
    yield tuple(news)
    if mark is not None:
        with suppress(OSError):
            mark.unlink(missing_ok=True)


def recovered(scans: Sequence[str]) -> tuple[Fault, ...]:
    """Return what the diver is told of scans that an earlier run, or a loss of power, left unpublished and that were whole."""
    return (Fault(FaultCode.SCAN_RECOVERED, f"scan {', '.join(scans)}"),) if scans else ()


def _restarted(mark: Path | None) -> Fault | None:
    if mark is None or not mark.exists():
        return None
    return Fault(FaultCode.RESTARTED, "the run before did not end by itself; see the journal")


def _undone(prefix: Path) -> Fault | None:
    """Return how the last trial ended, as ``systemd/kingfisher_setup`` has written it beside the versions."""
    if not _is_installed(prefix):
        return None
    try:
        with (prefix.parent.parent / "outcome.json").open("rb") as file:
            ended = json.loads(file.read(MOST_BYTES))
        if ended["accepted"] is not False or ended["now"] != prefix.name:
            return None
        return Fault(FaultCode.UPDATE_UNDONE, f"{ended['version']}: {ended['reason']}")
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _is_installed(prefix: Path) -> bool:
    return prefix.parent.name == "versions"
