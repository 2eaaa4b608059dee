"""The key pad: four keys that work with gloves, as HID reports."""

from drivers.keys.keypad import HidKeypad
from drivers.keys.spec import KeysSpec

__all__ = ["HidKeypad", "KeysSpec"]
