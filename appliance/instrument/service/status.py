"""The instrument's state for readers without a display, in ``run/status.json``.

``docs/protocols/status.md`` describes the file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from appliance.calibrate import STEPS
from appliance.instrument.machine.keys import labels
from appliance.instrument.machine.leading import alerts, guidance_text, overlap_text
from appliance.instrument.machine.states import Answer, Device, Machine
from appliance.instrument.machine.words import worded


def describe(
    machine: Machine, pid: int, version: str, worker_pid: int | None = None, gallery: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the file's content; ``gallery``: the entry of the scan shown.

    A device is ``ok``, ``lost`` or, before it was tried, ``unknown``.
    """
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
                "seen": alert.is_acknowledged,
            }
            for alert in alerts(machine)
        ],
        "question": _question(machine),
        "keys": {key.name.lower(): worded(label) for key, label in labels(machine).items()},
        "devices": {device.value: _device(machine, device) for device in Device},
        "scans": machine.scans,
        "scans_left": machine.scans_left,
        "last_scan": machine.last_scan,
        "object": machine.choices.object,
        "overlap": _overlap(machine),
        "guidance": _guidance(machine),
        "range": _range(machine),
        "calibration": _calibration(machine),
        "gallery": gallery,
        "pid": pid,
        "worker_pid": worker_pid,
        "version": version,
    }


def _question(machine: Machine) -> dict[str, Any] | None:
    """Return the question to the diver, and the selected answer; ``None``: there is none."""
    if machine.off_question is None:
        return None
    return {"answers": [answer.value for answer in Answer], "selected": machine.off_question.answer.value}


def _calibration(machine: Machine) -> dict[str, Any] | None:
    """Return the current step and the result of its latest recording; ``None`` outside a calibration."""
    position, session = machine.calibrating, machine.session
    if position is None:
        return None
    verified = session.verified
    result = None
    if position.failed is not None:
        result = "FAILED"
    elif position.latest is not None:
        result = "FITS" if position.latest.refusal is None else position.latest.refusal.value
    return {
        "step": position.step.value,
        "busy": position.task is not None,
        "result": result,
        "detail": position.failed.detail
        if position.failed is not None
        else position.latest.detail
        if position.latest is not None
        else "",
        "done": [step.value for step in STEPS if session.done(step)],
        "e_l_before_percent": _percent(verified.before if verified is not None else None),
        "e_l_new_percent": _percent(verified.after if verified is not None else None),
        "in_use": session.in_use,
        "kept": session.kept,
    }


def _overlap(machine: Machine) -> str | None:
    """Return the screen's text about the latest scan's overlap; ``None``: none."""
    overlap = overlap_text(machine)
    return None if overlap is None else worded(overlap.label)


def _guidance(machine: Machine) -> dict[str, Any] | None:
    """Return the screen's guidance and the direction of its arrow; ``None``: none."""
    guidance = guidance_text(machine)
    if guidance is None:
        return None
    toward = None if guidance.toward is None else [round(part, 2) for part in guidance.toward]
    return {"words": guidance.english, "toward": toward}


def _range(machine: Machine) -> dict[str, Any] | None:
    measured = machine.range
    if measured is None:
        return None
    return {
        "distance_mm": round(measured.distance_mm),
        "tilt_deg": None if measured.tilt_deg is None else round(measured.tilt_deg),
        "sigma_mm": round(measured.sigma_mm, 1),
        "dots": measured.dots,
        "word": machine.reach.value,
    }


def _percent(part: float | None) -> float | None:
    return None if part is None else 100.0 * part


def _device(machine: Machine, device: Device) -> str:
    if device in machine.up:
        return "ok"
    return "lost" if device in machine.lost else "unknown"


class StatusFile:
    """Writes the file when it changes, atomically, without fsync: it is worthless after a restart."""

    def __init__(self, root: Path, pid: int, version: str) -> None:
        self.path = root / "run" / "status.json"
        self._pid = pid
        self._version = version
        self._written: dict[str, Any] | None = None

    def update(self, machine: Machine, worker_pid: int | None = None, gallery: Mapping[str, Any] | None = None) -> bool:
        """Write the file if its content changed; return True if it was written.

        A disk that refuses is no error here: the result is False, and the next call tries again.
        """
        content = describe(machine, self._pid, self._version, worker_pid, gallery)
        if content == self._written:
            return False
        draft = self.path.with_name(f".{self.path.name}.draft")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            draft.write_text(json.dumps(content) + "\n", encoding="utf-8")
            # Renamed over the old one, so that readers never see half a file.
            draft.replace(self.path)
        except OSError:
            return False
        self._written = content
        return True

    def remove(self) -> None:
        """Remove the file at a clean end: a status without a process would be wrong."""
        try:
            self.path.unlink(missing_ok=True)
        except OSError:
            return
