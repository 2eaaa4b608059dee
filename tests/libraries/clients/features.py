"""Reads named features of a camera through the reference implementation of GenApi, over the shipped control channel.

Arguments: serial number, names of features.
"""

from __future__ import annotations

import sys
from typing import Any

from genicam import genapi

from drivers.camera.bootstrap import read_identification, read_technology
from drivers.camera.control import ControlChannel
from drivers.camera.description import read_description
from drivers.camera.usb import UsbCamera, default_backend, find_camera
from drivers.native import MonotonicClock
from tests.libraries.clients import say


class Port(genapi.AbstractPort):  # type: ignore[misc]
    """Registers, four bytes and more at a time."""

    def __init__(self, control: ControlChannel) -> None:
        super().__init__()
        self._control = control

    def get_access_mode(self) -> Any:
        return genapi.EAccessMode.RW

    def read(self, address: int, length: int) -> bytes:
        return self._control.read(address, length)

    def write(self, address: int, data: bytes) -> None:
        self._control.write(address, bytes(data))


if __name__ == "__main__":
    serial, *names = sys.argv[1:]
    usb = UsbCamera(serial, find_camera(default_backend(), serial, serial))
    control = ControlChannel(serial, usb.control(), MonotonicClock())
    who = read_identification(control)
    technology = read_technology(control, who.sbrm_address)
    control.set_limits(technology.max_command_size, technology.max_answer_size, who.max_response_time_s)
    xml = read_description(control, serial, who.manifest_address)
    nodes = genapi.NodeMap()
    nodes.load_xml_from_string(xml)
    nodes.connect(Port(control), "Device")
    say(xml=xml, values={name: nodes.get_node(name).to_string() for name in names})
    usb.close()
