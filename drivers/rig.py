"""Opening devices by the names in a rig file: the only place that picks classes.

Every function returns a context manager; the device inside satisfies the protocol of ``drivers.api``.
"""

from __future__ import annotations

import importlib
from contextlib import AbstractContextManager

from drivers.api import Camera, CameraSpec, DeviceRefused, Wires, WiresOptions
from drivers.board import BoardSpec, TriggerBoard
from drivers.camera_families import USUAL, opener
from drivers.keys import HidKeypad, KeysSpec
from drivers.output.outputs import Outputs
from drivers.output.spec import OutputKind, OutputSpec
from drivers.registered_wires import REMEDY, check_registered

__all__ = [
    "BoardSpec",
    "CameraSpec",
    "KeysSpec",
    "OutputKind",
    "OutputSpec",
    "open_board",
    "open_camera",
    "open_keys",
    "open_outputs",
    "open_wires",
]


def open_wires(name: str, options: WiresOptions) -> AbstractContextManager[Wires]:
    """Return the wires that the registered ``module:function`` makes from ``options``.

    Raises DeviceRefused for a name that is not registered, before its module is imported, and where it is not
    installed.
    """
    check_registered(name)
    module_name, _, function_name = name.partition(":")
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise DeviceRefused("wires", f"{name!r}: {error}", REMEDY) from error
    opened: AbstractContextManager[Wires] = getattr(module, function_name)(options)
    return opened


def open_camera(spec: CameraSpec, wires: Wires, kind: str = USUAL) -> AbstractContextManager[Camera]:
    """Find, open and identify one camera of the family ``kind``. Raises DeviceGone, DeviceRefused."""
    return opener(kind)(spec, wires)


def open_board(spec: BoardSpec, wires: Wires) -> TriggerBoard:
    """Open the board and start its reader thread. Raises DeviceGone, DeviceRefused."""
    return TriggerBoard.open(spec, wires.clock)


def open_keys(spec: KeysSpec, wires: Wires) -> HidKeypad:
    """Open the keypad and wait for its first report. Raises DeviceGone, DeviceRefused."""
    return HidKeypad.open(spec, wires.hidraw, wires.clock)


def open_outputs(projector: OutputSpec, display: OutputSpec, wires: Wires) -> Outputs:
    """Return both outputs, unlit until ``open_projector()`` and ``open_display()`` are called.

    Two heads may share one card, so they are made together, but each can be opened again on its own.
    """
    return Outputs(projector, display, wires)
