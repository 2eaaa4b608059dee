"""Surfaces are what their dimensions say, rays never step through them, and the tape measure measures."""

from __future__ import annotations

import numpy as np
import pytest

from hw_sim.objects import shapes
from hw_sim.objects.shapes import BOX, NAMES, distances, march_all, values
from hw_sim.truth import Artefacts

SIZES = Artefacts().sizes()


def field(name: str, points: np.ndarray) -> np.ndarray:
    out = np.empty(len(points))
    values(NAMES[name], SIZES, np.ascontiguousarray(points), out)
    return out


def measured(name: str, points: np.ndarray, sizes: np.ndarray = SIZES) -> np.ndarray:
    out = np.empty(len(points))
    distances(NAMES[name], sizes, np.ascontiguousarray(points, dtype=float), out)
    return out


def rays_at(name: str, count: int, seed: int) -> np.ndarray:
    """Rays from where the instrument is, towards all of the object and a little beside it."""
    rng = np.random.default_rng(seed)
    start = np.column_stack([rng.uniform(-130, 130, count), rng.uniform(-60, 60, count), np.full(count, -480.0)])
    box = BOX[NAMES[name]]
    aim = rng.uniform(box[:3] - 8.0, box[3:] + 8.0, (count, 3))
    direction = (aim - start) / np.linalg.norm(aim - start, axis=1)[:, None]
    return np.ascontiguousarray(np.hstack([start, direction]))


@pytest.mark.parametrize("name", list(NAMES))
def test_marching_finds_the_first_surface_that_small_steps_find(name: str) -> None:
    rays = rays_at(name, 150, 8)
    found = np.empty(len(rays))
    march_all(NAMES[name], SIZES, rays, found)
    at = np.arange(300.0, 720.0, 0.05)
    hits, thin = 0, 0
    for ray, distance in zip(rays, found, strict=True):
        inside = field(name, ray[:3] + at[:, None] * ray[3:]) < 0.0
        if inside.any():
            first = at[np.argmax(inside)]
            assert distance <= first + 1e-9, "stepped through"
            thin += distance < first - 0.0501  # through a sliver of less than a step
            hits += 1
        elif not np.isnan(distance):
            thin += 1
    assert hits > 20
    assert thin <= 3


def test_simple_bodies_have_their_textbook_distances() -> None:
    rng = np.random.default_rng(4)
    way = rng.normal(size=(300, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    way = way[way[:, 0] > 0.3]  # not towards the bar
    off = rng.uniform(-2.0, 6.0, len(way))
    ball = np.array([shapes.BALL_DISTANCE_MM / 2, 0.0, 0.0]) + way * (shapes.BALL_RADIUS_MM + off)[:, None]
    np.testing.assert_allclose(measured("ballbar", ball), off, atol=1e-6)

    angle, off = rng.uniform(0, 2 * np.pi, 200), rng.uniform(-2.0, 3.0, 200)
    radius = shapes.PIPE_RADIUS_MM + off
    pipe = np.column_stack([rng.uniform(-20.0, 25.0, 200), radius * np.cos(angle), radius * np.sin(angle)])
    np.testing.assert_allclose(measured("pipe", pipe), off, atol=1e-6)

    flat = np.column_stack([rng.uniform(-100, 100, 200), rng.uniform(-80, 80, 200), -off])
    np.testing.assert_allclose(measured("plane", flat), off, atol=1e-6)

    slant = np.array([45.0, 0.0, -35.0]) / np.hypot(45.0, 35.0)  # outward normal of the flank at +x
    foot = np.column_stack([75.0 + rng.uniform(-30, -15, 200) * 35 / 45, rng.uniform(-15, 15, 200), np.zeros(200)])
    foot[:, 2] = (foot[:, 0] - 75.0) * 45 / 35
    np.testing.assert_allclose(measured("frustum", foot + off[:, None] * slant), off, atol=1e-6)


@pytest.mark.parametrize("name", ["shell", "stones", "pipe"])
def test_a_point_above_the_surface_is_as_far_as_it_was_lifted(name: str) -> None:
    rays = rays_at(name, 3000, 6)
    found = np.empty(len(rays))
    march_all(NAMES[name], SIZES, rays, found)
    points = (rays[:, :3] + found[:, None] * rays[:, 3:])[np.isfinite(found)]
    h = 1e-4
    steps = h * np.eye(3)
    slope = np.stack([(field(name, points + s) - field(name, points - s)) / (2 * h) for s in steps], -1)
    normal = slope / np.linalg.norm(slope, axis=1)[:, None]
    for lift in (-0.3, -0.05, 0.05, 0.3):
        error = np.abs(measured(name, points + lift * normal) - lift)
        # Beside creases and edges another face is nearer than the one the point was lifted from.
        assert np.quantile(error, 0.97) < 1e-4
        assert (np.abs(measured(name, points + lift * normal)) < abs(lift) + 1e-4).mean() > 0.999


def test_artefacts_are_as_the_workshop_made_them() -> None:
    long = Artefacts(ball_distance_mm=150.5).sizes()
    tip = np.array([[150.5 / 2 + shapes.BALL_RADIUS_MM, 0.0, 0.0]])
    assert measured("ballbar", tip, long)[0] == pytest.approx(0.0, abs=1e-9)
    assert measured("ballbar", tip)[0] == pytest.approx(0.25, abs=1e-9)
    bowed = Artefacts(plane_bow_mm=0.2).sizes()
    assert measured("plane", np.array([[0.0, 0.0, 0.0]]), bowed)[0] == pytest.approx(0.2, abs=1e-5)
    edge = shapes.PLANE_HALF_X_MM / np.sqrt(2)
    assert measured("plane", np.array([[edge, 0.0, 0.0]]), bowed)[0] == pytest.approx(0.0, abs=1e-5)
