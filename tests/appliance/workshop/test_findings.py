"""What boards, pads, syncs, cameras, triggers, planes and projectors are told to be, from values alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.accept.flatness import Flatness
from appliance.measure.light.exposure import Exposure
from appliance.workshop.board import judge_beats, judge_clock, judge_laser, judge_sensor
from appliance.workshop.cameras import judge_dark, judge_link, judge_settings, see_dark
from appliance.workshop.endurance import CameraEndurance, EnduranceRun, judge_endurance
from appliance.workshop.finding import Finding
from appliance.workshop.light import Lamp, LightTiming, LightWindow, Offer, Trial, keys_of
from appliance.workshop.pad import KeyTrial, judge_key, judge_pad
from appliance.workshop.plane import LIMITS_PER_PERIOD, CoordinateRipple, PlaneFigures, judge_plane
from appliance.workshop.projector import ProjectorMeasurement
from appliance.workshop.raster import MOST_BEATING, MOST_NOISE, LineLight, Orientation, PictureView
from appliance.workshop.response import ResponseShape, Shape
from appliance.workshop.trigger import PULSES, TriggeredFrames, judge_stamps, judge_triggers
from appliance.workshop.vsync import judge_count, judge_edge, judge_stamps_of_syncs, judge_stop
from drivers.api import BoardTime, HeldSetting, LaserState
from tests.appliance.workshop.scripted import named, projector_findings
from tests.support.golden_texts import Says

OFF, LEFT, BOTH = (LaserState(*on) for on in ((False, False), (True, False), (True, True)))
PERIOD_NS = 16_666_667.0


def clock(ppm: float, bracket_us: float = 100.0) -> list[BoardTime]:
    """Readings each half second for 20 s; the board reads at the beginning of the bracket first, at its end last."""
    found = []
    for k in range(41):
        sent_ns, inside_ns = round(k * 0.5e9), 0.0 if k < 20 else 1000.0 * bracket_us
        board_us = round((sent_ns + inside_ns) * (1 + ppm * 1e-6) / 1000.0)
        found.append(BoardTime(board_us, sent_ns, round(sent_ns + 1000 * bracket_us)))
    return found


def syncs(hz: float = 60.0, late_us: float = 0.0) -> tuple[tuple[int, int], ...]:
    return tuple((7 + k, round(k * 1e6 / hz + (late_us if k == 40 else 0.0))) for k in range(100))


def stamps(late_ns: int = 0, ppm: float = 0.0) -> Finding:
    """One camera's times of 64 pulses, of which the 31st may be late."""
    pulses = [1_000_000 + round(k * 16_666.7) for k in range(64)]
    frames: list[int | None] = [round((p - pulses[0]) * 1000 * (1 + ppm * 1e-6)) + 77_000_000 for p in pulses]
    frames[30] = (frames[30] or 0) + late_ns
    return judge_stamps(pulses, {"left": frames})[0]


WHOLE = CameraEndurance(6400, (), 0, 0)


def endured(
    left: CameraEndurance = WHOLE, reported: int = 6400, after_c: float = 40.0, ended: str | None = None
) -> dict[str, Finding]:
    before_c, later_c = {"case": 21.0}, {"case": after_c, "projector": None}
    seen = EnduranceRun(1.8, 1.8, 6400, reported, 0, {"left": left, "right": WHOLE}, before_c, later_c, ended)
    return named(judge_endurance(seen, {"case": 50.0, "projector": 65.0}))


def dark(
    black_dn: float = 2.0, noise_dn: float = 0.5, ambient_dn: float = 0.0, hot: int = 0, leak_dn: float = 0.0,
    frozen: bool = False,
) -> dict[str, Finding]:  # fmt: skip
    """What is said of a camera of 100 x 80 px: ``ambient_dn`` more in the longer exposure, ``leak_dn`` in a corner of it."""
    rng = np.random.default_rng(5)

    def taken(light_dn: float) -> NDArray[np.uint8]:
        frames = black_dn + light_dn * ambient_dn + noise_dn * rng.standard_normal((16, 80, 100))
        frames[:, :20, :25] += light_dn * leak_dn
        frames.reshape(16, -1)[:, 3 : 3 + hot] += 60.0
        if frozen:
            frames[:] = frames[0]
        return np.clip(np.rint(frames), 0, 255).astype(np.uint8)

    short, long = taken(0.0), taken(1.0)
    findings = judge_dark("left", see_dark(long, short), 2.0, 0.5)
    return {one.name.removeprefix("camera.left "): one for one in findings}


HELD = (
    HeldSetting("TriggerMode", "On", "On"),
    HeldSetting("ExposureTime", None, 12_000.0),
    HeldSetting("Gamma", None, None),
)


def fired(count: int, every: float = 1.0, clock: bool = True) -> TriggeredFrames:
    return TriggeredFrames(tuple(round(k * every * PERIOD_NS) + 5 if clock else None for k in range(count)))


def triggered(one: TriggeredFrames) -> Finding:
    found = named(judge_triggers(PULSES, {"left": one, "right": fired(PULSES)}, PERIOD_NS))
    assert found["camera.right"].ok, "each camera is judged by itself"
    return found["camera.left"]


FINE = CoordinateRipple((0.001, 0.001, 0.002), 0.03, 0.0002, 20_000)


def plane(
    amplitudes_px: tuple[float, float, float] = FINE.amplitude_px, shape: Shape = Shape.STRAIGHT, saturated: float = 0.0,
    filled: float = 0.8, flatness: Flatness | None = None, faults: tuple[str, ...] = (),
) -> dict[str, Finding]:  # fmt: skip
    response = ResponseShape(shape, 0.05, 0.08, 0.001, 0.0, 2.2 if shape is Shape.GAMMA else 1.0, 200.0)
    one = CoordinateRipple(amplitudes_px, 0.03, 0.0002, 20_000)
    seen = PlaneFigures(
        "000007", 32, {"left x": FINE, "right x": one}, {"left": filled, "right": 0.9}, Exposure(8000, 0.0),
        {"left": saturated, "right": 0.0}, response, flatness, "no calibration", faults,
    )  # fmt: skip
    return named(judge_plane(seen))


WRONG: dict[str, list[Finding]] = {
    "heartbeats": [
        judge_beats([0, 500_000, 1_500_000], 0, 0),
        judge_beats([0, 500_000, 1_000_000], 1, 0),
        judge_beats([0, 500_000, 1_000_000], 0, 2),
        judge_beats([0], 0, 0),
    ],
    "clock": [judge_clock(clock(400.0)), judge_clock([])],
    "lasers": [
        judge_laser("left", (OFF, OFF, OFF)),
        judge_laser("left", (OFF, LEFT, LEFT)),
        judge_laser("right", (OFF, LEFT, OFF)),
        judge_laser("right", (OFF, BOTH, OFF)),
    ],
    "sensors": [
        judge_sensor("HUM", True, None),
        judge_sensor("TPROJ", True, -127.0),
        judge_sensor("LEAK", True, 1.0),
        judge_sensor("SUPPLY", True, 10.0, supply_low_v=10.8),
    ],
    "keys": [
        judge_key(KeyTrial("up", (), ())),
        judge_key(KeyTrial("up", ("down",), ("down",))),
        judge_key(KeyTrial("up", ("up", "down"), ("up", "down"), 0.2)),
        judge_key(KeyTrial("up", ("up",), ())),
        judge_key(KeyTrial("up", ("up", "up"), ("up", "up"), 0.1)),
        *judge_pad((), {"back"}, 3, 0, 0),
    ],
    "syncs": [
        *(judge_stamps_of_syncs(syncs(hz), 60.0)[0] for hz in (59.8, 120.0, 30.0, 75.0)),
        judge_stamps_of_syncs(syncs(late_us=9.0), 60.0)[1],
        *judge_stamps_of_syncs((), 60.0),
        judge_count(601, 600),
        judge_count(598, 600),
        judge_stop(None),
    ],
    "stamps": [
        stamps(late_ns=60_000),
        stamps(ppm=20_000.0),
        judge_stamps(list(range(64)), {"left": list(range(63))})[0],
    ],
    "endurance": [
        endured(CameraEndurance(6399, ("discarded",), 0, 0))["camera.left"],
        endured(CameraEndurance(6400, (), 0, 1))["camera.left"],
        endured(CameraEndurance(6399, (), 0, 0))["camera.left"],
        endured(CameraEndurance(6400, (), 3, 0))["camera.left"],
        endured(CameraEndurance(70, (), 0, 0, "unplugged"))["camera.left"],
        endured(reported=6399)["pulses"],
        endured(after_c=55.0)["warmth.case"],
        endured(ended="the board restarted (BROWNOUT)")["run"],
    ],
    "covered": [
        dark(black_dn=9.0)["black"],
        dark(black_dn=0.2)["black"],
        dark(noise_dn=3.0)["noise"],
        dark(noise_dn=0.0)["noise"],
        dark(frozen=True)["noise"],
        dark(ambient_dn=6.0)["light"],
        dark(leak_dn=4.0)["light"],
        dark(hot=40)["hot pixels"],
    ],
    "settings": [
        judge_settings("left", (*HELD, HeldSetting("TriggerOverlap", "ReadOut", "Off")))[0],
        judge_settings("right", (*HELD[:2], HeldSetting("GammaEnable", True, True)))[1],
        judge_settings("right", (*HELD[:2], HeldSetting("LUTEnable", True, True)))[1],
        judge_settings("right", (*HELD[:2], HeldSetting("Gamma", 0.7, 0.7)))[1],
        judge_link("left", 480, "the link runs at 480 Mbit/s; SuperSpeed (5000) is needed"),
    ],
    "triggers": [
        triggered(fired(0)),
        triggered(fired(32, 2.0)),
        triggered(fired(31, 2.0)),
        triggered(fired(33, 2.0, clock=False)),
        triggered(fired(32)),
        triggered(fired(12, 2.0)),
        triggered(fired(60)),
        triggered(fired(65)),
        triggered(TriggeredFrames((*fired(63).times_ns, round(70 * PERIOD_NS)))),
        triggered(TriggeredFrames(fired(12).times_ns, ("truncated",))),
        *judge_triggers(12, {"left": fired(12)}, PERIOD_NS),
    ],
    "plane": [
        plane((0.06, 0.0, 0.0))["ripple 1x"],
        plane((0.0, 0.06, 0.0))["ripple 2x"],
        plane((0.0, 0.0, 0.3))["ripple 4x"],
        plane((0.0, 0.0, 0.3), Shape.GAMMA)["ripple 4x"],
        plane((0.0, 0.0, 0.3), Shape.BIT_PLANES)["ripple 4x"],
        plane((0.0, 0.0, 0.3), Shape.GAMMA, saturated=0.2)["ripple 4x"],
        plane(shape=Shape.GAMMA)["response"],
        plane(saturated=0.02)["clipping"],
        plane(filled=0.1)["plane"],
        plane(flatness=Flatness(0.1, 0.05, 25.0, 12.5, 0.02))["flatness"],
        plane(faults=("WRONG PATTERN: mirrored",))["judges"],
        plane((1.1 * LIMITS_PER_PERIOD[0] * 32, 0.0, 0.0))["ripple 1x"],
    ],
}
GOOD: dict[str, list[Finding]] = {
    "board": [
        judge_beats([0, 500_010, 1_000_020, 1_500_010], 0, 0),
        judge_clock(clock(30.0, bracket_us=20_000.0)),
        judge_laser("left", (OFF, LEFT, OFF)),
        judge_sensor("TCASE", True, 21.5),
        judge_sensor("HUM", False, None),  # what is not fitted is no fault
    ],
    "pad and syncs": [
        *judge_pad([KeyTrial("scan", ("scan",), ("scan",), 0.15)], (), 0, 0, 0),
        *judge_stamps_of_syncs(syncs(59.95), 60.0),
        *judge_stamps_of_syncs(syncs(), 60.0),
        judge_count(600, 600),
        judge_stop(20.0),
        judge_edge(12.0),
    ],
    "stamps and endurance": [stamps(ppm=80.0), judge_stamps([0, 1], {"left": [None, None]})[0], *endured().values()],
    "cameras": [
        *dark().values(),
        dark(black_dn=9.0)["light"],
        *judge_settings("left", HELD),
        judge_settings("left", (HeldSetting("Gamma", 1.0, 1.0),))[1],
        judge_settings("left", (HeldSetting("GammaEnable", False, False), HeldSetting("Gamma", None, 0.45)))[1],
        judge_link("left", 5000, None),
        judge_link("left", None, None),
    ],
    "triggers": [
        triggered(fired(PULSES)),
        triggered(fired(PULSES, clock=False)),
        triggered(fired(PULSES, 1.05)),
        triggered(
            TriggeredFrames((*fired(20).times_ns, None, *fired(PULSES).times_ns[21:]))
        ),  # no frame that came late
    ],
    "plane": [*plane().values(), plane((0.9 * LIMITS_PER_PERIOD[0] * 32, 0.0, 0.0))["ripple 1x"]],
}


@pytest.mark.parametrize("group", WRONG)
def test_what_is_wrong_is_told_with_what_to_do(group: str, says: Says) -> None:
    assert not any(one.ok for one in WRONG[group])
    says("\n".join(f"{one.name}: {one.said}\n  {one.remedy}" for one in WRONG[group]))


@pytest.mark.parametrize("group", GOOD)
def test_what_is_good_or_not_there_is_no_fault(group: str, says: Says) -> None:
    assert all(one.ok for one in GOOD[group])
    says("\n".join(f"{one.name}: {one.said}" for one in GOOD[group]))


def test_numbers_are_those_that_were_measured() -> None:
    found = judge_clock(clock(30.0)).numbers
    assert abs((found["drift_ppm"] or 0.0) - 30.0) <= (found["uncertainty_ppm"] or 0.0) < 12.0
    assert judge_beats([0, 500_010, 1_000_020, 1_500_010], 0, 0).numbers["longest_ms"] == pytest.approx(500.01)
    assert stamps(ppm=80.0).numbers["drift_ppm"] == pytest.approx(80.0, abs=1.0)
    assert stamps(late_ns=60_000).numbers["jitter_rms_us"] == pytest.approx(60.0 / 8.0, rel=0.03), "one of 64"
    assert dark()["black"].numbers["level_dn"] == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("count", [2, 8])
def test_the_noise_of_few_frames_is_that_of_many(count: int) -> None:
    """Divided by n in place of n - 1, two frames would show 71 % of it."""
    grey = np.rint(20.0 + 4.0 * np.random.default_rng(7).standard_normal((count, 200, 200))).astype(np.uint8)
    assert see_dark(grey, grey).noise_dn == pytest.approx(np.hypot(4.0, 1.0 / np.sqrt(12.0)), rel=0.02)


STRAIGHT = ResponseShape(Shape.STRAIGHT, 0.004, 0.01, 0.001, 0.0, 1.0, 100.0)
SEEN_LEFT, SEEN_RIGHT = PictureView(Orientation.UPRIGHT, 1.1, 0.9), PictureView(Orientation.UPRIGHT, 0.9, 0.7)
ALIKE, UNLIKE = LineLight(0.01, 0.001), LineLight(1.1 * MOST_BEATING, 0.001)
WINDOWS = (LightWindow(300.0, 4_300.0), LightWindow(8_300.0, 16_300.0))
TIMING = LightTiming(1, 300.0, 16_300.0, WINDOWS)
LAMP = Lamp(
    timing=TIMING,
    channels="green",
    sub_frames=1,
    profiles={255: np.ones(80)},
    responses={Trial(500, 4_000): STRAIGHT, Trial(500, 9_000): STRAIGHT},
    ramps={},
    offer=Offer(500, (4_000, 9_000)),
)
MEASURED = ProjectorMeasurement(
    LAMP, -20.0, {"columns": ALIKE, "rows": ALIKE}, {"left": SEEN_LEFT, "right": SEEN_RIGHT}, {}
)


def of_shape(shape: Shape, line_rms: float = 0.2, power: float = 1.0) -> ResponseShape:
    return replace(STRAIGHT, shape=shape, line_rms=line_rms, power=power)


def none_good(*shapes: ResponseShape) -> dict[str, Any]:
    return {"offer": None, "responses": {Trial(500, 4_000 + k): one for k, one in enumerate(shapes)}}


def both(orientation: Orientation) -> dict[str, Any]:
    return {
        "views": {
            "left": replace(SEEN_LEFT, orientation=orientation),
            "right": replace(SEEN_RIGHT, orientation=orientation),
        }
    }


def right(**changes: Any) -> dict[str, Any]:
    return {"views": {"left": SEEN_LEFT, "right": replace(SEEN_RIGHT, **changes)}}


DARK, RESTLESS = of_shape(Shape.DARK), of_shape(Shape.RESTLESS)
CUT, GAMMA = of_shape(Shape.BIT_PLANES), of_shape(Shape.GAMMA, 0.1, 2.2)
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
    ("grey", none_good(CUT, GAMMA, CUT)),
    ("grey", none_good(CUT, GAMMA)),
    ("grey", none_good(CUT)),
    ("grey", none_good(DARK, DARK)),
    ("grey", none_good(DARK, CUT)),
    ("grey", none_good(RESTLESS, RESTLESS)),
    ("grey", none_good(RESTLESS, CUT)),
    ("orientation", right(orientation=Orientation.MIRRORED)),
    *(("orientation", both(one)) for one in Orientation if one is not Orientation.UPRIGHT),
    ("sides", {"views": {"left": SEEN_RIGHT, "right": SEEN_LEFT}}),
    ("raster", {"lines": {"columns": UNLIKE, "rows": ALIKE}}),
    ("raster", {"lines": {"columns": UNLIKE, "rows": UNLIKE}}),
]


def concluded(name: str, changes: dict[str, Any]) -> Finding:
    lamp = {key: value for key, value in changes.items() if hasattr(LAMP, key)}
    others = {key: value for key, value in changes.items() if key not in lamp}
    found = replace(MEASURED, lamp=replace(LAMP, **lamp), **others)
    return projector_findings(found)[name]


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
    best = concluded("grey", none_good(CUT, GAMMA))
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
    lamp = replace(LAMP, **changes)
    assert {".".join(key): value for key, value in keys_of(lamp, 1e6 / 60.0, exposure_ms).items()} == {
        "projector.latency_blanks": 1,
        "projector.light_begins_us": light_begins_us,
        "projector.channels": "green",
        "projector.sub_frames": lamp.sub_frames,
        "board.trigger_delay_us": 500,
        "scan.exposures_ms": (4.0, 9.0),
        "camera.left.exposure_ms": nearest_ms,
        "camera.right.exposure_ms": nearest_ms,
    }


def test_nothing_is_written_of_a_projector_without_a_good_exposure() -> None:
    with pytest.raises(ValueError, match="no exposure is good"):
        keys_of(replace(LAMP, offer=None), 1e6 / 60.0, 12.0)
