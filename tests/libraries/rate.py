"""Measures what two full-size cameras at 60 Hz cost on device nodes: ``./dev run python -m tests.libraries.rate [frames [family]]``.

CPU times judge; the rate that was reached says more about what else the machine had to do.
"""

from __future__ import annotations

import json
import sys
import time

from drivers.camera_families import USUAL
from hw_sim.wires.umockdev.testbed import Testbed
from hw_sim.world import World, WorldOptions
from tests.hw_sim.devices.host import framed
from tests.libraries.client import Client

SIZE = (1600, 1200)
WARM_UP = 3


def measure(frames: int, kind: str = USUAL) -> dict[str, float]:
    width, height = SIZE
    options = WorldOptions(
        world="rate", width_px=width, height_px=height, pace="realtime", stills=True, truth="modelled"
    )
    with World(options) as world, Testbed(world) as bed:
        with world.time.condition:
            world.board.receive(framed("C,1,LIVE,1,500,1000"))
        cameras = ("--kind", kind, width, height)
        with Client(bed, "cameras", *cameras, WARM_UP, "KF-CAM-L", "KF-CAM-R") as client:
            client.expect("cpu_s", timeout_s=120)  # makes the images, one for each camera
        begin_s, world_s = time.monotonic(), time.process_time()
        with Client(bed, "cameras", *cameras, frames, "KF-CAM-L", "KF-CAM-R") as client:
            read = [client.expect("read", timeout_s=frames) for _ in range(2)]
            lasted_s, world_s = time.monotonic() - begin_s, time.process_time() - world_s
            host_s = client.expect("cpu_s")["cpu_s"]
    return {
        "frames": 2 * frames,
        "missing": sum(one["gaps"] for one in read),
        "damaged": sum(sum(one["met"].values()) - one["met"]["complete"] for one in read),
        "frames_per_s": max(one["frames_per_s"] for one in read),
        "lasted_s": lasted_s,
        "world_ms_per_frame": 1000 * world_s / (2 * frames),
        "host_ms_per_frame": 1000 * host_s / (2 * frames),
    }


if __name__ == "__main__":
    found = measure(int(sys.argv[1]) if len(sys.argv) > 1 else 300, *sys.argv[2:3])
    sys.stdout.write(json.dumps({name: round(value, 3) for name, value in found.items()}, indent=1) + "\n")
