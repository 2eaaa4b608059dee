"""Reads frames of cameras by their serial numbers, and opens them again when they come back.

Arguments: width, height, frames for each camera, serial numbers; ``--kind`` names the family, ``--source`` what triggers.
"""

from __future__ import annotations

import argparse
import itertools
import threading
import time
from collections import Counter
from contextlib import ExitStack

import numpy as np

from drivers.api import Camera, CameraSettings, DeviceError, DeviceGone, DeviceRefused, FrameStatus
from drivers.camera_families import USUAL
from drivers.native import NativeWires
from drivers.rig import CameraSpec, open_camera
from tests.libraries.clients import say, wait

EXPOSURE_US = 4000.0


def read(camera: Camera, serial: str, frames: int) -> None:
    """Trigger by trigger; what came of each, and whether any number is missing."""
    size = (camera.configure(SETTINGS).height_px, SETTINGS.width_px)
    slot = np.zeros(size, np.uint8)
    camera.start()
    say(started=serial)
    met: Counter[str] = Counter()
    numbers: list[int] = []
    brightest = 0
    times_ns: list[int] = []
    while met[FrameStatus.COMPLETE.value] < frames:
        frame = camera.next_frame(slot, 5.0)
        met[frame.status.value] += 1
        if frame.block_id is not None:
            numbers.append(frame.block_id)
            times_ns.append(frame.received_ns)
        brightest = max(brightest, int(slot.max()))
    camera.stop()
    gaps = sum(b - a - 1 for a, b in itertools.pairwise(numbers))
    rate = (len(times_ns) - 1) / (times_ns[-1] - times_ns[0]) * 1e9 if len(times_ns) > 1 else 0.0
    ends = {"first": numbers[0], "last": numbers[-1]} if numbers else {}
    say(read=serial, met=met, gaps=gaps, brightest=brightest, sum=int(slot.sum()), frames_per_s=rate, **ends)


def serve(serial: str, frames: int) -> None:
    """One camera, lost once at most."""
    for _ in range(2):
        with ExitStack() as stack:
            camera = opened(stack, serial)
            say(opened=serial, model=camera.identity.model, mbps=camera.identity.link_speed_mbps)
            try:
                read(camera, serial, frames)
                return
            except DeviceGone as error:
                say(gone=serial, why=str(error))
            except DeviceRefused as error:
                say(refused=str(error))
                return


def opened(stack: ExitStack, serial: str) -> Camera:
    end = time.monotonic() + 20.0
    spec = CameraSpec(f"camera {serial}", serial, trigger_source=ARGUMENTS.source, pixel_format=ARGUMENTS.format)
    while True:
        try:
            return stack.enter_context(open_camera(spec, NativeWires(), ARGUMENTS.kind))
        except DeviceError as error:
            if time.monotonic() > end:
                raise
            say(failed=str(error))
            time.sleep(0.2)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    for name in ("width", "height", "frames"):
        parser.add_argument(name, type=int)
    parser.add_argument("serials", nargs="+")
    parser.add_argument("--kind", default=USUAL)
    parser.add_argument("--source")
    parser.add_argument("--format", default="Mono8")
    return parser.parse_args()


ARGUMENTS = arguments()
SETTINGS = CameraSettings(ARGUMENTS.width, ARGUMENTS.height, EXPOSURE_US, 0.0)

if __name__ == "__main__":
    before_s = time.process_time()
    threads = [threading.Thread(target=serve, args=(serial, ARGUMENTS.frames)) for serial in ARGUMENTS.serials]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    say(cpu_s=time.process_time() - before_s)
    wait()
