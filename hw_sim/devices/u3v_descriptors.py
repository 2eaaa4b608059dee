"""The USB descriptors of the camera, at SuperSpeed and in the fall-back to 480 Mbit/s."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

VENDOR_ID, PRODUCT_ID, DEVICE_VERSION = 0x1209, 0x4B43, 0x0120
CONTROL_OUT, CONTROL_IN, EVENT_IN, STREAM_IN = 0x01, 0x81, 0x82, 0x83
CONTROL_INTERFACE, EVENT_INTERFACE, STREAM_INTERFACE = 0, 1, 2
GENCP_VERSION = (1, 3)
U3V_VERSION = (1, 0)
LANGUAGE = 0x0409

_DEVICE, _CONFIGURATION, _STRING, _INTERFACE, _ENDPOINT = 1, 2, 3, 4, 5
_ASSOCIATION, _BOS, _CAPABILITY, _COMPANION, _CLASS_INTERFACE = 11, 15, 16, 48, 0x24
_MISCELLANEOUS, _U3V = 0xEF, 0x05
_BULK = 2


class Speed(IntEnum):
    """Bus speed, numbered as libusb does."""

    HIGH = 3
    SUPER = 4

    @property
    def bulk_packet(self) -> int:
        """Number of bytes in a full bulk packet."""
        return 1024 if self is Speed.SUPER else 512

    @property
    def bytes_per_s(self) -> float:
        """Real data rate of bulk transfers."""
        return 380e6 if self is Speed.SUPER else 38e6


@dataclass(frozen=True, slots=True)
class Identity:
    """The camera's identification; ``guid`` is vendor and serial in 12 hex digits."""

    vendor: str
    model: str
    family: str
    version: str
    info: str
    guid: str
    serial: str
    user_name: str

    def strings(self) -> tuple[str, ...]:
        """USB strings 1..8 in the order of the U3V device-info descriptor."""
        return (
            *(self.guid, self.vendor, self.model, self.family),
            *(self.version, self.info, self.serial, self.user_name),
        )


def device(speed: Speed, ids: tuple[int, int]) -> bytes:
    """Return the device descriptor; ``ids``: numbers of vendor and product.

    The USB serial number is the GUID, as U3V requires.
    """
    # USB 3.2, device descriptor: a SuperSpeed device gives the packet size of endpoint 0 as a power of two: 2⁹.
    usb, packet0 = (0x0300, 9) if speed is Speed.SUPER else (0x0210, 64)
    return struct.pack(
        "<BBHBBBBHHHBBBB",
        *(18, _DEVICE, usb, _MISCELLANEOUS, 0x02, 0x01, packet0),
        *(*ids, DEVICE_VERSION, 2, 3, 1, 1),
    )


def configuration(speed: Speed) -> bytes:
    """Return the complete configuration: three interfaces in one association."""
    parts = [
        struct.pack("<BBBBBBBB", 8, _ASSOCIATION, CONTROL_INTERFACE, 3, _MISCELLANEOUS, _U3V, 0, 3),
        _interface(CONTROL_INTERFACE, 2, 0),
        _device_info(),
        _endpoint(CONTROL_IN, speed, 0),
        _endpoint(CONTROL_OUT, speed, 0),
        _interface(EVENT_INTERFACE, 1, 1),
        _endpoint(EVENT_IN, speed, 0),
        _interface(STREAM_INTERFACE, 1, 2),
        _endpoint(STREAM_IN, speed, 15),
    ]
    body = b"".join(parts)
    # bMaxPower has another unit at each speed.
    power = 112 if speed is Speed.SUPER else 250  # 896 mA in units of 8 mA; 500 mA in units of 2 mA
    return struct.pack("<BBHBBBBB", 9, _CONFIGURATION, 9 + len(body), 3, 1, 0, 0x80, power) + body


def bos(speed: Speed) -> bytes:
    """Return the binary device object store: USB 2 link power management and SuperSpeed."""
    usb2 = struct.pack("<BBBI", 7, _CAPABILITY, 2, 0x02)
    superspeed = struct.pack("<BBBBHBBH", 10, _CAPABILITY, 3, 0, 0x000C, 2, 10, 200)
    return struct.pack("<BBHB", 5, _BOS, 5 + len(usb2) + len(superspeed), 2) + usb2 + superspeed


def string(identity: Identity, index: int) -> bytes | None:
    """Return a string descriptor; number 0 lists the languages; ``None`` past the end."""
    if index == 0:
        return struct.pack("<BBH", 4, _STRING, LANGUAGE)
    strings = identity.strings()
    if index > len(strings):
        return None
    text = strings[index - 1].encode("utf-16-le")
    return struct.pack("<BB", 2 + len(text), _STRING) + text


def _interface(number: int, endpoints: int, protocol: int) -> bytes:
    return struct.pack("<BBBBBBBBB", 9, _INTERFACE, number, 0, endpoints, _MISCELLANEOUS, _U3V, protocol, 0)


def _endpoint(address: int, speed: Speed, burst: int) -> bytes:
    # Only SuperSpeed endpoints are followed by a companion (USB 3.2, 9.6.7), which holds the burst size.
    endpoint = struct.pack("<BBBBHB", 7, _ENDPOINT, address, _BULK, speed.bulk_packet, 0)
    companion = struct.pack("<BBBBH", 6, _COMPANION, burst, 0, 0)
    return endpoint + (companion if speed is Speed.SUPER else b"")


def _device_info() -> bytes:
    (gencp_major, gencp_minor), (u3v_major, u3v_minor) = GENCP_VERSION, U3V_VERSION
    strings = tuple(range(1, 9))
    speeds = 0x0C  # high speed and SuperSpeed
    return struct.pack(
        "<BBBHHHH8BB", 20, _CLASS_INTERFACE, 1, gencp_minor, gencp_major, u3v_minor, u3v_major, *strings, speeds
    )
