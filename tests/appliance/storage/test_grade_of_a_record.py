"""A stored scan has one grade: the word that the diver read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from appliance.scan.exposure import Exposure
from appliance.scan.fault import FaultCode
from appliance.scan.grade import NAME, Grade
from appliance.scan.verdict import Verdict
from appliance.service.gallery import read
from appliance.storage.library import Library
from appliance.storage.record import ScanRecord, SecondSequence
from tests.appliance.storage.scenes import ORIGIN, cloud, frames, record

CLOUD = {"points": 20, "coverage_percent": 81.5, "noise_mm": 0.03, "distance_mm": 512.0, "gap_mm": 0.0002}
UNDONE = Verdict("compensation", True, {}, "Motion of 3.1 px during the x fringes was undone")


def causes(*codes: FaultCode) -> Verdict:
    return Verdict("causes", not codes, {f"{code.value.lower()}_percent": 7.0 for code in codes})


def of(*verdicts: Verdict, **changes: object) -> ScanRecord:
    return record(cloud=CLOUD, verdicts=verdicts, **changes)


def test_the_word_that_the_diver_read_stands_whatever_the_numbers_say() -> None:
    said = of(causes(FaultCode.MOVED), Verdict(NAME, True, {}, "good"))
    assert said.grade is Grade.GOOD
    assert of(Verdict(NAME, True, {}, "splendid")).grade is None
    assert of(causes()).grade is None


def test_what_a_second_exposure_made_up_for_is_not_held_against_a_pair() -> None:
    second = SecondSequence(Exposure(3_000), 99, verdicts=(causes(FaultCode.TOO_DARK, FaultCode.AMBIENT),))
    pair = Verdict("pair", True)
    assert of(causes(FaultCode.TOO_BRIGHT), pair, second=second).held_against == (FaultCode.AMBIENT,)
    assert of(causes(FaultCode.TOO_BRIGHT), second=second).held_against == (FaultCode.TOO_BRIGHT,)


def test_a_compensated_scan_has_no_ray_gap() -> None:
    """Its rows come from the model: 0.2 µm would look like a perfect calibration."""
    assert (of(UNDONE).gap_mm, of(UNDONE).compensated) == (None, True)
    plain = of(replace(UNDONE, passed=False))
    assert (plain.gap_mm, plain.compensated) == (0.0002, False)


def test_the_gallery_shows_that_motion_was_corrected(tmp_path: Path) -> None:
    library = Library(tmp_path)
    library.prepare()
    for verdicts in ((UNDONE,), ()):
        kept = of(Verdict(NAME, True, {}, "usable"), *verdicts)
        pending = library.begin(frames(), kept, ORIGIN)
        pending.publish(kept, cloud())
        shown = read(library, pending.scan_id)
        assert (shown.grade, shown.corrected) == (Grade.USABLE, bool(verdicts))
