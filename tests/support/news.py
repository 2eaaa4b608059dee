"""Makes news of a scan as the worker tells them, in a line each."""

from __future__ import annotations

from appliance.measure.cloud import CloudLocation, CloudSummary
from appliance.measure.fault import Fault
from appliance.measure.guidance import Overlap
from appliance.measure.light.exposure import Exposure
from appliance.measure.news import (
    Bracket,
    CoarseCloud,
    FullCloud,
    News,
    PatternIdentity,
    ReconstructionFailure,
    ScanOverlap,
    Verdicts,
)
from appliance.measure.verdict import Judgement, Verdict


def held(name: str, fault: Fault) -> Judgement:
    return Judgement(Verdict(name, False), fault)


def found(summary: CloudSummary) -> CloudLocation:
    return CloudLocation(((0, summary.points),), summary)


def right(number: int) -> News:
    return News(number, PatternIdentity(Judgement(Verdict("identity", True))))


def wrong(number: int, fault: Fault) -> News:
    return News(number, PatternIdentity(held("identity", fault)))


def coarse(number: int, summary: CloudSummary) -> News:
    return News(number, CoarseCloud(found(summary)))


def judged(
    number: int, faults: tuple[Fault, ...] = (), proposal: Exposure | None = None, second: Exposure | None = None
) -> News:
    """Judges who hold ``faults`` against the scan, and the one of light with its proposals."""
    light = Judgement(Verdict("light", True), proposal=proposal, second=second)
    return News(number, Verdicts((light, *(held("any", fault) for fault in faults))))


def full(number: int, summary: CloudSummary, *faults: Fault) -> News:
    """The full cloud, and what is held against the scan at last."""
    return News(number, FullCloud(found(summary), tuple(held("any", fault) for fault in faults)))


def merged(number: int, summary: CloudSummary, *faults: Fault) -> News:
    """The cloud of two sequences, and what is held against the second one."""
    second = tuple(held("any", fault) for fault in faults)
    return News(number, Bracket(found(summary), Judgement(Verdict("pair", True)), second))


def not_merged(number: int, fault: Fault) -> News:
    return News(number, Bracket(None, held("pair", fault)))


def failed(number: int, fault: Fault) -> News:
    return News(number, ReconstructionFailure(fault))


def overlap(number: int, of: Overlap) -> News:
    return News(number, ScanOverlap(of))
