"""Files that people name are read only if regular and of a sensible size."""

from __future__ import annotations

import os
import struct
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from appliance.base.bounded_file import parse_toml, read_bounded, read_text
from appliance.calibrate.pictures import Pair, ViewFolder, common_size, read_grey, read_pair
from appliance.desk.foreign.camera_files import camera_numbers, numbers_in
from appliance.desk.foreign.description import load_description
from appliance.desk.foreign.frames import Frame, FrameReader, frames_in
from appliance.desk.foreign.problem import ForeignError, Table
from appliance.measure.calibration.noise_file import NOISE
from appliance.store.config import default_rig_path, load_rig
from appliance.store.instrument import load_calibration
from appliance.store.scan_list import ScanList

READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "rig file": ("rig.toml", load_rig),
    "description": ("set.toml", load_description),
    "list": ("list.toml", ScanList.read),
    "list in JSON": ("list.json", ScanList.read),
    "calibration": ("calibration.json", load_calibration),
    "noise": ("noise.json", NOISE.load),
    "session": ("board.json", lambda path: ViewFolder.session(path.parent)),
    **{f"cameras {suffix}": (f"stereo{suffix}", numbers_in) for suffix in (".yml", ".xml", ".json", ".npz", ".npy", ".mat", ".txt", ".csv")},
    "image": ("a.png", lambda path: FrameReader().raw(Frame(path))),
    "pages": ("a.tif", frames_in),
    "stack": ("a.npy", frames_in),
    "stacks": ("a.npz", frames_in),
    "board": ("a_left.png", lambda path: read_pair(Pair("a", path, path.with_name("b")), 64, 64)),
    "picture": ("left.png", read_grey),
    "pictures": ("left.png", lambda path: common_size([path])),
}  # fmt: skip


def refused(read: Callable[[Path], object], path: Path, words: str) -> str:
    with pytest.raises(Exception, match=words) as raised:
        read(path)
    assert type(raised.value).__module__.startswith("appliance.")
    return str(raised.value)


@pytest.mark.parametrize("reader", READERS)
def test_pipes_devices_and_what_is_too_large_are_refused_at_once(reader: str, tmp_path: Path) -> None:
    name, read = READERS[reader]
    path = tmp_path / name
    os.mkfifo(path)
    assert str(path) in refused(read, path, "it is a pipe")
    path.unlink()
    path.symlink_to("/dev/zero")
    assert str(path) in refused(read, path, "it is a device")
    path.unlink()
    if reader not in ("pages", "stack", "stacks"):
        with path.open("wb") as file:
            file.truncate(1 << 40)
        refused(read, path, r"larger than \d+ bytes")


def test_a_file_that_grows_while_it_is_read_is_bounded(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_bounded(path, 5) == b"12345"
    with pytest.raises(OSError, match="larger than 4 bytes"):
        read_bounded(path, 4)
    with pytest.raises(OSError, match="larger than 4 bytes"):
        read_bounded(Path("/proc/self/status"), 4)  # whose size is stated as nothing


def test_texts_saved_with_a_byte_order_mark_are_read(tmp_path: Path) -> None:
    mark = b"\xef\xbb\xbf"
    rig = tmp_path / "rig.toml"
    rig.write_bytes(mark + default_rig_path().read_bytes())
    assert load_rig(rig) == load_rig()
    for name, text in (
        ("a.txt", "M1 = 1 2 3"),
        ("a.json", '{"M1": [1, 2, 3]}'),
        ("a.yml", "%YAML:1.0\n---\nM1: [1, 2, 3]\n"),
        ("b.yml", "M1:\n- 1\n- 2\n- 3\n"),
        ("b.txt", "rows: 1\ncols: 3\ndata: 4 5 6\nM1: 1 2 3\n"),
    ):
        (tmp_path / name).write_bytes(mark + text.encode())
        assert numbers_in(tmp_path / name)["M1"].tolist() == [1.0, 2.0, 3.0], name
    listed = tmp_path / "list.toml"
    listed.write_bytes(mark + b'[[scan]]\nscan = "1"\nartefact = "plane"\n')
    assert len(ScanList.read(listed).entries) == 1
    assert read_text(listed, 100).startswith("[[scan]]")


@pytest.mark.parametrize("number", ["nan", "-inf", "1e400", "1" + 400 * "0", "0x" + 5000 * "f"])
@pytest.mark.parametrize(
    ("reader", "key", "text"),
    [
        ("list", "length_mm", '[[scan]]\nscan = "1"\nartefact = "ball-bar"\nlength_mm = {}\n'),
        ("list", "reference_mm", 'reference_mm = {}\n[[scan]]\nscan = "1"\nartefact = "plane"\n'),
        ("rig file", "case_hot_c", "[limits]\ncase_hot_c = {}\n"),
        ("description", "width_px", '[images]\nleft = "a*"\norder = "bright"\n[projector]\nwidth_px = {}\n[cameras]\n'),
    ],
)
def test_numbers_that_are_none_are_refused_in_words(
    reader: str, key: str, text: str, number: str, tmp_path: Path
) -> None:
    name, read = READERS[reader]
    (tmp_path / name).write_text(text.format(number))
    assert len(refused(read, tmp_path / name, rf"{key}\b.*allowed")) < 4000, "the number is not repeated"


def test_a_long_whole_number_in_a_list_in_json_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "list.json"
    path.write_text(f'{{"scan": [{{"scan": "1", "artefact": "ball-bar", "length_mm": 1{400 * "0"}}}]}}')
    assert len(refused(ScanList.read, path, r"allowed are numbers 1\.\.2000")) < 4000


@pytest.mark.parametrize("number", ["nan", "inf", "1e400", "1e12"])
@pytest.mark.parametrize(("name", "text"), [("s.txt", "{k} = {v}\n"), ("s.json", '"{k}": [{v}],')])
def test_cameras_numbers_that_are_none_are_named(name: str, text: str, number: str, tmp_path: Path) -> None:
    values = {
        "M1": "1,0,0,0,1,0,0,0,1", "M2": "1,0,0,0,1,0,0,0,1", "R1": "1,0,0,0,1,0,0,0,1", "T1": "0,0,0", "R2": "1,0,0,0,1,0,0,0,1",
        "T2": "0,0,0", "P1": "1,0,0,0,0,1,0,0,0,0,1,0", "P2": f"1,0,0,{number},0,1,0,0,0,0,1,0",
    }  # fmt: skip
    written = "".join(text.format(k=k, v=v) for k, v in values.items())
    spelt = written.replace("nan", "NaN").replace("inf", "Infinity")
    (tmp_path / name).write_text(f"{{{spelt.rstrip(',')}}}" if name.endswith(".json") else written)
    with pytest.raises(ForeignError, match=r"^s\.\w+: P2 is .*; allowed are finite numbers below 1e\+09"):
        camera_numbers(tmp_path, Table("cameras.", {"files": name}), of_projector=True)


def test_whole_numbers_of_toml_have_64_bits() -> None:
    assert parse_toml("a = 9223372036854775807\nb = [-9223372036854775808]") == {"a": 2**63 - 1, "b": [-(2**63)]}
    with pytest.raises(ValueError, match=r"t\.b is a whole number of 64 bits"):
        parse_toml("[t]\nb = [1, 9223372036854775808]")


def test_an_archive_of_zeros_is_refused_by_its_headers(tmp_path: Path) -> None:
    path = tmp_path / "stack.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("left.npy", "w") as member:
        np.lib.format.write_array_header_1_0(
            member, {"descr": "|u1", "fortran_order": False, "shape": (60, 10_000, 10_000)}
        )
        member.write(bytes(1 << 23))
    tracemalloc.start()
    frames = frames_in(path)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 1 << 20, "nothing but the header is unpacked"
    assert len(frames) == 60
    with pytest.raises(ForeignError, match=r"array left unpacks to 6 GB; allowed are 2\.15 GB"):
        FrameReader().raw(frames[0])
    assert numbers_in(path) == {}, "none of so many numbers is a camera's"


def test_headers_that_promise_more_than_there_is_memory_for_are_not_believed(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBB", 13, b"IHDR", 20_000, 20_000, 8, 0, 0, 0, 0))
    with pytest.raises(ForeignError, match="20000 x 20000 px"):
        FrameReader().raw(Frame(path))
    with zipfile.ZipFile(tmp_path / "stack.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("left.npy", b"\x93NUMPY\x02\x00" + (1 << 31).to_bytes(4, "little") + bytes(1 << 16))
    with pytest.raises(ForeignError, match="not readable"):
        frames_in(tmp_path / "stack.npz")


def _inflating() -> bytes:
    """A MATLAB file of some kB whose one array says that it has 2 GB, which it begins to unpack to."""
    head = struct.pack("<15I", 14, (1 << 31) - 256, 6, 8, 6, 0, 5, 8, 1 << 14, 1 << 14, 1, 1, 0x31, 9, 0)
    packed = zlib.compress(head + bytes(1 << 22))
    return b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H2sII", 0x0100, b"IM", 15, len(packed)) + packed


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("a.yml", b"M1: " + b"[" * 100_000, "line 1: more than 12 levels"),
        ("a.yml", b"M1: [1]\nM1: [2]\n", "M1 has two different values"),
        ("a.json", b'{"M1": ' + b"[" * 100_000, "recursion"),
        ("a.xml", b"<M1>" * 100_000 + b"1" + b"</M1>" * 100_000, "more than 12 levels"),
        ("a.mat", _inflating(), "not readable as MATLAB's .mat"),
        ("a.mat", b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(512), "version 7.3 is another format: save it with -v7"),
    ],
)  # fmt: skip
def test_what_small_camera_files_could_become_is_refused(name: str, data: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ForeignError) as error:
        numbers_in(tmp_path / name)
    assert said in str(error.value)
