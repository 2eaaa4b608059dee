"""A USB3 Vision camera of the tests' own behind pyusb's backend interface: registers, a description, and a log of what was set.

Every address and layout is from the standards (GenCP 1.1, section 4; USB3 Vision 1.0, annex), not from the driver's table.
"""

from __future__ import annotations

import errno
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import usb.core

from tests.drivers.clock import SteppedClock

DEVICE_INFO = bytes.fromhex("14 24 01 0300 0100 0000 0100 04 05 02 06 07 08 03 09 08".replace(" ", ""))
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
WHOLE = {"Width": (8, 1600, 8), "Height": (2, 1200, 2), "OffsetX": (0, 808, 8), "OffsetY": (0, 600, 2)}
WHOLE |= {"TLParamsLocked": (0, 1, 1), "BinningHorizontal": (1, 4, 1), "BinningVertical": (1, 4, 1)}
WHOLE |= {"DeviceLinkThroughputLimit": (1, 450_000_000, 1)}
FLOATS = {"ExposureTime": (10.0, 16_000.0), "Gain": (0.0, 12.0), "DeviceTemperature": (-40.0, 120.0)}
FLOATS |= {"Gamma": (0.25, 4.0), "BlackLevel": (0.0, 16.0), "TriggerDelay": (0.0, 1e6)}
FLAGS = ("ReverseX", "ReverseY", "AcquisitionFrameRateEnable", "GammaEnable", "LineInverter")
COMMANDS = ("AcquisitionStart", "AcquisitionStop", "UserSetLoad")
FEATURE_NAMES = (*CHOICES, *WHOLE, *FLOATS, *FLAGS, *COMMANDS)
ADDRESS = {name: FEATURES + 4 * k for k, name in enumerate(FEATURE_NAMES)}
OF_SIRM = {0x04: "control", 0x18: "leader", 0x1C: "transfer", 0x20: "transfers", 0x24: "final 1", 0x28: "final 2", 0x2C: "trailer"}  # fmt: skip
OF_ADDRESS = {address: name for name, address in ADDRESS.items()} | {0x1F8: "latch"}
OF_ADDRESS |= {SIRM + offset: f"SIRM {name}" for offset, name in OF_SIRM.items()}


def description(
    lacking: tuple[str, ...] = (), choices: dict[str, tuple[str, ...]] | None = None, fixed: tuple[str, ...] = ()
) -> str:
    """GenICam XML with the features that are not lacking; those that are fixed can be read only."""
    offered = CHOICES | (choices or {})
    features, registers = [], []
    for name in (name for name in FEATURE_NAMES if name not in lacking):
        access, register = "RO" if name in fixed else "RW", "IntReg"
        kind, more = "Command", "<CommandValue>1</CommandValue>"
        if name in offered:
            entries = (f"<EnumEntry Name='{e}'><Value>{k}</Value></EnumEntry>" for k, e in enumerate(offered[name]))
            kind, more = "Enumeration", "".join(entries)
        elif name in WHOLE:
            kind, more = "Integer", "<Min>{}</Min><Max>{}</Max><Inc>{}</Inc>".format(*WHOLE[name])
        elif name in FLOATS:
            kind, more, register = "Float", "<Min>{}</Min><Max>{}</Max>".format(*FLOATS[name]), "FloatReg"
        elif name in FLAGS:
            kind, more = "Boolean", ""
        else:
            access = "WO"
        features.append(
            f"<{kind} Name='{name}'>{more if kind == 'Enumeration' else ''}<pValue>{name}Reg</pValue>{more if kind != 'Enumeration' else ''}</{kind}>"
        )
        registers.append(
            f"<{register} Name='{name}Reg'><Address>{ADDRESS[name]}</Address><Length>4</Length><AccessMode>{access}</AccessMode>"
            f"<pPort>Device</pPort><Cachable>NoCache</Cachable>{'<Sign>Unsigned</Sign>' if register == 'IntReg' else ''}"
            f"<Endianess>LittleEndian</Endianess></{register}>"
        )
    return (
        "<RegisterDescription ModelName='T' VendorName='V' StandardNameSpace='None' SchemaMajorVersion='1' "
        "SchemaMinorVersion='1' SchemaSubMinorVersion='0' MajorVersion='1' MinorVersion='0' SubMinorVersion='0' "
        "ProductGuid='1F3C6A72-7842-4edd-9130-E2E90A2058BA' VersionGuid='7C9F2E1A-6A5B-4e8c-8A61-5E7A0C6B9D10' "
        f"xmlns='http://www.genicam.org/GenApi/Version_1_1'>{''.join(features)}{''.join(registers)}"
        "<Port Name='Device'/></RegisterDescription>"
    )


def frame_of(
    pixels: bytes,
    block: int = 9,
    stamp_ns: int = 10**15,
    size: tuple[int, int] = (64, 48),
    code: int = 0x01080001,
    valid: int | None = None,
) -> list[bytes]:
    leader = struct.pack("<4sHHQHHQIIIIIHH", b"U3VL", 0, 52, block, 0, 1, stamp_ns, code, *size, 0, 0, 0, 0)
    count = size[0] * size[1] if valid is None else valid
    return [leader, pixels, struct.pack("<4sHHQHHQI", b"U3VT", 0, 32, block, 0, 0, count, size[1])]


def usb_error(number: int) -> usb.core.USBError:
    return usb.core.USBError("failed", -1, number)


@dataclass
class Device:
    """What a device on the bus says of itself, and what is done with it."""

    serial: str = "KF-CAM-L"
    vision: bool = True
    speed: int | None = 4
    info: bytes = DEVICE_INFO
    iserial: int = 1
    string: bytes | None = None
    """In place of the serial number's descriptor."""
    interrupts: bool = False
    """Each interface begins with an endpoint that is not bulk."""
    fails: dict[str, int] = field(default_factory=dict)
    """Errors by what is done: ask, open, claim, release, clear, transfer."""
    answer: bytes = b""
    short_by: int = 0
    configuration: int = 0
    claimed: list[int] = field(default_factory=list)
    log: list[tuple[str, float]] = field(default_factory=list)
    timeouts_ms: list[int] = field(default_factory=list)
    is_open: bool = False
    plugged: bool = True

    def may(self, what: str) -> None:
        if not self.plugged:
            raise usb_error(errno.ENODEV)
        if what in self.fails:
            raise usb_error(self.fails[what])

    def take(self, endpoint: int, data: bytes) -> int:
        self.log.append((f"{endpoint:#x} {data!r}", len(data)))
        return len(data) - self.short_by

    def give(self, endpoint: int, buffer: memoryview, timeout_ms: int) -> int:
        buffer[: len(self.answer)] = self.answer
        return len(self.answer)


class Bus:
    """The part of ``usb.backend.IBackend`` that a camera needs: interfaces 0 (control), 1 (events) and 2 (stream)."""

    def __init__(self, *devices: Device) -> None:
        self._devices = devices

    def enumerate_devices(self) -> Iterator[Device]:
        return iter([device for device in self._devices if device.plugged])

    def get_device_descriptor(self, device: Device) -> Any:
        device.may("ask")
        return SimpleNamespace(iSerialNumber=device.iserial, speed=device.speed, bus=1, address=7)

    def get_configuration_descriptor(self, device: Device, config: int) -> Any:
        return SimpleNamespace(bNumInterfaces=3 if device.vision else 1, bConfigurationValue=1)

    def get_interface_descriptor(self, device: Device, index: int, alternate: int, config: int) -> Any:
        if alternate or config:
            raise IndexError(f"interface {index} has no alternate setting {alternate} in configuration {config}")
        return SimpleNamespace(
            bInterfaceNumber=index,
            bNumEndpoints=(2 if index == 0 else 1) + int(device.interrupts),
            bInterfaceClass=0xEF if device.vision else 0x08,
            bInterfaceSubClass=0x05 if device.vision else 0x06,
            bInterfaceProtocol=index,
            extra_descriptors=list(device.info) if index == 0 else None,
        )

    def get_endpoint_descriptor(self, device: Device, number: int, index: int, alternate: int, config: int) -> Any:
        number -= int(device.interrupts)
        if number < 0:
            return SimpleNamespace(bmAttributes=3, bEndpointAddress=0x8F)
        return SimpleNamespace(bmAttributes=2, bEndpointAddress=(0x81 + index) if number == 0 else 0x01)

    def open_device(self, device: Device) -> Device:
        device.may("open")
        device.is_open = True
        return device

    def close_device(self, device: Device) -> None:
        device.is_open = False

    def get_configuration(self, device: Device) -> int:
        return device.configuration

    def set_configuration(self, device: Device, value: int) -> None:
        device.log.append(("configuration", value))
        device.configuration = value

    def claim_interface(self, device: Device, interface: int) -> None:
        if interface == 2:
            device.may("claim")
        device.claimed.append(interface)

    def release_interface(self, device: Device, interface: int) -> None:
        device.may("release")
        device.claimed.remove(interface)

    def ctrl_transfer(
        self, device: Device, kind: int, request: int, value: int, index: int, data: Any, timeout_ms: int
    ) -> int:
        assert 0 < timeout_ms <= 2000, "a device that does not answer is not waited for"
        if (kind, request, value) == (0x02, 0x03, 0):  # USB 2.0, 9.4.9: SET_FEATURE(ENDPOINT_HALT)
            device.log.append(("set halt", index))
            return 0
        assert (kind, request, value >> 8, index) == (0x80, 0x06, 0x03, 0x0409)
        text = (device.serial if value & 0xFF == 3 else "not the U3V serial").encode("utf-16-le")
        string = bytes([len(text) + 2, 3]) + text if device.string is None else device.string
        data[: len(string)] = np.frombuffer(string, np.uint8)
        return len(string)

    def clear_halt(self, device: Device, endpoint: int) -> None:
        device.may("clear")
        device.log.append(("clear halt", endpoint))

    def bulk_write(self, device: Device, endpoint: int, interface: int, data: Any, timeout_ms: int) -> int:
        device.timeouts_ms.append(timeout_ms)
        device.may("transfer")
        return device.take(endpoint, bytes(memoryview(data)))

    def bulk_read(self, device: Device, endpoint: int, interface: int, data: Any, timeout_ms: int) -> int:
        device.timeouts_ms.append(timeout_ms)
        device.may("transfer")
        return device.give(endpoint, memoryview(data), timeout_ms)


class ScriptedCamera(Device):
    """A camera as far as a driver needs it: a sparse register memory behind the control endpoint, and a stream."""

    def __init__(self, clock: SteppedClock, xml: str | None = None) -> None:
        super().__init__(configuration=1)
        self.clock = clock
        self.memory: dict[int, int] = {}
        self.refusing: dict[int, int] = {}
        self.rounding: dict[str, int] = {}
        """What a feature's register holds whatever is written to it."""
        self.when: dict[str, Callable[[], None]] = {}
        """What else happens when a register is written."""
        self.stream: list[bytes] = []
        self.stream_buffers: list[int] = []
        self.longest_read = 0
        self.latches_take_s: list[float] = []
        for offset, text in ((0x004, "Reef"), (0x044, "Eye"), (0x0C4, "1.2"), (0x144, "KF-CAM-L")):
            self.set(offset, text.encode().ljust(64, b"\0"))
        self.set(0x1CC, struct.pack("<I", 300))
        self.set(0x1D0, struct.pack("<QQ", MANIFEST, SBRM))
        self.set(SBRM + 0x14, struct.pack("<IIIQ", 512, 256, 1, SIRM))
        self.set(SBRM + 0x40, struct.pack("<I", 8))
        self.needs()
        data = (description() if xml is None else xml).encode()
        self.set(MANIFEST, struct.pack("<QIIQQ40x", 1, 0x0001_0000, 0, FILE, len(data)))
        self.set(FILE, data)
        self.set_feature("DeviceTemperature", 41.5)
        # As a camera wakes up that somebody else used: every flag is set, and pixels are added up.
        for name in (*FLAGS, "BinningHorizontal", "BinningVertical"):
            self.set_feature(name, 1 if name in FLAGS else 2)
        self.set_feature("Gamma", 0.5)
        self.set_feature("TriggerDelay", 100.0)

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

    def written(self, address: int, data: bytes) -> None:
        name = OF_ADDRESS[address]
        (value,) = struct.unpack("<f" if name in FLOATS else "<I", data)
        self.log.append((name, value))
        self.set(address, struct.pack("<I", self.rounding[name]) if name in self.rounding else data)
        if name in self.when:
            self.when[name]()
        if name == "latch":
            self.clock.advance_s(self.latches_take_s.pop(0) if self.latches_take_s else 1e-4)
            self.set(0x1F0, struct.pack("<Q", self.clock.now_ns() - 500_000_000))

    # ---- its endpoints

    def take(self, endpoint: int, data: bytes) -> int:
        _, _, code, size, request = struct.unpack_from("<IHHHH", data)
        (address,) = struct.unpack_from("<Q", data, 12)
        status = self.refusing.get(address, 0)
        payload = b""
        if not status and code == 0x0800:
            (count,) = struct.unpack_from("<H", data, 22)
            payload = self.get(address, count)
            self.longest_read = max(self.longest_read, count)
        elif not status:
            payload = struct.pack("<HH", 0, size - 8)
            self.written(address, data[20:])
        self.answer = struct.pack("<4sHHHH", b"U3VC", status, code + 1, len(payload), request) + payload
        return len(data)

    def give(self, endpoint: int, buffer: memoryview, timeout_ms: int) -> int:
        answer = self.answer
        if endpoint != 0x81:
            self.stream_buffers.append(len(buffer))
            if not self.stream:
                self.clock.advance_s(timeout_ms * 1e-3)
                raise usb.core.USBTimeoutError("nothing", -7, errno.ETIMEDOUT)
            answer = self.stream.pop(0)
            if len(answer) > len(buffer):
                raise usb_error(errno.EOVERFLOW)
        buffer[: len(answer)] = answer
        return len(answer)
