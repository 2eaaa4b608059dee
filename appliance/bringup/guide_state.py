"""Owns what is kept of a guided bring-up between two calls: each step's findings, what they rest on, and when they were found."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from appliance.bringup.finding import BringupError, Finding
from appliance.bringup.guide import NAMES, STEPS, GuideStep, StepOutcome, changed, inputs_of

SCHEMA = 1
STATE = "bringup.json"


@dataclass(frozen=True, slots=True)
class StepRecord:
    """One step that was done."""

    good: bool
    findings: tuple[Finding, ...]
    when: str
    """Date and time, ISO 8601, by the computer's calendar: for people only."""
    duration_s: float
    inputs: Mapping[str, Any]
    """Keys of the rig file that it rests on, by dotted name."""
    tables: Mapping[str, tuple[Mapping[str, Any], ...]] = field(default_factory=dict)
    pictures: Mapping[str, str] = field(default_factory=dict)
    """Captions of its pictures, by the name of the file beside the state."""
    written: Mapping[str, Any] = field(default_factory=dict)
    """Keys that it wrote into the rig file, by dotted name."""

    @classmethod
    def of(cls, outcome: StepOutcome, when: str, duration_s: float, inputs: Mapping[str, Any]) -> StepRecord:
        """Return what is kept of an outcome."""
        pictures = {name: caption for name, (caption, _) in outcome.pictures.items()}
        written = {f"{place.table}.{place.key}": value for place, value in outcome.written.items()}
        return cls(outcome.good, outcome.findings, when, duration_s, inputs, outcome.tables, pictures, written)


@dataclass(frozen=True, slots=True)
class GuideState:
    """Everything that is kept."""

    rig_file: str = ""
    rig_sha256: str = ""
    """Checksum of the rig file as it was after the last step."""
    steps: Mapping[str, StepRecord] = field(default_factory=dict)
    about: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Versions, and what was on the buses at the last call: lines by title."""

    def with_step(self, name: str, record: StepRecord) -> GuideState:
        """Return the state after one more step."""
        return replace(self, steps={**self.steps, name: record})

    def stands(self, step: GuideStep, content: Mapping[str, Any]) -> bool:
        """Tell whether a step was good, and the keys of the rig file that it rests on are still the same."""
        record = self.steps.get(step.name)
        return record is not None and record.good and not changed(record.inputs, inputs_of(content, step))

    def outdated(self, step: GuideStep, content: Mapping[str, Any]) -> list[str]:
        """Return the keys that changed since a step was done."""
        record = self.steps.get(step.name)
        return [] if record is None else changed(record.inputs, inputs_of(content, step))

    def as_bytes(self) -> bytes:
        """Return the file's content."""
        steps = {name: _encoded(self.steps[name]) for name in NAMES if name in self.steps}
        content = {
            "schema": SCHEMA,
            "rig_file": self.rig_file,
            "rig_sha256": self.rig_sha256,
            "about": {name: list(lines) for name, lines in self.about.items()},
            "steps": steps,
        }
        return (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()


def read_state(data: bytes, name: str) -> GuideState:
    """Return the state in a file's content. Raises BringupError for what is none; ``name`` is the file's, for the text."""
    remedy = "move it away to begin anew, or give another folder with --out"
    try:
        content = json.loads(data)
        # Before anything else is looked for: another version's file is no damaged one.
        if content["schema"] != SCHEMA:
            raise BringupError(
                f"{name}: schema {content['schema']!r:.20}; this program writes and reads {SCHEMA}; {remedy}"
            )
        return GuideState(
            str(content["rig_file"]),
            str(content["rig_sha256"]),
            {step.name: _decoded(content["steps"][step.name]) for step in STEPS if step.name in content["steps"]},
            {str(title): tuple(map(str, lines)) for title, lines in content["about"].items()},
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BringupError(f"{name}: is no state of a bring-up ({type(error).__name__}: {error}); {remedy}") from error


def _encoded(record: StepRecord) -> dict[str, Any]:
    return {
        "good": record.good,
        "when": record.when,
        "duration_s": round(record.duration_s, 3),
        "findings": [one.as_dict() for one in record.findings],
        "inputs": dict(record.inputs),
        "written": dict(record.written),
        "tables": {title: [dict(row) for row in rows] for title, rows in record.tables.items()},
        "pictures": dict(record.pictures),
    }


def _decoded(content: Mapping[str, Any]) -> StepRecord:
    findings = tuple(
        Finding(
            str(one["name"]),
            bool(one["ok"]),
            str(one["said"]),
            str(one["limits"]),
            str(one["remedy"]),
            dict(one["numbers"]),
        )
        for one in content["findings"]
    )
    return StepRecord(
        bool(content["good"]),
        findings,
        str(content["when"]),
        float(content["duration_s"]),
        dict(content["inputs"]),
        {str(title): tuple(dict(row) for row in rows) for title, rows in content["tables"].items()},
        {str(name): str(caption) for name, caption in content["pictures"].items()},
        dict(content["written"]),
    )
