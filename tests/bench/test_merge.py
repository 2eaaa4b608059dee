"""The figures of merged scans count what is wrong, also where it is as wrong as can be."""

from __future__ import annotations

from typing import Any

import numpy as np

from appliance.registration.rigid import Rigid
from bench.merge import pairs, row
from tests.support import synthetic
from tests.support.views import between, view

SMALL = synthetic.calibration(192, 144)


def drawn(*, error_mm: float, overlap: float = 0.6) -> dict[str, Any]:
    return {
        "shape": "shell", "paint": "none", "overlap": overlap, "tells": True, "solvable": overlap > 0.4, "accepted": True,
        "refusal": None, "error_mm": error_mm, "sigma_mm": 0.01, "ready_s": 0.1, "pair_s": 0.1,
    }  # fmt: skip


def test_a_pair_that_was_accepted_and_shares_nothing_is_counted_as_wrong() -> None:
    # Two ends of the main, 600 mm apart, that somebody lays upon each other.
    first = view("main", (300.0, 0.0, 545.0, 0.0, 0.0, 0.0), "slight", 1, SMALL)
    second = view("main", (-300.0, 0.0, 545.0, 0.0, 0.0, 0.0), "slight", 2, SMALL)
    true = between(first, second)
    points, overlap = pairs.judged_on(first.ready(), second.ready(), true)
    assert overlap == 0.0
    assert abs(pairs.off_mm(Rigid(np.eye(3), np.zeros(3)), true, points) - 600.0) < 1.0
    found = pairs.figures([drawn(error_mm=0.02), drawn(error_mm=600.0, overlap=0.0)])[0]
    assert found.value == 1.0
    assert not found.kept


def test_the_way_that_is_gone_unless_asked_otherwise_keeps_both_bounds() -> None:
    def kept(*, default: bool, length_percent: float, worst_over_sigma: float) -> bool:
        of_row = {
            "length_percent": length_percent, "worst_mm": 0.3, "budget_mm": 0.5, "worst_over_sigma": worst_over_sigma,
        }  # fmt: skip
        return all(one.kept for one in row.figures("row", of_row, default=default))

    assert kept(default=True, length_percent=0.019, worst_over_sigma=1.9)
    assert not kept(default=True, length_percent=0.021, worst_over_sigma=1.0)
    assert not kept(default=True, length_percent=0.005, worst_over_sigma=2.1), "more bent than the budget says"
    assert kept(default=False, length_percent=0.005, worst_over_sigma=6.0), "the estimate is not believed, and printed"
