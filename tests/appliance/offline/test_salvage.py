"""What stands in the place of a lost frame is what the camera would have seen, and what cannot be told is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.offline.salvage import _make_up, salvage
from appliance.patterns.sequence import Direction, build_sequence
from appliance.scan.exposure import Exposure
from appliance.scan.noise import CameraNoise, StereoNoise
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.record import SecondSequence, SequenceInfo
from appliance.storage.scan import ScanError, add_second, write_raw
from tests.appliance.storage.scenes import ORIGIN, record

SEQUENCE = build_sequence(16)
SINES = SEQUENCE.axis(Direction.X).sine


def recorded() -> NDArray[np.uint8]:
    """Frames (n, 1, 64) of an even surface: fringes of 40 DN about 100 DN, four steps of 90° in each direction."""
    frames = np.full((len(SEQUENCE), 1, 64), 100, np.uint8)
    for direction in Direction:
        for step, k in enumerate(SEQUENCE.axis(direction).sine):
            frames[k, 0] = np.round(100.0 + 40.0 * np.cos(2.0 * np.pi * (np.arange(64) / 16.0 - step / 4.0)))
    return frames


@pytest.mark.parametrize("step", range(4))
def test_a_lost_sine_image_is_what_the_other_three_say(step: int) -> None:
    frames, said = recorded(), list[str]()
    before = frames[SINES[step]].astype(int)
    frames[SINES[step]] = 0
    assert _make_up(frames, SEQUENCE, (SINES[step],), "left", said) == 3.0
    assert np.abs(frames[SINES[step]] - before).max() <= 2
    assert len(said) == 1


def test_two_sine_images_of_one_direction_are_too_many() -> None:
    with pytest.raises(ScanError, match="two of the four sine images of a direction are lost; bring the folder back"):
        _make_up(recorded(), SEQUENCE, (SINES[0], SINES[1]), "left", [])


def test_one_of_each_direction_is_not() -> None:
    other = SEQUENCE.axis(Direction.Y).sine
    said = list[str]()
    _make_up(recorded(), SEQUENCE, (SINES[0], other[2]), "left", said)
    assert len(said) == 2


def test_bright_and_dark_image_cannot_both_be_missed() -> None:
    with pytest.raises(ScanError, match="bright and dark image are both lost"):
        _make_up(recorded(), SEQUENCE, (SEQUENCE.bright, SEQUENCE.dark), "left", [])


def test_a_gray_image_cannot_be_missed() -> None:
    with pytest.raises(ScanError, match="which fringe a pixel sees"):
        _make_up(recorded(), SEQUENCE, (SEQUENCE.axis(Direction.X).gray[0],), "left", [])


# ------------------------------------------------------------------------------------------------ a scan on the disk


HEIGHT_PX, WIDTH_PX = 2, 64


def scene(shift: float = 0.0) -> NDArray[np.uint8]:
    """Frames (n, 2, 64) as a camera would see them: a bright and a dark image, stripes of the Gray code, and fringes; in the
    dark 20 grey values, in the light 180."""
    frames = np.full((len(SEQUENCE), HEIGHT_PX, WIDTH_PX), 100, np.uint8)
    frames[SEQUENCE.bright], frames[SEQUENCE.dark] = 180, 20
    x = np.arange(WIDTH_PX)
    for direction in Direction:
        for bit, k in enumerate(SEQUENCE.axis(direction).gray):
            frames[k] = np.where((x >> bit) & 1, 180, 20)
        for step, k in enumerate(SEQUENCE.axis(direction).sine):
            frames[k] = np.round(100.0 + 40.0 * np.cos(2.0 * np.pi * (x / 16.0 - step / 4.0) + shift))
    return frames


RECORD = record(sequence=SequenceInfo.of(SEQUENCE))
NOISE = StereoNoise(CameraNoise(2.0, 0.25, 8.0), CameraNoise(1.5, 0.3, 9.0))


def kept(folder: Path, second: bool = False) -> None:
    """A scan of ``scene`` in ``folder``, with another exposure where wanted."""
    manifest = write_raw(LocalFileSystem(), folder, folder.name, {"left": scene(), "right": scene(0.5)}, RECORD, ORIGIN)
    if second:
        both = replace(RECORD, exposure=Exposure(8_000), second=SecondSequence(Exposure(14_000), 99))
        brighter = {"left": scene(1.0), "right": scene(1.5)}
        add_second(LocalFileSystem(), folder, manifest, brighter, both)


def damage(folder: Path, file: str, *frames: int) -> None:
    path = folder / file
    data = bytearray(path.read_bytes())
    for k in frames:
        start = 128 + k * HEIGHT_PX * WIDTH_PX
        data[start : start + HEIGHT_PX * WIDTH_PX] = bytes(HEIGHT_PX * WIDTH_PX)
    path.write_bytes(bytes(data))


def test_of_a_whole_scan_nothing_is_made_up(tmp_path: Path) -> None:
    kept(tmp_path / "000001", second=True)
    found = salvage(tmp_path / "000001")
    assert (found.notes, dict(found.variance)) == ((), {"left": 1.0, "right": 1.0})
    assert found.scan.second is not None
    assert found.noise(NOISE) == NOISE


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_lost_sine_image_is_made_up_in_its_camera_alone_and_its_noise_counts_three_times(
    tmp_path: Path, side: str
) -> None:
    folder = tmp_path / "000001"
    kept(folder)
    damage(folder, f"frames_{side}.npy", SINES[1])
    found = salvage(folder)
    other = "right" if side == "left" else "left"
    assert dict(found.variance) == {side: 3.0, other: 1.0}
    assert found.notes == (
        f"damaged: frames_{side}.npy: damaged (its checksum does not fit) in {SEQUENCE.patterns[SINES[1]].name}",
        f"{SEQUENCE.patterns[SINES[1]].name} was made up from the other three steps",
    )
    whole = {"left": scene(), "right": scene(0.5)}
    assert (found.scan.frames[other] == whole[other]).all()
    assert np.abs(found.scan.frames[side].astype(int) - whole[side]).max() <= 2
    noise = found.noise(NOISE)
    more, same = (noise.left, noise.right) if side == "left" else (noise.right, noise.left)
    before = NOISE.left if side == "left" else NOISE.right
    assert same == (NOISE.right if side == "left" else NOISE.left)
    for dn in (20.0, 200.0):  # the variance of a grey value, by its definition
        assert variance_of(more, dn) == pytest.approx(3.0 * variance_of(before, dn))
    assert more.black_dn == before.black_dn


def variance_of(noise: CameraNoise, value_dn: float) -> float:
    return noise.read_dn**2 + noise.dn_per_e * (value_dn - noise.black_dn)


@pytest.mark.parametrize(("lost", "level"), [("bright", 180), ("dark", 20)])
def test_a_lost_bright_or_dark_image_is_the_mean_of_where_the_gray_images_are_lit_or_not(
    tmp_path: Path, lost: str, level: int
) -> None:
    folder = tmp_path / "000001"
    kept(folder)
    damage(folder, "frames_left.npy", getattr(SEQUENCE, lost))
    found = salvage(folder)
    assert found.notes[1:] == (f"{lost} was made up from the Gray images",)
    assert dict(found.variance) == {"left": 1.0, "right": 1.0}
    seen = found.scan.frames["left"][getattr(SEQUENCE, lost)]
    known = np.array([SEQUENCE.axis(d).gray for d in Direction]).ravel()
    lit = (scene()[known] == (180 if lost == "bright" else 20)).any(axis=0)
    assert lit.mean() > 0.9
    assert (seen[lit] == level).all()


def test_a_pixel_at_the_border_of_a_stripe_counts_neither_as_lit_nor_as_dark() -> None:
    """What has less than nine tenths of the way is half lit; what has more is noise, and is averaged."""
    gray = [k for direction in Direction for k in SEQUENCE.axis(direction).gray]
    frames = scene()
    frames[gray] = 20
    frames[gray[0]], frames[gray[1]], frames[gray[2]] = 220, 204, 196  # the border is at 200
    _make_up(frames, SEQUENCE, (SEQUENCE.bright,), "left", [])
    assert (frames[SEQUENCE.bright] == 212).all()
    frames[gray] = 220
    frames[gray[0]], frames[gray[1]], frames[gray[2]] = 20, 36, 44  # the border is at 40
    _make_up(frames, SEQUENCE, (SEQUENCE.dark,), "left", [])
    assert (frames[SEQUENCE.dark] == 28).all()


@pytest.mark.parametrize(
    ("after", "opposite", "before", "made"),
    [
        (100, 100, 100, 100),
        (10, 20, 10, 0),
        (10, 21, 10, 255),
        (200, 145, 200, 255),
        (200, 140, 200, 255),
        (200, 146, 200, 254),
        (255, 100, 10, 255),
        (10, 100, 255, 255),
        (150, 255, 150, 255),
        (254, 254, 100, 100),
    ],
)
def test_where_a_step_would_be_out_of_range_or_another_one_is_it_makes_no_point(
    after: int, opposite: int, before: int, made: int
) -> None:
    """A pixel of 255 is saturated, and none of those makes a point."""
    frames = recorded()
    frames[SINES[2]], frames[SINES[3]], frames[SINES[0]] = after, opposite, before
    frames[SINES[1]] = 7
    _make_up(frames, SEQUENCE, (SINES[1],), "left", [])
    assert (frames[SINES[1]] == made).all()


def test_one_sine_and_one_reference_image_may_be_lost_at_once(tmp_path: Path) -> None:
    folder = tmp_path / "000001"
    kept(folder)
    damage(folder, "frames_left.npy", SEQUENCE.dark, SINES[0])
    damage(folder, "frames_right.npy", SINES[3])
    found = salvage(folder)
    assert len(found.notes) == 5
    assert dict(found.variance) == {"left": 3.0, "right": 3.0}


def test_a_damaged_first_exposure_leaves_the_second_one(tmp_path: Path) -> None:
    folder = tmp_path / "000001"
    kept(folder, second=True)
    damage(folder, "frames_left.npy", SEQUENCE.axis(Direction.X).gray[0])
    found = salvage(folder)
    assert found.notes[1:] == ("only the second exposure was used",)
    assert (found.scan.frames["left"] == scene(1.0)).all()
    assert (found.scan.frames["right"] == scene(1.5)).all()
    assert found.scan.second is None
    assert found.scan.manifest.record.exposure == Exposure(14_000)
    assert found.scan.manifest.record.second is None
    assert dict(found.variance) == {"left": 1.0, "right": 1.0}


def test_a_damaged_second_exposure_leaves_the_first_one(tmp_path: Path) -> None:
    folder = tmp_path / "000001"
    kept(folder, second=True)
    damage(folder, "frames_right_second.npy", 0)
    found = salvage(folder)
    assert found.notes[1:] == ("only the first exposure was used",)
    assert (found.scan.frames["left"] == scene()).all()
    assert (found.scan.frames["right"] == scene(0.5)).all()
    assert found.scan.manifest.record.exposure == Exposure(8_000)
    assert found.scan.manifest.record.second is None
    assert dict(found.variance) == {"left": 1.0, "right": 1.0}


def test_of_two_damaged_exposures_the_first_one_is_made_up(tmp_path: Path) -> None:
    folder = tmp_path / "000001"
    kept(folder, second=True)
    damage(folder, "frames_left.npy", SINES[2])
    damage(folder, "frames_left_second.npy", 3)
    found = salvage(folder)
    assert "only the first exposure was used" in found.notes
    assert np.abs(found.scan.frames["left"].astype(int) - scene()).max() <= 2


def test_what_cannot_be_done_without_is_named_with_its_folder(tmp_path: Path) -> None:
    folder = tmp_path / "000001"
    kept(folder)
    gray = SEQUENCE.axis(Direction.Y).gray[1]
    damage(folder, "frames_right.npy", gray)
    with pytest.raises(
        ScanError, match=rf"000001: frames_right\.npy: .*{SEQUENCE.patterns[gray].name} cannot be missed"
    ):
        salvage(folder)
