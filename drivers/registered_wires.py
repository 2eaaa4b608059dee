"""The list of wires that a rig file may name.

A rig file is data, often from other people. The function that it names as ``wires`` is called with its
``wires_options``; were any function allowed, reading a rig file would be running it. So the list is part of the
program, and a new world adds itself here (``docs/adr/0003-wires-are-the-only-meeting-point.md``).
"""

from __future__ import annotations

from drivers.errors import DeviceRefused

NATIVE = "drivers.native:open"
REGISTERED = (NATIVE, "hw_sim.wires:open")
"""Each a ``module:function`` that takes ``WiresOptions`` and gives a context manager of ``drivers.api.Wires``."""

REMEDY = f'Correct wires of [rig]; on the instrument it is "{NATIVE}"'


def check_registered(name: str) -> None:
    """Raise DeviceRefused, with the registered names, for any other one."""
    if name not in REGISTERED:
        raise DeviceRefused("wires", f"{name!r} is not registered; allowed: {', '.join(REGISTERED)}", REMEDY)
