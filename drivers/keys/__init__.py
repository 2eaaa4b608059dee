"""The keypad: four keys that work with gloves, as HID reports."""

from drivers.keys.keypad import HidKeypad, KeysSpec

__all__ = ["HidKeypad", "KeysSpec"]
