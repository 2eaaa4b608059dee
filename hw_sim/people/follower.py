"""A diver that follows the arrow on the screen, step by step, until it shows SCAN NOW."""

from __future__ import annotations

from hw_sim.people.operator import POLL_S, Operator, OperatorError

GOOD = "SCAN NOW"
LOOK_S = 2.0
"""Waiting time after a step, so that the guidance is of the present place."""


def follow(diver: Operator, step_mm: float, timeout_s: float) -> bool:
    """Move the object by steps in the rig's x and y, as the screen's arrow shows.

    Return True if the screen says SCAN NOW within ``timeout_s`` of world time, and still does after a wait. Raises
    OperatorError for an object that has not been placed.
    """
    world = diver.world
    end_ns = world.time_ns + int(timeout_s * 1e9)
    while world.time_ns < end_ns and not diver.over:
        guidance = diver.status().get("guidance")
        guidance_text, toward = (
            (str(guidance.get("words")), guidance.get("toward")) if isinstance(guidance, dict) else ("", None)
        )
        if guidance_text.endswith(GOOD):
            diver.sleep(LOOK_S)
            again = diver.status().get("guidance")
            if isinstance(again, dict) and str(again.get("words")).endswith(GOOD):
                return True
        elif isinstance(toward, list) and len(toward) == 2:
            if world.scene.pose is None:
                raise OperatorError("follow: the object has no pose; place it first with: object NAME X Y Z RX RY RZ")
            x, y, *more = world.scene.pose
            # The instrument moves in that direction, so the object in the opposite one.
            right, down = (step_mm * float(part) for part in toward)
            world.set_object(world.scene.object, [x - right, y - down, *more])
            diver.sleep(LOOK_S)
        else:
            diver.sleep(POLL_S)
    return False
