"""The true rig: what it is drawn from, how it is written down, and how it was before it went into the water."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hw_sim.objects.shapes import BALL_DISTANCE_MM
from hw_sim.optics.trace import lens_field
from hw_sim.truth import SETS, draw_truth, in_air, ray
from hw_sim.water.medium import Water, refractive_index

N_WATER = Water().index


def test_the_nominal_rig_is_the_drawing() -> None:
    rig = draw_truth("nominal", 99, 1600, 1200, N_WATER)
    for name, x_mm, toe_deg in (("left", -115.0, 12.41), ("right", 115.0, -12.41)):
        eye = rig.eye(name)
        assert eye.t_mm == (x_mm, 0.0, 0.0)
        assert eye.f_px[0] == pytest.approx(11.5 / 0.0045)
        assert eye.c_px == (799.5, 599.5)
        assert eye.distortion == (0.0,) * 5
        assert (eye.port.normal, eye.port.d_mm, eye.port.th_mm, eye.port.n_g) == ((0.0, 0.0, 1.0), 30.0, 5.0, 1.77)
        axis = np.array(eye.R)[:, 2]
        assert math.degrees(math.asin(axis[0])) == pytest.approx(toe_deg)
        meets = np.array(eye.t_mm) + axis * (522.5 / axis[2])
        assert abs(meets[0]) < 0.05, "the axes cross in the middle of the volume"
    assert rig.projector.f_px[0] == pytest.approx(16.9 / 0.0108)
    assert rig.artefacts.ball_distance_mm == BALL_DISTANCE_MM
    assert in_air(rig).left.R == rig.left.R


def test_a_smaller_picture_sees_the_same_field() -> None:
    big, small = (draw_truth("hard", 6, w, h, N_WATER) for w, h in ((1600, 1200), (400, 300)))
    uv = np.random.default_rng(1).uniform(10, 1190, (50, 2))
    for name in ("left", "right"):
        _, a = ray(big, name, uv)
        _, b = ray(small, name, (uv + 0.5) / 4 - 0.5)
        np.testing.assert_allclose(a, b, atol=1e-9)


@pytest.mark.parametrize(("kind", "rms_px"), [("realistic", 0.06), ("paper", 0.15)])
def test_the_lens_field_is_as_large_as_the_set_says_and_not_a_shift(kind: str, rms_px: float) -> None:
    eye = draw_truth(kind, 12, 1600, 1200, N_WATER).left.packed(N_WATER)
    v, u = np.mgrid[0:1200:8, 0:1600:8]
    field = np.array([lens_field(eye, float(x), float(y)) for x, y in zip(u.ravel(), v.ravel(), strict=True)])
    assert math.sqrt((field**2).mean()) == pytest.approx(rms_px, rel=0.02)
    assert np.abs(field.mean(axis=0)).max() < 0.1 * rms_px


def test_in_air_the_instrument_was_a_pinhole_camera_and_nearly_the_same() -> None:
    rigs = [draw_truth("realistic", seed, 1600, 1200, N_WATER) for seed in range(20)]
    turned, shifted, refocused = [], [], []
    for rig in rigs:
        before = in_air(rig)
        assert before == in_air(rig), "it has been one way only"
        for name in ("left", "right"):
            eye, was = rig.eye(name), before.eye(name)
            origin, direction = ray(before, name, np.random.default_rng(1).uniform(0, 1199, (20, 2)))
            off = np.cross(np.array(was.t_mm) - origin, direction)
            assert np.abs(off).max() < 1e-9, "all rays pass through one point"
            relative = np.array(eye.R).T @ np.array(was.R)
            turned.append(np.degrees([relative[2, 1], relative[0, 2], relative[1, 0]]))
            shifted.append(np.array(was.t_mm) - np.array(eye.t_mm))
            refocused.append(was.f_px[0] / eye.f_px[0] - 1.0)
            assert was.distortion == eye.distortion
            assert was.lens_field == eye.lens_field
    assert np.std(turned) == pytest.approx(0.005, rel=0.3)
    assert np.std(shifted) == pytest.approx(0.01, rel=0.3)
    assert np.std(refocused) == pytest.approx(1e-4, rel=0.4)


def test_the_same_seed_is_the_same_rig_and_another_seed_another() -> None:
    for kind in SETS[1:]:
        assert draw_truth(kind, 5, 400, 300, N_WATER) == draw_truth(kind, 5, 400, 300, N_WATER)
        assert draw_truth(kind, 5, 400, 300, N_WATER).left != draw_truth(kind, 6, 400, 300, N_WATER).left


@pytest.mark.parametrize(
    ("temperature_c", "salinity_psu", "wavelength_nm", "index"),
    [
        # Pure water at 20 °C relative to air: L. W. Tilton, J. K. Taylor, J. Res. NBS 20 (1938) 419.
        (20.0, 0.0, 486.1, 1.33712),
        (20.0, 0.0, 546.1, 1.33447),
        (20.0, 0.0, 589.3, 1.33299),
        (20.0, 0.0, 656.3, 1.33115),
        # Sea water of 35 psu: R. W. Austin, G. Halikas, SIO Ref. 76-1 (1976).
        (20.0, 35.0, 589.3, 1.33940),
    ],
)
def test_water_refracts_as_tables_of_measurements_say(
    temperature_c: float, salinity_psu: float, wavelength_nm: float, index: float
) -> None:
    assert refractive_index(temperature_c, salinity_psu, wavelength_nm) == pytest.approx(index, abs=5e-5)
    if salinity_psu == 0.0:
        assert refractive_index(10.0, 0.0, wavelength_nm) > index, "colder water is denser"
