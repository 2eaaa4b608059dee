"""Tolerances of the set ``outside`` are those of the rig's own workshop, and rigs scatter by them."""

from __future__ import annotations

import numpy as np

from hw_sim.objects.shapes import BALL_DISTANCE_MM
from hw_sim.truth import draw_truth, in_air
from hw_sim.workshop import RANGES, drawn_tolerances

N_WATER = 1.335


def test_every_workshop_is_within_the_ranges_and_no_two_are_alike() -> None:
    drawn = [drawn_tolerances(seed) for seed in range(50)]
    for name, allowed in RANGES.items():
        values = [tolerances[name] for tolerances in drawn]
        assert allowed.low <= min(values) < max(values) <= allowed.high
        assert len(set(values)) == 50


def test_rigs_scatter_by_the_tolerances_of_their_workshop() -> None:
    errors, refocused = [], []
    for seed in range(150):
        rig, tolerances = draw_truth("outside", seed, 400, 300, N_WATER), drawn_tolerances(seed)
        errors.append((rig.artefacts.ball_distance_mm - BALL_DISTANCE_MM) / tolerances["artefact_mm"])
        refocused.append((in_air(rig).left.f_px[0] / rig.left.f_px[0] - 1.0) / tolerances["refocus"])
    for normal in (errors, refocused):
        assert 0.82 < np.std(normal) < 1.18, "in units of its own tolerance each is a standard normal number"
        assert abs(np.mean(normal)) < 0.33
