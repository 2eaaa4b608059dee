"""What is made of a plane's images, and what is written of a projector, from pictures that are drawn by arithmetic."""

from __future__ import annotations

import datetime
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import appliance
from appliance.bringup.response_check import Shape
from appliance.capture.scan import CaptureReport
from appliance.config import load_rig, parse_rig, rig_text
from appliance.instrument import design_of
from appliance.patterns.sequence import Direction, build_sequence
from appliance.scan.exposure import Exposure
from appliance.service.bringup import plane, projector
from appliance.storage import scan as stored
from appliance.storage.library import Library
from tests.appliance.service.bringup.scripted import RIG_FILE, ValueBench, workplace
from tests.appliance.service.bringup.test_triggers_and_cameras import frame, ledger
from tests.support.projector_model import Model, ModelBench, planes_in

SEQUENCE = build_sequence(64, 512, 384)
HEIGHT, WIDTH = 72, 96
BRIGHT, DARK = SEQUENCE.bright, SEQUENCE.dark


def plane_seen(power: float = 1.0) -> NDArray[np.uint8]:
    """One camera's images of a plane, by light that is a power of the code."""
    p = np.broadcast_to(np.linspace(20.0, 490.0, WIDTH), (HEIGHT, WIDTH))
    q = np.broadcast_to(np.linspace(10.0, 370.0, HEIGHT)[:, None], (HEIGHT, WIDTH))
    rng = np.random.default_rng(8)
    frames = np.zeros((len(SEQUENCE), HEIGHT, WIDTH), np.uint8)
    for number, pattern in enumerate(SEQUENCE.patterns):
        at = p if pattern.direction is Direction.X else q
        codes = pattern.codes()
        light = (
            np.interp(at, np.arange(len(codes)), codes) / 255.0 if number not in (BRIGHT, DARK) else codes[0] / 255.0
        )
        frames[number] = np.clip(np.rint(10.0 + 200.0 * light**power + 0.4 * rng.standard_normal(at.shape)), 0, 255)
    return frames


def flat(bright: int, dark: int) -> NDArray[np.uint8]:
    frames = np.zeros((len(SEQUENCE), 10, 10), np.uint8)
    frames[BRIGHT], frames[DARK] = bright, dark
    return frames


@pytest.mark.parametrize(("bright", "dark", "lit"), [(30, 10, True), (29, 10, False), (10, 250, False), (255, 0, True)])
def test_a_pixel_is_lit_from_twenty_grey_values_over_its_dark_image(bright: int, dark: int, lit: bool) -> None:
    assert plane._lit(flat(bright, dark), SEQUENCE).all() == lit


def test_saturation_is_a_share_of_what_is_lit() -> None:
    frames = flat(200, 10)
    assert plane._saturated(frames, SEQUENCE) == 0.0
    frames[BRIGHT, :, :5] = 254
    assert plane._saturated(frames, SEQUENCE) == 0.5
    frames[BRIGHT, :, 5:] = frames[DARK, :, 5:]
    assert plane._saturated(frames, SEQUENCE) == 1.0, "what the projector does not reach does not count"
    frames[DARK, 0, :5] = 250
    assert plane._saturated(frames, SEQUENCE) == 1.0
    assert plane._saturated(flat(255, 255), SEQUENCE) == 0.0, "where nothing is lit nothing is saturated"


@pytest.mark.parametrize(
    ("saturates_from_us", "tried"),
    [
        (9_000, [8_000]),
        (8_000, [8_000, 4_000]),
        (1_500, [8_000, 4_000, 2_000, 1_000]),
        (0, [8_000, 4_000, 2_000, 1_000]),
    ],
)
def test_the_plane_is_recorded_darker_until_neither_camera_saturates(saturates_from_us: int, tried: list[int]) -> None:
    made: list[int] = []

    def record(exposure: Exposure) -> tuple[Any, plane.Frames]:
        made.append(exposure.time_us)
        right = flat(255 if exposure.time_us >= saturates_from_us else 200, 10)
        return len(made), {"left": flat(200, 10), "right": right}

    allowed = tuple(Exposure(1000 * k) for k in (1, 2, 4, 8, 16))
    report: Any
    report, frames, exposure = plane._exposed(record, SEQUENCE, allowed, Exposure(8_000))
    assert made == tried
    assert (made.index(exposure.time_us), report) == (len(tried) - 1, len(tried)), "the last one is that of the scan"
    assert (frames["right"][BRIGHT, 0, 0] == 255) == (saturates_from_us <= tried[-1])


def test_a_plane_is_decoded_into_both_coordinates() -> None:
    frames = plane_seen()
    frames[:, :, : WIDTH // 4] = 10
    found = plane._decoded(SEQUENCE, frames)
    assert found.filled == pytest.approx(0.75, abs=0.03)
    assert found.saturated == 0.0
    rows, columns = found.planes[Direction.X].rows, found.planes[Direction.X].columns
    np.testing.assert_allclose(found.planes[Direction.X].smooth_px, 20.0 + 470.0 * columns / (WIDTH - 1), atol=0.5)
    rows = found.planes[Direction.Y].rows
    np.testing.assert_allclose(found.planes[Direction.Y].smooth_px, 10.0 + 360.0 * rows / (HEIGHT - 1), atol=0.5)
    ripples = plane._ripples({"left": found, "right": replace(found, planes={})}, SEQUENCE.period_px)
    assert list(ripples) == ["left x", "left y"]
    assert max(ripples["left x"].amplitude_px) < 0.2
    assert plane._decoded(SEQUENCE, np.full_like(frames, 10)).planes == {}


def test_the_response_is_that_of_the_camera_that_sees_more_codes() -> None:
    frames = {"left": plane_seen(2.2), "right": plane_seen()}
    frames["left"][:, :, : WIDTH // 4] = 10
    frames["right"][:, :, WIDTH // 8 :] = 10
    sides = {side: plane._decoded(SEQUENCE, one) for side, one in frames.items()}
    shape, picture = plane._response(SEQUENCE, frames, sides)
    assert shape is not None
    assert shape.shape is Shape.GAMMA
    assert shape.power == pytest.approx(2.1, abs=0.1)
    assert picture is not None
    assert picture.startswith(b"\x89PNG")
    frames = {"left": frames["right"], "right": plane_seen()}
    sides = {side: plane._decoded(SEQUENCE, one) for side, one in frames.items()}
    shape, picture = plane._response(SEQUENCE, frames, sides)
    assert shape is not None
    assert shape.shape is Shape.STRAIGHT
    assert shape.power == pytest.approx(1.0, abs=0.05)
    # One without a plane is not asked, and two of those say nothing.
    assert plane._response(SEQUENCE, frames, {**sides, "left": replace(sides["left"], planes={})}) == (shape, picture)
    assert plane._response(SEQUENCE, frames, {}) == (None, None)


def test_too_few_codes_have_no_response() -> None:
    frames = plane_seen()
    side = plane._decoded(SEQUENCE, frames)
    few = {
        direction: replace(
            one, **{key: getattr(one, key)[:40] for key in ("rows", "columns", "smooth_px", "residual_px")}
        )
        for direction, one in side.planes.items()
    }
    assert plane._response(SEQUENCE, {"left": frames}, {"left": replace(side, planes=few)}) == (None, None)


def test_a_first_scan_is_stored_with_everything_that_is_known_of_it(tmp_path: Path) -> None:
    rig = load_rig(RIG_FILE)
    rig = replace(rig, storage=replace(rig.storage, root=tmp_path))
    at, _, told = workplace(rig=rig)
    today = SimpleNamespace(utc=datetime.datetime(2031, 5, 6, 7, 8, 9, 500, tzinfo=datetime.UTC), kept=True)
    wires: Any = SimpleNamespace(clock=at.wires.clock, calendar=SimpleNamespace(today=lambda: today))
    at = replace(at, wires=wires)
    report = CaptureReport(None, ledger([frame(k) for k in range(64)]), 1.0, ())
    frames = {side: plane_seen() for side in ("left", "right")}
    scan_id = plane._stored(at, report, frames, SEQUENCE, Exposure(4_000, 2.0), "ab" * 32)
    folder = Library(tmp_path).entry(scan_id).folder
    scan = stored.load(folder)
    np.testing.assert_array_equal(scan.frames["left"], frames["left"])
    record = scan.manifest.record
    assert (record.wall_time, record.clock_trusted) == ("2031-05-06T07:08:09+00:00", True)
    assert (record.exposure, record.response_hash) == (Exposure(4_000, 2.0), "ab" * 32)
    assert (record.rig_hash, record.software_version) == (rig.rig_hash, appliance.__version__)
    assert record.calibration_hash == design_of(rig).hash
    assert record.recorded_ns == wires.clock.now_ns()
    assert record.water == {"temperature_c": 20.0, "salinity_psu": 0.0, "wavelength_nm": 530.0}
    assert record.ledger is not None
    assert record.ledger["expected"] == 64
    assert (folder / "rig.toml").read_text(encoding="utf-8") == rig_text(rig)
    flatness, why_not, faults = plane._worked_through(at, scan_id)
    assert (flatness, faults) == (None, ())
    assert "there is no calibration yet" in why_not
    assert told.all == []


# --------------------------------------------------------------------------------------- projector


def test_where_the_instrument_stands_is_said_in_millimetres() -> None:
    assert "540 mm away and upright" in projector.wall(workplace()[0])


@pytest.mark.parametrize(("left_dn", "right_dn", "asked"), [(5, 5, 1), (5, 4, 3), (4, 5, 3), (0, 0, 3)])
def test_a_wall_is_asked_for_until_both_cameras_see_light_on_it(left_dn: int, right_dn: int, asked: int) -> None:
    lights = {"left": left_dn, "right": right_dn}

    def seen(side: str, _shot: Any, _take: int) -> Any:
        frames = np.full((24, 8, 8), 10)
        # It comes late by more blanks than any projector.
        frames[20:] += lights[side]
        return frames

    at, person, told = workplace()
    bench: Any = ValueBench(seen)
    projector._before_white(at, bench)
    assert len(person.said) == len(told.all) == asked
    assert person.said[0] == f"{projector.wall(at)}, and darken the room"
    assert ["asked again" in one for one in person.said] == [False, True, True][:asked]
    assert bench.taken[0][0] == [0] * 12 + [1] * 12
    shot = bench.taken[0][1]
    assert (shot.delay_us, shot.exposure_us, shot.gain_db) == (500, 12_000, 0.0)
    (black, white), all_channels = bench.loaded[0]
    assert black.shape == white.shape == (48, 64)
    assert (black.max(), white.min(), all_channels) == (0, 255, False)


@pytest.mark.parametrize("mirrored", [False, True])
def test_keys_are_written_all_or_none(mirrored: bool, tmp_path: Path) -> None:
    rig_file = tmp_path / "rig.toml"
    rig_file.write_text(RIG_FILE.read_text(encoding="utf-8"), encoding="utf-8")
    at, _, _ = workplace(rig_file=rig_file)
    model = Model(planes_in(0.0, 16_000.0), latency=1, mirrored=mirrored)
    outcomes = projector._measured(at, ModelBench(model, size_px=(32, 24), camera_px=(24, 18)))
    text = rig_file.read_text(encoding="utf-8")
    assert list(outcomes) == ["raster", "sides", "latency", "light", "skew"]
    if mirrored:
        assert not all(one.good for one in outcomes.values())
        assert text == RIG_FILE.read_text(encoding="utf-8")
        assert not list(tmp_path.glob("rig.toml.before*"))
    else:
        assert all(one.good for one in outcomes.values()), outcomes
        assert parse_rig(text).projector.latency_blanks == 1
        assert any(one.written for one in outcomes.values())
        assert (tmp_path / "rig.toml.before-1").read_text(encoding="utf-8") == RIG_FILE.read_text(encoding="utf-8")
        projector._measured(at, ModelBench(model, size_px=(32, 24), camera_px=(24, 18)))
        assert len(list(tmp_path.glob("rig.toml.before*"))) == 1, "what is right already is not written again"
