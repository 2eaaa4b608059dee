"""The scan-out code on the simulated card: what the driver says it shows is what lights the simulated scene."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.light.draw import draw_sequence
from appliance.measure.light.patterns import build_sequence
from drivers.api import DeviceRefused, Flip
from drivers.output.gl import open_gl
from drivers.output.outputs import Outputs, open_outputs
from drivers.output.spec import OutputKind, OutputSpec
from tests.integration.drivers.conftest import Rig

PROJECTOR = OutputSpec(OutputKind.KMS, "/dev/dri/card0", "HDMI-A-1", 1024, 768, 60.0)
DISPLAY = OutputSpec(OutputKind.KMS, "/dev/dri/card0", "DP-1", 800, 480, 60.0)


def codes(number: int) -> list[NDArray[np.uint8]]:
    return [np.full((768, 1024), 10 + index, np.uint8) for index in range(number)]


def never() -> bool:
    return False


def test_every_drawn_pattern_lights_the_scene_code_for_code_and_closing_darkens_it(rig: Rig) -> None:
    with open_gl() as gl:
        frames = draw_sequence(gl, build_sequence(64))
    with Outputs(PROJECTOR, DISPLAY, rig.wires) as outputs:
        projector, display = outputs.open_projector(), outputs.open_display()
        assert not rig.world.scanned_out("projector").any(), "it begins black"
        projector.load(frames)
        for index, frame in enumerate(frames):
            projector.show(index)
            np.testing.assert_array_equal(rig.world.scanned_out("projector"), frame)
        projector.show(0)
        np.testing.assert_array_equal(rig.world.scanned_out("projector"), frames[0])
        outputs.close_projector()
        outputs.close_projector()
        picture = np.random.default_rng(5).integers(0, 256, (480, 800, 3), dtype=np.uint8)
        display.present(picture, 2.0)  # until the next blank the scene is lit by what was scanned out before
        np.testing.assert_array_equal(rig.world.scanned_out("display"), picture)
        assert not rig.world.scanned_out("projector").any()


def test_a_play_has_consecutive_blanks_in_world_time_while_another_thread_presents(rig: Rig) -> None:
    frames, stop = codes(25), threading.Event()
    presented: list[Flip] = []
    with open_outputs(PROJECTOR, DISPLAY, rig.wires) as (projector, display):
        projector.load(frames)

        def present() -> None:
            while not stop.is_set():
                presented.append(display.present(np.full((480, 800, 3), 77, np.uint8), 5.0))

        screen = threading.Thread(target=present)
        screen.start()
        try:
            for _ in range(5):  # in real time a busy machine may miss a blank; it must then say so
                agreed: list[int] = []

                def start(flip: Flip, agreed: list[int] = agreed) -> int | None:
                    assert flip.sequence is not None
                    agreed.append(flip.sequence + 6)
                    return agreed[0]

                flips = projector.play(range(24), 24, start, never)
                steps = np.diff([flip.sequence for flip in flips if flip.sequence is not None])
                on_time = flips[0].sequence == agreed[0] and bool((steps == 1).all())
                assert on_time == (len(flips) == 24)
                if on_time:
                    break
        finally:
            stop.set()
            screen.join(20.0)
        assert on_time
        assert [flip.index for flip in flips] == list(range(24))
        np.testing.assert_allclose(np.diff([flip.time_ns for flip in flips]) / 1e6, 1000.0 / 60.0, atol=0.01)
        np.testing.assert_array_equal(rig.world.scanned_out("projector"), frames[24])
        assert rig.world.scanned_out("display").min() == 77
    sequences = [flip.sequence for flip in presented if flip.sequence is not None]
    assert sequences == sorted(set(sequences))


def test_what_is_not_there_is_refused_with_what_is(rig: Rig) -> None:
    for wrong, said in (
        (replace(PROJECTOR, width_px=1000), r"1000×768 .* it offers .*1024×768 60.00 Hz"),
        (replace(PROJECTOR, connector="VGA-1"), r"VGA-1 .* it has .*HDMI-A-1.*DP-1"),
    ):
        with Outputs(wrong, DISPLAY, rig.wires) as outputs, pytest.raises(DeviceRefused, match=said):
            outputs.open_projector()
