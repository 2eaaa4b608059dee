"""Owns access to a camera's features by their SFNC names, through the description that the camera carries.

Source of the names: GenICam Standard Features Naming Convention 2.7.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from genicam import genapi

from drivers.api import DeviceRefused, FeatureValue
from drivers.camera.references import WrongReference, check_references

_NUMBERS, _CHOICE, _COMMAND = (genapi.IInteger, genapi.IFloat), (genapi.IEnumeration,), (genapi.ICommand,)
_VALUES = (*_NUMBERS, *_CHOICE, genapi.IBoolean)
_REMEDY = "Check the rig's camera settings against the camera's manual"

_OLDER_NAMES = {"ExposureTime": "ExposureTimeAbs", "TriggerDelay": "TriggerDelayAbs"}
"""Names of SFNC 1.x, in the same unit, which many cameras with GigE Vision still have instead of today's."""


class RegisterMemory(Protocol):
    """A camera's register memory, over whatever bus."""

    def read(self, address: int, count: int) -> bytes:
        """``count`` bytes from ``address``. Raises DeviceGone, DeviceRefused."""

    def write(self, address: int, data: bytes) -> None:
        """Write ``data`` at ``address``. Raises DeviceGone, DeviceRefused."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Allowed values of a number, now. ``step`` is 1 where any value between them is allowed."""

    low: float
    high: float
    step: float


class _Port(genapi.AbstractPort):  # type: ignore[misc]  # the package has no types
    """GenApi's view of the register memory, whose exceptions pass through GenApi unchanged."""

    def __init__(self, memory: RegisterMemory) -> None:
        super().__init__()
        self._memory = memory

    def get_access_mode(self) -> Any:
        return genapi.EAccessMode.RW

    def read(self, address: int, length: int) -> bytes:
        return self._memory.read(address, length)

    def write(self, address: int, data: bytes) -> None:
        self._memory.write(address, bytes(data))


class Features:
    """The node map of one camera. Not safe for several threads at a time; its owner takes care of that.

    Every method raises DeviceRefused, naming the feature, the value and what is allowed, when the camera lacks the
    feature or refuses the value, and passes DeviceGone of the register memory on. A feature that has only its name of SFNC 1.x is
    found under today's.
    """

    def __init__(self, device: str, xml: str, memory: RegisterMemory) -> None:
        self._device = device
        self._map = genapi.NodeMap()
        try:
            check_references(xml)
            self._map.load_xml_from_string(xml)
            # Held by the map: GenApi keeps only a bare pointer to the port.
            self._map.connect(_Port(memory), "Device")
        except (genapi.GenericException, WrongReference) as error:
            raise DeviceRefused(
                device, f"its description cannot be loaded ({_short(error)})", "Update the camera's firmware"
            ) from error

    def has(self, feature: str) -> bool:
        """True when the camera knows the feature and it is implemented."""
        node = self._find(feature)
        return node is not None and bool(genapi.is_implemented(node))

    def writable(self, feature: str) -> bool:
        """True when the feature exists and may be written in the present state."""
        node = self._find(feature)
        return node is not None and bool(genapi.is_writable(node))

    def number(self, feature: str) -> float:
        """Value of an integer or float feature."""
        node = self._node(feature, _NUMBERS)
        try:
            return float(node.value)
        except genapi.GenericException as error:
            raise self._refused(feature, "cannot be read", error) from error

    def set_number(self, feature: str, value: float) -> float:
        """Write an integer or float feature; returns what the camera holds afterwards."""
        node = self._node(feature, _NUMBERS)
        whole = isinstance(node, genapi.IInteger)
        try:
            node.value = int(value) if whole else float(value)
            # Asked anew: a description may let us keep what was written, and a camera may round it nevertheless.
            return float(node.get_value(False, True))
        except genapi.GenericException as error:
            raise self._refused(feature, f"{value:g} refused, allowed {_range_of(node, whole)}", error) from error

    def choice(self, feature: str) -> str:
        """Symbol of an enumeration feature."""
        node = self._node(feature, _CHOICE)
        try:
            return str(node.value)
        except genapi.GenericException as error:
            raise self._refused(feature, "cannot be read", error) from error

    def choices(self, feature: str) -> tuple[str, ...]:
        """Symbols that the camera offers now, in the order of its description."""
        node = self._node(feature, _CHOICE)
        try:
            return tuple(str(entry.symbolic) for entry in node.entries if genapi.is_available(entry.node))
        except genapi.GenericException as error:
            raise self._refused(feature, "cannot be read", error) from error

    def choose(self, feature: str, symbol: str) -> None:
        """Set an enumeration feature."""
        node = self._node(feature, _CHOICE)
        try:
            node.value = symbol
        except genapi.GenericException as error:
            allowed = " ".join(self.choices(feature)) or "nothing"
            raise self._refused(feature, f"{symbol} refused, allowed: {allowed}", error) from error

    def limits(self, feature: str) -> Limits:
        """Return what an integer or float feature may be in the present state."""
        node = self._node(feature, _NUMBERS)
        try:
            step = float(node.inc) if isinstance(node, genapi.IInteger) else 1.0
            return Limits(float(node.min), float(node.max), step)
        except genapi.GenericException as error:
            raise self._refused(feature, "cannot be read", error) from error

    def value(self, feature: str) -> FeatureValue:
        """Return what the camera holds, whatever kind of feature it is: of an enumeration its symbol."""
        node = self._node(feature, _VALUES)
        try:
            # Asked anew: a description may let us keep what was written.
            if isinstance(node, genapi.IEnumeration):
                return str(node.get_current_entry(False, True).symbolic)
            if isinstance(node, genapi.IBoolean):
                return bool(node.get_value(False, True))
            return float(node.get_value(False, True))
        except genapi.GenericException as error:
            raise self._refused(feature, "cannot be read", error) from error

    def set_value(self, feature: str, value: FeatureValue) -> None:
        """Write a feature of whatever kind; the value must be of that kind."""
        node = self._node(feature, _VALUES)
        if isinstance(node, genapi.IBoolean) and isinstance(value, bool):
            try:
                node.value = value
            except genapi.GenericException as error:
                raise self._refused(feature, f"{value} refused", error) from error
        elif isinstance(node, genapi.IEnumeration) and isinstance(value, str):
            self.choose(feature, value)
        elif isinstance(node, _NUMBERS) and isinstance(value, int | float) and not isinstance(value, bool):
            self.set_number(feature, value)
        else:
            kind = (
                "true or false"
                if isinstance(node, genapi.IBoolean)
                else "a number"
                if isinstance(node, _NUMBERS)
                else "a name"
            )
            raise DeviceRefused(self._device, f"{feature} = {value!r}: it must be {kind}", _REMEDY)

    def forget(self) -> None:
        """Ask the camera anew for everything: its state was changed as a whole."""
        for node in self._map.nodes:
            node.node.invalidate_node()

    def execute(self, feature: str) -> None:
        """Run a command feature."""
        node = self._node(feature, _COMMAND)
        try:
            node.execute()
        except genapi.GenericException as error:
            raise self._refused(feature, "cannot be executed", error) from error

    def _find(self, feature: str) -> Any:
        found = self._get(feature)
        return self._get(_OLDER_NAMES[feature]) if found is None and feature in _OLDER_NAMES else found

    def _get(self, name: str) -> Any:
        try:
            return self._map.get_node(name)
        except genapi.GenericException:
            return None

    def _node(self, feature: str, kinds: tuple[Any, ...]) -> Any:
        """The feature, which must be of one of these kinds: a description may call anything by a standard name."""
        node = self._find(feature)
        if node is None:
            raise DeviceRefused(self._device, f"has no feature {feature}", "Use a camera that follows the SFNC")
        if not isinstance(node, kinds):
            raise DeviceRefused(
                self._device,
                f"{feature} is an {type(node).__name__}, not {' or '.join(kind.__name__ for kind in kinds)}",
                "Use a camera that follows the SFNC",
            )
        return node

    def _refused(self, feature: str, what: str, error: Exception) -> DeviceRefused:
        return DeviceRefused(self._device, f"{feature}: {what} ({_short(error)})", _REMEDY)


def _short(error: Exception) -> str:
    return str(error).split(" : ", maxsplit=1)[0].strip().rstrip(".")


def _range_of(node: Any, whole: bool) -> str:
    try:
        step = f" in steps of {node.inc}" if whole and node.inc != 1 else ""
        return f"{node.min:g}..{node.max:g}{step}"
    except genapi.GenericException:
        return "range unknown"
