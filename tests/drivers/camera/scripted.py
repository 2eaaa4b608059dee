"""A USB3 Vision camera of the tests' own behind pyusb's backend interface: registers, a description, and a log of what was set.

Every address and layout is from the standards (GenCP 1.1, section 4; USB3 Vision 1.0, annex), not from the driver's table.
"""

from __future__ import annotations

import errno
import io
import struct
import zipfile
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import usb.core

from tests.drivers.clock import SteppedClock

DEVICE_INFO = bytes.fromhex("1424010300010000000100040502060708030908")
MANIFEST, SBRM, SIRM, FEATURES, FILE = 0x4000, 0x1_0000, 0x2_0000, 0x3_0000, 0x5_0000
CHOICES = {
    "AcquisitionMode": ("SingleFrame", "Continuous"),
    "PixelFormat": ("Mono16", "Mono8"),
    "TriggerSelector": ("AcquisitionStart", "FrameStart"),
    "TriggerSource": ("Software", "Line1", "Line2"),
    "TriggerActivation": ("FallingEdge", "RisingEdge"),
    "TriggerMode": ("Off", "On"),
    "ExposureAuto": ("Continuous", "Off"),
    "GainAuto": ("Continuous", "Off"),
    "ExposureMode": ("TriggerWidth", "Timed"),
    "GainSelector": ("DigitalAll", "All"),
    "UserSetSelector": ("UserSet1", "Default"),
    "DeviceLinkThroughputLimitMode": ("On", "Off"),
    "TestPattern": ("Stripes", "Off"),
    "LineSelector": ("Line0", "Line1", "Line2"),
    "LineMode": ("Output", "Input"),
    "TriggerOverlap": ("Off", "PreviousFrame", "ReadOut"),
}
WHOLE = {"Width": (8, 1600, 8), "Height": (2, 1200, 2), "OffsetX": (0, 800, 8), "OffsetY": (0, 600, 2)}
WHOLE |= {"TLParamsLocked": (0, 1, 1), "BinningHorizontal": (1, 4, 1), "BinningVertical": (1, 4, 1)}
WHOLE |= {"DeviceLinkThroughputLimit": (1, 450_000_000, 1)}
FLOATS = {"ExposureTime": (10.0, 16_000.0), "Gain": (0.0, 12.0), "DeviceTemperature": (-40.0, 120.0)}
FLOATS |= {"Gamma": (0.25, 4.0), "BlackLevel": (0.0, 16.0), "TriggerDelay": (0.0, 1e6)}
FLAGS = ("ReverseX", "ReverseY", "AcquisitionFrameRateEnable", "GammaEnable", "LineInverter")
COMMANDS = ("AcquisitionStart", "AcquisitionStop", "UserSetLoad")
FEATURE_NAMES = (*CHOICES, *WHOLE, *FLOATS, *FLAGS, *COMMANDS)
ADDRESS = {name: FEATURES + 4 * k for k, name in enumerate(FEATURE_NAMES)}
OF_ADDRESS = {
    **{address: name for name, address in ADDRESS.items()},
    SIRM + 0x04: "SIRM control",
    SIRM + 0x18: "SIRM leader",
    SIRM + 0x1C: "SIRM transfer",
    SIRM + 0x20: "SIRM transfers",
    SIRM + 0x24: "SIRM final 1",
    SIRM + 0x28: "SIRM final 2",
    SIRM + 0x2C: "SIRM trailer",
    0x1F8: "latch",
}


def description(
    lacking: tuple[str, ...] = (), choices: dict[str, tuple[str, ...]] | None = None, fixed: tuple[str, ...] = ()
) -> str:
    """GenICam XML with the features that are not lacking; those that are fixed can be read only."""
    offered = CHOICES | (choices or {})
    features, registers = [], []
    for name in (name for name in FEATURE_NAMES if name not in lacking):
        place = f"<Address>{ADDRESS[name]}</Address><Length>4</Length>"
        access, kind, more = (
            "RO" if name in fixed else "RW",
            "IntReg",
            "<Sign>Unsigned</Sign><Endianess>LittleEndian</Endianess>",
        )
        if name in offered:
            entries = "".join(
                f"<EnumEntry Name='{e}'><Value>{k}</Value></EnumEntry>" for k, e in enumerate(offered[name])
            )
            features.append(f"<Enumeration Name='{name}'>{entries}<pValue>{name}Reg</pValue></Enumeration>")
        elif name in WHOLE:
            low, high, step = WHOLE[name]
            limits = f"<Min>{low}</Min><Max>{high}</Max><Inc>{step}</Inc>"
            features.append(f"<Integer Name='{name}'><pValue>{name}Reg</pValue>{limits}</Integer>")
        elif name in FLAGS:
            features.append(f"<Boolean Name='{name}'><pValue>{name}Reg</pValue></Boolean>")
        elif name in FLOATS:
            limits = "<Min>{}</Min><Max>{}</Max>".format(*FLOATS[name])
            features.append(f"<Float Name='{name}'><pValue>{name}Reg</pValue>{limits}</Float>")
            kind, more = "FloatReg", "<Endianess>LittleEndian</Endianess>"
        else:
            access = "WO"
            features.append(
                f"<Command Name='{name}'><pValue>{name}Reg</pValue><CommandValue>1</CommandValue></Command>"
            )
        registers.append(
            f"<{kind} Name='{name}Reg'>{place}<AccessMode>{access}</AccessMode><pPort>Device</pPort>"
            f"<Cachable>NoCache</Cachable>{more}</{kind}>"
        )
    return (
        "<RegisterDescription ModelName='T' VendorName='V' StandardNameSpace='None' SchemaMajorVersion='1' "
        "SchemaMinorVersion='1' SchemaSubMinorVersion='0' MajorVersion='1' MinorVersion='0' SubMinorVersion='0' "
        "ProductGuid='1F3C6A72-7842-4edd-9130-E2E90A2058BA' VersionGuid='7C9F2E1A-6A5B-4e8c-8A61-5E7A0C6B9D10' "
        f"xmlns='http://www.genicam.org/GenApi/Version_1_1'>{''.join(features)}{''.join(registers)}"
        "<Port Name='Device'/></RegisterDescription>"
    )


class ScriptedCamera:
    """``usb.backend.IBackend`` of one camera, as far as a driver needs it, over a sparse register memory."""

    def __init__(self, clock: SteppedClock, xml: str | None = None, *, zipped: bool = False) -> None:
        self.clock = clock
        self.memory: dict[int, int] = {}
        self.log: list[tuple[str, float]] = []
        """What was written to which register, in order."""
        self.refusing: dict[int, int] = {}
        """Status by address."""
        self.rounding: dict[str, int] = {}
        """What a feature's register holds whatever is written to it."""
        self.plugged, self.is_open = True, False
        self.claimed: list[int] = []
        self.speed: int | None = 4
        self.stream: list[bytes] = []
        self.stream_buffers: list[int] = []
        self.longest_read = self.longest_command = 0
        self.latches_take_s: list[float] = []
        self._answer = b""
        for offset, text in ((0x004, "Reef"), (0x044, "Eye"), (0x0C4, "1.2"), (0x144, "KF-CAM-L")):
            self.set(offset, text.encode().ljust(64, b"\0"))
        self.set(0x1CC, struct.pack("<I", 300))
        self.set(0x1D0, struct.pack("<QQ", MANIFEST, SBRM))
        self.set(SBRM + 0x14, struct.pack("<IIIQ", 512, 256, 1, SIRM))
        self.set(SBRM + 0x40, struct.pack("<I", 8))
        self.needs()
        data = (description() if xml is None else xml).encode()
        if zipped:
            packed = io.BytesIO()
            with zipfile.ZipFile(packed, "w") as archive:
                archive.writestr("camera.xml", data)
            data = packed.getvalue()
        self.set(MANIFEST, struct.pack("<QIIQQ40x", 1, 0x0001_0000, int(zipped) << 10, FILE, len(data)))
        self.set(FILE, data)
        self.set_feature("DeviceTemperature", 41.5)
        # As a camera wakes up that somebody else used: every flag is set, and pixels are added up.
        for name in (*FLAGS, "BinningHorizontal", "BinningVertical"):
            self.set_feature(name, 1 if name in FLAGS else 2)
        self.set_feature("Gamma", 0.5)
        self.set_feature("TriggerDelay", 100.0)
        self.when: dict[str, Callable[[], None]] = {}
        """What else happens when a register is written."""

    def needs(self, payload: int = 64 * 48, alignment_bits: int = 10, leader: int = 52, trailer: int = 32) -> None:
        self.set(SIRM, struct.pack("<IIQII", alignment_bits << 24, 0, payload, leader, trailer))

    def set(self, address: int, data: bytes) -> None:
        self.memory.update((address + k, byte) for k, byte in enumerate(data))

    def get(self, address: int, count: int) -> bytes:
        return bytes(self.memory.get(address + k, 0) for k in range(count))

    def set_feature(self, name: str, value: float) -> None:
        self.set(ADDRESS[name], struct.pack("<f", value) if name in FLOATS else struct.pack("<I", int(value)))

    def feature(self, name: str) -> float | str:
        """What the camera would work with: of an enumeration its symbol."""
        raw = self.get(ADDRESS[name], 4)
        if name in FLOATS:
            return float(struct.unpack("<f", raw)[0])
        value = int.from_bytes(raw, "little")
        return CHOICES[name][value] if name in CHOICES else bool(value) if name in FLAGS else value

    # ---- the bus

    def enumerate_devices(self) -> Iterator[ScriptedCamera]:
        return iter([self] if self.plugged else [])

    def get_device_descriptor(self, device: Any) -> Any:
        return SimpleNamespace(iSerialNumber=3, speed=self.speed, bus=1, address=7)

    def get_configuration_descriptor(self, device: Any, config: int) -> Any:
        return SimpleNamespace(bNumInterfaces=2, bConfigurationValue=1)

    def get_interface_descriptor(self, device: Any, index: int, alternate: int, config: int) -> Any:
        return SimpleNamespace(
            bInterfaceNumber=index,
            bNumEndpoints=2 if index == 0 else 1,
            bInterfaceClass=0xEF,
            bInterfaceSubClass=0x05,
            bInterfaceProtocol=2 * index,
            extra_descriptors=list(DEVICE_INFO) if index == 0 else [],
        )

    def get_endpoint_descriptor(self, device: Any, number: int, index: int, alternate: int, config: int) -> Any:
        return SimpleNamespace(bmAttributes=2, bEndpointAddress=(0x81 + index) if number == 0 else 0x01)

    def open_device(self, device: Any) -> Any:
        self.is_open = True
        return self

    def close_device(self, handle: Any) -> None:
        self.is_open = False

    def get_configuration(self, handle: Any) -> int:
        return 1

    def claim_interface(self, handle: Any, interface: int) -> None:
        self.claimed.append(interface)

    def release_interface(self, handle: Any, interface: int) -> None:
        self._need_plug()
        self.claimed.remove(interface)

    def ctrl_transfer(
        self, handle: Any, kind: int, request: int, value: int, index: int, data: Any, timeout_ms: int
    ) -> int:
        if (kind, request, value) == (0x02, 0x03, 0):  # USB 2.0, 9.4.9: SET_FEATURE(ENDPOINT_HALT)
            self.log.append(("set halt", index))
            return 0
        text = "KF-CAM-L".encode("utf-16-le")
        data[: len(text) + 2] = np.frombuffer(bytes([len(text) + 2, 3]) + text, np.uint8)
        return len(text) + 2

    def clear_halt(self, handle: Any, endpoint: int) -> None:
        self._need_plug()
        self.log.append(("clear halt", endpoint))

    def bulk_write(self, handle: Any, endpoint: int, interface: int, data: Any, timeout_ms: int) -> int:
        self._need_plug()
        command = bytes(memoryview(data))
        self.longest_command = max(self.longest_command, len(command))
        _, _, code, size, request = struct.unpack_from("<IHHHH", command)
        (address,) = struct.unpack_from("<Q", command, 12)
        status = self.refusing.get(address, 0)
        payload = b""
        if not status and code == 0x0800:
            (count,) = struct.unpack_from("<H", command, 22)
            payload = self.get(address, count)
            self.longest_read = max(self.longest_read, count)
        elif not status:
            payload = struct.pack("<HH", 0, size - 8)
            self.written(address, command[20:])
        self._answer = struct.pack("<4sHHHH", b"U3VC", status, code + 1, len(payload), request) + payload
        return len(command)

    def written(self, address: int, data: bytes) -> None:
        name = OF_ADDRESS[address]
        (value,) = struct.unpack("<f" if name in FLOATS else "<I", data)
        self.log.append((name, value))
        if name in self.rounding:
            data = struct.pack("<I", self.rounding[name])
        self.set(address, data)
        if name in self.when:
            self.when[name]()
        if name == "latch":
            self.clock.advance_s(self.latches_take_s.pop(0) if self.latches_take_s else 1e-4)
            self.set(0x1F0, struct.pack("<Q", self.clock.now_ns() - 500_000_000))

    def bulk_read(self, handle: Any, endpoint: int, interface: int, data: Any, timeout_ms: int) -> int:
        self._need_plug()
        if endpoint == 0x81:
            answer = self._answer
        else:
            self.stream_buffers.append(len(memoryview(data)))
            if not self.stream:
                self.clock.advance_s(timeout_ms * 1e-3)
                raise usb.core.USBTimeoutError("nothing", -7, errno.ETIMEDOUT)
            answer = self.stream.pop(0)
            if len(answer) > len(memoryview(data)):
                raise usb.core.USBError("overflow", -8, errno.EOVERFLOW)
        memoryview(data)[: len(answer)] = answer
        return len(answer)

    def _need_plug(self) -> None:
        if not self.plugged:
            raise usb.core.USBError("no such device", -4, errno.ENODEV)
