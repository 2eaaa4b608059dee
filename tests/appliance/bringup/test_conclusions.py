"""What is said of a measured projector: one case for each sentence, and the keys that go into the rig file."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from appliance.bringup.conclusions import conclusions, keys_of
from appliance.bringup.exposures import Offer, Trial
from appliance.bringup.finding import Finding
from appliance.bringup.light import LightTiming, LightWindow
from appliance.bringup.orientation import Orientation, SeenPicture
from appliance.bringup.projector import ProjectorMeasured
from appliance.bringup.raster import MOST_BEATING, MOST_NOISE, LineLight
from appliance.bringup.response_check import ResponseShape, Shape
from tests.support.golden_texts import Says

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
GOOD_ONES: list[tuple[str, dict[str, Any], dict[str, float | None]]] = [
    ("latency", {}, {"latency_blanks": 1.0}),
    ("latency", {"timing": replace(TIMING, latency_blanks=2)}, {"latency_blanks": 2.0}),
    ("light", {}, {"windows": 2.0, "lit_percent": 72.0}),
    ("light", {"sub_frames": 3, "channels": "all"}, {}),
    ("skew", {}, {"skew_us": -20.0}),
    ("grey", {}, {"line_percent": 0.4, "exposures": 2.0}),
    ("grey", {"responses": BENT}, {"line_percent": 3.0}),
    ("orientation", {}, {}),
    ("sides", {}, {"left_ratio": 1.1, "right_ratio": 0.9}),
    ("sides", right(scale_ratio=None), {"left_ratio": 1.1, "right_ratio": None}),
    ("raster", {}, {"columns_beating_percent": 1.0, "camera_px_per_projector_px": 0.7}),
    ("raster", right(px_per_px=0.69), {"camera_px_per_projector_px": 0.69}),
    ("raster", right(px_per_px=None), {"camera_px_per_projector_px": 0.9}),
    ("raster", {"lines": {"columns": ALIKE, "rows": LineLight(9.0, 1.1 * MOST_NOISE)}}, {}),
]
WRONG_ONES: list[tuple[str, dict[str, Any]]] = [
    ("skew", {"skew_us": -20.5}),
    ("skew", {"skew_us": 20.5}),
    ("grey", none_good()),
    ("grey", none_good(STEPS, GAMMA, STEPS)),
    ("grey", none_good(STEPS, GAMMA)),
    ("grey", none_good(STEPS)),
    ("grey", none_good(DARK, DARK)),
    ("grey", none_good(DARK, STEPS)),
    ("grey", none_good(RESTLESS, RESTLESS)),
    ("grey", none_good(RESTLESS, STEPS)),
    ("orientation", right(orientation=Orientation.MIRRORED)),
    *(("orientation", both(one)) for one in Orientation if one is not Orientation.UPRIGHT),
    ("sides", {"seen": {"left": RIGHT, "right": LEFT}}),
    ("raster", {"lines": {"columns": UNLIKE, "rows": ALIKE}}),
    ("raster", {"lines": {"columns": UNLIKE, "rows": UNLIKE}}),
]


def concluded(name: str, changes: dict[str, Any]) -> Finding:
    return {one.name: one for one in conclusions(replace(GOOD, **changes), 60.0)}[name]


def test_what_is_good_or_cannot_be_told_is_said_with_its_numbers(says: Says) -> None:
    for name, changes, numbers in GOOD_ONES:
        found = concluded(name, changes)
        assert (found.ok, found.remedy) == (True, "")
        assert {key: found.numbers[key] for key in numbers} == pytest.approx(numbers)
    says("\n".join(concluded(name, changes).said for name, changes, _ in GOOD_ONES))


def test_what_is_wrong_is_said_with_its_remedy(says: Says) -> None:
    found = [concluded(name, changes) for name, changes in WRONG_ONES]
    assert not any(one.ok for one in found)
    says("\n".join(f"{one.name}: {one.said}\n  {one.remedy}" for one in found))
    best = concluded("grey", none_good(STEPS, GAMMA))
    assert best.numbers == {"line_percent": pytest.approx(10.0), "power": 2.2}


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
