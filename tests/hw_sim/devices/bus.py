"""Owns a host without a world: it hands GenCP packets to one camera, pulses its line, and moves its time by hand.

What a feature is called and where it lies it learns from the camera's own description, by the reference implementation of
GenApi.
"""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from genicam.genapi import AbstractPort, EAccessMode, NodeMap
from numpy.typing import NDArray

from hw_sim.devices.board import Shot
from hw_sim.devices.power_on import PowerOn
from hw_sim.devices.shutter import Exposure
from hw_sim.devices.u3v_camera import U3vCamera
from hw_sim.faults import FaultBook
from hw_sim.rendering.exposure_worker import PendingImage
from tests.hw_sim.conftest import HandTime
from tests.hw_sim.devices.host import GencpError, GotFrame

COLUMNS, ROWS = 160, 120
SIRM = 0x1_1000
CONTROL_OUT, CONTROL_IN, STREAM = 0x01, 0x81, 0x83


def picture() -> NDArray[np.uint8]:
    """A picture of the world in which each place has a neighbourhood of its own: (120, 160) uint8, 20..219."""
    rows, columns = np.mgrid[:ROWS, :COLUMNS]
    grey: NDArray[np.uint8] = (20 + (columns + 3 * rows + columns * rows // 7) % 200).astype(np.uint8)
    return grey


@dataclass(frozen=True, slots=True)
class Sizes:
    """What the host allows for leader, payload and trailer."""

    leader: int
    transfer: int
    trailer: int


class Bus(AbstractPort):  # type: ignore[misc]
    """One camera of a personality, and the host on its wire. ``exposures``: all that it has begun to expose."""

    def __init__(self, time: HandTime, personality: str, **options: Any) -> None:
        super().__init__()
        self.time = time
        self.exposures: list[Exposure] = []
        faults = FaultBook(time.now_ns, time.at, lambda _: None)
        self.camera = U3vCamera(
            *("camera.left", "KF-CAM-L", (COLUMNS, ROWS), time, faults, self._expose, lambda: 30.0, 1),
            power_on=PowerOn(personality=personality, **options),
        )
        self._request = self._count = 0
        self.nodes = NodeMap()
        self.nodes.load_xml_from_string(self.description())
        self.nodes.connect(self, "Device")

    def _expose(self, exposure: Exposure) -> PendingImage:
        self.exposures.append(exposure)
        made = PendingImage()
        made.finish(picture())
        return made

    def read(self, address: int, size: int) -> bytes:
        at = range(0, size, 500)
        return b"".join(self._command(0x0800, struct.pack("<QHH", address + k, 0, min(500, size - k))) for k in at)

    def write(self, address: int, data: bytes) -> None:
        self._command(0x0802, struct.pack("<Q", address) + bytes(data))

    def get_access_mode(self) -> Any:
        return EAccessMode.RW

    def u32(self, address: int) -> int:
        return int.from_bytes(self.read(address, 4), "little")

    def put(self, address: int, value: int) -> None:
        self.write(address, value.to_bytes(4, "little"))

    def send(self, code: int, payload: bytes, number: int) -> None:
        packet = struct.pack("<IHHHH", 0x43563355, 0x4000, code, len(payload), number) + payload
        with self.time.condition:
            self.camera.write(CONTROL_OUT, packet)

    def _command(self, code: int, payload: bytes) -> bytes:
        self._request = self._request % 0xFFFF + 1
        self.send(code, payload, self._request)
        while True:
            raw = self.bulk(CONTROL_IN, 1024)
            if not raw:
                self.time.run(0.04)  # it was announced to take longer
                continue
            magic, status, answer, size, number = struct.unpack_from("<IHHHH", raw)
            assert (magic, number, size) == (0x43563355, self._request, len(raw) - 12)
            if answer == 0x0805:
                continue
            if status:
                raise GencpError(status)
            assert answer == code + 1
            return raw[12:]

    def status(self, code: int, payload: bytes) -> int:
        """The status of the answer to a command; 0: it was obeyed."""
        try:
            self._command(code, payload)
        except GencpError as error:
            return int(error.args[0])
        return 0

    def description(self) -> str:
        manifest = int.from_bytes(self.read(0x1D0, 8), "little")
        _, _, address, size = struct.unpack("<IIQQ", self.read(manifest + 8, 24))
        with zipfile.ZipFile(io.BytesIO(self.read(address, size))) as archive:
            return archive.read(archive.namelist()[0]).decode()

    def get(self, name: str) -> Any:
        return self.nodes.get_node(name).value

    def set(self, **values: Any) -> None:
        for name, value in values.items():
            self.nodes.get_node(name).value = value

    def press(self, name: str) -> None:
        self.nodes.get_node(name).execute()

    def refusal(self, name: str, value: int) -> int:
        """The status of a write to the feature's register, past the description's own locks; 0: it was taken."""
        return self.status(0x0802, struct.pack("<QI", self.nodes.get_node(f"{name}Reg").address, value))

    def stream(self, sizes: Sizes | None = None) -> int:
        """Set up and enable the stream as the camera's alignment wants it, or with ``sizes``; returns the status."""
        step = 1 << (self.u32(SIRM) >> 24)
        payload = int.from_bytes(self.read(SIRM + 8, 8), "little")
        if sizes is None:
            sizes = Sizes(*(-(-n // step) * step for n in (1024, payload, 1024)))
        for offset, value in ((0x18, sizes.leader), (0x1C, sizes.transfer), (0x20, 1), (0x24, 0), (0x28, 0)):
            self.put(SIRM + offset, value)
        self.put(SIRM + 0x2C, sizes.trailer)
        return self.status(0x0802, struct.pack("<QI", SIRM + 4, 1))

    def start(self) -> None:
        assert self.stream() == 0
        self.set(TLParamsLocked=1)
        self.press("AcquisitionStart")

    def stop(self) -> None:
        self.press("AcquisitionStop")
        self.put(SIRM + 4, 0)
        self.set(TLParamsLocked=0)

    def halt(self, on: bool) -> None:
        """SET_FEATURE or CLEAR_FEATURE(ENDPOINT_HALT) of the stream's endpoint."""
        with self.time.condition:
            self.camera.request(0x02, 0x03 if on else 0x01, 0, STREAM, 0)

    def bulk(self, endpoint: int, size: int) -> bytes:
        buffer = bytearray(size)
        with self.time.condition:
            filled, _ = self.camera.read(endpoint, memoryview(buffer))
        return bytes(buffer[:filled])

    def pulses(self, count: int, width_ms: float = 8.0) -> None:
        """Pulse the line at 60 Hz, and let everything come to its end."""
        for _ in range(count):
            with self.time.condition:
                self.camera.line0(self.time.now_ns(), round(width_ms * 1e6), Shot(0, self._count, None))
            self._count += 1
            self.time.run(1 / 60)
        self.time.run(0.3)

    def frames(self) -> list[GotFrame]:
        got: list[GotFrame] = []
        payload = int.from_bytes(self.read(SIRM + 8, 8), "little")
        room = -(-payload // 1024) * 1024 + 1024
        while leader := self.bulk(STREAM, 1024):
            got.append(GotFrame(leader, self.bulk(STREAM, room)[:payload], self.bulk(STREAM, 1024)))
        return got

    def image(self) -> NDArray[np.uint8]:
        """The image of one triggered frame, Mono8."""
        self.start()
        self.pulses(1)
        frame = self.frames()[-1]
        self.stop()
        return frame.image


LINES: Mapping[str, str] = {"blackfly": "Line0", "ace": "Line1", "alvium": "Line0"}
"""The board's pulse arrives there."""
BORDERS: Mapping[str, tuple[int, int]] = {"blackfly": (16, 40), "ace": (320, 0), "alvium": (336, 16)}
"""Columns and rows beyond the picture of the world."""


def careful(time: HandTime, personality: str, **options: Any) -> Bus:
    """Set a camera up as one that knows it does: the picture's window, grey values as they are, one trigger."""
    bus = Bus(time, personality, **options)
    wide, high = BORDERS[personality]
    bus.set(UserSetSelector="Default")
    bus.press("UserSetLoad")
    bus.set(Width=COLUMNS, Height=ROWS, OffsetX=wide // 2, OffsetY=high // 2, ReverseX=False, PixelFormat="Mono8")
    bus.set(TriggerSelector="FrameStart", TriggerSource=LINES[personality], TriggerMode="On")
    bus.set(ExposureMode="Timed", ExposureAuto="Off", ExposureTime=8000.0, GainAuto="Off", Gain=0.0, Gamma=1.0)
    match personality:
        case "blackfly":
            bus.set(TriggerOverlap="ReadOut", GammaEnable=False, BlackLevel=2.0 / 2.55)
        case "ace":
            bus.set(DeviceLinkThroughputLimitMode="Off", OverlapMode="On", BlackLevel=2.0)
        case "alvium":
            bus.set(DeviceLinkThroughputLimit=450_000_000, BlackLevel=32.0)
    return bus
