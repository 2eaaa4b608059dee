"""Of a damaged scan it is said which frames are lost, and all others are given as they were recorded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from appliance.store.atomic import LocalFileSystem
from appliance.store.damage import DamagedFrames, damaged_frames, frames_as_they_are
from appliance.store.manifest import Manifest, SequenceInfo
from appliance.store.scan import ScanError, add_second, write_raw
from tests.appliance.store.scenes import FRAMES, ORIGIN, frames, record, second_sequence

PIXELS = 8 * 10
NAMES = ("bright", "dark", "gray-x-0")
LEFT = "frames_left.npy"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "000001"


@pytest.fixture
def manifest(folder: Path) -> Manifest:
    return write_raw(LocalFileSystem(), folder, "000001", frames(), record(), ORIGIN)


def flip_byte(path: Path, at: int) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 0xFF
    path.write_bytes(bytes(data))


def test_one_damaged_pixel_costs_its_frame_alone(folder: Path, manifest: Manifest) -> None:
    assert damaged_frames(folder, manifest) == ()
    for k, pixel in ((0, 0), (1, PIXELS - 1), (2, 0), (2, PIXELS - 1)):
        flip_byte(folder / "frames_right.npy", 128 + k * PIXELS + pixel)
        (found,) = damaged_frames(folder, manifest)
        assert (found.file, found.frames, found.names) == ("frames_right.npy", (k,), (NAMES[k],))
        left = frames_as_they_are(folder, manifest, "frames_right.npy")
        assert (left == frames()["right"]).all(axis=(1, 2)).tolist() == [n != k for n in range(FRAMES)]
        flip_byte(folder / "frames_right.npy", 128 + k * PIXELS + pixel)


@pytest.mark.parametrize("missing", [1, PIXELS, PIXELS + 1, 3 * PIXELS + 5, 3 * PIXELS + 128, None])
def test_a_file_that_was_cut_or_is_gone_lacks_frames(folder: Path, manifest: Manifest, missing: int | None) -> None:
    data = (folder / LEFT).read_bytes()
    if missing is None:
        (folder / LEFT).unlink()
        missing, problem = len(data), "missing"
    else:
        (folder / LEFT).write_bytes(data[: len(data) - missing])
        problem = f"{len(data) - missing} bytes instead of {len(data)}"
    lost = tuple(range(max(0, FRAMES - -(-missing // PIXELS)), FRAMES))
    (found,) = damaged_frames(folder, manifest)
    assert (found.file, found.frames, found.problem) == (LEFT, lost, problem)
    whole = FRAMES - len(lost)
    left = frames_as_they_are(folder, manifest, LEFT)
    assert left.shape == (FRAMES, 8, 10)
    assert (left[:whole] == frames()["left"][:whole]).all()
    assert not left.reshape(-1)[max(0, FRAMES * PIXELS - missing) :].any(), "what is not there is dark"


def test_a_damaged_header_is_made_up_from_the_other_cameras_alone(folder: Path, manifest: Manifest) -> None:
    longer = replace(manifest, record=record(sequence=SequenceInfo(16, 1024, 768, (*NAMES, "gray-x-1"))))
    with pytest.raises(ScanError, match="the size of its frames is lost"):
        frames_as_they_are(folder, longer, LEFT)
    data = (folder / LEFT).read_bytes()
    for damage in (data.replace(b"8, 10)", b"4, 10)"), data[:3] + b"\0" + data[4:]):
        (folder / LEFT).write_bytes(damage)
        (found,) = damaged_frames(folder, manifest)
        assert found.frames == (), "no frame is lost"
        assert (frames_as_they_are(folder, manifest, LEFT) == frames()["left"]).all()
    flip_byte(folder / "frames_right.npy", 3)
    assert [found.frames for found in damaged_frames(folder, manifest)] == [(0, 1, 2), (0, 1, 2)]
    with pytest.raises(ScanError, match=r"frames_left\.npy: the size of its frames is lost"):
        frames_as_they_are(folder, manifest, LEFT)


def test_frames_of_the_second_exposure_are_told_apart(folder: Path, manifest: Manifest) -> None:
    both = record(second=second_sequence())
    added = add_second(LocalFileSystem(), folder, manifest, frames(seed=1), both)
    assert damaged_frames(folder, added) == ()
    flip_byte(folder / "frames_left_second.npy", 128 + PIXELS)
    (found,) = damaged_frames(folder, added)
    assert (found.file, found.frames) == ("frames_left_second.npy", (1,))
    assert (frames_as_they_are(folder, added, "frames_left_second.npy")[2] == frames(seed=1)["left"][2]).all()


def test_up_to_six_frames_are_named_and_more_are_counted() -> None:
    names = tuple(f"sine-x-{k}" for k in range(24))
    for count, end in ((0, ""), (1, " in sine-x-0"), (6, f" in {', '.join(names[:6])}"), (7, " in 7 frames"), (24, " in 24 frames")):  # fmt: skip
        assert str(DamagedFrames(LEFT, "damaged", tuple(range(count)), names[:count])) == f"{LEFT}: damaged{end}"
