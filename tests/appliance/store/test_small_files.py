"""What was chosen, named, learnt or counted survives a restart; what cannot be is not used, and is told."""

from __future__ import annotations

import json
import math
import os
import threading
import zlib
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from appliance.base.sealed_file import ContentError
from appliance.calibrate.health import MOST_POINTS, HealthFile, HealthTrend, Reference, ThirdTrend, TrendPoint
from appliance.instrument.machine.choices import Choices
from appliance.instrument.ranging.beams import PointerBeam, Pointers
from appliance.instrument.service.remembered import BeamsFile, ChoicesFile
from appliance.measure.cloud import PatchGaps
from appliance.measure.fault import FaultCode
from appliance.measure.light.exposure import Exposure
from appliance.store import label, names
from appliance.store.atomic import LocalFileSystem, StorageError
from appliance.store.label import Label
from appliance.store.lock import hold_lock, holder
from tests.appliance.store.scenes import padded
from tests.support.sealing import opened, sealed

RIG = Choices(Exposure(12_000), 16, 0.0, 20.0)
CHOSEN = Choices(Exposure(16_000, 4.0), 32, 35.0, 7.0, "de", 3, 4)


def test_what_was_chosen_is_there_after_a_restart_and_the_rest_follows_the_rig_file(tmp_path: Path) -> None:
    file = ChoicesFile(tmp_path, RIG)
    assert file.read() == (RIG, None), "nothing was chosen yet"
    file.write(CHOSEN)
    assert ChoicesFile(tmp_path, RIG).read() == (CHOSEN, None)
    file.write(replace(RIG, period_px=64, language="de"))
    assert json.loads((tmp_path / "choices.json").read_bytes())["chosen"] == {"period_px": 64, "language": "de"}
    corrected = replace(RIG, salinity_psu=12.0, exposure=Exposure(8_000))
    assert ChoicesFile(tmp_path, corrected).read() == (replace(corrected, period_px=64, language="de"), None)


CHOICES: dict[str, tuple[tuple[Any, ...], tuple[Any, ...]]] = {
    "exposure_us": ((50, 16_600), (49, 16_601, True)), "gain_db": ((0.0, 48.0), (-0.1, 48.1, "4")),
    "salinity_psu": ((0.0, 45.0), (-0.1, 45.1, None)), "water_c": ((-2.0, 40.0), (-2.1, 40.1)), "period_px": ((16, 64), (17,)),
    "language": (("en", "de"), ("fr",)), "object": ((), (1, "1")), "objects": ((0,), (-1, None)),
}  # fmt: skip
"""What is taken, and what is refused."""


@pytest.mark.parametrize("name", CHOICES)
def test_choices_are_taken_to_their_limits_and_not_beyond(tmp_path: Path, name: str) -> None:
    allowed, refused = CHOICES[name]
    for value in (*allowed, *refused):
        (tmp_path / "choices.json").write_bytes(sealed({"schema": 1, "chosen": {name: value}}))
        choices, fault = ChoicesFile(tmp_path, RIG).read()
        assert (fault is None) == (any(value is one for one in allowed)), value
        if fault is None:
            exposure = {"exposure_us": choices.exposure.time_us, "gain_db": choices.exposure.gain_db}
            assert exposure.get(name, getattr(choices, name, None)) == value
        else:
            assert (choices, fault.code, name in fault.detail) == (RIG, FaultCode.SETTINGS_LOST, True)


def test_a_file_of_another_form_version_or_length_is_refused_and_choosing_anew_repairs_it(tmp_path: Path) -> None:
    file, content = ChoicesFile(tmp_path, RIG), {"schema": 1, "chosen": {"period_px": 32}}
    for data, read in (
        (b"", False), (sealed({"schema": 2, "chosen": {}}), False), (b"[1]", False), (sealed({"schema": 1, "chosen": [1]}), False),
        (padded(content, 10_000), True), (padded(content, 10_001), False),
    ):  # fmt: skip
        (tmp_path / "choices.json").write_bytes(data)
        choices, fault = file.read()
        assert (choices.period_px == 32) == (fault is None) == read
    file.write(CHOSEN)
    assert file.read() == (CHOSEN, None)
    (tmp_path / "choices.json").unlink()
    (tmp_path / "choices.json").mkdir()
    assert file.read()[1] is not None


HASH = "0123456789abcdef" * 4


def trend(judged: int) -> HealthTrend:
    points = tuple(
        TrendPoint(f"{k:06d}", (1.234567, -2.0, 3.0, 0.1 * k), (0.5,) * 4, 1.25, 2.125, 0.0625, False)
        for k in range(min(judged, MOST_POINTS))
    )
    return HealthTrend(judged=judged, points=points, total=(0.1, 0.2, 0.3, 0.4), alarm="turned" if judged > 2 else None)


@pytest.fixture
def health(tmp_path: Path) -> HealthFile:
    return HealthFile(tmp_path, HASH)


def test_a_trend_is_read_as_it_was_written_and_each_calibration_has_its_own(health: HealthFile, tmp_path: Path) -> None:
    assert health.read() == HealthTrend()
    for judged in (1, 3, 100_000):
        health.write(trend(judged))
        assert HealthFile(tmp_path, HASH).read() == trend(judged)
    assert health.path.stat().st_size < 1_000_000 / 5, "the longest history stays small"
    assert HealthFile(tmp_path, "f" * 64).read() == HealthTrend()


def test_a_trend_says_nothing_that_cannot_be(health: HealthFile) -> None:
    wrong = (
        Reference(gap_um=(1.0,) * (PatchGaps.COUNT - 1)), Reference(variance_um2=(1.0,) * (PatchGaps.COUNT + 1)), Reference(scans=(1,) * (PatchGaps.COUNT + 1)),
        Reference(doubts_um=(0.0,) * 7),
    )  # fmt: skip
    for stored in (
        HealthTrend(judged=-1, alarm="turned"),
        *(HealthTrend(reference=one) for one in wrong),
        HealthTrend(third=ThirdTrend(reference=wrong[0])),
    ):
        health.write(stored)
        assert health.read() == HealthTrend()
    for stored in (
        HealthTrend(judged=0, alarm="turned"),
        HealthTrend(reference=Reference(gap_um=(1.0,) * PatchGaps.COUNT)),
    ):
        health.write(stored)
        assert health.read() == stored


def test_a_trend_of_another_calibration_version_form_or_length_is_put_aside(health: HealthFile) -> None:
    health.write(trend(3))
    whole = opened(health.path.read_bytes())
    without: dict[str, Any] = json.loads(json.dumps(whole))
    del without["trend"]["reference"]["doubts_um"]
    for data, read in (
        (sealed({**whole, "calibration": HASH[:16] + "0" * 48}), False), (sealed({**whole, "schema": 2}), False),
        (sealed({**whole, "trend": {"judged": "many"}}), False), (sealed(whole).replace(b'"judged": 3', b'"judged": 4'), False),
        (padded(whole, 1_000_000), True), (padded(whole, 1_000_001), False), (sealed(without), True), (b"", False),
    ):  # fmt: skip
        health.path.write_bytes(data)
        assert health.read() == (trend(3) if read else HealthTrend())
    health.write(trend(2))
    assert health.read() == trend(2)
    assert health.path.with_suffix(".damaged").read_bytes() == b""
    health.path.unlink()
    health.path.mkdir()
    assert health.read() == HealthTrend()
    with pytest.raises(StorageError, match="health"):
        health.write(trend(1))


POINTERS = Pointers((40.0, -60.0, 30.0), (25.0, 0.0, 522.5), 0.3)
DRAWN = POINTERS.beams()


def taught() -> tuple[PointerBeam, PointerBeam]:
    left, right = DRAWN
    for z_mm in (430.0, 480.0, 530.0):
        right = right.updated(right.at(np.array(z_mm)) + np.array([0.8, -0.5, 0.0]))
    return left, right


def test_what_the_dots_taught_is_there_to_the_last_digit(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = BeamsFile(tmp_path, POINTERS)
    assert file.read("abc") == DRAWN, "nothing was learned yet"
    file.write("abc", DRAWN)
    file.write("abc", taught())
    assert BeamsFile(tmp_path, POINTERS).read("abc") == taught()
    assert [path.name for path in file.path.parent.iterdir()] == ["beams.json"]
    assert caplog.messages == []
    assert file.read("def") == DRAWN
    other = replace(POINTERS, aim_mm=(24.0, 0.0, 522.5))
    assert BeamsFile(tmp_path, other).read("abc") == other.beams()
    whole = opened(file.path.read_bytes())
    beams = whole["beams"]
    wrong = [("beams", one) for one in (None, [], beams[:1], [*beams, beams[0]])]
    for name, value in (*wrong, ("schema", 2)):
        file.path.write_bytes(sealed({**whole, name: value}))
        assert file.read("abc") == DRAWN
    assert len(caplog.messages) == 7, "each is told"
    for length, read in ((20_000, True), (20_001, False)):
        file.path.write_bytes(padded(whole, length))
        assert (file.read("abc") == taught()) == read


def changed_beam(tmp_path: Path, **changes: object) -> tuple[PointerBeam, PointerBeam]:
    """What is read of a file whose right beam, as it was drawn, was changed so and sealed anew."""
    file = BeamsFile(tmp_path, POINTERS)
    file.write("abc", DRAWN)
    content = opened(file.path.read_bytes())
    content["beams"][1].update({"learned": 7} | changes)  # so that it differs from the drawing
    file.path.write_bytes(sealed(json.loads(json.dumps(content))))
    return file.read("abc")


@pytest.mark.parametrize("value", range(4))
def test_a_beam_is_within_six_tolerances_of_the_drawing_and_not_less_certain(tmp_path: Path, value: int) -> None:
    """0.7 mm where it leaves its window, 0.3° in its direction."""
    for sigmas, taken in ((5.8, True), (-5.8, True), (6.2, False), (-6.2, False)):
        line = list(DRAWN[1].line)
        line[value] += sigmas * (0.7 if value < 2 else math.radians(0.3))
        found = changed_beam(tmp_path, line=line)
        assert (found != DRAWN) == taken
        assert not taken or found[1].line == pytest.approx(line)
    for times, taken in ((0.0, True), (1.0005, True), (1.01, False), (-0.1, False)):
        P = np.array(DRAWN[1].covariance)
        P[value, value] *= times
        assert (changed_beam(tmp_path, covariance=P.tolist()) != DRAWN) == taken


def test_a_covariance_that_nothing_can_have_is_not_used(tmp_path: Path) -> None:
    """Place and lean that go together by more than they vary."""
    P = np.array(DRAWN[1].covariance)
    for share, taken in ((0.9, True), (-0.9, True), (1.2, False), (-1.2, False)):
        P[0, 2] = P[2, 0] = share * math.sqrt(P[0, 0] * P[2, 2])
        assert (changed_beam(tmp_path, covariance=P.tolist()) != DRAWN) == taken


def test_what_a_beams_file_may_say_ends_somewhere(tmp_path: Path) -> None:
    rows: dict[str, tuple[tuple[object, ...], tuple[object, ...]]] = {
        "learned": ((1, 2**53), (2**53 + 1, -1, 1.5, True)), "last_z_mm": ((None, 480, -999_999.0), (1e6, -1e6, True, "far")),
        "line": ((), ([40.0, -60.0, 0.0], ["x", 0, 0, 0])), "covariance": ((), ([[0.1] * 4] * 3, [[1.0]])),
    }  # fmt: skip
    for name, (taken, refused) in rows.items():
        for value in (*taken, *refused):
            assert (changed_beam(tmp_path, **{name: value}) != DRAWN) == any(value is one for one in taken), (
                name,
                value,
            )
    assert changed_beam(tmp_path, last_z_mm=480.5)[1].last_z_mm == 480.5
    assert math.isinf(changed_beam(tmp_path, last_z_mm=None)[1].last_z_mm)


FS = LocalFileSystem()


def sealed_number(number: int) -> bytes:
    return b"%d %08x\n" % (number, zlib.crc32(b"%d" % number))


def test_numbers_begin_with_one_never_repeat_and_end(tmp_path: Path) -> None:
    assert [names.take_number(FS, tmp_path, ()) for _ in range(3)] == [1, 2, 3]
    assert names.take_number(FS, tmp_path, (1, 9, 4)) == 10, "a folder's number counts as well"
    assert names.take_number(FS, tmp_path, (3,)) == 11, "and the higher of the two wins"
    assert (tmp_path / names.NUMBER_FILE).read_bytes() == sealed_number(12)
    for damage in (b"", b"700\n", b"700 00000000\n", sealed_number(700) + b"x", b"7x0 01234567\n"):
        (tmp_path / names.NUMBER_FILE).write_bytes(damage)
        assert names.take_number(FS, tmp_path, (41, 5)) == 42, "left to the folders"
    (tmp_path / names.NUMBER_FILE).write_bytes(sealed_number(names.LARGEST_NUMBER))
    assert names.take_number(FS, tmp_path, ()) == names.LARGEST_NUMBER == 999_999_999_999
    for taken in ((), (names.LARGEST_NUMBER,)):
        with pytest.raises(StorageError, match="last number"):
            names.take_number(FS, tmp_path, taken)
    assert [names.spell_id(number) for number in (1, 123456, 1234567)] == ["000001", "123456", "1234567"]


@pytest.mark.parametrize(("what", "longest"), [("name", 60), ("note", 1000)])
def test_a_label_has_so_many_characters_that_can_be_read(what: Literal["name", "note"], longest: int) -> None:
    assert Label.checked(what, f"  {'x' * longest} ") == "x" * longest
    with pytest.raises(ContentError, match=f"{what}: {longest + 1} characters"):
        Label.checked(what, "x" * (longest + 1))
    for character in "\n\t\u202e\u2028\u2029\ue000\u0378\x7f\udcff":
        with pytest.raises(ContentError, match=rf"{what}: character 3 is U\+{ord(character):04X}"):
            Label.checked(what, f"ab{character}c")
    assert Label.checked(what, "Bo\u0308je") == "B\u00f6je", "two spellings of one letter are one"
    assert Label.checked(what, " \t ") is None


def test_a_label_is_read_as_it_was_written_and_another_hands_with_the_same_care(tmp_path: Path) -> None:
    assert Label.read(tmp_path) == Label(None, None)
    for written in (Label("bollard 3", "north side"), Label(None, "x" * 1000), Label("\u6d77" * 60, None)):
        written.write(FS, tmp_path)
        assert Label.read(tmp_path) == written
    path, named = tmp_path / label.LABEL_FILE, {"schema": 1, "name": "a", "note": None}
    path.write_bytes(padded(named, 16_384))
    assert Label.read(tmp_path).name == "a"
    for data, said in (
        (sealed({"schema": 2, "name": "a"}), "schema 2"), (sealed({"schema": 1, "name": 7}), "name is 7"),
        (sealed({"schema": 1, "note": "x" * 1001}), "1001"), (sealed({"schema": 1, "name": "a\x07"}), "name"), (padded(named, 16_385), "16384"),
    ):  # fmt: skip
        path.write_bytes(data)
        with pytest.raises(ContentError, match=rf"^label\.json: .*{said}"):
            Label.read(tmp_path)
    path.unlink()
    path.mkdir()
    with pytest.raises(ContentError, match=r"label\.json"):
        Label.read(tmp_path)


def test_one_process_holds_a_root_and_others_are_told_which(tmp_path: Path) -> None:
    assert holder(tmp_path) is None, "nobody ever did"
    with hold_lock(tmp_path):
        assert holder(tmp_path) == str(os.getpid())
        with pytest.raises(StorageError, match=f"process {os.getpid()}"), hold_lock(tmp_path):
            pass
    assert holder(tmp_path) is None, "and nobody does now"
    with ExitStack() as held:
        held.enter_context(hold_lock(tmp_path))
        threading.Timer(0.1, held.close).start()
        with hold_lock(tmp_path, wait_s=20.0):
            assert holder(tmp_path) == str(os.getpid()), "who waits gets it"
    (tmp_path / "run" / "lock").write_text("1234567890\n")  # of an earlier process, with more digits
    with hold_lock(tmp_path):
        assert holder(tmp_path) == str(os.getpid())
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="file"), hold_lock(tmp_path / "file"):
        pass
