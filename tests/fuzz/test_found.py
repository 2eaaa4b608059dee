"""What damaged input found, each by its symptom: a camera, a disk or a sentence that ended the program instead of being refused."""

from __future__ import annotations

import json
import math
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.calibration import file as calibration_file
from appliance.calibration.health import HealthTrend
from appliance.calibration.response import file as response_file
from appliance.config import ConfigError
from appliance.config.load import parse_rig
from appliance.storage import counter
from appliance.storage import manifest as form
from appliance.storage.atomic import StorageError
from appliance.storage.calibrations import Calibrations
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.health import HealthFile
from appliance.storage.library import Library
from appliance.storage.manifest import Decision, Manifest, Stage
from appliance.storage.ply import PlyError, read_ply
from appliance.storage.scan import ScanError
from drivers.api import DeviceRefused, FrameStatus
from drivers.camera.control import ControlChannel
from drivers.camera.description import BadDescription, unpack
from drivers.camera.features import Features
from drivers.camera.usb import TransferError
from hw_sim.people import status_file
from tests.appliance.storage.scenes import ORIGIN, frames, record
from tests.drivers.camera.test_features import XML, RegisterMemory
from tests.drivers.camera.test_stream import Bench, frame
from tests.drivers.clock import SteppedClock
from tests.fuzz.camera import SHORT, _zipped
from tests.fuzz.files import CALIBRATIONS, CLOUDS, HASH, HEALTH, RESPONSE, SESSION, _resealed


def features(xml: str) -> Features:
    return Features("camera.left", xml, ControlChannel("camera.left", RegisterMemory(), SteppedClock()))


@pytest.mark.parametrize(
    ("old", "new"), [("<pPort>Device<", "<pPort>Width<"), ("<pFeature>Width<", "<pFeature>Device<")]
)
def test_a_description_whose_references_kill_genapi_is_refused(old: str, new: str) -> None:
    with pytest.raises(DeviceRefused, match=r"camera\.left: its description cannot be loaded .*port"):
        features(XML.replace(old, new, 1))


def test_a_description_in_an_encoding_nobody_knows_is_refused() -> None:
    with pytest.raises(DeviceRefused, match="not well-formed"):
        features(XML.replace('encoding="utf-8"', 'encoding="inf-8"'))


def test_a_feature_of_another_kind_than_its_standard_name_is_refused() -> None:
    with pytest.raises(DeviceRefused, match="Width is an IInteger, not IEnumeration"):
        features(XML).choices("Width")


def test_a_register_outside_64_bits_is_refused() -> None:
    with pytest.raises(DeviceRefused, match="outside 64 bits"):
        ControlChannel("camera.left", RegisterMemory(), SteppedClock()).read(-4, 4)


def test_a_zipped_description_without_a_name_or_in_a_greedy_packing_is_refused() -> None:
    nameless = _zipped(SHORT).replace(b"camera.xml", b"\0amera.xml")
    with pytest.raises(BadDescription):
        unpack(nameless, 1)
    lzma = bytearray(_zipped(SHORT))
    at = lzma.index(b"PK\1\2")
    lzma[at + 10 : at + 12] = struct.pack("<H", 14)
    with pytest.raises(BadDescription, match="packed by method 14"):
        unpack(bytes(lzma), 1)


def test_a_transfer_that_fails_where_a_leader_was_due_costs_one_frame() -> None:
    bench = Bench()
    bench.pipe.send(TransferError("short"), *frame(3))
    assert bench.next().status is FrameStatus.CORRUPT
    bench.expect_whole(3)


def resealed(data: bytes, **changes: object) -> bytes:
    content = json.loads(data)
    del content["sha256"]
    return _resealed({**content, **changes})


def test_a_whole_number_larger_than_any_float_is_refused() -> None:
    with pytest.raises(calibration_file.CalibrationError, match="residual_px"):
        calibration_file.decode(resealed(CALIBRATIONS[0], residual_px=10**400))
    with pytest.raises(response_file.ResponseFileError, match="must be numbers"):
        response_file.decode(resealed(RESPONSE, residual=10**400), "response.json")


def test_a_message_quotes_no_page_of_nonsense() -> None:
    for changes in ({"schema": "9" * 5000}, {"harmonics": [0.25] * 5000}):
        with pytest.raises(response_file.ResponseFileError) as caught:
            response_file.decode(resealed(RESPONSE, **changes), "response.json")
        assert len(str(caught.value)) < 400


def test_a_key_of_a_page_is_not_quoted_as_a_page() -> None:
    with pytest.raises(ConfigError, match="unknown key") as refused:
        parse_rig(f"[rig]\n{'9' * 5000} = 1\n")
    assert len(str(refused.value)) < 400


def test_a_checksum_of_a_page_is_not_quoted_as_a_page() -> None:
    content = {**json.loads(RESPONSE), "sha256": "9" * 5000}
    with pytest.raises(response_file.ResponseFileError, match="changed or damaged") as refused:
        response_file.decode(json.dumps(content).encode(), "response response.json")
    assert len(str(refused.value)) < 400


@pytest.mark.parametrize(
    ("field", "value"), [("kept", "9" * 5000), ("kept", "../../scans/000001/manifest.json"), ("number", "nan")]
)
def test_a_session_with_a_name_or_a_number_that_cannot_be_keeps_nothing_of_it(
    tmp_path: Path, field: str, value: str
) -> None:
    content = json.loads(SESSION)
    del content["sha256"]
    if field == "number":
        content["trials"][0]["number"] = value
    else:
        content[field] = value
    store = Calibrations(tmp_path, "KF-TEST")
    (store.folder / "session").mkdir(parents=True)
    (store.folder / "session" / "session.json").write_bytes(_resealed(content))
    session = store.session()
    assert session.kept is None
    assert store.write(session) == session
    assert (session.trials == ()) == (field == "number")


def test_numbers_that_are_used_up_are_not_given_again(tmp_path: Path) -> None:
    assert counter.take(LocalFileSystem(), tmp_path, [counter.LARGEST - 1]) == counter.LARGEST
    with pytest.raises(StorageError, match="last number"):
        counter.take(LocalFileSystem(), tmp_path, [])


def test_a_time_that_is_not_finite_does_not_make_a_scan_unreadable() -> None:
    times = replace(record(), stage_times_s={"capture": 0.4, "full": math.nan, "saved": math.inf})
    manifest = Manifest("000001", Stage.COMPLETE, Decision.KEPT, times, {}, frame_crc32={})
    assert form.decode(form.encode(manifest), "manifest.json").record.stage_times_s == {"capture": 0.4}


def test_a_cloud_with_a_point_nowhere_is_refused(tmp_path: Path) -> None:
    import zlib

    head, end, body = CLOUDS[1].partition(b"end_header\n")
    body = struct.pack("<f", math.nan) + body[4:]
    head = head.replace(b"%08x" % zlib.crc32(CLOUDS[1].partition(b"end_header\n")[2]), b"%08x" % zlib.crc32(body))
    (tmp_path / "cloud.ply").write_bytes(head + end + body)
    with pytest.raises(PlyError, match="not finite"):
        read_ply(tmp_path / "cloud.ply")


def test_a_trend_with_numbers_that_cannot_be_begins_anew(tmp_path: Path) -> None:
    file = HealthFile(tmp_path, HASH)
    file.path.parent.mkdir(parents=True)
    trend = json.loads(HEALTH)["trend"]
    for wrong in ({"judged": -1}, {"total": [1e400, 0.0, 0.0, 0.0]}):
        file.path.write_bytes(resealed(HEALTH, trend={**trend, **wrong}))
        assert file.read() == HealthTrend()


@pytest.mark.parametrize(("old", "new"), [(b"(3, 8", b"((3,8"), (b"(3, 8, 10)", b"(3, 0, 80)"), (b"'|u1'", b"'|O' ")])
def test_frames_with_a_header_that_cannot_be_are_refused(tmp_path: Path, old: bytes, new: bytes) -> None:
    library = Library(tmp_path)
    library.prepare()
    path = library.begin(frames(), record(), ORIGIN).publish(record()) / "frames_left.npy"
    data = path.read_bytes()
    path.write_bytes(data.replace(old, new, 1)[: len(data)].ljust(len(data)))
    with pytest.raises(ScanError, match=r"frames_left\.npy"):
        library.load("000001")


def test_frames_that_numpy_itself_wrote_are_read(tmp_path: Path) -> None:
    library = Library(tmp_path)
    library.prepare()
    path = library.begin(frames(), record(), ORIGIN).publish(record()) / "frames_left.npy"
    np.save(path, frames()["left"])
    assert (library.load("000001").frames["left"] == frames()["left"]).all()


def test_a_status_file_with_other_things_in_it_is_looked_at_all_the_same() -> None:
    status = {"alerts": "AIM", "keys": [1], "devices": 1.5, "calibration": [{}]}
    assert not status_file.is_met(status, "alert", ["AIM"])
    assert not status_file.is_met(status, "device", ["board", "ok"])
    assert not status_file.is_met(status, "step", ["M1"])
    assert "alerts: none" in status_file.summary(status)
