"""A beam's line and its certainty: as drawn, and as dots teach it, against the least squares of all dots at once."""

from __future__ import annotations

import math

import numpy as np
import pytest

from appliance.instrument.ranging.beams import PointerBeam, Pointers

POINTERS = Pointers((60.0, 10.0, 30.0), (20.0, 5.0, 500.0), 1.5)


def test_pointers_run_as_mirror_images_to_where_they_are_aimed_as_certain_as_their_mounts() -> None:
    left, right = POINTERS.beams()
    z = np.array([30.0, 500.0, 735.0])
    assert right.at(z) == pytest.approx(np.array([[60.0, 10.0, 30.0], [20.0, 5.0, 500.0], [0.0, 2.5, 735.0]]))
    assert left.at(z) == pytest.approx(right.at(z) * (-1.0, 1.0, 1.0))
    # 0.7 mm at the window, 1.5° from there on, and 0.2 mm that no dot takes away.
    for z_mm in (30.0, 330.0, 730.0):
        sd_mm = math.sqrt(0.7**2 + (math.radians(1.5) * (z_mm - 30.0)) ** 2 + 0.2**2)
        assert [float(beam.sd_mm(np.array(z_mm))) for beam in (left, right)] == pytest.approx([sd_mm] * 2)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_less_certain_direction_across_a_beam_counts_and_place_and_lean_may_go_together(axis: int) -> None:
    """As a beam that is known at one depth: it leans about that place."""
    P = np.diag([0.01, 0.01, 1e-6, 1e-6])
    P[axis, axis], P[axis + 2, axis + 2] = 4.0, 4e-4
    P[axis, axis + 2] = P[axis + 2, axis] = -0.04
    beam = PointerBeam(30.0, (0.0, 0.0, 0.0, 0.0), tuple(tuple(row) for row in P.tolist()))
    for z_mm in (30.0, 130.0, 330.0):
        ahead = z_mm - 30.0
        across = max((2.0 - 0.02 * ahead) ** 2, 0.01 + 1e-6 * ahead**2)
        assert float(beam.sd_mm(np.array(z_mm))) == pytest.approx(math.sqrt(across + 0.04))


def test_dots_one_after_the_other_teach_what_least_squares_of_all_of_them_say() -> None:
    """Each dot is uncertain by 0.5 mm across the beam."""
    drawn = POINTERS.beams()[1]
    rng = np.random.default_rng(5)
    z = np.array([430.0, 470.0, 520.0, 580.0, 620.0])
    dots = drawn.at(z) + np.stack([1.0 + 0.004 * z, -2.0 + 0.003 * z, 0.0 * z], axis=1) + rng.normal(0.0, 0.4, (5, 3))
    dots[:, 2] = z
    beam = drawn
    for dot in dots:
        beam = beam.updated(dot)
    ahead = z - 30.0
    for axis in (0, 1):
        A = np.stack([np.ones(5), ahead], axis=1) / 0.5
        prior = np.diag([1.0 / 0.7, 1.0 / math.radians(1.5)])
        known = np.array([drawn.line[axis], drawn.line[axis + 2]])
        rows, values = np.vstack([A, prior]), np.concatenate([dots[:, axis] / 0.5, prior @ known])
        line, *_ = np.linalg.lstsq(rows, values, rcond=None)
        assert (beam.line[axis], beam.line[axis + 2]) == pytest.approx(tuple(line))
        P = np.asarray(beam.covariance)[np.ix_([axis, axis + 2], [axis, axis + 2])]
        assert pytest.approx(np.linalg.inv(rows.T @ rows)) == P
    assert np.asarray(beam.covariance)[0, 1] == pytest.approx(0.0, abs=1e-12), "x and y are taught apart"
    assert (beam.learned, beam.last_z_mm, beam.z0_mm) == (5, 620.0, 30.0)


def test_a_dot_that_holds_still_is_seen_once() -> None:
    once = POINTERS.beams()[0].updated(np.array([-21.0, 5.5, 500.0]))
    for z_mm, learned in ((503.5, 1), (496.5, 1), (504.0, 2), (496.0, 2)):
        assert once.updated(np.array([-21.0, 5.5, z_mm])).learned == learned
