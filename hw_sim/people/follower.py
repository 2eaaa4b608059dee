"""Owns how a diver follows the arrow on the screen: a step that way, a look at what is said then, until it says SCAN NOW."""

from __future__ import annotations

from hw_sim.people.operator import POLL_S, Operator, OperatorError

GOOD = "SCAN NOW"
LOOK_S = 2.0
"""The diver waits so long after a step: what is said then is said of where the instrument is."""


def follow(diver: Operator, step_mm: float, timeout_s: float) -> bool:
    """Move the object before the instrument, by steps in the rig's x and y, as the screen's arrow tells; return whether the screen says SCAN NOW
    within ``timeout_s`` of world time, and still does after a look. Raises OperatorError for an object that has not been placed."""
    world = diver.world
    end_ns = world.time_ns + int(timeout_s * 1e9)
    while world.time_ns < end_ns and not diver.over:
        said = diver.status().get("guidance")
        words, toward = (str(said.get("words")), said.get("toward")) if isinstance(said, dict) else ("", None)
        if words.endswith(GOOD):
            diver.sleep(LOOK_S)
            again = diver.status().get("guidance")
            if isinstance(again, dict) and str(again.get("words")).endswith(GOOD):
                return True
        elif isinstance(toward, list) and len(toward) == 2:
            if world.scene.pose is None:
                raise OperatorError("follow: the object has no pose; place it first, by: object NAME X Y Z RX RY RZ")
            x, y, *more = world.scene.pose
            # The instrument goes toward it, which the object does the other way.
            right, down = (step_mm * float(part) for part in toward)
            world.set_object(world.scene.object, [x - right, y - down, *more])
            diver.sleep(LOOK_S)
        else:
            diver.sleep(POLL_S)
    return False
