"""Phases of any number of steps, against closed forms, and against the instrument's own four-step kernels on its own images."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.desk.foreign.camera import decode_camera
from appliance.desk.foreign.description import AxisConvention, Description, ImageFiles
from appliance.desk.foreign.guess import periods_by_phases
from appliance.desk.foreign.images import ImageSet
from appliance.desk.foreign.order import parse_order
from appliance.desk.foreign.phase import fit_sine, step_weights
from appliance.desk.foreign.problem import ForeignError, Table
from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.decode.phase import phase
from appliance.measure.decode.scratch import COORDINATE, DECODING_SIZE, MODULATION_HALF_DN
from appliance.measure.light.patterns import PatternSequence, build_sequence
from tests.support.synthetic import calibration, frames, plane_points, projector

NORMAL = np.array([0.05, -0.02, 0.998])


def ideal(turns: NDArray[np.float64], steps_deg: tuple[float, ...]) -> list[NDArray[np.float64]]:
    """A = 100, B = 60."""
    return [100.0 + 60.0 * np.cos(2 * np.pi * turns + math.radians(step)) for step in steps_deg]


@pytest.mark.parametrize(
    "steps_deg", [(0.0, -120.0, -240.0), (270.0, 0.0, 180.0, 90.0), (15.0, 80.0, 160.0, 200.0, 333.0)]
)
def test_any_steps_tell_the_phase(steps_deg: tuple[float, ...]) -> None:
    turns = np.linspace(-0.499, 0.499, 4000).reshape(40, 100)
    fit = fit_sine(ideal(turns, steps_deg), steps_deg, 255.0)
    np.testing.assert_allclose(fit.turns, turns, atol=3e-6)
    np.testing.assert_allclose(fit.modulation, 60.0, rtol=1e-5)
    np.testing.assert_allclose(fit.offset, 100.0, rtol=1e-5)
    assert (fit.misfit is None) == (len(steps_deg) == 3)
    if fit.misfit is not None:
        assert float(fit.misfit.max()) < 1e-3


def test_four_steps_of_ours_give_the_phase_of_our_own_kernel_byte_for_byte() -> None:
    random = np.random.default_rng(9)
    images = random.integers(0, 256, (4, 60, 700)).astype(np.uint8)
    images[:, :20] //= 40  # many equal values: noughts, and phases on the axes
    fit = fit_sine(list(images), (0.0, 90.0, 180.0, 270.0), 255.0)
    places = np.zeros(DECODING_SIZE, np.float32)
    for row in range(60):
        phase(images[0, row], images[1, row], images[2, row], images[3, row], places)
        own = places[COORDINATE : COORDINATE + 700]
        assert np.array_equal(
            own.view(np.uint32) << 1, fit.turns[row].view(np.uint32) << 1
        )  # but for the sign of nought
        assert np.array_equal(places[MODULATION_HALF_DN : MODULATION_HALF_DN + 700], 2.0 * fit.modulation[row])
    assert np.array_equal(fit.saturated, (images == 255).any(axis=0))


def test_noise_makes_the_error_that_the_steps_allow() -> None:
    # σ_φ = σ √(2/N) / B for N steps evenly around the circle (Surrel, Appl. Opt. 35 (1996) 51).
    random = np.random.default_rng(5)
    turns = np.zeros((200, 200))
    for count in (3, 5, 12):
        steps_deg = tuple(360.0 * k / count for k in range(count))
        noisy = [image + random.normal(0.0, 2.0, image.shape) for image in ideal(turns, steps_deg)]
        fit = fit_sine(noisy, steps_deg, 255.0)
        assert float(fit.turns.std()) * 2 * math.pi == pytest.approx(2.0 * math.sqrt(2 / count) / 60.0, rel=0.03)
        if fit.misfit is not None:
            assert float(np.sqrt(np.mean(fit.misfit**2))) == pytest.approx(2.0, rel=0.03)


@pytest.mark.parametrize("steps_deg", [(0.0, 1.0, 2.0), (0.0, 180.0, 360.0), (0.0, 360.0, 720.0, 90.0)])
def test_steps_that_tell_no_phase_are_refused(steps_deg: tuple[float, ...]) -> None:
    with pytest.raises(ForeignError, match="too close together"):
        step_weights(steps_deg)


@pytest.mark.parametrize(("name", "fringes"), [("x", (64, 8, 1)), ("y", (13, 120)), ("x", (1,)), ("x", ())])
def test_phases_alone_tell_how_many_fringes_there_are(name: str, fringes: tuple[int, ...]) -> None:
    steps_deg = (0.0, 90.0, 180.0, 270.0)
    place = np.linspace(0.1, 0.9, 600)[None]
    places = [(place if name == "x" else place.T) * count for count in fringes]
    images = [np.rint(ideal(one, steps_deg)).astype(np.uint8) for one in places]
    found = periods_by_phases(images, [steps_deg] * len(fringes), name, 1024.0)
    assert found == pytest.approx(tuple(1024.0 / count for count in fringes))


def own(sequence: PatternSequence, stack: NDArray[np.uint8]) -> tuple[Description, ImageSet]:
    """The instrument's own images, described as if they were another's."""
    bits = [len([p for p in sequence.patterns if p.name.startswith(f"gray-{axis}")]) for axis in "xy"]
    order = parse_order(f"bright dark gray-x*{bits[0]} sine-x*4 gray-y*{bits[1]} sine-y*4", "order")
    steps = (tuple(90.0 * step for step in sequence.steps),)
    period = float(sequence.period_px)
    axes = tuple(
        AxisConvention(name, float(size), (period,), steps, bits=n, stripe_px=0.5 * period)
        for name, size, n in zip("xy", (sequence.width_px, sequence.height_px), bits, strict=True)
    )
    files = {"left": ImageFiles(("*",))}
    said = Description("own", Path(), files, order, "grey", None, (1024, 768), axes, Table("", {}))
    return said, ImageSet(order, (), stack, 255.0)


@pytest.mark.parametrize("period_px", [16, 64])
def test_our_own_images_give_the_same_coordinates_as_our_own_kernels(period_px: int) -> None:
    cal = calibration()
    sequence = build_sequence(period_px)
    points = plane_points(cal.rig.left, NORMAL, 520.0)
    pq = projector(cal).project(points, 1.334)
    random = np.random.default_rng(period_px)
    light = frames(sequence, pq)
    stack = np.clip(np.rint(light + random.normal(0.0, 1.2, light.shape)), 0, 255).astype(np.uint8)
    decoder = CameraDecoder(sequence, 400, 300)
    for k in range(len(sequence)):
        decoder.push(stack, k)
    decoder.finish()
    description, images = own(sequence, stack)
    camera = decode_camera(images, description)
    both = np.isfinite(sum(one.coordinate_px for one in camera.placed.values()) + decoder.p_px)
    assert both.sum() > 0.95 * np.isfinite(decoder.p_px).sum() > 50_000
    # 2e-6 of a pattern of 1024 px: the two differ by the rounding of float32, not by a formula.
    for name, mine in (("x", decoder.p_px), ("y", decoder.q_px)):
        np.testing.assert_allclose(camera.placed[name].coordinate_px[both], mine[both], atol=2e-3 * period_px / 16)
        off = camera.placed[name].coordinate_px[both] - mine[both]
        assert float(np.sqrt(np.mean(np.square(off)))) < 1.5e-5 * period_px
