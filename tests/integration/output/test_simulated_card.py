"""The scan-out code on the simulated card: what the driver says it shows is what lights the simulated scene."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

import hw_sim.wires
from appliance.patterns.draw import draw_sequence
from appliance.patterns.sequence import build_sequence
from drivers.api import DeviceRefused, Display, Flip, Projector, Wires
from drivers.board import BoardSpec
from drivers.output.gl import open_gl
from drivers.output.outputs import Outputs, open_outputs
from drivers.output.spec import OutputKind, OutputSpec
from drivers.rig import open_board
from hw_sim.world import World, WorldOptions

PROJECTOR = OutputSpec(OutputKind.KMS, "/dev/dri/card0", "HDMI-A-1", 1024, 768, 60.0)
DISPLAY = OutputSpec(OutputKind.KMS, "/dev/dri/card0", "DP-1", 800, 480, 60.0)
PERIOD_MS = 1000.0 / 60.0
_numbers = itertools.count()


@dataclass
class Rig:
    name: str
    world: World
    wires: Wires
    projector: Projector
    display: Display


@pytest.fixture
def name() -> str:
    return f"output-{next(_numbers)}"


@pytest.fixture
def simulated(name: str) -> Iterator[tuple[World, Wires]]:
    with World(WorldOptions(world=name)) as world, hw_sim.wires.open({"world": name}) as wires:
        yield world, wires


@pytest.fixture
def rig(name: str, simulated: tuple[World, Wires]) -> Iterator[Rig]:
    world, wires = simulated
    with open_outputs(PROJECTOR, DISPLAY, wires) as (projector, display):
        yield Rig(name, world, wires, projector, display)


def codes(number: int) -> list[NDArray[np.uint8]]:
    return [np.full((768, 1024), 10 + index, np.uint8) for index in range(number)]


def never() -> bool:
    return False


def test_every_drawn_pattern_lights_the_scene_code_for_code(rig: Rig) -> None:
    sequence = build_sequence(64)
    with open_gl() as gl:
        frames = draw_sequence(gl, sequence)
    rig.projector.load(frames)
    for index, frame in enumerate(frames):
        rig.projector.show(index)
        np.testing.assert_array_equal(rig.world.scanned_out("projector"), frame)


def test_the_display_shows_the_picture_in_its_colours(rig: Rig) -> None:
    rng = np.random.default_rng(5)
    for _ in range(3):
        picture = rng.integers(0, 256, (480, 800, 3), dtype=np.uint8)
        rig.display.present(picture, 2.0)
        np.testing.assert_array_equal(rig.world.scanned_out("display"), picture)


def test_both_outputs_begin_black(rig: Rig) -> None:
    assert not rig.world.scanned_out("projector").any()
    assert not rig.world.scanned_out("display").any()


def test_a_play_has_consecutive_blanks_in_world_time_and_ends_on_idle(rig: Rig) -> None:
    frames = codes(25)
    rig.projector.load(frames)
    agreed: list[int] = []

    def start(flip: Flip) -> int | None:
        assert flip.sequence is not None
        agreed.append(flip.sequence + 6)
        return agreed[0]

    for _ in range(5):  # in real time a busy machine may miss a blank; it must then say so
        agreed.clear()
        flips = rig.projector.play(range(24), 24, start, never)
        steps = np.diff([flip.sequence for flip in flips if flip.sequence is not None])
        on_time = flips[0].sequence == agreed[0] and (steps == 1).all()
        assert on_time == (len(flips) == 24)
        if on_time:
            break
    assert on_time
    assert [flip.index for flip in flips] == list(range(24))
    np.testing.assert_allclose(np.diff([flip.time_ns for flip in flips]) / 1e6, PERIOD_MS, atol=0.01)
    assert flips[-1].time_ns <= rig.wires.clock.now_ns()
    np.testing.assert_array_equal(rig.world.scanned_out("projector"), frames[24])


def test_presenting_goes_on_from_another_thread_during_a_play(rig: Rig) -> None:
    rig.projector.load(codes(4))
    stop = threading.Event()
    presented: list[Flip] = []
    picture = np.full((480, 800, 3), 77, np.uint8)

    def present() -> None:
        while not stop.is_set():
            presented.append(rig.display.present(picture, 5.0))

    screen = threading.Thread(target=present)
    screen.start()
    try:
        for _ in range(5):
            rig.projector.play([0, 1, 2], 3, lambda flip: None, never)
    finally:
        stop.set()
        screen.join(20.0)
    assert not screen.is_alive()
    assert len(presented) >= 5
    sequences = [flip.sequence for flip in presented if flip.sequence is not None]
    assert sequences == sorted(set(sequences))
    assert rig.world.scanned_out("display").min() == 77


def test_presenting_is_paced_by_the_worlds_blanks(rig: Rig) -> None:
    picture = np.zeros((480, 800, 3), np.uint8)
    flips = [rig.display.present(picture, 2.0) for _ in range(12)]
    steps_ms = np.diff([flip.time_ns for flip in flips]) / 1e6
    assert (steps_ms > 0.9 * PERIOD_MS).all()


def test_a_mode_that_the_beamer_does_not_have_is_refused_with_its_list(simulated: tuple[World, Wires]) -> None:
    _, wires = simulated
    with (
        Outputs(replace(PROJECTOR, width_px=1000), DISPLAY, wires) as outputs,
        pytest.raises(DeviceRefused, match=r"no mode 1000×768 at 60 Hz on HDMI-A-1; it offers .*1024×768 60.00 Hz"),
    ):
        outputs.open_projector()


def test_a_connector_that_is_not_there_is_refused_with_those_that_are(simulated: tuple[World, Wires]) -> None:
    _, wires = simulated
    with (
        Outputs(replace(PROJECTOR, connector="VGA-1"), DISPLAY, wires) as outputs,
        pytest.raises(DeviceRefused, match=r"VGA-1 is not on /dev/dri/card0; it has .*HDMI-A-1.*DP-1"),
    ):
        outputs.open_projector()


def test_closing_darkens_and_the_card_can_be_opened_again(simulated: tuple[World, Wires]) -> None:
    world, wires = simulated
    for code in (90, 120):
        with open_outputs(PROJECTOR, DISPLAY, wires) as (projector, _):
            projector.load([np.full((768, 1024), code, np.uint8)])
            projector.show(0)
            assert world.scanned_out("projector").min() == code
        wires.clock.sleep_s(0.05)  # the light goes out with the next blank
        assert not world.scanned_out("projector").any()


def test_a_projector_alone_goes_dark_while_its_card_and_the_display_stay(simulated: tuple[World, Wires]) -> None:
    world, wires = simulated
    with Outputs(PROJECTOR, DISPLAY, wires) as outputs:
        projector, display = outputs.open_projector(), outputs.open_display()
        projector.load(codes(1))
        projector.show(0)
        outputs.close_projector()
        outputs.close_projector()
        assert not world.scanned_out("projector").any()
        red = np.zeros((480, 800, 3), np.uint8)
        red[..., 0] = 200
        display.present(red, 1.0)
        assert (world.scanned_out("display")[..., 0] == 200).all()


def test_a_flip_that_the_card_completes_late_is_late_in_the_flips(rig: Rig) -> None:
    """The board is armed, so that the world waits for the flips: what is late is the card, not this machine."""
    rig.projector.load(codes(25))
    rig.world.fault("projector delayed frame=9")
    with open_board(BoardSpec(f"kfsim://{rig.name}/board"), rig.wires) as board:

        def start(flip: Flip) -> int | None:
            assert flip.sequence is not None
            vsync = board.vsync()
            board.arm(24, vsync.count + 8, 500, 12_000)
            return flip.sequence + 8

        flips = rig.projector.play(range(24), 24, start, never)
        board.stop()
    steps = np.diff([flip.sequence for flip in flips if flip.sequence is not None])
    assert [flip.index for flip in flips] == list(range(10))
    assert steps.tolist() == [1] * 8 + [2]
