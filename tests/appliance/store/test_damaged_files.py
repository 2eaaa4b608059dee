"""What may lie on the disk, damaged or in another's hand, is read, put aside or refused by its name: rig file, scans, and what was learnt."""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
import tomllib
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import strategies as st

from appliance.base.sealed_file import ContentError
from appliance.calibrate.calibrations import Calibrations
from appliance.calibrate.guide import USED, AdjustmentSummary, LengthCheck, RecordingCheck, Session, Step
from appliance.calibrate.health import HealthFile, HealthTrend, TrendPoint
from appliance.calibrate.pictures import Pair, PicturesError, ViewFolder, read_pair
from appliance.desk import object_store as objects
from appliance.instrument.machine.choices import Choices
from appliance.instrument.ranging.beams import Pointers
from appliance.instrument.service.remembered import BeamsFile, ChoicesFile
from appliance.measure.calibration import file as calibration_file
from appliance.measure.calibration.design import design_calibration
from appliance.measure.calibration.noise_file import NOISE as NOISE_FILE
from appliance.measure.calibration.noise_file import BothFigures, CameraFigures, StoredNoise
from appliance.measure.calibration.response_file import RESPONSE as RESPONSE_FILE
from appliance.measure.calibration.response_file import StoredResponse
from appliance.measure.light.correction import ImageCorrection, node_count
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.ray_shift import RayShift
from appliance.store import incomplete, names, packed
from appliance.store import label as labels
from appliance.store import manifest as form
from appliance.store.atomic import LocalFileSystem, Stamp, StorageError
from appliance.store.config import ConfigError, default_rig_path, load_rig
from appliance.store.library import Library, LibraryFolder
from appliance.store.packed import PackedError
from appliance.store.ply import PlyError, encode_ply, read_ply
from appliance.store.scan import ScanError
from tests.appliance.store.scenes import ORIGIN, cloud, frames, record
from tests.appliance.store.test_objects import OBJECT as STORED_OBJECT
from tests.support.calibrating import DESIGN
from tests.support.damage import Parser, changed, damaged, toml_of
from tests.support.sealing import sealed
from tests.support.truth import WATER

HASH = "0123456789abcdef" * 4
RIG_TEXT = default_rig_path().read_text(encoding="utf-8")
RIG = tomllib.loads(RIG_TEXT)
RIG_KEYS = tuple(sorted({key for table in RIG.values() for key in table} | set(RIG)))


def written(write: Callable[[Path], object]) -> bytes:
    """The bytes that the writer itself leaves."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder))
        return next(path for path in sorted(Path(folder).rglob("*.json"))).read_bytes()


def of_sealed(data: bytes, *words: str) -> st.SearchStrategy[bytes]:
    """A sealed file that is damaged, or of other content that has the checksum that fits it."""
    content = {key: value for key, value in json.loads(data).items() if key != "sha256"}
    # Of a content that lost its last key something else than an object may be made.
    other = changed(content, ("x", *words)).map(
        lambda one: sealed(one) if isinstance(one, dict) else json.dumps(one).encode()
    )
    return other | damaged([data])


def rich_calibration() -> calibration_file.Calibration:
    plain = design_calibration(DESIGN, "KF-0001", 1600, 1200, WATER)
    values = tuple(0.01 * k for k in range(2 * node_count((2, 1))))
    left = replace(plain.rig.left, correction=ImageCorrection(1600, 1200, (2, 1), values))
    right = replace(plain.rig.right, ray_shift=RayShift(1600, 1200, (2, 1), values))
    covariance = tuple(tuple(float(i == j) for j in range(22)) for i in range(22))
    rig = replace(plain.rig, left=left, right=right)
    return replace(plain, method="bundle", residual_px=0.03, rig=rig, air_covariance=covariance)


def session() -> Session:
    trials = tuple(RecordingCheck(step, None, 0.03, 900, "bar", f"{k:06d}") for k, step in enumerate(USED, 1))
    summary = AdjustmentSummary("bundle", 0.031, ("0.026 px remain",), HASH)
    return Session(trials, summary, LengthCheck(0.003, -0.0001, 0.00004))


TREND = HealthTrend(
    judged=1, points=(TrendPoint("000001", (1.25, -2.0, 3.0, 0.5), (0.5,) * 4, 1.25, 2.125, 0.0625, False),),
    total=(0.1, 0.2, 0.3, 0.4),
)  # fmt: skip
FIGURES = CameraFigures("L", 9_100.0, 4.5, 6.0), CameraFigures("R", 18_000.0, 25.0, 1.5)
STANDARD, CHOSEN = Choices(), Choices(Exposure(8000, 6.0), 32, 35.0, 12.5, "de")
POINTERS = Pointers((40.0, -60.0, 30.0), (25.0, 0.0, 522.5), 0.3)
CALIBRATION = calibration_file.encode_calibration(rich_calibration())
RESPONSE = RESPONSE_FILE.encode(StoredResponse("KF-1", ("000007",), 0.0107, (0.45, 0.53, 0.05, -0.02)))
NOISE = NOISE_FILE.encode(StoredNoise("KF-1", ("000007",), BothFigures(*FIGURES)))
HEALTH = written(lambda root: HealthFile(root, HASH).write(TREND))
SESSION = written(lambda root: Calibrations(root, "KF-TEST").write(session()))
BEAMS = written(lambda root: BeamsFile(root, POINTERS).write(HASH, POINTERS.beams()))
CHOICES = written(lambda root: ChoicesFile(root, STANDARD).write(CHOSEN))
OBJECT = objects.OBJECT.encode(STORED_OBJECT)
BOARD = written(lambda folder: ViewFolder(folder, "KF-1", None))
LABEL = sealed({"schema": 1, "name": "bollard 3", "note": "north side"})
PICTURES = tuple(
    cv2.imencode(kind, np.arange(48, dtype=np.uint8).reshape(6, 8))[1].tobytes()
    for kind in (".png", ".tif", ".bmp", ".pgm", ".jpg")
)
CLOUDS = tuple(b"".join(bytes(part) for part in encode_ply(cloud(points))) for points in (0, 1, 20))


def packed_frames() -> bytes:
    pictures = frames()["left"]
    header, body = b"a header", pictures.tobytes()
    stamp = Stamp(len(header) + len(body), hashlib.sha256(header + body).hexdigest())
    return b"".join(bytes(part) for part in packed.pack(header, pictures, stamp, "frames_left.npy"))


def scan_files() -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as folder:
        library = Library(Path(folder))
        library.prepare()
        there = library.begin(frames(), record(), ORIGIN).publish(record(), cloud(), b"\x89PNG")
        return {path.name: path.read_bytes() for path in sorted(there.iterdir())}


SCAN = scan_files()
BROKEN = sealed({**json.loads(SCAN[form.MANIFEST_FILE]), **incomplete.INCOMPLETE_OF, "missing": ["bright"]})


def read_rig(data: bytes, folder: Path) -> None:
    (folder / "rig.toml").write_bytes(data)
    rig = load_rig(folder / "rig.toml")
    assert len(rig.rig_hash) == len(rig.optical_hash) == 64


def read_picture(data: bytes, folder: Path) -> None:
    left, right = folder / "00_left.png", folder / "00_right.png"
    left.write_bytes(data)
    right.write_bytes(PICTURES[0])
    for image in read_pair(Pair("00", left, right), 8, 6):
        assert image.shape == (6, 8)
        assert image.dtype == np.uint8


def read_by(module: Any, name: str) -> Callable[[bytes, Path], None]:
    """A reader of what a module decodes, writes and decodes again."""

    def read(data: bytes, _: Path) -> None:
        stored = module.decode(data, name)
        again = module.decode(module.encode(stored), "again")
        assert again == stored
        assert getattr(again, "hash", None) == getattr(stored, "hash", None)

    return read


def put(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def read_health(data: bytes, folder: Path) -> None:
    file = HealthFile(folder, HASH)
    put(file.path, data)
    trend = file.read()
    assert trend == HealthTrend() or trend.judged >= 0
    file.write(trend)
    assert file.read() == trend


def read_choices(data: bytes, folder: Path) -> None:
    file = ChoicesFile(folder, STANDARD)
    put(file.path, data)
    chosen, fault = file.read()
    assert fault is None or (chosen == STANDARD and fault.detail)
    file.write(chosen)
    assert file.read() == (chosen, None)


def read_beams(data: bytes, folder: Path) -> None:
    file = BeamsFile(folder, POINTERS)
    put(file.path, data)
    beams = file.read(HASH)
    assert np.isfinite([beam.at(np.array(500.0)) for beam in beams]).all()
    assert all(np.isfinite(beam.sd_mm(np.array(500.0))) for beam in beams)
    file.write(HASH, beams)
    assert file.read(HASH) == beams


def read_session(data: bytes, folder: Path) -> Session:
    store = Calibrations(folder, "KF-TEST")
    put(store.folder / "session" / "session.json", data)
    found = store.session()
    assert isinstance(found.next_step, Step)
    assert store.write(found) == found
    return found


def read_label(data: bytes, folder: Path) -> None:
    (folder / labels.LABEL_FILE).write_bytes(data)
    label = labels.Label.read(folder)
    for text, longest in ((label.name, labels.Label.LONGEST["name"]), (label.note, labels.Label.LONGEST["note"])):
        assert text is None or (0 < len(text) <= longest and "\n" not in text and "\x1b" not in text)


def read_packed(data: bytes, folder: Path) -> None:
    path = folder / "frames_left.npy.jls"
    path.write_bytes(data)
    index = packed.read_index(path)
    for k in range(index.count):
        frame = index.frame(k)
        assert f"{zlib.crc32(frame.tobytes()):08x}" == index.crc32[k], "no pixels but those that were packed"
    index.is_undamaged()


def read_count(data: bytes, folder: Path) -> None:
    (folder / names.NUMBER_FILE).write_bytes(data)
    number = names.take_number(LocalFileSystem(), folder, [7])
    assert number >= 8, "a number that a scan on the disk has"
    assert len(names.spell_id(number)) <= 12
    assert names.take_number(LocalFileSystem(), folder, [7]) == number + 1


def read_manifest(data: bytes, _: Path) -> None:
    manifest = form.MANIFEST.decode(data, "manifest.json")
    assert all("/" not in name for name in manifest.files)
    again = form.MANIFEST.decode(form.encode(manifest), "manifest.json, written again")
    assert again.scan_id == manifest.scan_id
    assert again.files == manifest.files


def read_broken(data: bytes, _: Path) -> None:
    broken = incomplete.INCOMPLETE.decode(data, "incomplete.json", incomplete.INCOMPLETE_OF)
    assert all(isinstance(name, str) for name in broken.missing)
    again = incomplete.INCOMPLETE.encode(broken, incomplete.INCOMPLETE_OF)
    assert incomplete.INCOMPLETE.decode(again, "again", incomplete.INCOMPLETE_OF) == broken


def read_board(data: bytes, folder: Path) -> None:
    (folder / "board.json").write_bytes(data)
    begun = ViewFolder.session(folder)
    assert begun is not None
    assert ViewFolder(folder, *begun).design == begun[1]


def with_crc(data: bytes) -> bytes:
    """A cloud whose checksum fits whatever its body is."""
    head, end, body = data.partition(b"end_header\n")
    at = head.find(b"crc32 ") + 6
    return head[:at] + b"%08x" % zlib.crc32(body) + head[at + 8 :] + end + body if at > 5 else data


def read_cloud(data: bytes, folder: Path) -> None:
    (folder / "cloud.ply").write_bytes(data)
    stored = read_ply(folder / "cloud.ply")
    n = len(stored.points_mm)
    assert stored.points_mm.shape == (n, 3)
    assert len(stored.intensity) == len(stored.sigma_mm) == len(stored.ray_gap_mm) == len(stored.modulation_dn) == n
    assert np.isfinite(stored.points_mm).all(), "no point lies nowhere"


@st.composite
def scan_folder(draw: st.DrawFn) -> dict[str, bytes]:
    """A scan's folder with one file lost or damaged; its manifest mostly believes in what is there."""
    files = dict(SCAN)
    name = draw(st.sampled_from(sorted(files)))
    if name == form.MANIFEST_FILE:
        return {**files, name: draw(of_sealed(files[name], *SCAN))}
    if draw(st.sampled_from((True, *[False] * 9))):
        del files[name]
        return files
    headers = ((b"'|u1'", b"'|O' "), (b"(3, 8", b"(9, 8"), (b"(3, 8", b"(-3,8"), (b"False", b"True "), (b"'shape'", b"'shame'"),
               (b"10)", b"10L)"), (b"(3, 8, 10)", b"__import__"), (b"(3, 8, 10)", b"(2**70,)  "), (b"(3, 8, 10)", b"(3,0,80)  "))  # fmt: skip
    old, new = draw(st.sampled_from(headers))
    files[name] = draw(damaged([files[name]]) | st.just(files[name].replace(old, new, 1)))
    if draw(st.sampled_from((True, True, False))):
        manifest = json.loads(files[form.MANIFEST_FILE])
        manifest["files"][name] = {"length": len(files[name]), "sha256": hashlib.sha256(files[name]).hexdigest()}
        files[form.MANIFEST_FILE] = sealed(manifest)
    return files


def open_scan(files: dict[str, bytes], root: Path) -> None:
    folder = root / "scans" / "000001"
    shutil.rmtree(folder, ignore_errors=True)
    for name, data in files.items():
        put(folder / name, data)
    library = Library(root)
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


COUNTS = st.sampled_from((b"1", b"42", b"999999999999", b"0", b"000007", "٣".encode(), b"1" * 40)).map(
    lambda number: number + b" %08x\n" % zlib.crc32(number)
)
RIGS = changed(RIG, RIG_KEYS).map(lambda tree: toml_of(tree).encode("utf-8", "surrogatepass"))
PLIES = damaged(CLOUDS)
PARSERS = (
    Parser("rig", RIGS | damaged([RIG_TEXT.encode()]), read_rig, (ConfigError,), "CONFIG: ", longest=12_000, share=0.2),
    Parser("picture", damaged(PICTURES), read_picture, (PicturesError,), "00_left", share=0.6),
    Parser("calibration", of_sealed(CALIBRATION), read_by(SimpleNamespace(decode=calibration_file.decode_calibration, encode=calibration_file.encode_calibration), "calibration current.json"), (calibration_file.CalibrationError,), "calibration current.json", share=0.6),
    Parser("response", of_sealed(RESPONSE), read_by(RESPONSE_FILE, "response response.json"), (ContentError,), "response response.json", share=0.6),
    Parser("noise", of_sealed(NOISE), read_by(NOISE_FILE, "noise noise.json"), (ContentError,), "noise noise.json", share=0.6),
    Parser("health", of_sealed(HEALTH), read_health, share=0.5),
    Parser("beams", of_sealed(BEAMS, "line", "covariance", "learned", "last_z_mm"), read_beams, share=0.5),
    Parser("choices", of_sealed(CHOICES, "language", "period_px"), read_choices, share=0.5),
    Parser("session", of_sealed(SESSION), read_session, share=0.5),
    Parser("label", of_sealed(LABEL, "name", "note", "schema"), read_label, (ContentError,), labels.LABEL_FILE, share=0.6),
    Parser("counter", COUNTS | COUNTS.flatmap(lambda line: damaged([line])), read_count, (StorageError,), share=0.5),
    Parser("manifest", of_sealed(SCAN[form.MANIFEST_FILE], "files", "record", "../x"), read_manifest, (ContentError,), "manifest.json", share=0.6),
    Parser("broken", of_sealed(BROKEN, "missing", "kind", "../x"), read_broken, (ContentError,), "incomplete.json", share=0.6),
    Parser("object", of_sealed(OBJECT, "places", "../x"), read_by(objects.OBJECT, "object.json"), (ContentError,), "object.json", share=0.6),
    Parser("board", damaged([BOARD]) | changed(json.loads(BOARD)).map(lambda one: json.dumps(one).encode()), read_board, (ContentError,), "board.json", share=0.6),
    Parser("cloud", PLIES | PLIES.map(with_crc), read_cloud, (PlyError,), "cloud.ply", share=0.6),
    Parser("packed", damaged([packed_frames()]), read_packed, (PackedError,), share=0.6),
    Parser("scan", scan_folder(), open_scan, (ScanError,), "000001", share=0.5),
)  # fmt: skip


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("parser", PARSERS, ids=lambda parser: parser.name)
def test_whatever_a_file_holds_it_is_read_or_put_aside_or_refused_by_name(parser: Parser, tmp_path: Path) -> None:
    assert parser.judge(tmp_path)["accepted"], "nothing behind the first check was reached"
