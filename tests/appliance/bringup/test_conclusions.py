"""What is said of a measured projector: one case for each sentence, and the keys that go into the rig file."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from appliance.bringup.conclusions import conclusions, keys_of
from appliance.bringup.exposures import Offer, Trial
from appliance.bringup.light import LightTiming, LightWindow
from appliance.bringup.orientation import Orientation, SeenPicture
from appliance.bringup.projector import ProjectorMeasured
from appliance.bringup.raster import MOST_BEATING, MOST_NOISE, LineLight
from appliance.bringup.response_check import ResponseShape, Shape

STRAIGHT = ResponseShape(Shape.STRAIGHT, 0.004, 0.01, 0.001, 0.0, 1.0, 100.0)
LEFT, RIGHT = SeenPicture(Orientation.UPRIGHT, 1.1, 0.9), SeenPicture(Orientation.UPRIGHT, 0.9, 0.7)
ALIKE, UNLIKE = LineLight(0.01, 0.001), LineLight(1.1 * MOST_BEATING, 0.001)
WINDOWS = (LightWindow(300.0, 4_300.0), LightWindow(8_300.0, 16_300.0))
TIMING = LightTiming(1, 300.0, 16_300.0, WINDOWS)
GOOD = ProjectorMeasured(
    timing=TIMING,
    channels="green",
    sub_frames=1,
    skew_us=-20.0,
    profiles={},
    responses={Trial(500, 4_000): STRAIGHT, Trial(500, 9_000): STRAIGHT},
    ramps={},
    offer=Offer(500, (4_000, 9_000)),
    lines={"columns": ALIKE, "rows": ALIKE},
    seen={"left": LEFT, "right": RIGHT},
    pictures={},
)


def of_shape(shape: Shape, line_rms: float = 0.2, power: float = 1.0) -> ResponseShape:
    return replace(STRAIGHT, shape=shape, line_rms=line_rms, power=power)


def none_good(*shapes: ResponseShape) -> dict[str, Any]:
    return {"offer": None, "responses": {Trial(500, 4_000 + k): one for k, one in enumerate(shapes)}}


def both(orientation: Orientation) -> dict[str, Any]:
    return {"seen": {"left": replace(LEFT, orientation=orientation), "right": replace(RIGHT, orientation=orientation)}}


def right(**changes: Any) -> dict[str, Any]:
    return {"seen": {"left": LEFT, "right": replace(RIGHT, **changes)}}


DARK, RESTLESS = of_shape(Shape.DARK), of_shape(Shape.RESTLESS)
STEPS, GAMMA = of_shape(Shape.BIT_PLANES), of_shape(Shape.GAMMA, 0.1, 2.2)
BENT = {Trial(500, 4_000): STRAIGHT, Trial(500, 9_000): of_shape(Shape.CURVED, 0.03)}
UPRIGHT = "both cameras see the picture upright"
GOOD_ONES: list[tuple[str, dict[str, Any], str, dict[str, float | None]]] = [
    ("latency", {}, "comes 1 vertical blank after its flip", {"latency_blanks": 1.0}),
    ("latency", {"timing": replace(TIMING, latency_blanks=2)}, "2 vertical blanks after", {"latency_blanks": 2.0}),
    ("light", {}, "lights 0.30 to 4.30 ms, 8.30 to 16.30 ms after the blank, 72 % of", {"windows": 2.0, "lit_percent": 72.0}),
    ("light", {}, "; no equal sub-frames, drawn into green channels", {}),
    ("light", {"sub_frames": 3, "channels": "all"}, "; 3 equal sub-frames, drawn into all channels", {}),
    ("skew", {}, "begin their exposures 20 µs apart", {"skew_us": -20.0}),
    ("grey", {}, "exposures of 4, 9 ms from 500 µs after the blank see grey", {"line_percent": 0.4, "exposures": 2.0}),
    ("grey", {"responses": BENT}, "; it is curved by 3.0 %, which scans straighten", {"line_percent": 3.0}),
    ("orientation", {}, UPRIGHT, {}),
    ("sides", {}, "left and right are as in the rig file", {"left_ratio": 1.1, "right_ratio": 0.9}),
    ("sides", right(scale_ratio=None), "which camera is left cannot be told", {"left_ratio": 1.1, "right_ratio": None}),
    ("raster", {}, "equally bright", {"columns_beating_percent": 1.0, "camera_px_per_projector_px": 0.7}),
    ("raster", right(px_per_px=0.69), "cannot be told by cameras this coarse", {"camera_px_per_projector_px": 0.69}),
    ("raster", right(px_per_px=None), "cannot be told by cameras this coarse", {"camera_px_per_projector_px": 0.9}),
    ("raster", {"lines": {"columns": ALIKE, "rows": LineLight(9.0, 1.1 * MOST_NOISE)}}, "or in so little light", {}),
]  # fmt: skip
WRONG_ONES: list[tuple[str, dict[str, Any], str, str]] = [
    ("skew", {"skew_us": -20.5}, "the right one later", "LineDebouncer"),
    ("skew", {"skew_us": 20.5}, "the left one later", "LineDebouncer"),
    ("grey", none_good(), "no exposure of 0 sees grey", "pattern mode"),
    ("grey", none_good(STEPS, GAMMA, STEPS), "of 3 sees grey as it was drawn (2 bit planes, 1 gamma)", "switch gamma off"),
    ("grey", none_good(STEPS, GAMMA), "the best is 10.0 % off a straight line, like a power of 2.2", "switch gamma off"),
    ("grey", none_good(STEPS), "(1 bit planes)", "pattern mode"),
    ("grey", none_good(DARK, DARK), "(2 dark)", "something white"),
    ("grey", none_good(DARK, STEPS), "(1 dark, 1 bit planes)", "pattern mode"),
    ("grey", none_good(RESTLESS, RESTLESS), "(2 restless)", "dynamic contrast"),
    ("grey", none_good(RESTLESS, STEPS), "(1 restless, 1 bit planes)", "pattern mode"),
    ("orientation", right(orientation=Orientation.MIRRORED), "camera.right alone sees", "mount camera.right"),
    ("orientation", both(Orientation.MIRRORED), "both cameras see the picture mirrored", "rear projection"),
    ("orientation", both(Orientation.UPSIDE_DOWN), "both cameras see", "vertical flip"),
    ("orientation", both(Orientation.TURNED), "both cameras see", "ceiling projection"),
    ("orientation", both(Orientation.ON_ITS_SIDE), "both cameras see", "by 90°"),
    ("orientation", both(Orientation.UNSEEN), "both cameras see", "point the projector"),
    ("sides", {"seen": {"left": RIGHT, "right": LEFT}}, "left and right camera are exchanged", "exchange the serials"),
    ("raster", {"lines": {"columns": UNLIKE, "rows": ALIKE}}, "single columns are not", "keystone"),
    ("raster", {"lines": {"columns": UNLIKE, "rows": UNLIKE}}, "single columns and rows are not", "keystone"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "changes", "said", "numbers"), GOOD_ONES)
def test_what_is_good_or_cannot_be_told_is_said_with_its_numbers(
    name: str, changes: dict[str, Any], said: str, numbers: dict[str, float | None]
) -> None:
    found = {one.name: one for one in conclusions(replace(GOOD, **changes), 60.0)}[name]
    assert found.ok
    assert found.remedy == ""
    assert said in found.said
    assert {key: found.numbers[key] for key in numbers} == pytest.approx(numbers)


@pytest.mark.parametrize(("name", "changes", "said", "remedy"), WRONG_ONES)
def test_what_is_wrong_is_said_with_its_remedy(name: str, changes: dict[str, Any], said: str, remedy: str) -> None:
    found = {one.name: one for one in conclusions(replace(GOOD, **changes), 60.0)}[name]
    assert not found.ok
    assert said in found.said
    assert remedy in found.remedy


def test_the_best_of_no_good_exposures_is_told_in_numbers() -> None:
    found = {one.name: one for one in conclusions(replace(GOOD, **none_good(STEPS, GAMMA)), 60.0)}["grey"]
    assert found.numbers == {"line_percent": pytest.approx(10.0), "power": 2.2}


@pytest.mark.parametrize(
    ("changes", "exposure_ms", "light_begins_us", "nearest_ms"),
    [
        ({}, 12.0, 0, 9.0),
        ({}, 6.4, 0, 4.0),
        ({"sub_frames": 3}, 6.6, 500, 9.0),
        ({"timing": replace(TIMING, ends_us=16_800.0)}, 1.0, 500, 4.0),
    ],
)
def test_the_keys_are_those_of_the_offer_and_exposures_begin_with_late_light(
    changes: dict[str, Any], exposure_ms: float, light_begins_us: int, nearest_ms: float
) -> None:
    measured = replace(GOOD, **changes)
    assert {".".join(key): value for key, value in keys_of(measured, 60.0, exposure_ms).items()} == {
        "projector.latency_blanks": 1,
        "projector.light_begins_us": light_begins_us,
        "projector.channels": "green",
        "projector.sub_frames": measured.sub_frames,
        "board.trigger_delay_us": 500,
        "scan.exposures_ms": (4.0, 9.0),
        "camera.left.exposure_ms": nearest_ms,
        "camera.right.exposure_ms": nearest_ms,
    }


def test_nothing_is_written_of_a_projector_without_a_good_exposure() -> None:
    with pytest.raises(ValueError, match="no exposure is good"):
        keys_of(replace(GOOD, offer=None), 60.0, 12.0)
