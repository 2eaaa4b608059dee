"""Each device through the library that the instrument uses, with the shipped driver and nothing in between."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hw_sim.timing.world_time import BLANK_NS
from hw_sim.wires.umockdev.testbed import Testbed
from hw_sim.world import World
from tests.hw_sim.devices.host import framed
from tests.libraries.client import Client
from tests.libraries.clients.output import pattern
from tests.libraries.instrument import rig_file

pytestmark = pytest.mark.foreign


def triggered(world: World) -> None:
    """The board fires both cameras at every sixth blank, as it does while the diver aims."""
    with world.time.condition:
        world.board.receive(framed("C,1,LIVE,6,500,1000"))


LARGE = (1280, 960)
"""Few transfers wait at once: one end of a stream in a thousand hangs in Aravis, the sooner the more of them there are."""


@pytest.mark.parametrize(("kind", "world"), [("usb3vision", (400, 300)), ("aravis", LARGE)], indirect=["world"])
def test_both_cameras_are_read_at_once(kind: str, world: World, bed: Testbed) -> None:
    world.view("left")
    triggered(world)
    size = (world.options.width_px, world.options.height_px)
    with Client(bed, "cameras", "--kind", kind, *size, 20, "KF-CAM-L", "KF-CAM-R") as client:
        for _ in range(2):
            opened = client.expect("opened")
            assert (opened["model"], opened["mbps"]) == ("KFC1920", 5000)
        for _ in range(2):
            read = client.expect("read", timeout_s=60)
            damaged = sum(read["met"].values()) - read["met"]["complete"]  # on a busy machine
            assert (read["met"]["complete"], read["gaps"] <= damaged) == (20, True)
            assert read["brightest"] > 0, "pixels came, not only headers"
        client.expect("cpu_s")


@pytest.mark.parametrize(
    ("kind", "world", "said", "others"),
    [
        ("usb3vision", (400, 300), "unplugged while streaming", "the bus has KF-CAM-R"),
        ("aravis", LARGE, "Check the connector; the camera is opened again by itself", "there are KF-CAM-R"),
    ],
    indirect=["world"],
)
def test_a_camera_that_is_unplugged_is_gone_and_comes_back(
    kind: str, world: World, said: str, others: str, bed: Testbed
) -> None:
    triggered(world)
    size = (world.options.width_px, world.options.height_px)
    with Client(bed, "cameras", "--kind", kind, *size, 40, "KF-CAM-L") as client:
        client.expect("started")
        world.fault("camera.left off")
        assert said in client.expect("gone")["why"]
        assert f"KF-CAM-L not found; {others}" in client.expect("failed")["failed"]
        world.clear_faults()
        client.expect("opened")
        assert client.expect("read", timeout_s=60)["met"]["complete"] == 40


def test_hidapi_hears_each_press_and_survives_the_cable(world: World, bed: Testbed) -> None:
    with Client(bed, "keys", 12) as client:
        client.expect("opened", "firmware 3")
        for key in ("scan", "back", "up", "down"):
            world.press(key, 0.2)
            client.expect("press", key)
            assert client.expect("release", key)["held_s"] == pytest.approx(0.2, abs=0.15)
        world.fault("keypad off")
        assert "unplugged" in client.expect("gone")["gone"]
        world.clear_faults()
        client.expect("opened", "firmware 3")
        world.press("up", 0.2)
        client.expect("press", "up")


def test_pyserial_talks_to_the_board(world: World, bed: Testbed) -> None:
    with Client(bed, "board", "/dev/kingfisher-board") as client:
        assert client.expect("serial") == {"serial": "KF-BRD-0001", "firmware": "1.4.2"}
        assert client.expect("lasers")["lasers"] == [True, False]
        assert world.board.lasers_on == (True, False)
        client.go_on()
        fired = client.expect("vsyncs")
    assert fired["vsyncs"] == list(range(24)), "no pulse is missing, none reported twice"
    assert fired["steps_us"] == pytest.approx([BLANK_NS / 1000] * 23, abs=5)
    assert fired["damaged"] == 0


def test_mode_setting_lights_both_heads_to_the_bit(world: World, bed: Testbed) -> None:
    with Client(bed, "output", "/dev/dri/card0") as client:
        heads = client.expect("projector")
        assert heads == {"projector": "HDMI-A-1 1024×768 60.00 Hz", "display": "DP-1 800×480 60.00 Hz"}
        for index in range(4):
            client.expect("shown", index)
            assert np.array_equal(world.scanned_out("projector"), pattern(index))
            client.go_on()
        client.expect("presented")
        shown = world.scanned_out("display")
        assert (shown[:, :, 0] == 200).all()
        assert (shown[7, :, 1] == np.arange(800) % 256).all()
        assert (shown[:, :, 2] == 7).all()
        client.go_on()
        flips = client.expect("sequences")
    blanks = np.diff(flips["sequences"])
    assert (blanks >= 1).all(), "the counter only counts up"
    period_ns = np.diff(flips["times_ns"]) / blanks
    assert period_ns == pytest.approx(BLANK_NS, abs=2000), "a blank is a blank, by the kernel's clock of microseconds"
    assert 0 <= flips["now_ns"] - flips["times_ns"][-1] < 1e9, "and that clock is the host's monotonic one"


def test_check_names_every_device_and_what_ails_one(world: World, bed: Testbed, tmp_path: Path) -> None:
    """``kingfisher check`` with the packaged rig file."""
    world.fault("camera.right slow")
    (tmp_path / "root").mkdir()
    done = subprocess.run(
        [sys.executable, "-m", "appliance.cli", "check", "--rig", str(rig_file(tmp_path, (400, 300))), "--json"],
        env={**os.environ, **bed.environment},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    found = {entry["device"]: entry for entry in json.loads(done.stdout)}
    assert set(found) == {"camera.left", "camera.right", "board", "keys", "projector", "display"}
    assert {name for name, entry in found.items() if not entry["ok"]} == {"camera.right"}
    assert found["camera.left"]["details"]["serial"] == "KF-CAM-L"
    assert found["camera.left"]["details"]["link"] == "5000 Mbit/s"
    assert found["camera.right"]["details"]["link"] == "480 Mbit/s"
    assert done.returncode == 1
