"""Reads frames of cameras by their serial numbers, and opens them again when they come back.

Arguments: width, height, frames for each camera, serial numbers.
"""

from __future__ import annotations

import itertools
import sys
import threading
import time
from collections import Counter

import numpy as np

from drivers.api import CameraSettings, DeviceError, DeviceGone, FrameStatus
from drivers.camera import CameraSpec, UsbVisionCamera
from drivers.native import MonotonicClock
from tests.libraries.clients import say, wait

CLOCK = MonotonicClock()
EXPOSURE_US = 4000.0


def read(camera: UsbVisionCamera, serial: str, frames: int) -> None:
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
    say(read=serial, met=met, gaps=gaps, brightest=brightest, frames_per_s=rate)


def serve(serial: str, frames: int) -> None:
    """One camera, lost once at most."""
    for _ in range(2):
        camera = opened(serial)
        with camera:
            say(opened=serial, model=camera.identity.model, mbps=camera.identity.link_speed_mbps)
            try:
                read(camera, serial, frames)
                return
            except DeviceGone as error:
                say(gone=serial, why=str(error))


def opened(serial: str) -> UsbVisionCamera:
    """As the service does: again and again."""
    end = time.monotonic() + 20.0
    while True:
        try:
            return UsbVisionCamera.open(CameraSpec(f"camera {serial}", serial), None, CLOCK)
        except DeviceError as error:
            if time.monotonic() > end:
                raise
            say(failed=str(error))
            time.sleep(0.2)


SETTINGS = CameraSettings(int(sys.argv[1]), int(sys.argv[2]), EXPOSURE_US, 0.0)

if __name__ == "__main__":
    before_s = time.process_time()
    threads = [threading.Thread(target=serve, args=(serial, int(sys.argv[3]))) for serial in sys.argv[4:]]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    say(cpu_s=time.process_time() - before_s)
    wait()
