"""Lights both heads through the kernel's mode setting; the card is the first argument."""

from __future__ import annotations

import sys
import time

import numpy as np

from drivers.native import NativeWires
from drivers.output.spec import OutputKind, OutputSpec
from drivers.rig import open_outputs
from tests.libraries.clients import say, wait

FLIPS = 60


def pattern(index: int) -> np.ndarray:
    """A picture in which every column and many rows differ."""
    rows, columns = np.mgrid[0:768, 0:1024]
    return np.asarray((columns * (index + 1) + rows * 7) % 256, np.uint8)


if __name__ == "__main__":
    projector = OutputSpec(OutputKind.KMS, sys.argv[1], "HDMI-A-1", 1024, 768, 60.0)
    display = OutputSpec(OutputKind.KMS, sys.argv[1], "DP-1", 800, 480, 60.0)
    with open_outputs(projector, display, NativeWires()) as outputs:
        beamer, screen = outputs.open_projector(), outputs.open_display()
        say(projector=beamer.health().summary, display=screen.health().summary)
        beamer.load([pattern(index) for index in range(4)])
        for index in range(4):
            beamer.show(index)
            say(shown=index)
            wait()
        image = np.zeros((480, 800, 3), np.uint8)
        image[:, :, 0], image[:, :, 1], image[:, :, 2] = 200, np.arange(800) % 256, 7
        screen.present(image, 1.0)
        say(presented=True)
        wait()
        flips = [beamer.show(index % 4) for index in range(FLIPS)]
        say(
            sequences=[flip.sequence for flip in flips],
            times_ns=[flip.time_ns for flip in flips],
            now_ns=time.monotonic_ns(),
        )
