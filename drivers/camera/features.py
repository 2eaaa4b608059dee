"""Access to a camera's features by their SFNC names, through the description that the camera carries.

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
    """A camera's register memory on any bus."""

    def read(self, address: int, count: int) -> bytes:
        """Return ``count`` bytes from ``address``. Raises DeviceGone, DeviceRefused."""

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
    """The node map of one camera. Not safe for several threads at a time; its owner ensures that.

    Every method raises DeviceRefused, naming the feature, the value and the allowed ones, when the camera lacks the
    feature or refuses the value, and passes DeviceGone of the register memory on. A feature that has only its name of
    SFNC 1.x is found under today's.
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
        """Return True if the camera knows the feature and it is implemented."""
        node = self._find(feature)
        return node is not None and bool(genapi.is_implemented(node))

    def writable(self, feature: str) -> bool:
        """Return True if the feature exists and may be written in the present state."""
        node = self._find(feature)
        return node is not None and bool(genapi.is_writable(node))

    def number(self, feature: str) -> float:
        """Return the value of an integer or float feature."""
        node = self._node(feature, _NUMBERS)
        try:
            return float(node.value)
        except genapi.GenericException as error:
            raise self._refused(feature, "cannot be read", error) from error

    def set_number(self, feature: str, value: float) -> float:
        """Write an integer or float feature and return its value in the camera afterwards."""
        node = self._node(feature, _NUMBERS)
        is_integer = isinstance(node, genapi.IInteger)
        try:
            node.value = int(value) if is_integer else float(value)
            # Read from the camera: the description may allow caching the written value, which the camera may round.
            return float(node.get_value(False, True))
        except genapi.GenericException as error:
            raise self._refused(feature, f"{value:g} refused, allowed {_range_of(node, is_integer)}", error) from error

    def choice(self, feature: str) -> str:
        """Return the symbol of an enumeration feature."""
        node = self._node(feature, _CHOICE)
        try:
            return str(node.value)
        except genapi.GenericException as error:
            raise self._refused(feature, "cannot be read", error) from error

    def choices(self, feature: str) -> tuple[str, ...]:
        """Return the symbols that the camera offers now, in the order of its description."""
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
        """Return the limits of an integer or float feature in the present state."""
        node = self._node(feature, _NUMBERS)
        try:
            step = float(node.inc) if isinstance(node, genapi.IInteger) else 1.0
            return Limits(float(node.min), float(node.max), step)
        except genapi.GenericException as error:
            raise self._refused(feature, "cannot be read", error) from error

    def value(self, feature: str) -> FeatureValue:
        """Return the value of a feature of any kind; of an enumeration its symbol."""
        node = self._node(feature, _VALUES)
        try:
            # Read from the camera: the description may allow caching the written value.
            if isinstance(node, genapi.IEnumeration):
                return str(node.get_current_entry(False, True).symbolic)
            if isinstance(node, genapi.IBoolean):
                return bool(node.get_value(False, True))
            return float(node.get_value(False, True))
        except genapi.GenericException as error:
            raise self._refused(feature, "cannot be read", error) from error

    def set_value(self, feature: str, value: FeatureValue) -> None:
        """Write a feature of any kind; the value must be of that kind."""
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
        """Drop all cached values, because the camera's state was changed as a whole."""
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
        node = self._get(feature)
        return self._get(_OLDER_NAMES[feature]) if node is None and feature in _OLDER_NAMES else node

    def _get(self, name: str) -> Any:
        try:
            return self._map.get_node(name)
        except genapi.GenericException:
            return None

    def _node(self, feature: str, kinds: tuple[Any, ...]) -> Any:
        """Return a feature that must be of one of these kinds: a description may use a standard name for any."""
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


def _range_of(node: Any, is_integer: bool) -> str:
    try:
        step = f" in steps of {node.inc}" if is_integer and node.inc != 1 else ""
        return f"{node.min:g}..{node.max:g}{step}"
    except genapi.GenericException:
        return "range unknown"
