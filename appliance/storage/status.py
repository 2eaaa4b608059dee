"""Owns ``run/status.json``: what the instrument is doing, for those who have no display (``docs/protocols/status.md``)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from appliance.machine.alerts import alerts
from appliance.machine.states import Device, Machine


def describe(machine: Machine, pid: int, version: str) -> dict[str, Any]:
    """The file's content. A device is ``ok``, ``lost`` or, before it was tried, ``unknown``."""
    return {
        "state": machine.state.value,
        "since_ns": machine.since_ns,
        "alerts": [
            {
                "code": alert.code.value,
                "headline": alert.headline,
                "action": alert.action,
                "severity": alert.severity.name,
                "detail": alert.detail,
            }
            for alert in alerts(machine)
        ],
        "devices": {device.value: _device(machine, device) for device in Device},
        "scans": machine.scans,
        "scans_left": machine.scans_left,
        "last_scan": machine.last_scan,
        "pid": pid,
        "version": version,
    }


def _device(machine: Machine, device: Device) -> str:
    if device in machine.up:
        return "ok"
    return "lost" if device in machine.lost else "unknown"


class StatusFile:
    """Writes the file when it would change, atomically, without fsync: it is worthless after a restart."""

    def __init__(self, root: Path, pid: int, version: str) -> None:
        self.path = root / "run" / "status.json"
        self._pid = pid
        self._version = version
        self._written: dict[str, Any] | None = None

    def update(self, machine: Machine) -> bool:
        """Write if anything changed; whether it did. A disk that refuses is not an error here: False, and tried again."""
        content = describe(machine, self._pid, self._version)
        if content == self._written:
            return False
        draft = self.path.with_name(f".{self.path.name}.draft")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            draft.write_text(json.dumps(content) + "\n", encoding="utf-8")
            draft.replace(self.path)
        except OSError:
            return False
        self._written = content
        return True

    def remove(self) -> None:
        """Take the file away at a clean end: a status without a process would be a lie."""
        try:
            self.path.unlink(missing_ok=True)
        except OSError:
            return
