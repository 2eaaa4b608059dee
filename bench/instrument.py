"""A simulated instrument without its service: shipped drivers and capture over simulated wires, one scan at a time.

The world runs in lock-step with the vertical blank, so that a slow machine records the same frames as a fast one.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from appliance.instrument.capture.grabber import Grabber
from appliance.instrument.capture.scan import ScanRecorder, ScanSettings
from appliance.instrument.capture.store import FrameStore
from appliance.measure.light.patterns import PatternSequence, build_sequence
from appliance.measure.light.sides import SIDES
from drivers import rig as drivers_rig
from drivers.api import CameraSettings, Wires
from hw_sim.options import WorldOptions
from hw_sim.wires import open as open_wires
from hw_sim.world import World
from tests.support.rendered import pictures

CARD = "/dev/dri/card0"
REFRESH_HZ, EXPOSURE_US, TRIGGER_DELAY_US = 60.0, 12_000, 500
IDLE_SPEED = 0.5
"""World seconds per second between recordings, slow enough for a busy host to keep the board's heartbeat."""
_NAMES = (f"bench-{k}" for k in itertools.count())


class ScanFailedError(Exception):
    """A scan ended with a fault; the text is the product's own."""


@dataclass(frozen=True, slots=True)
class Instrument:
    """One true rig on its wires. Frames lie in ``store`` until the next scan."""

    world: World
    sequence: PatternSequence
    store: FrameStore
    recorder: ScanRecorder

    def scan(self, name: str, pose: tuple[float, float, float, float, float, float]) -> None:
        """Put an object before the instrument and record it. Raises ScanFailedError."""
        self.world.set_object(name, pose)
        report = self.recorder.record(self.sequence, self.store, lambda side, index: None, lambda: None)
        if report.fault is not None:
            raise ScanFailedError(f"{name} at {pose}: {report.fault.code.value}: {report.fault.detail}")


@contextmanager
def open_instrument(options: WorldOptions, period_px: int = 16) -> Iterator[Instrument]:
    """Return the instrument of ``options``, whose world gets a unique name."""
    options = replace(options, world=next(_NAMES), idle_speed=IDLE_SPEED)
    sequence = build_sequence(period_px)
    with ExitStack() as stack:
        world = stack.enter_context(World(options))
        wires = cast(Wires, stack.enter_context(open_wires({"world": options.world})))
        kms = drivers_rig.OutputKind("kms")
        outputs = stack.enter_context(
            drivers_rig.open_outputs(
                drivers_rig.OutputSpec(kms, CARD, "HDMI-A-1", sequence.width_px, sequence.height_px, REFRESH_HZ),
                drivers_rig.OutputSpec(kms, CARD, "DP-1", 800, 480, REFRESH_HZ),
                wires,
            )
        )
        projector = outputs.open_projector()
        dark = np.zeros((sequence.height_px, sequence.width_px), np.uint8)
        projector.load([*pictures(sequence), dark])
        projector.show(len(sequence))
        course = ScanSettings(REFRESH_HZ, EXPOSURE_US, TRIGGER_DELAY_US)
        grabbers = {}
        width, height = options.width_px, options.height_px
        for side in SIDES:
            spec = drivers_rig.CameraSpec(f"camera.{side}", f"KF-CAM-{side[0].upper()}")
            camera = stack.enter_context(drivers_rig.open_camera(spec, wires))
            settings = CameraSettings(width, height, float(EXPOSURE_US), 0.0)
            camera.configure(settings)
            grabbers[side] = stack.enter_context(Grabber(side, camera, wires.clock, settings, course.timeouts))
        board = stack.enter_context(
            drivers_rig.open_board(drivers_rig.BoardSpec(f"kfsim://{options.world}/board"), wires)
        )
        store = stack.enter_context(FrameStore(len(sequence), height, width))
        yield Instrument(world, sequence, store, ScanRecorder(grabbers, board, projector, wires.clock, course))
