"""What the laser dots have taught survives a restart; what is of another instrument, or damaged, is not used."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.capture.ranging_beams import Beam, Pointers
from appliance.sealed import seal, unseal
from appliance.storage.beams import MAX_BYTES, BeamsFile

POINTERS = Pointers((40.0, -60.0, 30.0), (25.0, 0.0, 522.5), 0.3)


def taught() -> tuple[Beam, Beam]:
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
    content = unseal(file.path.read_bytes(), MAX_BYTES)
    content["beams"][1][name] = value
    file.path.write_bytes(seal(json.loads(json.dumps(content))))
    assert file.read("abc") == POINTERS.beams()
    assert said in caplog.text
