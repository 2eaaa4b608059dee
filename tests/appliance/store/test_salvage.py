"""What stands in the place of a lost frame is what the camera would have seen, and what cannot be told is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.light.exposure import Exposure
from appliance.measure.light.noise import CameraNoise, StereoNoise
from appliance.measure.light.patterns import Direction, build_sequence
from appliance.store.atomic import LocalFileSystem
from appliance.store.damage import SalvagedScan, _make_up
from appliance.store.manifest import SecondSequence, SequenceInfo
from appliance.store.scan import ScanError, StoredScan, add_second, write_raw
from tests.appliance.store.scenes import ORIGIN, record

SEQUENCE = build_sequence(16)
SINES, OTHER_SINES = (SEQUENCE.axis(direction).sine for direction in Direction)
GRAYS = [k for direction in Direction for k in SEQUENCE.axis(direction).gray]
HEIGHT_PX, WIDTH_PX = 2, 64
RECORD = record(sequence=SequenceInfo.of(SEQUENCE))
NOISE = StereoNoise(CameraNoise(2.0, 0.25, 8.0), CameraNoise(1.5, 0.3, 9.0))


def scene(shift: float = 0.0) -> NDArray[np.uint8]:
    """Frames (n, 2, 64) as a camera would see them: a bright and a dark image, stripes of the Gray code, and fringes of 40 DN about
    100 DN in four steps of 90°; in the dark 20 grey values, in the light 180."""
    frames = np.full((len(SEQUENCE), HEIGHT_PX, WIDTH_PX), 100, np.uint8)
    frames[SEQUENCE.bright], frames[SEQUENCE.dark] = 180, 20
    x = np.arange(WIDTH_PX)
    for direction in Direction:
        for bit, k in enumerate(SEQUENCE.axis(direction).gray):
            frames[k] = np.where((x >> bit) & 1, 180, 20)
        for step, k in enumerate(SEQUENCE.axis(direction).sine):
            frames[k] = np.round(100.0 + 40.0 * np.cos(2.0 * np.pi * (x / 16.0 - step / 4.0) + shift))
    return frames


@pytest.mark.parametrize("step", range(4))
def test_a_lost_sine_image_is_what_the_other_three_say(step: int) -> None:
    frames, said = scene(), list[str]()
    before = frames[SINES[step]].astype(int)
    frames[SINES[step]] = 0
    assert _make_up(frames, SEQUENCE, (SINES[step],), "left", said) == 3.0
    assert np.abs(frames[SINES[step]] - before).max() <= 2
    assert len(said) == 1


@pytest.mark.parametrize(
    ("lost", "said"),
    [
        ((SINES[0], OTHER_SINES[2]), None),
        ((SINES[0], SINES[1]), "two of the four"),
        ((SEQUENCE.bright, SEQUENCE.dark), "bright and dark"),
        ((GRAYS[0],), "fringe"),
    ],
)
def test_one_of_each_direction_may_be_lost_and_no_more(lost: tuple[int, ...], said: str | None) -> None:
    if said is None:
        _make_up(scene(), SEQUENCE, lost, "left", [])
        return
    with pytest.raises(ScanError, match=said):
        _make_up(scene(), SEQUENCE, lost, "left", [])


@pytest.mark.parametrize(
    ("after", "opposite", "before", "made"),
    [
        (100, 100, 100, 100), (10, 20, 10, 0), (10, 21, 10, 255), (200, 145, 200, 255), (200, 146, 200, 254), (255, 100, 10, 255),
        (10, 100, 255, 255), (150, 255, 150, 255), (254, 254, 100, 100),
    ],
)  # fmt: skip
def test_where_a_step_would_be_out_of_range_or_another_one_is_it_makes_no_point(
    after: int, opposite: int, before: int, made: int
) -> None:
    """A pixel of 255 is saturated, and none of those makes a point."""
    frames = scene()
    frames[SINES[2]], frames[SINES[3]], frames[SINES[0]], frames[SINES[1]] = after, opposite, before, 7
    _make_up(frames, SEQUENCE, (SINES[1],), "left", [])
    assert (frames[SINES[1]] == made).all()


def test_a_pixel_at_the_border_of_a_stripe_counts_neither_as_lit_nor_as_dark() -> None:
    """What has less than nine tenths of the way is half lit; what has more is noise, and is averaged."""
    frames = scene()
    for lost, others, seen, made in (
        (SEQUENCE.bright, 20, (220, 204, 196), 212),  # the border is at 200
        (SEQUENCE.dark, 220, (20, 36, 44), 28),  # at 40
    ):
        frames[GRAYS] = others
        frames[GRAYS[0]], frames[GRAYS[1]], frames[GRAYS[2]] = seen
        _make_up(frames, SEQUENCE, (lost,), "left", [])
        assert (frames[lost] == made).all()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A scan of ``scene``."""
    there = tmp_path / "000001"
    write_raw(LocalFileSystem(), there, "000001", {"left": scene(), "right": scene(0.5)}, RECORD, ORIGIN)
    return there


@pytest.fixture
def both(folder: Path) -> Path:
    """The same with another exposure."""
    told = replace(RECORD, exposure=Exposure(8_000), second=SecondSequence(Exposure(14_000), 99))
    frames = {"left": scene(1.0), "right": scene(1.5)}
    add_second(LocalFileSystem(), folder, StoredScan.manifest_of(folder), frames, told)
    return folder


def damage(folder: Path, file: str, *frames: int) -> None:
    data = bytearray((folder / file).read_bytes())
    for k in frames:
        start = 128 + k * HEIGHT_PX * WIDTH_PX
        data[start : start + HEIGHT_PX * WIDTH_PX] = bytes(HEIGHT_PX * WIDTH_PX)
    (folder / file).write_bytes(bytes(data))


def variance_of(noise: CameraNoise, value_dn: float) -> float:
    return noise.read_dn**2 + noise.dn_per_e * (value_dn - noise.black_dn)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_lost_sine_image_is_made_up_in_its_camera_alone_and_its_noise_counts_three_times(
    folder: Path, side: str
) -> None:
    damage(folder, f"frames_{side}.npy", SINES[1])
    found, other = SalvagedScan.of(folder), "right" if side == "left" else "left"
    assert dict(found.variance) == {side: 3.0, other: 1.0}
    assert len(found.notes) == 2
    assert all(SEQUENCE.patterns[SINES[1]].name in note for note in found.notes)
    whole = {"left": scene(), "right": scene(0.5)}
    assert (found.scan.frames[other] == whole[other]).all()
    assert np.abs(found.scan.frames[side].astype(int) - whole[side]).max() <= 2
    more, before = (getattr(noise, side) for noise in (found.noise(NOISE), NOISE))
    assert getattr(found.noise(NOISE), other) == getattr(NOISE, other)
    for dn in (20.0, 200.0):  # the variance of a grey value, by its definition
        assert variance_of(more, dn) == pytest.approx(3.0 * variance_of(before, dn))
    assert more.black_dn == before.black_dn


@pytest.mark.parametrize(("lost", "level"), [("bright", 180), ("dark", 20)])
def test_a_lost_bright_or_dark_image_is_the_mean_of_where_the_gray_images_are_lit_or_not(
    folder: Path, lost: str, level: int
) -> None:
    k = getattr(SEQUENCE, lost)
    damage(folder, "frames_left.npy", k)
    found = SalvagedScan.of(folder)
    assert lost in found.notes[1]
    assert dict(found.variance) == {"left": 1.0, "right": 1.0}
    lit = (scene()[GRAYS] == level).any(axis=0)
    assert lit.mean() > 0.9
    assert (found.scan.frames["left"][k][lit] == level).all()
    damage(folder, "frames_left.npy", SINES[0])
    damage(folder, "frames_right.npy", SINES[3])
    found = SalvagedScan.of(folder)
    assert (len(found.notes), dict(found.variance)) == (5, {"left": 3.0, "right": 3.0}), "all at once"
    damage(folder, "frames_right.npy", GRAYS[-1])
    with pytest.raises(ScanError, match=rf"000001: frames_right\.npy: .*{SEQUENCE.patterns[GRAYS[-1]].name}"):
        SalvagedScan.of(folder)


@pytest.mark.parametrize(
    ("damages", "used", "time_us"),
    [
        ({}, None, 8_000),
        ({"frames_left.npy": GRAYS[0]}, "second", 14_000),
        ({"frames_right_second.npy": 0}, "first", 8_000),
        ({"frames_left.npy": SINES[2], "frames_left_second.npy": 3}, "first", 8_000),
    ],
)
def test_of_two_exposures_the_one_that_is_damaged_less_is_used(
    both: Path, damages: dict[str, int], used: str | None, time_us: int
) -> None:
    for file, k in damages.items():
        damage(both, file, k)
    found = SalvagedScan.of(both)
    assert used is None or any(f"only the {used} exposure" in note for note in found.notes)
    shift = 1.0 if used == "second" else 0.0
    assert np.abs(found.scan.frames["left"].astype(int) - scene(shift)).max() <= 2
    assert (found.scan.frames["right"] == scene(shift + 0.5)).all()
    assert found.scan.manifest.record.exposure == Exposure(time_us)
    assert (found.scan.second is None) == (found.scan.manifest.record.second is None) == (used is not None)
    made_up = "frames_left.npy" in damages and used == "first"
    assert dict(found.variance) == {"left": 3.0 if made_up else 1.0, "right": 1.0}
    if not damages:
        assert (found.notes, found.noise(NOISE)) == ((), NOISE)
