"""Owns what a judgement of a recorded scan says: a name, a yes or no, and the numbers behind it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from appliance.measure.fault import Fault
from appliance.measure.light.exposure import Exposure


@dataclass(frozen=True, slots=True)
class Verdict:
    """One judgement with its numbers; ``passed`` is None where there was nothing to judge."""

    name: str
    """Name like ``ledger``, ``identity``, ``motion``, ``exposure`` …"""
    passed: bool | None
    numbers: Mapping[str, float | None] = field(default_factory=dict, hash=False)
    text: str = ""

    @classmethod
    def failed(cls, name: str, fault: Fault) -> Verdict:
        """Return the verdict that a fault stands for."""
        return cls(name, False, dict(fault.numbers), f"{fault.code.value}: {fault.detail}".rstrip(": "))


@dataclass(frozen=True, slots=True)
class Judgement:
    """A verdict, and the fault to tell the diver of; ``None``: nothing to tell. The alerts' table says what it spoils."""

    verdict: Verdict
    fault: Fault | None = None
    proposal: Exposure | None = None
    """Exposure proposed for the next scan; ``None``: as this one."""
    second: Exposure | None = None
    """Exposure that a second sequence of the same scene should have, to show what this one cannot; ``None``: one
    serves."""
    remembered: object | None = None
    """Evidence for whoever compares scans with each other, given beside the verdict and never stored. ``None``:
    nothing."""


def faults_in(judgements: Iterable[Judgement]) -> tuple[Fault, ...]:
    """Return the faults of ``judgements``, in their order."""
    return tuple(one.fault for one in judgements if one.fault is not None)
