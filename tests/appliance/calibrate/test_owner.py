"""A calibration is used with the instrument, the cameras and the image size that it was made with, and with no others."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from appliance.calibrate.recordings import RecordingError
from appliance.calibrate.stored_recordings import cameras_of
from appliance.instrument.machine.alerts import alert_of
from appliance.measure.calibration.file import Calibration, CalibrationError, decode_calibration, encode_calibration
from appliance.measure.calibration.owner import Owner, exchanged, owner_misfit
from appliance.measure.fault import FaultCode
from appliance.store.config import Rig, load_rig
from appliance.store.instrument import Instrument
from appliance.store.library import Library
from tests.appliance.store.scenes import frames, record
from tests.support.sealing import sealed

OWN = ("KF-CAM-L", "KF-CAM-R")


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    packaged = load_rig()
    return with_cameras(replace(packaged, storage=replace(packaged.storage, root=tmp_path)), OWN)


def with_cameras(rig: Rig, serials: tuple[str, str]) -> Rig:
    left, right = (replace(c, serial=s) for c, s in zip((rig.camera.left, rig.camera.right), serials, strict=True))
    return replace(rig, camera=replace(rig.camera, left=left, right=right))


def measured(rig: Rig, serials: tuple[str, str] | None) -> Calibration:
    return replace(Instrument(rig).design(), method="bundle", camera_serials=serials)


def installed(rig: Rig, name: str, serials: tuple[str, str] | None) -> Calibration:
    path = rig.storage.root / "calibration" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(encode_calibration(measured(rig, serials)))
    return decode_calibration(path.read_bytes())


def test_serial_numbers_of_the_cameras_are_written_and_files_without_them_accepted(rig: Rig) -> None:
    said = json.loads(encode_calibration(measured(rig, OWN)))
    assert (said.pop("camera_serials"), said.pop("schema")) == ({"left": "KF-CAM-L", "right": "KF-CAM-R"}, 1)
    assert "camera_serials" not in json.loads(encode_calibration(measured(rig, None)))
    for serials in (None, OWN):
        kept = installed(rig, "current.json", serials)
        assert Instrument(rig).calibration() == (kept, ())
    del said["sha256"]
    for wrong in ("L and R", ["L", "R"], {"left": "L"}, {"left": 3, "right": "R"}):
        with pytest.raises(CalibrationError, match=r"camera_serials|left is|right is"):
            decode_calibration(sealed({**said, "schema": 1, "camera_serials": wrong}))


@pytest.mark.parametrize(
    ("serials", "named", "action", "german"),
    [
        (("KF-OLD", "KF-CAM-R"), ("left camera", "KF-OLD", "KF-CAM-L"), "LEFT CAMERA EXCHANGED", "LINKE KAMERA GETAUSCHT"),
        (("KF-CAM-L", "KF-OLD"), ("right camera", "KF-OLD", "KF-CAM-R"), "RIGHT CAMERA EXCHANGED", "RECHTE KAMERA GETAUSCHT"),
        (("KF-A", "KF-B"), ("left camera", "right camera", "KF-A"), "CAMERAS EXCHANGED", "KAMERAS GETAUSCHT"),
        (("KF-CAM-R", "KF-CAM-L"), ("swapped",), "CAMERAS EXCHANGED", "KAMERAS GETAUSCHT"),
    ],
)  # fmt: skip
def test_a_calibration_of_other_cameras_is_not_used(
    rig: Rig, serials: tuple[str, str], named: tuple[str, ...], action: str, german: str
) -> None:
    installed(rig, "current.json", serials)
    calibration, (fault,) = Instrument(rig).calibration()
    assert (calibration.method, fault.code) == ("design", FaultCode.UNCALIBRATED)
    assert all(words in fault.detail for words in named)
    assert (alert_of(fault).action, alert_of(fault).german) == (action, ("UNKALIBRIERT", german))


def test_after_an_exchange_a_kept_calibration_counts_only_if_it_says_that_it_is_of_these_cameras(rig: Rig) -> None:
    installed(rig, "current.json", ("KF-OLD", "KF-CAM-R"))
    installed(rig, "kept/0002-2026-11-20.json", None)
    assert Instrument(rig).calibration()[0].method == "design"
    own = installed(rig, "kept/0001-2026-11-19.json", OWN)
    calibration, (fault,) = Instrument(rig).calibration()
    assert calibration == own
    assert "0001-2026-11-19.json, the calibration used before, is used" in fault.detail


def test_instrument_and_image_size_come_before_the_cameras_and_unknown_ones_are_no_exchange(rig: Rig) -> None:
    calibration = measured(rig, OWN)
    size_px = (rig.camera.left.width_px, rig.camera.left.height_px)
    for serials in (OWN, None):
        assert owner_misfit(calibration, Owner(rig.rig.serial, (size_px, size_px), serials)) is None
    of_another = owner_misfit(calibration, Owner("KF-0009", (size_px, size_px), ("A", "B")))
    smaller = owner_misfit(calibration, Owner(rig.rig.serial, (size_px, (800, 600)), OWN))
    for found, named in ((of_another, ("KF-0001", "KF-0009")), (smaller, ("right", "1600x1200", "800x600"))):
        assert found is not None
        assert all(words in found.reason for words in named)
        assert not found.exchanged
    assert exchanged(None, OWN) is exchanged(OWN, None) is exchanged(OWN, OWN) is None


def scanned(rig: Rig, library: Library, serials: tuple[str, str]) -> Path:
    """A stored scan that was taken with these cameras."""
    origin = Instrument(with_cameras(rig, serials)).origin(Instrument(rig).design())
    return library.begin(frames(), record(), origin).publish(record())


def test_a_calibration_from_scans_is_of_the_cameras_that_took_them(rig: Rig) -> None:
    library = Library(rig.storage.root)
    library.prepare()
    first, second = (scanned(rig, library, OWN) for _ in range(2))
    start = measured(rig, None)
    assert cameras_of([first, second], start) == OWN
    other = scanned(rig, library, ("KF-NEW", "KF-CAM-R"))
    with pytest.raises(RecordingError, match=r"000001 and 000003 are of different cameras.*left camera exchanged"):
        cameras_of([first, other], start)
    with pytest.raises(RecordingError, match="of other cameras than the start"):
        cameras_of([first], measured(rig, ("KF-OLD", "KF-CAM-R")))
