"""Who moves the mouse moves the instrument: the object goes the other way, as fast, and rests when the hand rests."""

from __future__ import annotations

import numpy as np
import pytest

from hw_sim.objects.motion import PIVOT_MM, object_pose, pose_matrix
from hw_sim.people.hands import Hands
from hw_sim.scene import Scene

MS = 1_000_000
AT = (10.0, -5.0, 520.0, 3.0, 12.0, -7.0)


class Desk:
    """A world as far as hands know it."""

    def __init__(self) -> None:
        self.scene = Scene("plane", AT)
        self.recording = False

    def set_scene(self, scene: Scene) -> None:
        self.scene = scene


def test_the_object_goes_the_other_way_and_its_speed_is_the_hands() -> None:
    desk = Desk()
    hands = Hands(desk)
    for k in range(10):
        hands.shift(2.0, 0.0, k * 15 * MS)  # 1 mm in 15 ms
        hands.settle(k * 15 * MS)
    assert desk.scene.start_pose == pytest.approx((0.0, *AT[1:]), abs=1e-9)
    assert desk.scene.motion.velocity_mm_s == pytest.approx((1000.0 / 15.0, 0.0, 0.0), rel=0.15)
    hands.settle(1000 * MS)
    assert desk.scene.motion.still
    assert desk.scene.start_pose[0] == pytest.approx(0.0, abs=1e-9), "and it stays there"


def test_where_the_mouse_has_led_is_where_its_speed_would_have_led() -> None:
    desk = Desk()
    hands = Hands(desk)
    hands.turn(20.0, -8.0, 0)
    hands.settle(0)
    first, motion = desk.scene.start_pose, desk.scene.motion
    _, before = pose_matrix(AT)
    R, t = pose_matrix(first)
    assert np.linalg.norm(t - PIVOT_MM) == pytest.approx(np.linalg.norm(before - PIVOT_MM)), "about the pivot"
    R_later, t_later = object_pose(AT, motion, 0.15)
    assert np.allclose(R, R_later, atol=1e-9)
    assert np.allclose(t, t_later, atol=1e-9)


def test_a_sequence_is_not_disturbed_and_what_was_done_meanwhile_counts_afterwards() -> None:
    desk = Desk()
    hands = Hands(desk)
    desk.recording = True
    hands.wheel(2.0, 0)
    hands.settle(10 * MS)
    assert desk.scene.start_pose == AT
    desk.recording = False
    hands.settle(20 * MS)
    assert desk.scene.start_pose[2] == pytest.approx(510.0), "nearer"


def test_nobody_walks_through_the_window() -> None:
    desk = Desk()
    hands = Hands(desk)
    hands.wheel(100.0, 0)
    hands.settle(0)
    assert desk.scene.start_pose[2] == 250.0
