"""The family ``aravis``: on our simulated cameras over USB, on Aravis' own fake camera, and on its cameras with GigE Vision over a network."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from drivers.api import Camera, CameraSettings, CameraSpec, DeviceRefused, Frame, FrameStatus
from drivers.aravis import AravisCamera, library
from drivers.aravis.camera import find_device
from drivers.aravis.stream import LEAST_BUFFERS
from drivers.native import MonotonicClock
from hw_sim.wires.umockdev.testbed import Testbed
from hw_sim.world import World, WorldOptions
from tests.libraries.client import Client
from tests.libraries.clients import network
from tests.libraries.test_devices import triggered

pytestmark = pytest.mark.foreign

FULL = (1600, 1200)
SMALL = (320, 240)
WHOLE = (512, 256)
"""An image of whole kilobytes in every format."""
KIND = ("--kind", "aravis")
CLOCK = MonotonicClock()
WIDTH, EXPOSURE_TIME_US = 0x100, 0x120
"""Registers of the fake camera's own description."""
STRIPES = 255
"""Grey values of its picture."""


@contextmanager
def alvium() -> Iterator[Testbed]:
    """A left camera of another maker: with 12 bits, and with transfers in multiples of 1024 bytes alone."""
    width, height = WHOLE
    options = WorldOptions(
        world="bits", width_px=width, height_px=height, pace="realtime", stills=True, truth="modelled", noise=False,
        ambient=0.2, cameras={"left": {"personality": "alvium"}},
    )  # fmt: skip
    with World(options) as world, Testbed(world) as bed:
        triggered(world)
        yield bed


@pytest.mark.parametrize("pixel_format", ["Mono10p", "Mono12"])
def test_more_than_eight_bits_become_the_same_eight_as_by_our_own_family(pixel_format: str) -> None:
    """The same still scene through both families."""
    sums = []
    with alvium() as bed:
        for kind in ("usb3vision", "aravis"):
            words = ("--kind", kind, "--format", pixel_format, "--source", "Line0")
            with Client(bed, "cameras", *words, *WHOLE, 5, "KF-CAM-L") as client:
                sums.append(client.expect("read", timeout_s=20)["sum"])
                client.expect("cpu_s")
    assert sums[0] == sums[1] > 0


def test_a_size_that_the_camera_does_not_send_through_aravis_is_refused_with_the_way_out() -> None:
    with alvium() as bed, Client(bed, "cameras", *KIND, "--source", "Line0", 400, 200, 5, "KF-CAM-L") as client:
        why = client.expect("refused")["refused"]
        assert "images of 80000 bytes, no multiple of its 1024" in why
        assert why.endswith('Choose another size of the image, or kind = "usb3vision"')


# -------------------------------------------------------------------------------------- Aravis' fake camera


class Fake:
    """The fake camera of this process, behind the driver; the test has the camera's own side."""

    def __init__(self, **spec: Any) -> None:
        self._aravis = network.library()
        self._aravis.arv_fake_device_get_fake_camera.restype = ctypes.c_void_p
        self._aravis.arv_fake_device_get_fake_camera.argtypes = (ctypes.c_void_p,)
        device = find_device("camera.left", "Fake_1", library.library("camera.left"))
        self._camera = self._aravis.arv_fake_device_get_fake_camera(device.handle)
        self.device = device
        self.driver = AravisCamera(CameraSpec("camera.left", "1", **spec), device, CLOCK)

    def line(self, rate_hz: float) -> None:
        """The line that triggers it is pulsed so often."""
        self._aravis.arv_fake_camera_set_trigger_frequency(self._camera, rate_hz)

    def put(self, register: int, value: int) -> None:
        """Change a register behind the driver's back."""
        self._aravis.arv_fake_camera_write_register(self._camera, register, value)

    def get(self, register: int) -> int:
        """What the camera holds."""
        return int.from_bytes(self.device.read(register, 4), "big")


@contextmanager
def faked(size: tuple[int, int] = SMALL, rate_hz: float = 60.0, **spec: Any) -> Iterator[Fake]:
    """A fake camera, set."""
    fake = Fake(**spec)
    with fake.driver as camera:
        fake.line(rate_hz)
        assert camera.configure(settings(size)) == settings(size)
        yield fake


def settings(size: tuple[int, int]) -> CameraSettings:
    """With the exposure at which the fake camera's picture is not scaled."""
    return CameraSettings(*size, 10_000.0, 0.0)


def slot_of(size: tuple[int, int]) -> Any:
    return np.zeros(size[::-1], np.uint8)


def frames(camera: Camera, size: tuple[int, int], count: int) -> list[tuple[Frame, int]]:
    """Each with its first pixel: the fake camera draws diagonal stripes that move by one pixel with each frame."""
    slot = slot_of(size)
    found = []
    for _ in range(count):
        frame = camera.next_frame(slot, 2.0)
        for pixel in ((0, 3), (5, 0), (size[1] - 1, size[0] - 1)):
            assert slot[pixel] == (int(slot[0, 0]) + sum(pixel)) % STRIPES
        found.append((frame, int(slot[0, 0])))
    return found


def test_the_fake_camera_says_who_it_is_and_is_set_under_the_names_of_older_conventions() -> None:
    with faked((640, 480)) as fake:
        who = fake.driver.identity
        assert (who.vendor, who.model, who.serial, who.link_speed_mbps) == ("Aravis", "Fake", "1", None)
        health = fake.driver.health()
        assert health.ok
        assert health.details["through"].startswith(f"Aravis {who.firmware}, Fake")
        assert "no user sets" in health.details["not offered"]
        assert [fake.driver.temperature_c(), fake.driver.read_clock(), fake.driver.slow_link] == [None] * 3
        assert (fake.get(WIDTH), fake.get(EXPOSURE_TIME_US)) == (640, 10_000)
        assert fake.driver.configure(CameraSettings(640, 480, 7500.0, 0.0)).exposure_us == 7500.0
        assert fake.get(EXPOSURE_TIME_US) == 7500
        assert fake.device.read(0x4B, 5) == fake.device.read(0x48, 16)[3:8] == b"vis\0\0", "no whole word"
        with pytest.raises(DeviceRefused, match="has no gain to set"):
            fake.driver.configure(CameraSettings(640, 480, 7500.0, 6.0))


@pytest.mark.parametrize(
    ("spec", "size", "match"),
    [
        ({"pixel_format": "Mono10p"}, SMALL, "PixelFormat: Mono10p refused, allowed: .*Mono8"),
        ({"trigger_source": "Line7"}, SMALL, "TriggerSource: Line7 refused, allowed: Line0 Software"),
        ({}, (4096, 1200), "Width"),
        ({"features": (("NoSuchThing", 1.0),)}, SMALL, "has no feature NoSuchThing"),
    ],
)
def test_what_the_camera_does_not_take_is_refused_by_name(
    spec: dict[str, Any], size: tuple[int, int], match: str
) -> None:
    with Fake(**spec).driver as camera, pytest.raises(DeviceRefused, match=match):
        camera.configure(settings(size))


def test_frames_come_in_order_with_the_cameras_time_and_again_after_a_start() -> None:
    with faked() as fake:
        camera = fake.driver
        for _ in range(2):
            camera.start()
            taken = frames(camera, SMALL, 200)  # more than there are buffers for this size
            assert {frame.status for frame, _ in taken} == {FrameStatus.COMPLETE}
            ids = [frame.block_id or 0 for frame, _ in taken]
            assert ids == list(range(ids[0], ids[0] + 200)), "by the numbers of the wire"
            assert [(pixel - taken[0][1]) % STRIPES for _, pixel in taken] == [k % STRIPES for k in range(200)]
            stamps_ns = [frame.camera_time_ns or 0 for frame, _ in taken]
            assert (stamps_ns[-1] - stamps_ns[0]) / 199 == pytest.approx(1e9 / 60, rel=0.2)
        # What was exposed before the moment that a stream is told of is dropped, and nothing after it.
        assert camera._stream is not None
        since_ns = stamps_ns[-1] + 100_000_000
        camera._stream.expect_since(since_ns)
        stamps_ns = [frame.camera_time_ns or 0 for frame, _ in frames(camera, SMALL, 2)]
        assert since_ns <= stamps_ns[0] < since_ns + 50_000_000
        assert stamps_ns[1] - stamps_ns[0] < 50_000_000
        camera.configure(settings((640, 480)))  # a running stream begins anew at another size
        assert {frame.status for frame, _ in frames(camera, (640, 480), 5)} == {FrameStatus.COMPLETE}
        camera.stop()
        with pytest.raises(DeviceRefused, match="asked for a frame while stopped"):
            camera.next_frame(slot_of(SMALL), 0.1)


def test_an_image_of_another_size_than_asked_for_is_damaged_and_the_next_is_not() -> None:
    with faked() as fake:
        fake.driver.start()
        frames(fake.driver, SMALL, 2)
        fake.put(WIDTH, 160)
        met = [fake.driver.next_frame(slot_of(SMALL), 2.0) for _ in range(6)]
        assert met[-1].status is FrameStatus.CORRUPT
        assert met[-1].detail == "image of 160 x 240, expected 320 x 240"
        assert met[-1].block_id is not None
        fake.put(WIDTH, 320)
        assert [fake.driver.next_frame(slot_of(SMALL), 2.0).status for _ in range(6)][-1] is FrameStatus.COMPLETE


def test_a_reader_that_is_late_finds_as_many_frames_as_there_are_buffers_and_then_a_gap() -> None:
    with faked(FULL) as fake:
        fake.driver.start()
        time.sleep(6 * LEAST_BUFFERS / 60.0)
        taken = frames(fake.driver, FULL, LEAST_BUFFERS + 4)
        stamps_ns = [frame.camera_time_ns or 0 for frame, _ in taken]
        steps = np.diff(stamps_ns) * 60e-9
        assert np.argmax(steps) == LEAST_BUFFERS - 1
        assert steps[LEAST_BUFFERS - 1] > 2 * LEAST_BUFFERS


# ------------------------------------------------------------------------------------ GigE Vision, over a loop


@contextmanager
def networked(rate_hz: float, *serials: str) -> Iterator[tuple[Client, tuple[str, ...]]]:
    """Cameras on a network of their own, and the words that bring a program into it."""
    if shutil.which("unshare") is None or subprocess.run(["unshare", "-rn", "true"], check=False).returncode != 0:
        pytest.skip("this machine lets nobody make a network of his own (unshare -rn)")
    loop = 'ip link set lo up && ip addr add 127.0.0.2/8 dev lo && exec "$@"'
    with Client(None, "network", rate_hz, *serials, within=("unshare", "-rn", "sh", "-c", loop, "sh")) as cameras:
        cameras.expect("ready", len(serials))
        yield cameras, ("nsenter", "-t", str(cameras.pid), "-U", "-n", "--preserve-credentials")


LISTED = """
from drivers.aravis.camera import listed_cameras
from drivers.aravis.library import library
print(*sorted(listed_cameras(library("cameras"))), sep="; ")
"""


def test_two_network_cameras_are_listed_and_read_without_a_loss_while_their_numbers_go_round() -> None:
    with networked(60.0, "GV-L", "GV-R") as (_, within):
        done = subprocess.run(
            [*within, sys.executable, "-c", LISTED], capture_output=True, text=True, timeout=60, check=False
        )
        assert done.stdout == "GV-L (GigE Vision, 127.0.0.1); GV-R (GigE Vision, 127.0.0.2)\n", done.stderr
        words = (*KIND, "--source", "Software", 640, 480, 300, "GV-L", "GV-R")
        with Client(None, "cameras", *words, within=within) as client:
            for _ in range(2):
                read = client.expect("read", timeout_s=60)
                assert (read["met"], read["gaps"]) == ({"complete": 300}, 0)
                assert read["first"] < 0xFFFF < read["last"], "sixteen bits went round"
                assert read["brightest"] == network.MODULUS - 1
            client.expect("cpu_s")


def test_a_network_camera_that_falls_silent_is_gone() -> None:
    with networked(20.0, "GV-L") as (cameras, within):
        words = (*KIND, "--source", "Software", 320, 240, 4000, "GV-L")
        with Client(None, "cameras", *words, within=within) as client:
            client.expect("started")
            # A process that stands still keeps its network: the camera falls silent, its cable stays.
            cameras.freeze()
            assert "no longer answers over the network" in client.expect("gone", timeout_s=30)["why"]
            assert "GV-L not found; Aravis sees no camera" in client.expect("failed", timeout_s=30)["failed"]
            client.kill()
            cameras.kill()


def test_a_network_camera_that_another_program_controls_is_refused() -> None:
    with networked(20.0, "GV-L") as (_, within):
        words = (*KIND, "--source", "Software", 320, 240, 4000, "GV-L")
        with Client(None, "cameras", *words, within=within) as first:
            first.expect("started")
            with Client(None, "cameras", *words, within=within) as second:
                assert "another program controls the camera. Stop it" in second.expect("failed")["failed"]
                second.kill()
            first.kill()
