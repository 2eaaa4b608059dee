"""What the diver chose survives a restart; what cannot be read is said, and the rig file's values hold."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from appliance.checksummed_file import with_checksum
from appliance.machine.choices import Choices
from appliance.scan.exposure import Exposure
from appliance.scan.fault import FaultCode
from appliance.storage.choices import FILE, ChoicesFile

RIG = Choices(Exposure(12_000), 16, 0.0, 20.0)
CHOSEN = Choices(Exposure(16_000, 4.0), 32, 35.0, 7.0, "de", 3, 4)


def test_what_was_chosen_is_there_after_a_restart(tmp_path: Path) -> None:
    assert ChoicesFile(tmp_path, RIG).read() == (RIG, None), "nothing was chosen yet"
    ChoicesFile(tmp_path, RIG).write(CHOSEN)
    assert ChoicesFile(tmp_path, RIG).read() == (CHOSEN, None)


def test_what_was_not_chosen_follows_a_corrected_rig_file(tmp_path: Path) -> None:
    ChoicesFile(tmp_path, RIG).write(replace(RIG, period_px=64))
    corrected = replace(RIG, salinity_psu=12.0, exposure=Exposure(8_000))
    assert ChoicesFile(tmp_path, corrected).read() == (replace(corrected, period_px=64), None)


@pytest.mark.parametrize("at", range(0, 200, 7))
def test_a_damaged_file_is_a_condition_and_the_rig_files_values_hold(tmp_path: Path, at: int) -> None:
    file = ChoicesFile(tmp_path, RIG)
    file.write(CHOSEN)
    data = bytearray(file.path.read_bytes())
    data[at % len(data)] ^= 0x01
    file.path.write_bytes(bytes(data))
    choices, fault = file.read()
    if choices != CHOSEN:  # a blank between the words may change without harm
        assert choices == RIG
        assert fault is not None
        assert fault.code is FaultCode.SETTINGS_LOST
        file.write(CHOSEN)
        assert file.read() == (CHOSEN, None), "choosing anew repairs it"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("period_px", 17),
        ("water_c", 99.0),
        ("exposure_us", True),
        ("gain_db", "4"),
        ("language", "fr"),
        ("salinity_psu", None),
        ("object", 1),
        ("object", "1"),
        ("objects", -1),
        ("objects", None),
    ],
)
def test_a_sealed_value_out_of_range_is_not_taken(tmp_path: Path, name: str, value: object) -> None:
    (tmp_path / FILE).write_bytes(with_checksum({"schema": 1, "chosen": {name: value}}))
    choices, fault = ChoicesFile(tmp_path, RIG).read()
    assert choices == RIG
    assert fault is not None
    assert name in fault.detail


def test_an_empty_file_and_one_of_another_version_are_refused(tmp_path: Path) -> None:
    for data in (b"", with_checksum({"schema": 2, "chosen": {}}), json.dumps([1]).encode()):
        (tmp_path / FILE).write_bytes(data)
        assert ChoicesFile(tmp_path, RIG).read()[1] is not None
