"""Detection by loops and overlaps: wrong pairs in a row of scans, and a depth error that the calibration does not
state.

The row is placed once. Then a pair is given another pose, or all pairs are given what a shared error would do to them
(by their own derivatives, which ``tests/appliance/desk/registration/test_bow.py`` holds against real registrations),
and the graph is solved again.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from appliance.calibrate.health import OVERLAP_LIMIT
from appliance.desk.registration.bow import PRIOR_MM2, bow_score, prior_covariance
from appliance.desk.registration.graph import Edge, place
from appliance.desk.registration.solve import edges_of, middle_of, solve
from appliance.measure.light.rotation import rotation_matrix
from appliance.measure.overlap.pair import ReadyScan
from appliance.measure.overlap.rigid import Rigid
from bench.merge.pairs import ready_of
from bench.merge.row import FORTH, drawn
from bench.merge.views import Array, view_of
from bench.progress import Progress
from bench.result import Measurement
from bench.spread import spread

RIG_SET = "realistic"
TRIES = 6
"""Pairs that are made wrong in each way, one at a time."""
REPEAT_MM = 12.0
"""Side of a square of the simulated world's grid, by which paint repeats."""
SHIFTS_MM = (0.3, 0.5, 1.0, 2.0)
STATED_SHARE = 0.36
"""Stated variance of the depth error over the usual one, as of rigs after a water calibration."""
TIMES = (0.0, 1.0, 2.0, 4.0, 6.0, 8.0)
"""Injected errors, in stated standard deviations."""
DRAWS = 12


def measure(
    seed: int, size_px: tuple[int, int], keep: Path | None
) -> tuple[list[Measurement], dict[str, list[dict[str, Any]]]]:
    """Return figures, and the rows of both tables."""
    requests = drawn(seed, RIG_SET, size_px)[:FORTH]
    progress = Progress(len(requests))
    scans: list[ReadyScan] = []
    for view in spread(partial(view_of, keep=keep), requests):
        progress.step(f"view {len(scans) + 1} of {len(requests)}")
        scans.append(ready_of(view))
    return noticed(seed, scans)


def noticed(seed: int, scans: list[ReadyScan]) -> tuple[list[Measurement], dict[str, list[dict[str, Any]]]]:
    """Return figures and tables of scans in a row, as ``measure`` takes them."""
    solved = solve(scans, lambda *_: None)
    middles = {k: middle_of(scan) for k, scan in enumerate(scans)}
    edges = list(solved.placed.used)
    bridges = {(edge.first, edge.second) for edge in solved.placed.unchecked}
    looped = [edge for edge in edges if (edge.first, edge.second) not in bridges]
    figures = [
        Measurement("loops: scans placed", len(solved.placed.poses), f"of {len(scans)}"),
        Measurement("loops: pairs accepted, of them in no loop", len(edges), f"{len(bridges)}"),
        Measurement(
            "loops: right pairs taken out of the row as it is", len(edges_of(solved.compared)) - len(edges), ""
        ),
    ]
    wrong_rows = _wrong(seed, edges, looped, middles)
    for row in wrong_rows:
        figures.append(Measurement(f"loops: {row['made wrong by']}, found", row["found"], f"of {row['tried']}"))
    power = _power(seed, len(scans), edges, middles)
    for row in power:
        figures.append(
            Measurement(
                f"health: error of {row['times']:g} stated sigma, alarms", row["alarms"], f"of {row['draws']}",
                at_most=0.0 if row["times"] <= 1.0 else None,
            )
        )  # fmt: skip
        figures.append(Measurement("health: the same, score in the median", row["score"], ""))
    return figures, {"wrong": wrong_rows, "power": power}


def _wrong(seed: int, edges: list[Edge], looped: list[Edge], middles: dict[int, Array]) -> list[dict[str, Any]]:
    rng = np.random.default_rng([31, seed])
    ways = [("half a turn about the view", None), ("one repeat of the paint", REPEAT_MM)]
    ways += [(f"a shift of {shift:g} mm", shift) for shift in SHIFTS_MM]
    count, rows = max(max(edge.first, edge.second) for edge in edges) + 1, []
    for name, shift_mm in ways:
        detected = right_removed = 0
        missed_mm: list[float] = []
        chosen = [looped[k] for k in rng.choice(len(looped), min(TRIES, len(looped)), replace=False)]
        for edge in chosen:
            wrong_edge = _made_wrong(edge, shift_mm, rng)
            placed = place(
                count,
                [wrong_edge if edge_or_other is edge else edge_or_other for edge_or_other in edges],
                middles,
                with_bow=False,
            )
            is_wrong = [edge_or_other is wrong_edge for edge_or_other in placed.wrong]
            detected += any(is_wrong)
            right_removed += len(is_wrong) - sum(is_wrong)
            if not any(is_wrong):
                missed_mm.append(placed.discrepancy_mm.get((edge.first, edge.second), float("nan")))
        rows.append(
            {
                "made wrong by": name,
                "tried": len(chosen),
                "found": detected,
                "right pairs taken out": right_removed,
                "left in, discrepancy at most mm": max(missed_mm, default=None),
            }
        )
    return rows


def _made_wrong(edge: Edge, shift_mm: float | None, rng: np.random.Generator) -> Edge:
    pose, middle_mm = edge.fit.pose, edge.fit.middle_mm
    if shift_mm is None:
        half_turn = rotation_matrix(np.array([0.0, 0.0, np.pi]))
        return replace(
            edge,
            fit=replace(
                edge.fit,
                pose=Rigid(half_turn @ pose.rotation, half_turn @ (pose.translation_mm - middle_mm) + middle_mm),
            ),
        )
    # In the image's plane, where a slide or a repeat goes.
    direction = rng.normal(size=2)
    shift = shift_mm * np.array([*(direction / np.linalg.norm(direction)), 0.0])
    return replace(edge, fit=replace(edge.fit, pose=Rigid(pose.rotation, pose.translation_mm + shift)))


def _power(seed: int, count: int, edges: list[Edge], middles: dict[int, Array]) -> list[dict[str, Any]]:
    rng = np.random.default_rng([32, seed])
    prior = prior_covariance(STATED_SHARE * PRIOR_MM2)
    root = np.linalg.cholesky(STATED_SHARE * PRIOR_MM2)
    rows = []
    for times in TIMES:
        scores = []
        for _ in range(DRAWS if times else 1):
            shared = times * (root @ rng.normal(size=len(root)))
            placed = place(count, [_bent(edge, shared) for edge in edges], middles, with_bow=True, prior_mm2=prior)
            scores.append(bow_score(placed.bow_mm, prior, placed.bow_covariance))
        valid_scores = [score for score in scores if score is not None]
        rows.append(
            {
                "times": times,
                "draws": len(scores),
                "told": len(valid_scores),
                "score": float(np.median(valid_scores)) if valid_scores else float("nan"),
                "alarms": sum(score > OVERLAP_LIMIT for score in valid_scores),
            }
        )
    return rows


def _bent(edge: Edge, shared_mm: Array) -> Edge:
    """Return the pair with a shared depth error in the points of both scans."""
    fit = edge.fit
    delta = fit.depth_error.response @ shared_mm
    rotation = rotation_matrix(delta[:3] / fit.lever_mm)
    middle_mm = fit.middle_mm
    pose = Rigid(rotation @ fit.pose.rotation, rotation @ (fit.pose.translation_mm - middle_mm) + middle_mm + delta[3:])
    news = replace(fit.depth_error, gradient=fit.depth_error.gradient - fit.depth_error.information @ shared_mm)
    return replace(edge, fit=replace(fit, pose=pose, depth_error=news))
