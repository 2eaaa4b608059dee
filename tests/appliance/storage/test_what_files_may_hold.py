"""How large small files may be, who may read what was written, and what clouds, manifests and files of frames must say."""

from __future__ import annotations

import hashlib
import json
import os
import re
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.calibration.health import HealthTrend, Reference
from appliance.calibration.patches import COUNT
from appliance.checksummed_file import checked_content, with_checksum
from appliance.machine.choices import Choices
from appliance.scan.exposure import Exposure
from appliance.scan.fault import FaultCode
from appliance.storage import label
from appliance.storage import manifest as form
from appliance.storage.atomic import StorageError, replace_file
from appliance.storage.choices import FILE, ChoicesFile
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.health import HealthFile
from appliance.storage.label import LabelError
from appliance.storage.manifest import Decision, Manifest, ManifestError, Stage
from appliance.storage.ply import POINT, PlyError, encode_ply, read_ply, write_ply
from appliance.storage.scan import ScanError, cloud_bytes, frames_bytes, load, map_frames, write_raw
from tests.appliance.storage.scenes import ORIGIN, BadDisk, cloud, frames, record

HASH = "0123456789abcdef" * 4
RIG = Choices(Exposure(12_000), 16, 0.0, 20.0)


@pytest.fixture
def open_umask() -> Iterator[None]:
    before = os.umask(0)
    yield
    os.umask(before)


def test_whoever_copies_scans_may_read_what_was_written_and_only_the_owner_may_write(
    tmp_path: Path, open_umask: None
) -> None:
    fs = LocalFileSystem()
    fs.make_folder(tmp_path / "folder")
    fs.create(tmp_path / "file").close()
    fs.allocate(tmp_path / "place", 100)
    modes = [(tmp_path / name).stat().st_mode & 0o777 for name in ("folder", "file", "place")]
    assert modes == [0o755, 0o644, 0o644]


def test_nothing_is_made_where_something_is(tmp_path: Path) -> None:
    fs = LocalFileSystem()
    (tmp_path / "file").write_bytes(b"content")
    for make in (fs.create, lambda path: fs.allocate(path, 9), fs.make_folder):
        with pytest.raises(FileExistsError):
            make(tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == b"content"


def test_a_place_is_taken_on_the_disk_and_a_folder_that_is_not_empty_is_not_removed(tmp_path: Path) -> None:
    fs = LocalFileSystem()
    fs.allocate(tmp_path / "place", 100_000)
    found = (tmp_path / "place").stat()
    assert found.st_size == 100_000
    assert found.st_blocks * 512 >= 100_000
    with pytest.raises(OSError, match="not empty"):
        fs.remove(tmp_path)
    fs.remove(tmp_path / "place")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("call", ["write", "sync", "close"])
def test_a_file_that_could_not_be_written_leaves_no_draft_and_the_old_content(tmp_path: Path, call: str) -> None:
    path = tmp_path / "choices.json"
    path.write_bytes(b"old")
    disk = BadDisk(["create", "write", "sync", "close"].index(call))
    with pytest.raises(StorageError, match=r"cannot write .*choices\.json\.draft"):
        replace_file(disk, path, b"new content")
    assert disk.calls[-2].startswith(call) or disk.calls[-1].startswith("remove")
    assert [one.name for one in tmp_path.iterdir()] == ["choices.json"]
    assert path.read_bytes() == b"old"
    replace_file(disk, path, b"new ", b"content")
    assert path.read_bytes() == b"new content"


# ------------------------------------------------------------------------------------------- files that are too long


def padded(content: dict[str, object], length: int) -> bytes:
    """A sealed file of that length, of which some is white space."""
    data = with_checksum(content)
    assert len(data) <= length
    return data[:-2] + b" " * (length - len(data)) + data[-2:]


def test_choices_are_read_up_to_10_kb(tmp_path: Path) -> None:
    file = ChoicesFile(tmp_path, RIG)
    for length, read in ((10_000, True), (10_001, False)):
        (tmp_path / FILE).write_bytes(padded({"schema": 1, "chosen": {"period_px": 32}}, length))
        choices, fault = file.read()
        assert (choices.period_px == 32) == (fault is None) == read


def test_a_label_is_read_up_to_16_kib(tmp_path: Path) -> None:
    for length, read in ((16_384, True), (16_385, False)):
        (tmp_path / "label.json").write_bytes(padded({"schema": 1, "name": "a", "note": None}, length))
        if read:
            assert label.read(tmp_path).name == "a"
        else:
            with pytest.raises(LabelError, match=r"^label\.json: "):
                label.read(tmp_path)


def test_a_trend_is_read_up_to_a_megabyte(tmp_path: Path) -> None:
    file = HealthFile(tmp_path, HASH)
    file.write(HealthTrend(judged=3))
    content = checked_content(file.path.read_bytes(), 10**6)
    for length, read in ((1_000_000, True), (1_000_001, False)):
        file.path.write_bytes(padded(content, length))
        assert file.read().judged == (3 if read else 0)


def test_what_cannot_be_opened_is_no_choice_no_label_and_no_trend(tmp_path: Path) -> None:
    """A folder lies where the file should be."""
    file = HealthFile(tmp_path, HASH)
    for path in (tmp_path / FILE, tmp_path / "label.json", file.path):
        path.mkdir(parents=True)
    choices, fault = ChoicesFile(tmp_path, RIG).read()
    assert choices == RIG
    assert fault is not None
    assert (fault.code, fault.detail) == (FaultCode.SETTINGS_LOST, "choices.json: Is a directory")
    with pytest.raises(LabelError, match=r"label\.json: Is a directory"):
        label.read(tmp_path)
    assert file.read() == HealthTrend()
    with pytest.raises(StorageError, match="cannot read"):
        file.write(HealthTrend(judged=1))


def test_only_what_differs_from_the_rig_file_is_written(tmp_path: Path) -> None:
    ChoicesFile(tmp_path, RIG).write(replace(RIG, period_px=64, language="de"))
    content = json.loads((tmp_path / FILE).read_bytes())
    assert content["chosen"] == {"period_px": 64, "language": "de"}
    (tmp_path / FILE).write_bytes(with_checksum({"schema": 1, "chosen": [1]}))
    assert ChoicesFile(tmp_path, RIG).read()[1] is not None


@pytest.mark.parametrize(
    ("trend", "read"),
    [
        (HealthTrend(judged=0, alarm="turned"), True),
        (HealthTrend(judged=-1, alarm="turned"), False),
        (HealthTrend(reference=Reference(gap_um=(1.0,) * COUNT)), True),
        (HealthTrend(reference=Reference(gap_um=(1.0,) * (COUNT - 1))), False),
        (HealthTrend(reference=Reference(variance_um2=(1.0,) * (COUNT + 1))), False),
        (HealthTrend(reference=Reference(scans=(1,) * (COUNT + 1))), False),
    ],
)
def test_a_trend_says_nothing_that_cannot_be(tmp_path: Path, trend: HealthTrend, read: bool) -> None:
    file = HealthFile(tmp_path, HASH)
    file.write(trend)
    assert file.read() == (trend if read else HealthTrend())


def test_a_trend_of_another_calibration_or_version_is_not_used(tmp_path: Path) -> None:
    file = HealthFile(tmp_path, HASH)
    file.write(HealthTrend(judged=3))
    whole = checked_content(file.path.read_bytes(), 10**6)
    for changed in ({"calibration": HASH[:16] + "0" * 48}, {"schema": 2}, {"trend": {"judged": "many"}}):
        file.path.write_bytes(with_checksum({**whole, **changed}))
        assert file.read() == HealthTrend()
    file.path.write_bytes(with_checksum(whole))
    assert file.read() == HealthTrend(judged=3)


# -------------------------------------------------------------------------------------------------------- clouds


def test_a_cloud_of_many_blocks_comes_back_as_it_was_written(tmp_path: Path) -> None:
    """And its checksum is that of all its bytes, as any program computes it."""
    written = cloud(70_000)
    write_ply(tmp_path / "c.ply", written)
    read = read_ply(tmp_path / "c.ply")
    for name in ("points_mm", "intensity", "modulation_dn", "ray_gap_mm", "sigma_mm"):
        assert np.array_equal(getattr(read, name), getattr(written, name))
    head, body = (tmp_path / "c.ply").read_bytes().split(b"end_header\n", 1)
    assert f"comment body crc32 {zlib.crc32(body):08x}".encode() in head
    assert len(body) == 70_000 * 25


@pytest.mark.parametrize("length", [1, 1999, 2000, 2001, 4000])
def test_what_a_salvaged_cloud_says_of_itself_is_read_back_up_to_2000_characters(tmp_path: Path, length: int) -> None:
    said = ("lost: gray-x-3 " * 300)[:length]
    (tmp_path / "c.ply").write_bytes(b"".join(bytes(part) for part in encode_ply(cloud(3), said)))
    assert read_ply(tmp_path / "c.ply").salvaged == said[:2000]


def test_letters_that_a_header_cannot_hold_are_replaced_in_what_it_says(tmp_path: Path) -> None:
    (tmp_path / "c.ply").write_bytes(b"".join(bytes(part) for part in encode_ply(cloud(3), "Gr\u00fc\u00dfe")))
    assert read_ply(tmp_path / "c.ply").salvaged == "Gr??e"
    (tmp_path / "c.ply").write_bytes(b"".join(bytes(part) for part in encode_ply(cloud(3), "")))
    assert read_ply(tmp_path / "c.ply").salvaged is None


def test_points_of_two_coordinates_are_no_cloud() -> None:
    whole = cloud(5)
    with pytest.raises(ValueError, match=r"points_mm has shape \(5, 2\); \(n, 3\) is needed"):
        encode_ply(replace(whole, points_mm=whole.points_mm[:, :2]))
    with pytest.raises(ValueError, match=r"points_mm has shape \(5, 3, 1\)"):
        encode_ply(replace(whole, points_mm=whole.points_mm[..., None]))
    with pytest.raises(ValueError, match=r"sigma has shape \(5, 1\)"):
        encode_ply(replace(whole, sigma_mm=whole.sigma_mm[:, None]))


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_cloud_with_a_point_that_is_nowhere_is_refused_although_its_checksum_fits(tmp_path: Path, axis: str) -> None:
    head, body = (bytes(part) for part in encode_ply(cloud(5)))
    points = np.frombuffer(body, POINT).copy()
    points[axis][2] = np.inf
    wrong = points.tobytes()
    head = re.sub(rb"crc32 [0-9a-f]{8}", b"crc32 %08x" % zlib.crc32(wrong), head)
    (tmp_path / "c.ply").write_bytes(head + wrong)
    with pytest.raises(PlyError, match="points that are not finite"):
        read_ply(tmp_path / "c.ply")


# ----------------------------------------------------------------------------------------------- manifests and frames


def a_manifest(**changes: object) -> Manifest:
    return replace(Manifest("000001", Stage.RAW, Decision.UNDECIDED, record(), {}, frame_crc32={}), **changes)  # type: ignore[arg-type]


def resealed(content: dict[str, object]) -> bytes:
    plain = {name: value for name, value in content.items() if name != "sha256"}
    digest = hashlib.sha256(json.dumps(plain, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
    return json.dumps({**plain, "sha256": digest}).encode()


@pytest.mark.parametrize("name", ["../frames_left.npy", "a/b", "manifest.json", "/etc/passwd", "..", "", ".", "a\0b"])
def test_a_manifest_lists_nothing_but_files_beside_it(name: str) -> None:
    content = json.loads(form.encode(a_manifest()))
    content["files"] = {name: {"length": 1, "sha256": "ab"}}
    with pytest.raises(ManifestError, match=r"here: .* is not the name of a file beside it"):
        form.decode(resealed(content), "here")
    content["files"] = {"frames_left.npy": {"length": 1, "sha256": "ab"}}
    assert set(form.decode(resealed(content), "here").files) == {"frames_left.npy"}


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"[1]", "a JSON object was expected, not list"),
        (b"{", "not readable as JSON"),
        (b"[" * 100_000, "not readable as JSON"),
        (b'{"a": NaN}', "NaN is no number that can be stored"),
        (b'{"a": 1e999}', "1e999 is no number that can be stored"),
        (b"{}", "its checksum does not fit its content"),
    ],
)
def test_what_is_no_manifest_says_why(data: bytes, said: str) -> None:
    with pytest.raises(ManifestError, match=said):
        form.decode(data, "here")


@pytest.mark.parametrize(("name", "value"), [("stage", "half"), ("files", []), ("recovered", "perhaps")])
def test_a_manifest_of_another_form_names_what_is_wrong_in_it(name: str, value: object) -> None:
    content = json.loads(form.encode(a_manifest()))
    with pytest.raises(ManifestError, match=f"^here: {name}: "):
        form.decode(resealed({**content, name: value}), "here")


def test_a_manifest_is_read_up_to_16_mib(tmp_path: Path) -> None:
    whole = form.encode(a_manifest())
    for length, read in ((16 * 1024 * 1024, True), (16 * 1024 * 1024 + 1, False)):
        (tmp_path / "manifest.json").write_bytes(whole[:-2] + b" " * (length - len(whole)) + whole[-2:])
        if read:
            assert form.read(tmp_path).scan_id == "000001"
        else:
            with pytest.raises(ManifestError, match="larger than 16777216 bytes"):
                form.read(tmp_path)


def test_times_that_are_not_known_are_left_out_and_others_stay(tmp_path: Path) -> None:
    timed = record(stage_times_s={"full": 1.5, "coarse": float("nan"), "saved": float("inf")})
    read = form.decode(form.encode(a_manifest(record=timed)), "here")
    assert dict(read.record.stage_times_s) == {"full": 1.5}


@pytest.mark.parametrize("value", [b"bytes", object()])
def test_what_json_cannot_hold_is_not_written_in_another_form(value: object) -> None:
    with pytest.raises(TypeError, match="cannot be written to a manifest"):
        form.encode(a_manifest(record=record(ledger={"a": value})))


def test_frames_and_points_take_what_is_reserved_for_them(tmp_path: Path) -> None:
    write_raw(LocalFileSystem(), tmp_path / "000001", "000001", frames(), record(), ORIGIN)
    assert (tmp_path / "000001" / "frames_left.npy").stat().st_size == frames_bytes(3, 10, 8) == 128 + 3 * 80
    assert 25 * 640 * 480 + 600 < cloud_bytes(640, 480) < 25 * 640 * 480 + 10_000


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        ((2, 8, 10), "not 3 frames of 8 bits"),
        ((3, 8, 9), "bytes are not 3 frames of 9 x 8 px"),
        ((3, 0, 10), "not 3 fr"),
    ],
)
def test_a_file_whose_header_says_something_else_is_not_mapped(
    tmp_path: Path, shape: tuple[int, int, int], said: str
) -> None:
    folder = tmp_path / "000001"
    manifest = write_raw(LocalFileSystem(), folder, "000001", frames(), record(), ORIGIN)
    path = folder / "frames_right.npy"
    data = path.read_bytes()
    changed = data[:128].replace(b"(3, 8, 10)", str(shape).encode())[:127].rstrip(b"\n").ljust(127) + b"\n" + data[128:]
    path.write_bytes(changed)
    assert len(changed) == manifest.files["frames_right.npy"].length
    with pytest.raises(ScanError, match=said):
        load(folder)
    path.unlink()
    with pytest.raises(ScanError, match=r"frames_right\.npy: not readable as frames"):
        map_frames(path, 3)


@pytest.mark.parametrize("block", [np.zeros((3, 8), np.uint8), np.zeros((3, 8, 10), np.uint16), np.zeros((4, 8, 10), np.uint8)])  # fmt: skip
@pytest.mark.parametrize("side", ["left", "right"])
def test_frames_of_another_form_are_refused_before_anything_is_made(
    tmp_path: Path, side: str, block: np.ndarray
) -> None:
    with pytest.raises(ValueError, match=rf"{side} frames are {block.dtype}"):
        write_raw(LocalFileSystem(), tmp_path / "000001", "000001", {**frames(), side: block}, record(), ORIGIN)
    assert list(tmp_path.iterdir()) == []
