"""The plug of each device of the instrument, as paths and attributes of sysfs."""

from __future__ import annotations

from types import ModuleType

from hw_sim.devices.u3v_camera import U3vCamera
from hw_sim.devices.u3v_descriptors import Speed
from hw_sim.wires.umockdev.hidraw_node import PHYS
from hw_sim.wires.umockdev.tree import SysDevice

PCI = "devices/pci0000:00"
SUPER_SPEED_BUS, HIGH_SPEED_BUS, PAD_BUS = 2, 1, 1
USB_MAJOR, TTY_MAJOR, DRM_MAJOR, HIDRAW_MAJOR = 189, 166, 226, 240
_MBIT = {Speed.HIGH: "480", Speed.SUPER: "5000"}

FIXED = (
    SysDevice(f"{PCI}/0000:00:14.0", "pci", attributes={"class": "0x0c0330"}),
    SysDevice(f"{PCI}/0000:00:02.0", "pci", attributes={"class": "0x030000"}),
)
"""The host's own devices: a USB controller and a display controller."""
BOARD = SysDevice(
    f"{PCI}/0000:00:14.0/usb1/1-9/1-9:1.0/tty/ttyACM0", "tty", "ttyACM0", (TTY_MAJOR, 0), attributes={"dev": "166:0"}
)
BOARD_LINK = "kingfisher-board"
"""Name of the link that the instrument's udev rules make."""
CARD = SysDevice(
    f"{PCI}/0000:00:02.0/drm/card0", "drm", "dri/card0", (DRM_MAJOR, 0), "drm_minor", attributes={"dev": "226:0"}
)


def bus_of(device: U3vCamera) -> int:
    """Return the bus of the camera's speed."""
    return SUPER_SPEED_BUS if device.speed is Speed.SUPER else HIGH_SPEED_BUS


def camera(device: U3vCamera, port: int, address: int) -> SysDevice:
    """Return a camera on its port; ``address`` is new each time it appears."""
    bus = bus_of(device)
    descriptors = device.device_descriptor() + device.configuration_descriptor()
    # drivers/usb/core: the minor number of a device node holds bus and address.
    minor = (bus - 1) * 128 + address - 1
    return SysDevice(
        f"{PCI}/0000:00:14.0/usb{bus}/{bus}-{port}",
        "usb",
        f"bus/usb/{bus:03d}/{address:03d}",
        (USB_MAJOR, minor),
        "usb_device",
        {
            "busnum": str(bus),
            "devnum": str(address),
            "devpath": str(port),
            "speed": _MBIT[device.speed],
            "bConfigurationValue": "1",
            "idVendor": f"{device.usb_ids[0]:04x}",
            "idProduct": f"{device.usb_ids[1]:04x}",
            "manufacturer": device.identity.vendor,
            "product": device.identity.model,
            "serial": device.identity.guid,
            "dev": f"{USB_MAJOR}:{minor}",
            "descriptors": descriptors,
        },
        properties={"BUSNUM": f"{bus:03d}", "DEVNUM": f"{address:03d}"},
    )


def keypad(pad: ModuleType, number: int, address: int) -> list[SysDevice]:
    """Return the pad's chain from the bus to ``hidrawN``; parents first.

    Its USB device has no node, as no library opens one.
    """
    root = f"{PCI}/0000:00:14.0/usb{PAD_BUS}/{PAD_BUS}-5"
    interface = f"{root}/{PAD_BUS}-5:1.0"
    name = f"0003:{pad.VENDOR:04X}:{pad.PRODUCT:04X}.{address:04X}"
    hid = f"{interface}/{name}"
    identity = {
        "DRIVER": "hid-generic",
        "HID_ID": f"0003:{pad.VENDOR:08X}:{pad.PRODUCT:08X}",
        "HID_NAME": f"{pad.MANUFACTURER} {pad.NAME}",
        "HID_PHYS": PHYS,
        "HID_UNIQ": pad.SERIAL,
    }
    minor = number % 64
    return [
        SysDevice(
            root,
            "usb",
            kind="usb_device",
            attributes={
                "busnum": str(PAD_BUS),
                "devnum": str(address),
                "speed": "12",
                "idVendor": f"{pad.VENDOR:04x}",
                "idProduct": f"{pad.PRODUCT:04x}",
                "bcdDevice": f"{pad.RELEASE:04x}",
                "manufacturer": pad.MANUFACTURER,
                "product": pad.NAME,
                "serial": pad.SERIAL,
            },
        ),
        SysDevice(
            interface, "usb", kind="usb_interface", attributes={"bInterfaceNumber": "00", "bInterfaceClass": "03"}
        ),
        SysDevice(hid, "hid", attributes={"report_descriptor": pad.REPORT_DESCRIPTOR}, properties=identity),
        SysDevice(
            f"{hid}/hidraw/hidraw{number}",
            "hidraw",
            f"hidraw{number}",
            (HIDRAW_MAJOR, minor),
            attributes={"dev": f"{HIDRAW_MAJOR}:{minor}"},
            links={"device": f"../../../{name}"},
        ),
    ]
