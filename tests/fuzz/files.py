"""What may lie on the disk: the rig file, what was learnt, and scans, after damage or in another's hand."""

from __future__ import annotations

import copy
import hashlib
import json
import logging
import re
import shutil
import tomllib
import zlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import cv2
import numpy as np

from appliance.calibration import file as calibration_file
from appliance.calibration import noise_file
from appliance.calibration.design import Design, design_calibration
from appliance.calibration.file import CalibrationError
from appliance.calibration.guide import USED, AdjustmentSummary, RecordingCheck, Session, Step, Verified
from appliance.calibration.health import HealthTrend, TrendPoint
from appliance.calibration.noise_file import CameraFigures, NoiseFileError, StoredNoise
from appliance.calibration.response import file as response_file
from appliance.calibration.response.file import ResponseFileError, StoredResponse
from appliance.checksummed_file import with_checksum
from appliance.config import ConfigError, default_rig_path, load_rig
from appliance.machine.choices import Choices
from appliance.offline.calibration.air import Pair, PicturesError, read_pair
from appliance.optics.correction import ImageCorrection, node_count
from appliance.optics.ray_shift import RayShift
from appliance.optics.water import Water
from appliance.patterns.response import Response
from appliance.ranging.beams import Pointers
from appliance.scan.exposure import Exposure
from appliance.storage import counter, packed
from appliance.storage import label as labels
from appliance.storage import manifest as form
from appliance.storage.atomic import Stamp, StorageError
from appliance.storage.beams import BeamsFile
from appliance.storage.calibrations import Calibrations
from appliance.storage.choices import ChoicesFile
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.health import HealthFile
from appliance.storage.label import LabelError
from appliance.storage.library import Library, LibraryFolder
from appliance.storage.manifest import Decision, Manifest, ManifestError, Stage
from appliance.storage.packed import PackedError
from appliance.storage.ply import PlyError, encode_ply, read_ply
from appliance.storage.scan import ScanError
from tests.appliance.storage.scenes import ORIGIN, cloud, frames, record
from tests.fuzz.damage import changed, damaged
from tests.fuzz.target import Target
from tests.fuzz.toml import toml_of

logging.getLogger("kingfisher").addHandler(
    logging.NullHandler()
)  # what is put aside is logged: here, ten thousand times

# ---------------------------------------------------------------------------------------------------- rig file

RIG_TEXT = default_rig_path().read_text(encoding="utf-8")
RIG = tomllib.loads(RIG_TEXT)
RIG_WORDS = tuple(sorted({key for table in RIG.values() for key in table} | set(RIG)))
_SPACES = re.compile(r"[^\S\n]+")


def _rig(chance: Random) -> bytes:
    if chance.random() < 0.65:
        return toml_of(changed(chance, RIG, RIG_WORDS)).encode("utf-8", "surrogatepass")
    lines = RIG_TEXT.splitlines(keepends=True)
    for _ in range(chance.randrange(1, 4)):
        at = chance.randrange(len(lines))
        other = lines[chance.randrange(len(lines))]
        lines[at] = chance.choice(
            ("", lines[at] * 2, other, lines[at].replace("=", ""), lines[at].replace('"', ""), lines[at].upper())
        )
    data = "".join(lines).encode()
    return data if chance.random() < 0.5 else damaged(chance, data, (data,))


def _read_rig(data: bytes, scratch: Path) -> None:
    path = scratch / "rig.toml"
    path.write_bytes(data)
    rig = load_rig(path)
    assert len(rig.rig_hash) == len(rig.optical_hash) == 64
    assert load_rig(path) == rig


# --------------------------------------------------------------------------------------------------- pictures

PICTURES = tuple(
    cv2.imencode(kind, np.arange(48, dtype=np.uint8).reshape(6, 8))[1].tobytes()
    for kind in (".png", ".tif", ".bmp", ".pgm", ".jpg")
)


def _picture(chance: Random) -> bytes:
    return damaged(chance, chance.choice(PICTURES), PICTURES)


def _read_picture(data: bytes, scratch: Path) -> None:
    path = scratch / "00_left.png"
    path.write_bytes(data)
    for image in read_pair(_pair(path, scratch), 8, 6):
        assert image.shape == (6, 8)
        assert image.dtype == np.uint8


def _pair(left: Path, scratch: Path) -> Pair:
    right = scratch / "00_right.png"
    right.write_bytes(PICTURES[0])
    return Pair("00", left, right)


# ------------------------------------------------------------------------------------------------ sealed JSON


def _sealed(chance: Random, data: bytes, words: tuple[str, ...] = ()) -> bytes:
    """A sealed file with changed content; mostly with the checksum that fits it again."""
    if chance.random() < 0.15:
        return damaged(chance, data, (data,))
    content = json.loads(data)
    content.pop("sha256")
    content = changed(chance, content, words)
    return _resealed(content) if isinstance(content, dict) else json.dumps(content).encode()


def _resealed(content: Mapping[str, Any]) -> bytes:
    digest = hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
    return json.dumps({**content, "sha256": digest}, sort_keys=True).encode()


def _calibrations() -> tuple[bytes, ...]:
    plain = design_calibration(
        Design(11.5, 4.5, 230.0, 12.41, 30.0, 5.0, 1.77), "KF-0001", 1600, 1200, Water(20.0, 0.0, 530.0)
    )
    intervals = (2, 1)
    values = tuple(0.01 * k for k in range(2 * node_count(intervals)))
    left = replace(plain.rig.left, correction=ImageCorrection(1600, 1200, intervals, values))
    right = replace(plain.rig.right, ray_shift=RayShift(1600, 1200, intervals, values))
    rich = replace(
        plain,
        method="bundle",
        residual_px=0.03,
        rig=replace(plain.rig, left=left, right=right),
        air_covariance=tuple(tuple(float(i == j) for j in range(22)) for i in range(22)),
    )
    return calibration_file.encode(plain), calibration_file.encode(rich)


CALIBRATIONS = _calibrations()


def _read_calibration(data: bytes, _: Path) -> None:
    calibration = calibration_file.decode(data, "calibration current.json")
    again = calibration_file.decode(calibration_file.encode(calibration))
    assert again == calibration
    assert again.hash == calibration.hash


RESPONSE = response_file.encode(StoredResponse("KF-1", ("000007",), 0.0107, Response((0.45, 0.53, 0.05, -0.02))))


def _read_response(data: bytes, _: Path) -> None:
    stored = response_file.decode(data, "response response.json")
    assert response_file.decode(response_file.encode(stored), "again") == stored


NOISE = noise_file.encode(
    StoredNoise("KF-1", ("000007",), CameraFigures("L", 9_100.0, 4.5, 6.0), CameraFigures("R", 18_000.0, 25.0, 1.5))
)


def _read_noise(data: bytes, _: Path) -> None:
    stored = noise_file.decode(data, "noise noise.json")
    assert noise_file.decode(noise_file.encode(stored), "again") == stored


HASH = "0123456789abcdef" * 4


def _trend() -> bytes:
    points = (TrendPoint("000001", (1.25, -2.0, 3.0, 0.5), (0.5,) * 4, 1.25, 2.125, 0.0625, False),)
    return _written(
        lambda root: HealthFile(root, HASH).write(HealthTrend(judged=1, points=points, total=(0.1, 0.2, 0.3, 0.4)))
    )


def _session() -> bytes:
    trials = tuple(RecordingCheck(step, None, 0.03, 900, "bar", f"{k:06d}") for k, step in enumerate(USED, 1))
    session = Session(
        trials, AdjustmentSummary("bundle", 0.031, ("0.026 px remain",), HASH), Verified(0.003, -0.0001, 0.00004)
    )
    return _written(lambda root: Calibrations(root, "KF-TEST").write(session))


def _written(write: Callable[[Path], object]) -> bytes:
    """The bytes that the writer itself leaves."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder))
        return next(path for path in sorted(Path(folder).rglob("*.json"))).read_bytes()


STANDARD = Choices()
CHOSEN = Choices(Exposure(8000, 6.0), 32, 35.0, 12.5, "de")
HEALTH, SESSION = _trend(), _session()
POINTERS = Pointers((40.0, -60.0, 30.0), (25.0, 0.0, 522.5), 0.3)
BEAMS = _written(lambda root: BeamsFile(root, POINTERS).write(HASH, POINTERS.beams()))
CHOICES = _written(lambda root: ChoicesFile(root, STANDARD).write(CHOSEN))


def _read_health(data: bytes, scratch: Path) -> None:
    file = HealthFile(scratch, HASH)
    file.path.parent.mkdir(parents=True, exist_ok=True)
    file.path.write_bytes(data)
    trend = file.read()
    assert trend == HealthTrend() or trend.judged >= 0
    file.write(trend)
    assert file.read() == trend


def _read_choices(data: bytes, scratch: Path) -> None:
    file = ChoicesFile(scratch, STANDARD)
    file.path.write_bytes(data)
    chosen, fault = file.read()
    assert fault is None or (chosen == STANDARD and fault.detail)
    file.write(chosen)
    assert file.read() == (chosen, None)


def _read_beams(data: bytes, scratch: Path) -> None:
    file = BeamsFile(scratch, POINTERS)
    file.path.parent.mkdir(parents=True, exist_ok=True)
    file.path.write_bytes(data)
    beams = file.read(HASH)
    assert np.isfinite([beam.at(np.array(500.0)) for beam in beams]).all()
    assert all(np.isfinite(beam.sd_mm(np.array(500.0))) for beam in beams)
    file.write(HASH, beams)
    assert file.read(HASH) == beams


def _read_session(data: bytes, scratch: Path) -> None:
    store = Calibrations(scratch, "KF-TEST")
    folder = store.folder / "session"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "session.json").write_bytes(data)
    session = store.session()
    assert isinstance(session.next_step, Step)
    assert store.write(session) == session


def _label(chance: Random) -> bytes:
    return _sealed(
        chance, with_checksum({"schema": 1, "name": "bollard 3", "note": "north side"}), ("name", "note", "schema")
    )


def _read_label(data: bytes, scratch: Path) -> None:
    (scratch / labels.FILE_NAME).write_bytes(data)
    label = labels.read(scratch)
    for text, longest in ((label.name, labels.LONGEST_NAME), (label.note, labels.LONGEST_NOTE)):
        assert text is None or (0 < len(text) <= longest and "\n" not in text and "\x1b" not in text)


def _packed_file() -> bytes:
    pictures = frames()["left"]
    header, body = b"a header", pictures.tobytes()
    stamp = Stamp(len(header) + len(body), hashlib.sha256(header + body).hexdigest())
    return b"".join(bytes(part) for part in packed.pack(header, pictures, stamp, "frames_left.npy"))


PACKED = _packed_file()


def _read_packed(data: bytes, scratch: Path) -> None:
    path = scratch / "frames_left.npy.jls"
    path.write_bytes(data)
    index = packed.read_index(path)
    for k in range(index.count):
        frame = index.frame(k)
        assert f"{zlib.crc32(frame.tobytes()):08x}" == index.crc32[k], "no pixels but those that were packed"
    index.whole()


def _count(chance: Random) -> bytes:
    number = chance.choice((b"1", b"42", b"999999999999", b"0", b"000007", "٣".encode(), b"1" * 40))
    line = number + b" %08x\n" % zlib.crc32(number)
    return line if chance.random() < 0.3 else damaged(chance, line)


def _read_count(data: bytes, scratch: Path) -> None:
    (scratch / counter.FILE_NAME).write_bytes(data)
    number = counter.take(LocalFileSystem(), scratch, [7])
    assert number >= 8, "a number that a scan on the disk has"
    assert len(counter.spell_id(number)) <= 12
    assert counter.take(LocalFileSystem(), scratch, [7]) == number + 1


# ------------------------------------------------------------------------------------------------------- scans

MANIFEST = form.encode(
    Manifest(
        "000042",
        Stage.COMPLETE,
        Decision.KEPT,
        record(),
        {"frames_left.npy": Stamp(10, HASH), "cloud.ply": Stamp(7, HASH)},
        frame_crc32={"frames_left.npy": ("00" * 4,)},
    )
)


def _read_manifest(data: bytes, _: Path) -> None:
    manifest = form.decode(data, "manifest.json")
    assert all("/" not in name for name in manifest.files)
    again = form.decode(form.encode(manifest), "manifest.json, written again")
    assert again.scan_id == manifest.scan_id
    assert again.files == manifest.files


def _cloud(points: int) -> bytes:
    return b"".join(bytes(part) for part in encode_ply(cloud(points)))


CLOUDS = (_cloud(0), _cloud(1), _cloud(20))
_BODY = re.compile(rb"crc32 [0-9a-f]{8}")


def _ply(chance: Random) -> bytes:
    data = damaged(chance, chance.choice(CLOUDS), CLOUDS)
    head, end, body = data.partition(b"end_header\n")
    return _BODY.sub(b"crc32 %08x" % zlib.crc32(body), head, count=1) + end + body if chance.random() < 0.6 else data


def _read_cloud(data: bytes, scratch: Path) -> None:
    path = scratch / "cloud.ply"
    path.write_bytes(data)
    stored = read_ply(path)
    n = len(stored.points_mm)
    assert stored.points_mm.shape == (n, 3)
    assert len(stored.intensity) == len(stored.sigma_mm) == len(stored.ray_gap_mm) == len(stored.modulation_dn) == n
    assert np.isfinite(stored.points_mm).all(), "no point lies nowhere"


def _scan_files() -> dict[str, bytes]:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        library = Library(Path(folder))
        library.prepare()
        there = library.begin(frames(), record(), ORIGIN).publish(record(), cloud(), b"\x89PNG")
        return {path.name: path.read_bytes() for path in sorted(there.iterdir())}


SCAN = _scan_files()
NPY = (SCAN["frames_left.npy"], SCAN["frames_right.npy"])


def _folder(chance: Random) -> dict[str, bytes]:
    """A scan's folder with one file damaged; its manifest mostly believes in what is there."""
    files = dict(SCAN)
    name = chance.choice(list(files))
    if chance.random() < 0.1:
        del files[name]
    elif name == form.FILE_NAME:
        files[name] = _sealed(chance, files[name], tuple(SCAN))
        return files
    else:
        files[name] = damaged(chance, files[name], NPY) if chance.random() < 0.9 else _header(chance, files[name])
    if chance.random() < 0.7:
        content = copy.deepcopy(json.loads(files[form.FILE_NAME])) if form.FILE_NAME in files else None
        if content is not None and name in files:
            del content["sha256"]
            content["files"][name] = {"length": len(files[name]), "sha256": hashlib.sha256(files[name]).hexdigest()}
            files[form.FILE_NAME] = _resealed(content)
    return files


def _header(chance: Random, data: bytes) -> bytes:
    old, new = chance.choice(
        ((b"'|u1'", b"'|O' "), (b"(3, 8", b"(9, 8"), (b"(3, 8", b"(-3,8"), (b"False", b"True "), (b"'shape'", b"'shame'"), (b"{", b"("),
         (b"10)", b"10L)"), (b"(3, 8, 10)", b"__import__"), (b"(3, 8, 10)", b"(2**70,)  "), (b"(3, 8, 10)", b"(3,0,80)  "))
    )  # fmt: skip
    return data.replace(old, new, 1)


def _open(files: dict[str, bytes], scratch: Path) -> None:
    folder = scratch / "scans" / "000001"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, data in files.items():
        (folder / name).write_bytes(data)
    library = Library(scratch)
    (entry,) = library.entries(LibraryFolder.SCANS)
    checked = library.verify("000001")
    assert set(entry.problems) <= set(checked.problems) or entry.problems
    assert all(len(problem) > 3 for problem in checked.problems)
    stored = library.load("000001")
    for one in stored.frames.values():
        assert one.dtype == np.uint8
        assert len(one) == len(stored.manifest.record.sequence.patterns)
        one.sum()
    stored.cloud()


TARGETS = (
    Target("rig", "the rig file", _rig, _read_rig, (ConfigError,), "CONFIG: ", longest=12_000, cost=20.0),
    Target("picture", "a picture of the board", _picture, _read_picture, (PicturesError,), "00_left", cost=2.0),
    Target("calibration", "a calibration file", lambda c: _sealed(c, c.choice(CALIBRATIONS)), _read_calibration,
           (CalibrationError,), "calibration current.json", cost=5.0),
    Target("response", "the projector's response", lambda c: _sealed(c, RESPONSE), _read_response, (ResponseFileError,),
           "response response.json"),
    Target("noise", "the cameras' noise", lambda c: _sealed(c, NOISE), _read_noise, (NoiseFileError,), "noise noise.json"),
    Target("health", "how a calibration holds", lambda c: _sealed(c, HEALTH), _read_health, cost=10.0),
    Target("beams", "what the laser dots have taught", lambda c: _sealed(c, BEAMS, ("line", "covariance", "learned", "last_z_mm")),
           _read_beams, cost=5.0),
    Target("choices", "what the diver chose", lambda c: _sealed(c, CHOICES, ("language", "period_px")), _read_choices, cost=5.0),
    Target("session", "a calibration under way", lambda c: _sealed(c, SESSION), _read_session, cost=10.0),
    Target("label", "what a person calls a scan", _label, _read_label, (LabelError,), labels.FILE_NAME),
    Target("counter", "the number of the next scan", _count, _read_count, (StorageError,), cost=5.0),
    Target("manifest", "a scan's manifest", lambda c: _sealed(c, MANIFEST, ("files", "record", "../x")), _read_manifest,
           (ManifestError,), "manifest.json", cost=3.0),
    Target("cloud", "a scan's cloud", _ply, _read_cloud, (PlyError,), "cloud.ply", cost=2.0),
    Target("packed", "a packed file of frames", lambda c: damaged(c, PACKED, (PACKED,)), _read_packed, (PackedError,), cost=2.0),
    Target("scan", "a scan's whole folder", _folder, _open, (ScanError,), "000001", cost=10.0),
)  # fmt: skip
