"""Owns the whole instrument of the boot test: a computer that is a virtual machine, and a simulated world around it.

Cameras, board and key pad are plugged into the machine over USB/IP. What its kernel flushes to the projector's head is
fetched from the emulated card and lights the scene. A diver knows it by its status file, read through the agent.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from hw_sim.devices.cable import Cable
from hw_sim.wires.usbip.exporter import Exporter
from hw_sim.world import World, WorldOptions
from tests.boot.injected import rig_drop_in, with_files
from tests.boot.machine import DISPLAY, PROJECTOR, Boot, Given, Gone, Machine
from tests.boot.picture import Image

ASKED_HZ, REFRESH_HZ = 2, 1.89
"""Of the projector: emulated in software, a machine needs this long for a picture and everything around it. The kernel makes
the mode that it is asked for of a pixel clock in steps of 250 kHz."""
DISPLAY_HZ = 2.0
"""Of the diver's display, and so of the heartbeat: drawing is what an emulated processor is slowest at."""
STATUS = "/var/lib/kingfisher/run/status.json"
RIG = "/etc/kingfisher/rig.toml"
DATA_DISK = r"dev-disk-by\x2dlabel-kf\x2ddata.device"
POLL_S = 0.3
DRAWN_S = 60.0
"""Two pictures of the diver's display, on a computer that is busy with other things."""
SIZE_PX = (400, 300)
WORLD = {"truth": "nominal", "seed": 1, "stills": True, "pace": "realtime"}
PROJECTOR_SIZE = (1024, 768)


def rig_file(root: Path) -> str:
    """The small simulated rig as this machine has it: native wires, and the connectors that its kernel names."""
    text = (root / "hw_sim" / "rigs" / "small.toml").read_text(encoding="utf-8")
    begin, end = text.index("[rig.wires_options]"), text.index("[camera.left]")
    text = text[:begin] + text[end:]
    changes = {
        'wires = "hw_sim.wires:open"': 'wires = "drivers.native:open"',
        'url = "kfsim://main/board"': 'url = "/dev/ttyACM0"',
        "live_every_vsyncs = 6": "live_every_vsyncs = 1",
        'connector = "HDMI-A-1"\nwidth_px = 1024\nheight_px = 768\nrefresh_hz = 60.0': (
            f'connector = "Virtual-1"\nwidth_px = 1024\nheight_px = 768\nrefresh_hz = {REFRESH_HZ}'
        ),
        'connector = "DP-1"\nwidth_px = 800\nheight_px = 480\nrefresh_hz = 60.0': (
            f'connector = "Virtual-2"\nwidth_px = 800\nheight_px = 480\nrefresh_hz = {DISPLAY_HZ}'
        ),
        'root = "/var/tmp/kingfisher-sim"': 'root = "/var/lib/kingfisher"',
        "reserve_mb = 500 ": "reserve_mb = 100 ",
    }
    for before, after in changes.items():
        assert text.count(before) == 1, f"{before!r} is {text.count(before)} times in small.toml"
        text = text.replace(before, after)
    return text


class Instrument:
    """Switched on as long as it is entered; ``artefacts`` keeps pictures and logs."""

    def __init__(self, image: Image, root: Path, folder: Path, artefacts: Path, drop_in: str) -> None:
        self._image, self._root, self._folder, self.artefacts = image, root, folder, artefacts
        self._drop_in = drop_in
        self._stack = ExitStack()
        self._flipped = threading.Event()
        self._over = threading.Event()
        self.cable = Cable(round(1e9 / REFRESH_HZ))
        self.status_path = folder / "status.json"
        self._drawn = 0

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            width, height = SIZE_PX
            options = WorldOptions(width_px=width, height_px=height, **WORLD)  # type: ignore[arg-type]
            self.world = stack.enter_context(World(options, self.cable))
            self.world.view("left")  # the scene is built before anybody waits for its images
            self.exporter = stack.enter_context(Exporter(self.world, 0))
            files = {
                "kingfisher-test/rig.toml": rig_file(self._root),
                "systemd/system/kingfisher.service.d/90-test.conf": self._drop_in + rig_drop_in(RIG),
                "systemd/system/kingfisher-safe.service.d/90-test.conf": rig_drop_in(RIG),
                f"systemd/system/{DATA_DISK}.d/90-test.conf": "[Unit]\nJobRunningTimeoutSec=300\n",
            }
            initrd = self._folder / "initrd"
            initrd.write_bytes(with_files(self._image.initrd.read_bytes(), self.exporter.port, files))
            arguments = (
                f"{self._image.arguments} console=ttyS0 fbcon=map:9 "
                f"video=Virtual-1:1024x768MR@{ASKED_HZ} video=Virtual-2:800x480MR@{DISPLAY_HZ:.0f}e"
            )
            given = Given(self._image.kernel, initrd, arguments)
            boot = Boot(self._image.overlay(self._folder), given, model=self._image.cpu)
            self.machine = stack.enter_context(Machine(boot, self._folder, self._on_flip))
            for work in (self._light, self._read_status):
                thread = threading.Thread(target=work, daemon=True)
                thread.start()
                stack.callback(thread.join, 30.0)
            stack.callback(self._over.set)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(Gone):
            self.keep("at-the-end")
            _, journal = self.machine.try_run("journalctl -b --no-pager -o short-monotonic -u kingfisher -n 2000", 60.0)
            (self.artefacts / "journal.txt").write_text(journal, encoding="utf-8")
        self._stack.close()
        for name in ("console.log", "qemu.log"):
            with suppress(OSError):
                (self.artefacts / name).write_bytes((self._folder / name).read_bytes())

    def _on_flip(self, head: int) -> None:
        if head == PROJECTOR:
            self._flipped.set()
        else:
            self._drawn += 1

    def _light(self) -> None:
        """What is scanned out to the projector lights the scene, picture by picture."""
        while not self._over.is_set():
            if not self._flipped.wait(0.5):
                continue
            self._flipped.clear()
            try:
                picture = self.machine.screen(PROJECTOR)
            except Gone:
                continue
            with self.world.time.condition:
                if picture.shape[1::-1] == PROJECTOR_SIZE:
                    self.cable.show(np.ascontiguousarray(picture[:, :, 1]))
                else:
                    self.cable.dark()

    def _read_status(self) -> None:
        while not self._over.wait(POLL_S):
            try:
                code, text = self.machine.try_run(f"cat {STATUS}", 20.0)
            except Gone:
                continue
            if code == 0:
                draft = self.status_path.with_suffix(".draft")
                draft.write_text(text, encoding="utf-8")
                draft.replace(self.status_path)
            else:
                self.status_path.unlink(missing_ok=True)

    def status(self) -> dict[str, Any]:
        """The service's status now; empty while there is none."""
        try:
            found: dict[str, Any] = json.loads(self.status_path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return found

    def wait(self, what: str, seen: Callable[[dict[str, Any]], object], timeout_s: float) -> dict[str, Any]:
        """The first status in which ``seen``. Raises AssertionError after the time limit."""
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            status = self.status()
            if status and seen(status):
                return status
            time.sleep(POLL_S / 2)
        self.keep(f"waited-in-vain-for-{what.replace(' ', '-')}")
        raise AssertionError(f"no {what} within {timeout_s:g} s; the status is {json.dumps(self.status())[:1500]}")

    def screen(self) -> NDArray[np.uint8]:
        """(h, w, 3) uint8 RGB: the diver's screen, drawn after this was called. Raises AssertionError if none is."""
        drawn, end_s = self._drawn, time.monotonic() + DRAWN_S
        while self._drawn < drawn + 2:  # the next one may have been begun before
            assert time.monotonic() < end_s, f"no new picture within {DRAWN_S:g} s"
            time.sleep(0.05)
        return self.machine.screen(DISPLAY)

    def keep(self, name: str, picture: NDArray[np.uint8] | None = None) -> Path:
        path = self.artefacts / f"{name}.png"
        cv2.imwrite(str(path), (self.machine.screen(DISPLAY) if picture is None else picture)[:, :, ::-1])
        return path
