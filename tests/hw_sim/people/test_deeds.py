"""What a builder does to the parts: caps, the projector's menu, one thing mended; each does what it says and refuses the rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hw_sim.faults import FaultSyntaxError
from hw_sim.optics.beamer import Beamer
from hw_sim.options import WorldOptions
from hw_sim.people.commands import adjusted, check, do
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.world import World
from tests.hw_sim.conftest import SMALL

WHITE = np.full((768, 1024), 255, np.uint8)


@pytest.fixture
def world() -> Iterator[World]:
    with World(WorldOptions(**{**SMALL, "world": "deeds", "projector": "repeats"})) as made:
        yield made


def say(world: World, line: str) -> None:
    verb, *words = line.split()
    assert check(verb, tuple(words))
    do(world, verb, tuple(words), Path("nowhere"))


def light(world: World, side: str) -> float:
    renderer = Renderer(world.truth, world.scene)
    return float(renderer.light(side, [LightSlice(WHITE, 0.012)], 0.0, 0.012, (False, False)).mean())


def test_a_cap_makes_its_camera_blind_and_no_other(world: World) -> None:
    say(world, "cap left on")
    assert light(world, "left") == 0.0
    assert light(world, "right") > 100.0
    say(world, "cap both on")
    assert light(world, "right") == 0.0
    say(world, "cap left off")
    assert world.scene.capped == {"right"}
    assert light(world, "left") > 100.0
    assert not check("cap", ("middle", "on"))
    with pytest.raises(ValueError, match="capped"):
        world.set_caps("middle")


def test_the_projectors_menu_changes_what_is_true_of_it(world: World) -> None:
    say(world, "projector mirrored=true gamma=2.2 latency_blanks=2")
    beamer = world.projector_truth.beamer
    assert (beamer.kind, beamer.mirrored, beamer.gamma, world.projector_truth.latency_blanks) == (
        "repeats",
        True,
        2.2,
        2,
    )
    say(world, "projector mirrored=off gamma=off latency_blanks=off")
    assert world.projector_truth.beamer == Beamer("repeats")
    for words in (("brightness=3",), ("gamma=9",), ("mirrored=3",), ("gamma",)):
        with pytest.raises(ValueError, match=r"allowed"):
            check("projector", words)
    assert adjusted(Beamer(), ("scaled=[912,1140]",)) == replace(Beamer(), scaled=(912, 1140))


def test_the_world_goes_on_with_the_new_projector(world: World) -> None:
    for line in ("projector latency_blanks=3", "projector latency_blanks=0", "projector late_us=0 kind=ideal"):
        say(world, line)
        before_ns = world.time_ns
        with world.time.condition:
            assert world.time.wait_for(lambda past=before_ns + 200_000_000: world.time_ns >= past, 1.0)  # type: ignore[misc]
        assert world.scanned_out("projector").shape == (768, 1024)


def test_one_thing_is_mended_and_the_rest_stays_broken(world: World) -> None:
    for sentence in ("laser.left off", "laser.right stuck", "sensor.TPROJ off"):
        say(world, f"fault {sentence}")
    say(world, "mend laser.left off")
    assert world.broken == ("laser.right stuck", "sensor.TPROJ off")
    with pytest.raises(FaultSyntaxError, match=r"not broken; broken is: laser\.right stuck; sensor\.TPROJ off"):
        say(world, "mend laser.left off")
    with pytest.raises(FaultSyntaxError, match="not supported"):
        say(world, "mend laser.middle off")
