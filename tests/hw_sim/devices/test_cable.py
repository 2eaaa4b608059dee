"""A computer outside drives the projector: its pictures are what lights the scene and what the board counts."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from hw_sim.devices.cable import Cable
from hw_sim.world import World, WorldOptions

PERIOD_S = 0.4


@pytest.fixture
def world() -> Iterator[World]:
    options = WorldOptions(world="cable", width_px=64, height_px=48, pace="realtime", truth="nominal", noise=False)
    with World(options, Cable(round(PERIOD_S * 1e9))) as made:
        yield made


def show(world: World, code: int) -> None:
    assert world.cable is not None
    with world.time.condition:
        world.cable.show(np.full((768, 1024), code, np.uint8))


def until(world: World, what: Callable[[], bool]) -> bool:
    """Whether it comes true within a minute."""
    for _ in range(1200):
        if what():
            return True
        world.time.sleep_s(0.05)
    return False


def test_each_picture_is_a_sync_and_a_sequence_exposes_it_with_its_own_pulse(world: World) -> None:
    """Bright and dark in turn: what the camera saw last follows what was shown last."""
    world.view("left")  # the scene is built before anybody waits for an image
    with world.time.condition:
        world.cameras["left"].settings.trigger_on = 1
        world.cameras["left"].start()
    means = []
    for number, code in enumerate((240, 0, 240, 0), 1):
        before, old = world.board._count, world.seen("left")
        show(world, code)
        assert until(world, lambda: world.board._count > before)  # noqa: B023
        assert int(world.scanned_out("projector").min()) == code
        with world.time.condition:
            world.board._obey("ARM", ("1", str(world.board._count + 1), "500", "12000"))
        assert until(world, lambda: world.seen("left") is not old)  # noqa: B023
        assert world.board.series == number
        seen = world.seen("left")
        assert seen is not None
        means.append(float(seen.mean()))
    assert min(means[0], means[2]) > 3 * max(means[1], means[3])
