"""What the process for points says enters the scan in hand, and only that one; what it means is told once."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from appliance.machine import events as on
from appliance.machine.states import Part
from appliance.machine.words import Text
from appliance.reconstruct.table import Cloud
from appliance.scan.exposure import Exposure
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.overlap import Overlap
from appliance.scan.verdict import Judgement, Verdict
from appliance.service.scan_in_memory import ScanInMemory, SecondInMemory
from appliance.service.worker_reports import WorkerReports
from appliance.worker.looking import LiveLookedAt
from appliance.worker.process import (
    CloudReady,
    PairJudged,
    ScanCompared,
    ScanJudged,
    ScanSpoiled,
    SequenceIdentified,
    WorkerFailed,
    WorkerReady,
)
from tests.appliance.machine.walks import SUMMARY
from tests.appliance.service.scripted import Desk, a_desk
from tests.appliance.storage.scenes import ORIGIN, record, second_sequence

SPOILT = Fault(FaultCode.MOVED, "the hands shook")
GOOD, BAD = Judgement(Verdict("motion", True)), Judgement(Verdict("motion", False), SPOILT)
PAIR = Judgement(Verdict("pair", True))
DOWN = Fault(FaultCode.RECONSTRUCTION_FAILED, "the process ended with code -9")


def cloud() -> Cloud:
    ones = np.ones(5, np.float32)
    return Cloud(
        np.ones((5, 3), np.float32), np.ones(5, np.uint8), ones, ones, ones, np.arange(5, dtype=np.uint32), SUMMARY
    )


class Heard:
    """Reports about a scan that began 2 s before, and whether what was recorded last was given up."""

    def __init__(self, desk: Desk) -> None:
        scans = desk.parts.scans
        self.dropped = 0
        self.reports = WorkerReports(scans.worker, scans.watch, desk.script.clock, self._drop)
        begun_ns = desk.script.clock.now_ns() - 2_000_000_000
        self.scan = ScanInMemory(4, begun_ns, Exposure(8_000), ORIGIN, record=record())

    def _drop(self) -> None:
        self.dropped += 1

    @property
    def verdicts(self) -> list[Verdict]:
        assert self.scan.record is not None
        return list(self.scan.record.verdicts)


@pytest.fixture
def heard(tmp_path: Path) -> Iterator[Heard]:
    with a_desk(tmp_path) as desk:
        yield Heard(desk)


def test_of_another_scan_nothing_is_heard(heard: Heard) -> None:
    about = (CloudReady(3, True, cloud(), 0.1), ScanJudged(3, (BAD,), 0.1), ScanCompared(3, Overlap(0.5), 0.1))
    for report in about:
        assert heard.reports.meant(report, heard.scan) == []
        assert heard.reports.meant(report, None) == []
    assert (heard.scan.full, heard.scan.judgements, heard.scan.times_s) == (None, (), {})


def test_news_of_no_scan_are_told_as_they_are(heard: Heard) -> None:
    assert [heard.reports.settled] == [False]
    assert heard.reports.meant(WorkerReady(), None) == [
        on.ConditionCleared(FaultCode.RECONSTRUCTION_FAILED), on.PartTested(Part.WORKER, True),
    ]  # fmt: skip
    assert [heard.reports.settled] == [True]
    assert heard.reports.meant(SequenceIdentified(9), None) == [on.PatternsRight(9)]
    assert heard.reports.meant(LiveLookedAt(None, 77, 0.1), None) == [on.Guided(None, 77)]


def test_clouds_enter_the_scan_with_the_time_at_which_each_was_seen_first(heard: Heard) -> None:
    scan, made = heard.scan, cloud()
    assert heard.reports.meant(CloudReady(4, False, made, 0.25), scan) == [on.CoarseReady(4, made.summary)]
    assert (scan.coarse, scan.full) == (made, None)
    assert heard.reports.meant(CloudReady(4, True, made, 0.5), scan) == [on.FullReady(4, made.summary)]
    assert (scan.full, scan.times_s["coarse_cpu"], scan.times_s["full_cpu"]) == (made, 0.25, 0.5)
    assert 2.0 <= scan.times_s["coarse"] <= scan.times_s["full"] < 5.0
    first_s = scan.times_s["full"]
    heard.reports.meant(CloudReady(4, True, cloud(), 0.5), scan)
    assert scan.times_s["full"] == first_s


def test_judgements_are_entered_and_the_first_proposals_told(heard: Heard) -> None:
    proposing = Judgement(Verdict("exposure", True), proposal=Exposure(4_000), second=Exposure(14_000))
    later = Judgement(Verdict("water", True), proposal=Exposure(9_000), second=Exposure(9_000))
    events = heard.reports.meant(ScanJudged(4, (BAD, proposing, later), 0.25), heard.scan)
    assert events == [on.Judged(4, (SPOILT,), Exposure(4_000), Exposure(14_000))]
    assert {"motion", "exposure", "water"} <= {one.name for one in heard.verdicts}
    assert heard.reports.meant(ScanJudged(4, (GOOD,), 0.5), heard.scan) == [on.Judged(4)]
    assert heard.scan.times_s["judged_cpu"] == 0.75
    assert heard.scan.judgements == (GOOD,)
    assert [one.passed for one in heard.verdicts if one.name == "motion"] == [True], "in place of the first word"


def test_a_spoilt_scan_and_its_overlap_are_told(heard: Heard) -> None:
    assert heard.reports.meant(ScanCompared(4, Overlap(0.5), 0.1), heard.scan) == [on.OverlapTold(4, Overlap(0.5))]
    assert heard.scan.times_s["overlap_cpu"] == 0.1
    assert heard.reports.meant(ScanSpoiled(4, GOOD), heard.scan) == []
    assert heard.reports.meant(ScanSpoiled(4, BAD), heard.scan) == [on.ReconstructionFailed(4, SPOILT)]
    assert BAD.verdict in heard.verdicts


def with_second(heard: Heard) -> SecondInMemory:
    second = SecondInMemory(5, heard.scan.begun_ns, Exposure(14_000), second_sequence())
    heard.scan.second = second
    return second


def test_both_sequences_become_one_cloud(heard: Heard) -> None:
    assert heard.reports.meant(PairJudged(4, (GOOD,), PAIR, cloud(), 0.5), heard.scan) == [], "there is no second one"
    second, made = with_second(heard), cloud()
    (merged,) = heard.reports.meant(PairJudged(4, (GOOD,), PAIR, made, 0.5), heard.scan)
    assert isinstance(merged, on.PairMerged)
    assert (merged.number, merged.summary, merged.warnings) == (4, made.summary, ())
    assert (second.merged, heard.scan.full, heard.scan.times_s["pair_cpu"]) == (True, made, 0.5)
    assert 2.0 <= heard.scan.times_s["pair"] < 5.0
    assert heard.scan.coarse is not None
    assert PAIR.verdict in heard.verdicts
    assert second.record is not None
    assert second.record.verdicts[-1] == GOOD.verdict
    assert heard.dropped == 0


@pytest.mark.parametrize("fault", [SPOILT, None])
def test_a_second_sequence_that_does_not_fit_is_given_up_alone(heard: Heard, fault: Fault | None) -> None:
    second = with_second(heard)
    pair = Judgement(Verdict("pair", False, {}, "nothing in common"), fault)
    (failed,) = heard.reports.meant(PairJudged(4, (), pair, None, 0.5), heard.scan)
    assert failed == on.PairFailed(4, fault or Fault(FaultCode.RECONSTRUCTION_FAILED, "nothing in common"))
    assert (second.merged, heard.scan.full, heard.dropped) == (False, None, 1)


@pytest.mark.parametrize(
    ("number", "second", "merged", "told"),
    [
        (4, False, False, on.ReconstructionFailed(4, DOWN)),
        (4, True, False, on.PairFailed(4, DOWN)),
        (4, True, True, on.ReconstructionFailed(4, DOWN)),
        (3, True, False, on.ReconstructionFailed(3, DOWN)),
        (None, False, False, None),
    ],
)
def test_a_process_that_is_down_for_good_fails_what_it_had(
    heard: Heard, number: int | None, second: bool, merged: bool, told: on.Event | None
) -> None:
    if second:
        with_second(heard).merged = merged
    events = heard.reports.meant(WorkerFailed(number, DOWN), heard.scan)
    down = [on.ConditionRaised(DOWN), on.PartTested(Part.WORKER, False, Text.GIVEN_UP)]
    assert events == [*([] if told is None else [told]), *down]
    assert heard.reports.settled
    assert heard.dropped == isinstance(told, on.PairFailed)
