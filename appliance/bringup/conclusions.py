"""Owns what follows from a measured projector: findings with their limits and remedies, and the keys of the rig file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from appliance.bringup.exposures import Trial
from appliance.bringup.finding import Finding
from appliance.bringup.orientation import Orientation, SeenPicture, exchanged
from appliance.bringup.projector import ProjectorMeasured
from appliance.bringup.raster import MOST_BEATING, LineLight
from appliance.bringup.response_check import STRAIGHT, Shape
from appliance.bringup.rig_edit import KeyValue

LEAST_RESOLVED = 0.7
"""Camera pixels per projector pixel below which lines of one pixel fall between the camera's, and beat with those."""
MOST_SKEW_US = 20.0
PATTERN_MODE = "use a pattern mode of the controller (8 bits, equal sub-frames, one LED) or a mode in which one exposure holds the light of the whole frame"
_TURNED_BACK = {
    Orientation.MIRRORED: "switch rear projection off in the projector",
    Orientation.UPSIDE_DOWN: "switch the projector's vertical flip off",
    Orientation.TURNED: "switch ceiling projection off, or turn the projector over",
    Orientation.ON_ITS_SIDE: "turn the projector, or the cameras, by 90°",
    Orientation.UNSEEN: "point the projector at what the cameras see, and light it",
}


def conclusions(measured: ProjectorMeasured, refresh_hz: float) -> tuple[Finding, ...]:
    """Return what is to be said of a measured projector, in the order of the measurements."""
    return (
        _latency(measured),
        _windows(measured, 1e6 / refresh_hz),
        _skew(measured),
        _grey(measured),
        _orientation(measured),
        _sides(measured),
        raster_finding(measured.lines, measured.seen),
    )


def keys_of(
    measured: ProjectorMeasured, refresh_hz: float, exposure_ms: float
) -> dict[KeyValue, int | str | float | tuple[float, ...]]:
    """Return the keys of the rig file, by table and name; ``exposure_ms`` is that of before, whose nearest is kept.

    Raises ValueError for a projector without a good exposure: nothing is written of that.
    """
    offer = measured.offer
    if offer is None:
        raise ValueError("no exposure is good: there is nothing to write")
    times_ms = tuple(time_us / 1000.0 for time_us in offer.exposures_us)
    nearest = min(times_ms, key=lambda one: abs(one - exposure_ms))
    timing = measured.timing
    # Where light goes on beyond the next blank, exposures begin with it, and may last as long.
    late = measured.sub_frames > 1 or timing.overhangs(1e6 / refresh_hz)
    begins_us = offer.delay_us if late else 0
    return {
        KeyValue("projector", "latency_blanks"): timing.latency_blanks,
        KeyValue("projector", "light_begins_us"): begins_us,
        KeyValue("projector", "channels"): measured.channels,
        KeyValue("projector", "sub_frames"): measured.sub_frames,
        KeyValue("board", "trigger_delay_us"): offer.delay_us,
        KeyValue("scan", "exposures_ms"): times_ms,
        KeyValue("camera.left", "exposure_ms"): nearest,
        KeyValue("camera.right", "exposure_ms"): nearest,
    }


def _latency(measured: ProjectorMeasured) -> Finding:
    blanks = measured.timing.latency_blanks
    said = f"a picture's light comes {blanks} vertical blank{'' if blanks == 1 else 's'} after its flip"
    return Finding("latency", True, said, "0..5 blanks", numbers={"latency_blanks": float(blanks)})


def _windows(measured: ProjectorMeasured, period_us: float) -> Finding:
    windows = measured.timing.windows
    shown = ", ".join(f"{one.begins_us / 1000.0:.2f} to {one.ends_us / 1000.0:.2f} ms" for one in windows)
    lit = sum(one.ends_us - one.begins_us for one in windows)
    kind = f"{'no' if measured.sub_frames == 1 else measured.sub_frames} equal sub-frames"
    said = f"the lamp lights {shown} after the blank, {100.0 * lit / period_us:.0f} % of the frame; {kind}, drawn into {measured.channels} channels"
    return Finding(
        "light", True, said, numbers={"windows": float(len(windows)), "lit_percent": 100.0 * lit / period_us}
    )


def _skew(measured: ProjectorMeasured) -> Finding:
    skew = measured.skew_us
    ok = abs(skew) <= MOST_SKEW_US
    later = "right" if skew < 0.0 else "left"
    said = f"the cameras begin their exposures {abs(skew):.0f} µs apart" + ("" if ok else f", the {later} one later")
    remedy = (
        ""
        if ok
        else "give both cameras the same line and filter (LineDebouncer, TriggerDelay 0), and pulses of 200 µs and more"
    )
    return Finding("skew", ok, said, f"up to {MOST_SKEW_US:g} µs", remedy, {"skew_us": skew})


def _grey(measured: ProjectorMeasured) -> Finding:
    limits = f"within {100.0 * STRAIGHT:g} % (RMS) of a straight line or smoothly curved, rising, repeatable"
    offer = measured.offer
    if offer is not None:
        shape = measured.responses[Trial(offer.delay_us, offer.exposures_us[-1])]
        times = ", ".join(f"{time / 1000.0:g}" for time in offer.exposures_us)
        curved = (
            ""
            if shape.shape is Shape.STRAIGHT
            else f"; it is curved by {100.0 * shape.line_rms:.1f} %, which scans straighten"
        )
        said = f"exposures of {times} ms from {offer.delay_us} µs after the blank see grey as it was drawn{curved}"
        return Finding(
            "grey",
            True,
            said,
            limits,
            numbers={"line_percent": 100.0 * shape.line_rms, "exposures": float(len(offer.exposures_us))},
        )
    shapes = list(measured.responses.values())
    # The most frequent shape is what is wrong; single ones come of windows that hold next to nothing.
    kinds = Counter(shape.shape for shape in shapes)
    best = min(shapes, key=lambda one: one.line_rms, default=None)
    seen = ", ".join(f"{count} {kind.value}" for kind, count in kinds.most_common())
    said = f"no exposure of {len(shapes)} sees grey as it was drawn ({seen})"
    if best is None:
        return Finding("grey", False, said, limits, PATTERN_MODE)
    said += f"; the best is {100.0 * best.line_rms:.1f} % off a straight line, like a power of {best.power:.1f}"
    remedy = PATTERN_MODE
    if kinds[Shape.GAMMA]:
        remedy = "switch gamma off in the projector (linear, 1:1, table off) and in the graphics driver"
    elif kinds[Shape.DARK] == len(shapes):
        remedy = "take something white at half a metre, that neither is too dark nor saturates the cameras"
    elif kinds[Shape.RESTLESS] == len(shapes):
        remedy = "switch dynamic contrast, dither and lamp dimming off in the projector, and other light in the room"
    return Finding("grey", False, said, limits, remedy, {"line_percent": 100.0 * best.line_rms, "power": best.power})


def _orientation(measured: ProjectorMeasured) -> Finding:
    seen = {side: one.orientation for side, one in measured.seen.items()}
    limits = "upper left of the picture is upper left in both cameras"
    if all(one is Orientation.UPRIGHT for one in seen.values()):
        return Finding("orientation", True, "both cameras see the picture upright", limits)
    wrong = {side: one for side, one in seen.items() if one is not Orientation.UPRIGHT}
    if len(wrong) < len(seen):
        side, how = next(iter(wrong.items()))
        said = f"camera.{side} alone sees the picture {how.value}: it is the camera that turns it"
        remedy = f"mount camera.{side} the right way round, and switch its ReverseX and ReverseY off"
    else:
        how = next(iter(wrong.values()))
        said = f"both cameras see the picture {how.value}"
        remedy = _TURNED_BACK[how]
    return Finding("orientation", False, said, limits, remedy)


def _sides(measured: ProjectorMeasured) -> Finding:
    left, right = measured.seen["left"], measured.seen["right"]
    ratios = {f"{side}_ratio": one.scale_ratio for side, one in measured.seen.items()}
    found = exchanged(left, right)
    limits = "the left camera sees the left part of a plane larger, the right camera the right part"
    if found is None:
        return Finding(
            "sides",
            True,
            "which camera is left cannot be told here: take a flat wall at half a metre, and a picture that is not turned",
            limits,
            "",
            ratios,
        )
    if found:
        remedy = "exchange the serials of [camera.left] and [camera.right] in the rig file"
        return Finding("sides", False, "left and right camera are exchanged", limits, remedy, ratios)
    return Finding("sides", True, "left and right are as in the rig file", limits, "", ratios)


def raster_finding(lines: Mapping[str, LineLight], seen: Mapping[str, SeenPicture]) -> Finding:
    """Return what single ``lines``, by direction, say of the picture's raster, by cameras that have ``seen`` the picture so large."""
    resolved = [one.px_per_px for one in seen.values()]
    numbers: dict[str, float | None] = {
        **{f"{name}_beating_percent": 100.0 * line.beating for name, line in lines.items()},
        "camera_px_per_projector_px": min((one for one in resolved if one is not None), default=None),
    }
    limits = f"single lines alike to {100.0 * MOST_BEATING:g} %"
    # Not told is no fault: the picture may be right, and the checker's photograph is on the page for a person.
    if any(one is None or one < LEAST_RESOLVED for one in resolved) or not all(one.told for one in lines.values()):
        return Finding(
            "raster",
            True,
            "whether the picture is scaled cannot be told by cameras this coarse, or in so little light",
            limits,
            "",
            numbers,
        )
    scaled: Sequence[str] = [name for name, line in lines.items() if line.scaled]
    if scaled:
        said = f"single {' and '.join(scaled)} are not equally bright: the projector scales its picture"
        remedy = (
            "set width_px and height_px of [projector] to the raster of its panel, and keystone, zoom and overscan off"
        )
        return Finding("raster", False, said, limits, remedy, numbers)
    return Finding(
        "raster", True, "single lines are equally bright: each pixel is one of the panel's", limits, "", numbers
    )
