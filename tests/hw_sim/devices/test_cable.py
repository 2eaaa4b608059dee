"""A computer outside drives the projector: its pictures are what lights the scene and what the board counts."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from hw_sim.devices.cable import HELD_PERIODS, Cable
from hw_sim.options import OptionError
from hw_sim.world import World, WorldOptions

PERIOD_S = 0.4


@pytest.fixture
def world() -> Iterator[World]:
    options = WorldOptions(world="cable", width_px=64, height_px=48, pace="realtime", truth="nominal", noise=False)
    with World(options, Cable(round(PERIOD_S * 1e9))) as made:
        yield made


def picture(code: int) -> np.ndarray:
    return np.full((768, 1024), code, np.uint8)


def show(world: World, code: int) -> None:
    assert world.cable is not None
    with world.time.condition:
        world.cable.show(picture(code))


def count(world: World) -> int:
    """The board's number of the latest vertical sync."""
    return world.board._count


def test_each_picture_is_a_sync_and_lights_the_scene(world: World) -> None:
    for code in (40, 200, 90):
        before = count(world)
        show(world, code)
        world.time.sleep_s(0.1)
        assert count(world) == before + 1
        assert int(world.scanned_out("projector").min()) == code


def test_a_picture_that_stays_is_shown_again(world: World) -> None:
    show(world, 50)
    world.time.sleep_s(0.1)
    before = count(world)
    world.time.sleep_s(5 * HELD_PERIODS * PERIOD_S)
    assert 4 <= count(world) - before <= 5


def test_two_pictures_at_once_are_two_syncs(world: World) -> None:
    assert world.cable is not None
    before = count(world)
    with world.time.condition:
        world.cable.show(picture(10))
        world.cable.show(picture(20))
    world.time.sleep_s(0.2)
    assert count(world) == before + 2
    assert int(world.scanned_out("projector").max()) == 20


def test_without_a_picture_the_board_has_no_sync_and_the_scene_no_light(world: World) -> None:
    world.time.sleep_s(0.5)
    assert count(world) == 1, "the console of before"
    assert int(world.scanned_out("projector").max()) == 0


def test_a_sequence_exposes_each_picture_with_its_own_pulse(world: World) -> None:
    """Bright and dark in turn: what the camera saw last follows what was shown last."""
    world.view("left")  # the scene is built before anybody waits for an image
    with world.time.condition:
        world.cameras["left"].settings.trigger_on = 1
        world.cameras["left"].start()
    means = []
    for number, code in enumerate((240, 0, 240, 0), 1):
        before, old = count(world), world.seen("left")
        show(world, code)
        assert until(world, lambda: count(world) > before)  # noqa: B023
        with world.time.condition:
            world.board._obey("ARM", ("1", str(count(world) + 1), "500", "12000"))
        assert until(world, lambda: world.seen("left") is not old)  # noqa: B023
        assert world.board.series == number
        seen = world.seen("left")
        assert seen is not None
        means.append(float(seen.mean()))
    assert min(means[0], means[2]) > 3 * max(means[1], means[3])


def until(world: World, what: Callable[[], bool]) -> bool:
    """Whether it comes true within a minute."""
    for _ in range(1200):
        if what():
            return True
        world.time.sleep_s(0.05)
    return False


def test_only_a_picture_of_the_projectors_size_fits(world: World) -> None:
    assert world.cable is not None
    with pytest.raises(ValueError, match="1024"):
        world.cable.show(np.zeros((800, 1280), np.uint8))


def test_a_clock_that_is_not_the_real_one_is_refused() -> None:
    with pytest.raises(OptionError, match="realtime"):
        World(WorldOptions(world="lock-step"), Cable(10**9))
