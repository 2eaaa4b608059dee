"""PF, PS, SD and F of made-up points whose errors are known by construction; limits that are kept, exceeded, undecided."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from appliance.measure.accept.acceptance import (
    Certificate,
    Compliance,
    Quantity,
    Symbol,
    bar_quantities,
    expanded_mm,
    overall,
    probe,
)
from appliance.measure.accept.ball_bar import BallBar
from appliance.measure.accept.result import Artefact, Result, evaluate
from appliance.store.scan_list import ListError, ScanList
from tests.appliance.measure.accept.made_points import CENTRE, LENGTH_MM, OTHER, RADIUS_MM, Array, Points, board, cap

START = np.array([*CENTRE, RADIUS_MM]) + 0.3


def shell(n: int, radius_mm: float) -> tuple[Array, Array]:
    """Exact points of a sphere about CENTRE that face the instrument within 55°, and their directions: (n, 3) each."""
    rng = np.random.default_rng(3)
    cos, turn = rng.uniform(math.cos(math.radians(55.0)), 1.0, n), rng.uniform(0.0, 2.0 * math.pi, n)
    sin = np.sqrt(1.0 - cos**2)
    away = np.column_stack([sin * np.cos(turn), sin * np.sin(turn), -cos])
    return CENTRE + radius_mm * away, away


def test_exact_points_have_no_form_error_and_the_true_radius() -> None:
    found = probe(shell(2000, 14.9)[0], START)
    assert found is not None
    assert found.radius_mm == pytest.approx(14.9, abs=1e-9)
    assert found.range_mm < 1e-8
    assert (found.points, found.rejected) == (1994, 6), "0.3 % of 2000 go, not one more"


def test_the_form_error_is_the_range_of_the_radial_distances() -> None:
    """A ripple of ±0.08 mm over a ball: SciPy's own least squares tells sphere and range."""
    points, away = shell(999, RADIUS_MM)  # two points go
    points += 0.08 * np.cos(9.0 * np.arctan2(away[:, 1], away[:, 0]))[:, None] * away
    found = probe(points, START)
    assert found is not None
    assert found.rejected == 2
    kept = points
    for _ in range(4):
        solved = least_squares(lambda x, p=kept: np.linalg.norm(p - x[:3], axis=1) - x[3], START, xtol=1e-14).x
        off = np.abs(np.linalg.norm(points - solved[:3], axis=1) - solved[3])
        kept = points[np.sort(np.argsort(off)[:-2])]
    residual = np.linalg.norm(kept - solved[:3], axis=1) - solved[3]
    assert found.radius_mm == pytest.approx(solved[3], abs=1e-6)
    assert found.range_mm == pytest.approx(np.ptp(residual), abs=1e-6)


def bar_cloud() -> Points:
    rng = np.random.default_rng(2)
    return Points.of(np.vstack([cap(CENTRE, 75.0, 0.4, 0.02, rng), cap(OTHER, 75.0, 0.4, 0.02, rng)]), 0.02)


def measured(certificate: Certificate) -> Result:
    return evaluate(bar_cloud(), Artefact.BALL_BAR, {"length": LENGTH_MM - 0.1}, 250.0, certificate, {})


def test_a_ball_bar_has_form_size_and_spacing_with_their_uncertainty() -> None:
    result = measured(Certificate(0.03, RADIUS_MM - 0.05, 0.004))
    assert [(q.symbol.value, q.part) for q in result.quantities] == [
        ("PF", "first ball"), ("PS", "first ball"), ("PF", "second ball"), ("PS", "second ball"), ("SD", "length"),
    ]  # fmt: skip
    *balls, spacing = result.quantities
    for form, size in (balls[:2], balls[2:]):
        # Depth noise of 0.02 mm, seen at up to 55°: a range of some six to eight sigma.
        assert 0.06 < form.value_mm < 0.20
        assert form.uncertainty_mm is None
        assert form.rejected == math.floor(0.003 * (form.points + form.rejected))
        assert size.value_mm == pytest.approx(0.1, abs=0.02), "the certificate's ball is 0.1 mm smaller across"
        assert size.uncertainty_mm == pytest.approx(2.0 * 2.0 * 0.004, rel=0.25)
        assert size.uncertainty_mm is not None
        assert size.uncertainty_mm > 0.016
    assert spacing.value_mm == pytest.approx(0.1, abs=0.01), "the certificate's bar is 0.1 mm shorter"
    assert spacing.uncertainty_mm == pytest.approx(0.06, rel=0.02), "twice the certificate's 0.03 mm, hardly any noise"
    (length,) = result.lengths
    assert length.sigma_mm is not None
    assert length.uncertainty_mm == pytest.approx(2.0 * math.hypot(length.sigma_mm, 0.03))


def test_without_a_certified_radius_there_is_no_size_and_of_a_ball_of_too_few_points_no_form() -> None:
    result = measured(Certificate())
    assert {q.symbol for q in result.quantities} == {Symbol.PF, Symbol.SD}
    assert isinstance(result.fit, BallBar)
    used = result.fit.first.used
    few = replace(used, indices=used.indices[:4], rejected=used.rejected[:0])
    broken = replace(result.fit, first=replace(result.fit.first, used=few))
    quantities = bar_quantities(bar_cloud(), broken, LENGTH_MM, Certificate(), {})
    assert [(q.symbol, q.part) for q in quantities] == [(Symbol.PF, "second ball"), (Symbol.SD, "length")]


def test_the_flatness_error_is_the_range_of_the_plane() -> None:
    result = evaluate(Points.of(board(0.3, 0.01), 0.01), Artefact.PLANE, {}, 250.0, None, {Symbol.F: 0.2})
    (flat,) = result.quantities
    assert result.e_f is not None
    assert flat.value_mm == pytest.approx(250.0 * result.e_f)
    assert (flat.symbol, flat.compliance) == (Symbol.F, Compliance.FAIL)
    assert flat.value_mm > 0.25


def test_a_limit_is_kept_or_exceeded_only_beyond_the_uncertainty_and_all_together_if_each_is() -> None:
    for value_mm, uncertainty_mm, limit_mm, compliance in (
        (0.04, 0.01, 0.05, Compliance.PASS), (-0.03, 0.01, 0.05, Compliance.PASS),
        (0.045, 0.01, 0.05, Compliance.UNDECIDED), (-0.055, 0.01, 0.05, Compliance.UNDECIDED),
        (0.07, 0.01, 0.05, Compliance.FAIL), (-0.07, 0.01, 0.05, Compliance.FAIL),
        (0.0500001, None, 0.05, Compliance.FAIL), (0.05, None, 0.05, Compliance.PASS),
        (9.0, None, None, Compliance.NO_LIMIT),
    ):  # fmt: skip
        assert Quantity(Symbol.SD, "length", value_mm, uncertainty_mm, 100, 0, limit_mm).compliance is compliance
    one, over = (Quantity(Symbol.PF, "first ball", value_mm, None, 100, 0, 0.2) for value_mm in (0.1, 0.3))
    free, doubt = Quantity(Symbol.F, "plane", 0.3, None, 100, 0), Quantity(Symbol.SD, "length", 0.2, 0.01, 100, 0, 0.2)
    for quantities, kept in (
        ([one, free], Compliance.PASS), ([one, doubt], Compliance.UNDECIDED), ([one, doubt, over], Compliance.FAIL),
        ([free], Compliance.NO_LIMIT), ([], Compliance.NO_LIMIT),
    ):  # fmt: skip
        assert overall(quantities) is kept
    assert expanded_mm(3.0, 4.0, None) == pytest.approx(10.0), "squares add, and what is not known is nothing"


BAR = '[[scan]]\nscan = "1"\nartefact = "ball-bar"\nlength_mm = 150.0\nradius_mm = 15.0\nradius_sd_mm = 0.001\n'


def test_a_list_states_limits_and_the_radius_with_its_uncertainty_and_a_wrong_limit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "list.toml"
    path.write_text("[limits]\npf_mm = 0.1\nf_mm = 0.2\n" + BAR)
    listed = ScanList.read(path)
    assert listed.limits_mm == {Symbol.PF: 0.1, Symbol.F: 0.2}
    assert (listed.entries[0].radius_mm, listed.entries[0].radius_sd_mm) == (15.0, 0.001)
    for text, words in (
        ("limits = 3", "limits is no table; give [limits] with pf_mm, ps_mm, sd_mm, f_mm"),
        ("[limits]\npx_mm = 0.1", "limits.px_mm is unknown; allowed are f_mm, pf_mm, ps_mm, sd_mm"),
        ("[limits]\npf_mm = 0.0", "limits.pf_mm is 0.0; allowed are numbers 0.0001..10"),
        ('[limits]\nsd_mm = "small"', "limits.sd_mm is 'small'; allowed are numbers"),
    ):
        path.write_text(f"{text}\n{BAR}")
        with pytest.raises(ListError, match=re.escape(words)):
            ScanList.read(path)
