"""The rows of the table in ``docs/calibration-health.md`` that a default run can afford: seen, or not, as it says."""

from __future__ import annotations

import pytest

from bench.health_changes import changes, length_error_percent
from tests.support.gap_scans import calibrated, learnt, scans_until_alarm

CHANGES = {change.name: change for change in changes()}
MADE = calibrated(1)


@pytest.mark.parametrize(
    ("name", "size", "most"),
    [
        ("principal distance, right", 1.0, 2),
        ("interface distance, right", 0.15, 2),
        ("right port tilted about x", 0.1, 1),
        ("right camera shifted along y", 0.1, 1),
        ("right camera shifted along z", 0.05, 2),
        ("water warmer than stated", 10.0, 8),
        ("water colder than stated", 10.0, 8),
    ],
)
def test_is_seen(name: str, size: float, most: int) -> None:
    changed = CHANGES[name].make(MADE.truth, size)
    assert scans_until_alarm(MADE, learnt(MADE), changed, most) is not None


@pytest.mark.parametrize(("name", "size"), [("principal distance, both", 1.0), ("interface distance, both", 0.3)])
def test_what_both_cameras_have_in_common_is_for_the_length_check(name: str, size: float) -> None:
    changed = CHANGES[name].make(MADE.truth, size)
    assert scans_until_alarm(MADE, learnt(MADE), changed, most=6) is None
    assert length_error_percent(MADE.truth, changed, MADE.rig) > 0.005


def test_length_errors_are_those_that_optics_says() -> None:
    """0.01° of toe-in between the cameras is 0.047 % of a length in depth or across; water, 0.0072 % per 1e-4."""
    yaw = CHANGES["right camera turned about y (yaw)"].make(MADE.truth, 0.01)
    assert length_error_percent(MADE.truth, yaw, MADE.rig) == pytest.approx(0.055, abs=0.012)
    salt = CHANGES["water saltier than stated"].make(MADE.truth, 35.0)
    index = 1e4 * (salt.n_water - MADE.truth.n_water)
    assert length_error_percent(MADE.truth, salt, MADE.rig) == pytest.approx(0.0072 * index, rel=0.15)
