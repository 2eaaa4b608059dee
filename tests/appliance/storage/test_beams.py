"""What the laser dots have taught survives a restart; what is of another instrument, or damaged, is not used."""

from __future__ import annotations

import json
import logging
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.checksummed_file import checked_content, with_checksum
from appliance.ranging.beams import PointerBeam, Pointers
from appliance.storage.beams import MAX_BYTES, BeamsFile

POINTERS = Pointers((40.0, -60.0, 30.0), (25.0, 0.0, 522.5), 0.3)


def taught() -> tuple[PointerBeam, PointerBeam]:
    left, right = POINTERS.beams()
    for z_mm in (430.0, 480.0, 530.0):
        right = right.taught(right.at(np.array(z_mm)) + np.array([0.8, -0.5, 0.0]))
    return left, right


def test_what_was_learned_is_there_after_a_restart_to_the_last_digit(tmp_path: Path) -> None:
    assert BeamsFile(tmp_path, POINTERS).read("abc") == POINTERS.beams(), "nothing was learned yet"
    BeamsFile(tmp_path, POINTERS).write("abc", taught())
    assert BeamsFile(tmp_path, POINTERS).read("abc") == taught()


def test_beams_of_another_calibration_or_drawing_are_not_used(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    BeamsFile(tmp_path, POINTERS).write("abc", taught())
    with caplog.at_level(logging.WARNING):
        assert BeamsFile(tmp_path, POINTERS).read("def") == POINTERS.beams()
        other = replace(POINTERS, aim_mm=(24.0, 0.0, 522.5))
        assert BeamsFile(tmp_path, other).read("abc") == other.beams()
    assert ["another calibration" in m or "other pointers" in m for m in caplog.messages] == [True, True]


@pytest.mark.parametrize("at", range(0, 1500, 61))
def test_a_damaged_file_is_one_line_in_the_log_and_the_drawing_holds(
    tmp_path: Path, at: int, caplog: pytest.LogCaptureFixture
) -> None:
    file = BeamsFile(tmp_path, POINTERS)
    file.write("abc", taught())
    data = bytearray(file.path.read_bytes())
    data[at % len(data)] ^= 0x01
    file.path.write_bytes(bytes(data))
    found = file.read("abc")
    if found != taught():  # a blank between the words may change without harm
        assert found == POINTERS.beams()
        assert len(caplog.messages) == 1


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("line", [0.0, 0.0, 0.0, 0.0], "farther from the drawing"),
        ("line", ["x", 0, 0, 0], "not readable"),
        ("covariance", [[9.0 if i == k else 0.0 for k in range(4)] for i in range(4)], "less certain"),
        ("covariance", [[1.0]], "four finite values"),
        ("learned", True, "dots taught"),
        ("last_z_mm", "far", "last_z_mm"),
    ],
)
def test_a_sealed_beam_that_no_dot_could_have_taught_is_not_used(
    tmp_path: Path, name: str, value: object, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    file = BeamsFile(tmp_path, POINTERS)
    file.write("abc", taught())
    content = checked_content(file.path.read_bytes(), MAX_BYTES)
    content["beams"][1][name] = value
    file.path.write_bytes(with_checksum(json.loads(json.dumps(content))))
    assert file.read("abc") == POINTERS.beams()
    assert said in caplog.text


def sealed(tmp_path: Path, **changes: object) -> tuple[PointerBeam, PointerBeam]:
    """What is read of a file whose right beam, as it was drawn, was changed so and sealed anew."""
    file = BeamsFile(tmp_path, POINTERS)
    file.write("abc", POINTERS.beams())
    content = checked_content(file.path.read_bytes(), MAX_BYTES)
    content["beams"][1].update(changes)
    content["beams"][1]["learned"] = content["beams"][1]["learned"] or 7  # so that it differs from the drawing
    file.path.write_bytes(with_checksum(json.loads(json.dumps(content))))
    return file.read("abc")


def is_taken(found: tuple[PointerBeam, PointerBeam]) -> bool:
    return found != POINTERS.beams()


@pytest.mark.parametrize("value", range(4))
@pytest.mark.parametrize(("sigmas", "taken"), [(5.8, True), (-5.8, True), (6.2, False), (-6.2, False)])
def test_a_beam_may_be_as_far_from_the_drawing_as_six_times_its_tolerance(
    tmp_path: Path, value: int, sigmas: float, taken: bool
) -> None:
    """0.7 mm where it leaves its window, 0.3° in its direction."""
    line = list(POINTERS.beams()[1].line)
    line[value] += sigmas * (0.7 if value < 2 else math.radians(0.3))
    found = sealed(tmp_path, line=line)
    assert is_taken(found) == taken
    if taken:
        assert found[1].line == pytest.approx(line)


@pytest.mark.parametrize("value", range(4))
@pytest.mark.parametrize(("times", "taken"), [(0.0, True), (1.0, True), (1.0005, True), (1.01, False), (-0.1, False)])
def test_no_dot_makes_a_beam_less_certain_than_drawn_or_more_than_certain(
    tmp_path: Path, value: int, times: float, taken: bool
) -> None:
    P = np.array(POINTERS.beams()[1].covariance)
    P[value, value] *= times
    assert is_taken(sealed(tmp_path, covariance=P.tolist())) == taken


def test_a_covariance_that_nothing_can_have_is_not_used(tmp_path: Path) -> None:
    """Place and lean that go together by more than they vary."""
    P = np.array(POINTERS.beams()[1].covariance)
    for share, taken in ((0.9, True), (-0.9, True), (1.2, False), (-1.2, False)):
        P[0, 2] = P[2, 0] = share * math.sqrt(P[0, 0] * P[2, 2])
        assert is_taken(sealed(tmp_path, covariance=P.tolist())) == taken


@pytest.mark.parametrize(
    ("changes", "taken"),
    [
        ({"learned": 1}, True),
        ({"learned": 2**53}, True),
        ({"learned": 2**53 + 1}, False),
        ({"learned": -1}, False),
        ({"learned": 1.5}, False),
        ({"last_z_mm": None}, True),
        ({"last_z_mm": 480}, True),
        ({"last_z_mm": -999_999.0}, True),
        ({"last_z_mm": 1e6}, False),
        ({"last_z_mm": -1e6}, False),
        ({"last_z_mm": True}, False),
        ({"line": [40.0, -60.0, 0.0]}, False),
        ({"covariance": [[0.1] * 4] * 3}, False),
    ],
)
def test_what_a_beams_file_may_say_ends_somewhere(tmp_path: Path, changes: dict[str, object], taken: bool) -> None:
    assert is_taken(sealed(tmp_path, **changes)) == taken


def test_where_the_latest_dot_was_is_remembered_and_where_none_was_nothing(tmp_path: Path) -> None:
    assert sealed(tmp_path, last_z_mm=480.5)[1].last_z_mm == 480.5
    assert math.isinf(sealed(tmp_path, last_z_mm=None)[1].last_z_mm)


def test_beams_that_are_none_or_three_are_not_used(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = BeamsFile(tmp_path, POINTERS)
    file.write("abc", taught())
    whole = checked_content(file.path.read_bytes(), MAX_BYTES)
    for beams in (None, [], whole["beams"][:1], [*whole["beams"], whole["beams"][0]]):
        file.path.write_bytes(with_checksum({**whole, "beams": beams}))
        assert file.read("abc") == POINTERS.beams()
    file.path.write_bytes(with_checksum({**whole, "schema": 2}))
    assert file.read("abc") == POINTERS.beams()
    assert "schema 2; 1 is known here" in caplog.text
    file.path.write_bytes(with_checksum(whole))
    assert file.read("abc") == taught()


def test_beams_are_written_again_where_others_are(tmp_path: Path) -> None:
    file = BeamsFile(tmp_path, POINTERS)
    file.write("abc", POINTERS.beams())
    file.write("abc", taught())
    assert file.read("abc") == taught()
    assert [path.name for path in file.path.parent.iterdir()] == ["beams.json"]
