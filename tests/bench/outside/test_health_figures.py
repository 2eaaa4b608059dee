"""What is counted over the scans that the watch over the calibration sees: scans judged, and turns made in their ray gaps."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.outside.health import figures

COUNT, ACROSS = 48, 8
Y, X = np.divmod(np.arange(COUNT), ACROSS)
PATTERNS = np.stack([np.ones(COUNT), (X - 3.5) / 2.3, (Y - 2.5) / 1.7, (X - 3.5) * (Y - 2.5) / 3.9], -1)
TURNS_UM = [[9_300.0, 0.0, 0.0, 0.0], [0.0, 0.0, 40.0, 20.0], [0.0, 1_100.0, 0.0, 0.0]]
NORMAL = 12


def rows(turns_um: list[list[float]] | None, seen: int = COUNT) -> dict[int, list[dict[str, Any]]]:
    """Return the rows of one instrument: normal scans, and three with a large knock."""
    rng = np.random.default_rng(10_020)
    found = []
    for number in range(NORMAL + 3):
        gap = rng.normal(0.0, 1.0, seen) + (200.0 if number >= NORMAL else 0.0)
        gaps = {
            "patch": list(range(seen)), "gap_um": gap.tolist(), "noise_um": [1.0] * seen, "modes": PATTERNS[:seen].tolist(),
            "samples": 5_000, "water_index": 1.335, "turns_um": turns_um,
        }  # fmt: skip
        found.append({"gaps": gaps, "faults": [], "complete_percent": 90.0, "error_over_sigma": 1.0, "number": number})
    return {0: found}


def named(of: dict[int, list[dict[str, Any]]]) -> dict[str, float]:
    return {one.name: one.value for one in figures(of, NORMAL)}


def test_turns_are_found_as_far_as_gaps_show_them_and_what_is_not_found_was_announced() -> None:
    found = named(rows(TURNS_UM))
    about = {
        axis: found[f"turns of 0.02° about {axis}, in the gaps of normal scans, found within three"] for axis in "xyz"
    }
    assert about == {"x": 2, "y": 0, "z": 2}
    assert found["of these not found though each scan says it would be"] == 0
    assert found["normal scans that are judged"] == NORMAL
    assert found["knocks of 0.02° found within three judged scans"] == 1
    assert found["knocks missed though each scan says that it would find them"] == 0


def test_scans_that_are_not_judged_are_no_good_ones() -> None:
    found = named(rows(TURNS_UM, seen=7))
    assert found["normal scans that are judged"] == 0
    assert found["turns of 0.02° about x, in the gaps of normal scans, found within three"] == 0


def test_rows_of_a_product_that_knows_no_turns_are_counted_without() -> None:
    assert named(rows(None))["knocks of 0.02° found within three judged scans"] == 1
