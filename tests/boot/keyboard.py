"""Owns the keys of the virtual machine's keyboard: what to press for a text (US layout, as a Linux console has it)."""

from __future__ import annotations

_NAMES = {
    " ": "spc", "\n": "ret", "-": "minus", "=": "equal", "/": "slash", ".": "dot", ",": "comma", ";": "semicolon",
    "'": "apostrophe", "\\": "backslash", "[": "bracket_left", "]": "bracket_right", "`": "grave_accent",
}  # fmt: skip
_SHIFTED = dict(zip('_+?><:"|{}~!@#$%^&*()', "-=/.,;'\\[]`1234567890", strict=False)) | {">": ".", "<": ","}


def keys_of(text: str) -> list[list[str]]:
    """Chords, one for each character, as QEMU names keys. Raises KeyError for what is not on this keyboard."""
    return [_chord(character) for character in text]


def _chord(character: str) -> list[str]:
    if character in _SHIFTED:
        return ["shift", *_chord(_SHIFTED[character])]
    if character.isascii() and character.isupper():
        return ["shift", character.lower()]
    if character.isascii() and character.isalnum():
        return [character]
    return [_NAMES[character]]
