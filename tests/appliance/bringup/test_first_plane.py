"""What the fringes of a plane are told to suffer from: ripples of known size in coordinates made by arithmetic."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.bringup.finding import Finding
from appliance.bringup.plane_check import (
    LIMITS_PER_PERIOD,
    PlaneSeen,
    curve_of,
    judge_curve,
    judge_plane,
    next_exposure,
)
from appliance.bringup.plane_ripple import CoordinateRipple, SmoothPlane, ripple_of, smooth_plane
from appliance.bringup.response_check import ResponseShape, Shape
from appliance.evaluation.flatness import Flatness
from appliance.patterns.sequence import Direction, build_sequence
from appliance.scan.exposure import Exposure

PERIOD_PX = 32


def coordinate(
    amplitudes_px: tuple[float, float, float] = (0.0, 0.0, 0.0),
    noise_px: float = 0.02,
    shape: tuple[int, int] = (150, 200),
) -> NDArray[np.float32]:
    """Columns of a pattern on a leaning plane behind a lens, rippled at 1, 2 and 4 cycles, with holes and some wrong periods."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[-1.0 : 1.0 : shape[0] * 1j, -1.0 : 1.0 : shape[1] * 1j]
    true = 500.0 + 380.0 * x / (1.0 + 0.08 * x + 0.05 * y) + 20.0 * y + 6.0 * x * (x**2 + y**2)
    theta = 2.0 * np.pi * (true + 0.5) / PERIOD_PX
    p = true + noise_px * rng.standard_normal(shape)
    for k, amplitude in zip((1, 2, 4), amplitudes_px, strict=True):
        p += amplitude * np.cos(k * theta - 0.7)
    p[rng.random(shape) < 0.1] = np.nan
    p[rng.random(shape) < 0.01] += PERIOD_PX
    return np.asarray(p, np.float32)


def ripple(**made: object) -> CoordinateRipple:
    plane = smooth_plane(coordinate(**made), PERIOD_PX)  # type: ignore[arg-type]
    assert plane is not None
    return ripple_of(plane, PERIOD_PX)


@pytest.mark.parametrize("k", [0, 1, 2])
def test_a_ripple_is_measured_at_its_own_number_of_cycles(k: int) -> None:
    wanted = [0.0, 0.0, 0.0]
    wanted[k] = 0.08
    found = ripple(amplitudes_px=tuple(wanted))
    assert found.amplitude_px == pytest.approx(tuple(wanted), abs=5.0 * found.uncertainty_px)
    assert found.uncertainty_px < 0.001
    assert found.noise_px == pytest.approx(0.02, rel=0.1)


def test_a_smooth_plane_has_none_beyond_what_noise_makes() -> None:
    found = ripple()
    assert max(found.amplitude_px) < 4.0 * found.uncertainty_px


def test_a_step_in_depth_and_an_empty_image_are_no_plane() -> None:
    assert smooth_plane(np.full((60, 80), np.nan, np.float32), PERIOD_PX) is None
    # A second surface in a corner is left out, and the ripple of the plane is what it was.
    p = coordinate((0.0, 0.0, 0.05))
    p[:40, :50] += 7.0
    plane = smooth_plane(p, PERIOD_PX)
    assert plane is not None
    assert ripple_of(plane, PERIOD_PX).amplitude_px[2] == pytest.approx(0.05, abs=0.005)


# ------------------------------------------------------------------------------------------ light by code


def photographed(power: float = 1.0, planes: bool = False) -> ResponseShape | None:
    """The response of light that is a power of the code, or that loses its fifth bit plane, as a plane shows it."""
    sequence = build_sequence(64, 512, 384)
    height, width = 96, 128
    p = np.broadcast_to(np.linspace(20.0, 490.0, width), (height, width))
    rng = np.random.default_rng(8)
    frames = np.zeros((len(sequence), height, width), np.uint8)
    for number, pattern in enumerate(sequence.patterns):
        if pattern.direction is not Direction.X and pattern.name not in ("bright", "dark"):
            continue
        codes = (
            np.interp(p, np.arange(pattern.size_px), pattern.codes())
            if pattern.name not in ("bright", "dark")
            else None
        )
        drawn = np.full(p.shape, float(pattern.codes()[0])) if codes is None else codes
        light = (drawn / 255.0) ** power
        if planes:
            light = (drawn - 14.0 * ((drawn.astype(int) >> 4) & 1)) / 255.0
        frames[number] = np.clip(np.rint(10.0 + 200.0 * light + 0.4 * rng.standard_normal(p.shape)), 0, 255)
    rows, columns = (one.ravel() for one in np.mgrid[:height, :width])
    plane = SmoothPlane(rows, columns, p[rows, columns], np.zeros(rows.size))
    return judge_curve(*curve_of(sequence, frames, {Direction.X: plane}))


def test_straight_light_gamma_and_cut_bit_planes_are_told_from_one_scan() -> None:
    straight, gamma, planes = photographed(), photographed(2.2), photographed(planes=True)
    assert straight is not None
    assert gamma is not None
    assert planes is not None
    assert straight.shape is Shape.STRAIGHT
    assert gamma.shape is Shape.GAMMA
    assert planes.shape is Shape.BIT_PLANES


# ------------------------------------------------------------------------------------------ judgement

FINE = CoordinateRipple((0.001, 0.001, 0.002), 0.03, 0.0002, 20_000)
STRAIGHT = ResponseShape(Shape.STRAIGHT, 0.002, 0.003, 0.001, 0.0, 1.0, 200.0)


def seen(
    amplitudes_px: tuple[float, float, float] = FINE.amplitude_px,
    shape: Shape = Shape.STRAIGHT,
    saturated: float = 0.0,
    filled: float = 0.8,
    flatness: Flatness | None = None,
    faults: tuple[str, ...] = (),
) -> dict[str, Finding]:
    response = ResponseShape(shape, 0.05, 0.08, 0.001, 0.0, 2.2 if shape is Shape.GAMMA else 1.0, 200.0)
    one = CoordinateRipple(amplitudes_px, 0.03, 0.0002, 20_000)
    findings = judge_plane(
        PlaneSeen(
            "000007", PERIOD_PX, {"left x": FINE, "right x": one}, {"left": filled, "right": 0.9}, Exposure(8000, 0.0),
            {"left": saturated, "right": 0.0}, response, flatness, "no calibration", faults,
        )
    )  # fmt: skip
    return {finding.name: finding for finding in findings}


def test_a_good_first_plane_is_good_without_a_calibration() -> None:
    found = seen()
    assert all(one.ok for one in found.values())
    assert "not measured: no calibration" in found["flatness"].said


@pytest.mark.parametrize(
    ("found", "name", "remedy"),
    [
        (seen((0.06, 0.0, 0.0)), "ripple 1x", "light is added to some images"),
        (seen((0.0, 0.06, 0.0)), "ripple 2x", "step latency"),
        (seen((0.0, 0.0, 0.3)), "ripple 4x", "measure its response (`kingfisher measure response 000007`)"),
        (seen((0.0, 0.0, 0.3), Shape.GAMMA), "ripple 4x", "gamma: switch it off"),
        (seen((0.0, 0.0, 0.3), Shape.BIT_PLANES), "ripple 4x", "cut bit planes"),
        (seen((0.0, 0.0, 0.3), Shape.GAMMA, saturated=0.2), "ripple 4x", "clipping"),
        (seen(shape=Shape.GAMMA), "response", "gamma"),
        (seen(saturated=0.02), "clipping", "exposure"),
        (seen(filled=0.1), "plane", "the left camera sees too little"),
        (seen(flatness=Flatness(0.1, 0.05, 25.0, 12.5, 0.02)), "flatness", "calibrate"),
        (seen(faults=("WRONG PATTERN: mirrored",)), "judges", "docs/faults.md"),
    ],
)
def test_each_cause_is_named(found: dict[str, Finding], name: str, remedy: str) -> None:
    assert not found[name].ok
    assert remedy in found[name].remedy


def test_limits_are_shares_of_the_period() -> None:
    limit_px = LIMITS_PER_PERIOD[0] * PERIOD_PX
    assert seen((0.9 * limit_px, 0.0, 0.0))["ripple 1x"].ok
    assert not seen((1.1 * limit_px, 0.0, 0.0))["ripple 1x"].ok


def test_a_saturated_plane_is_tried_with_half_of_the_light_then_with_what_is_left() -> None:
    allowed = [Exposure(us, 0.0) for us in (2000, 5000, 8000, 12_000)]
    assert next_exposure(allowed, allowed[3], 0.005) is None
    assert next_exposure(allowed, allowed[3], 0.3) == allowed[1]
    assert next_exposure(allowed[2:], allowed[3], 0.3) == allowed[2]
    assert next_exposure(allowed, allowed[0], 0.3) is None
