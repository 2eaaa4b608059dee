"""Owns the letters of the safe screen: 5 x 7 dots each, capitals only, so that it needs no font file and no library."""

from __future__ import annotations

WIDTH, HEIGHT = 5, 7
ADVANCE, LINE = 6, 10
"""From letter to letter and from line to line, in dots."""

_COLUMNS = {
    " ": "0000000000", "!": "00005F0000", '"': "0007000700", "#": "147F147F14", "%": "2313086462", "&": "3649552250",
    "'": "0000070000", "(": "001C224100", ")": "0041221C00", "*": "14083E0814", "+": "08083E0808", ",": "0050300000",
    "-": "0808080808", ".": "0060600000", "/": "2010080402", "0": "3E5149453E", "1": "00427F4000", "2": "4261514946",
    "3": "2141454B31", "4": "1814127F10", "5": "2745454539", "6": "3C4A494930", "7": "0171090503", "8": "3649494936",
    "9": "064949291E", ":": "0036360000", ";": "0056360000", "<": "0814224100", "=": "1414141414", ">": "0041221408",
    "?": "0201510906", "@": "324979413E", "A": "7E1111117E", "B": "7F49494936", "C": "3E41414122", "D": "7F4141221C",
    "E": "7F49494941", "F": "7F09090901", "G": "3E4149497A", "H": "7F0808087F", "I": "00417F4100", "J": "2040413F01",
    "K": "7F08142241", "L": "7F40404040", "M": "7F020C027F", "N": "7F0408107F", "O": "3E4141413E", "P": "7F09090906",
    "Q": "3E4151215E", "R": "7F09192946", "S": "4649494931", "T": "01017F0101", "U": "3F4040403F", "V": "1F2040201F",
    "W": "3F4038403F", "X": "6314081463", "Y": "0708700807", "Z": "6151494543", "[": "007F414100", "\\": "0204081020",
    "]": "0041417F00", "_": "4040404040", "|": "00007F0000", "Ä": "7D1212127D", "Ö": "3D4242423D", "Ü": "3D4040403D",
}  # fmt: skip
"""Five columns from left to right, the lowest bit on top."""

_LETTERS = {
    letter: tuple(tuple(bool(columns[k] >> row & 1) for k in range(WIDTH)) for row in range(HEIGHT))
    for letter, columns in ((letter, bytes.fromhex(code)) for letter, code in _COLUMNS.items())
}


def letter(character: str) -> tuple[tuple[bool, ...], ...]:
    """Seven rows of five dots; small letters are shown as capitals, what is not known as a question mark."""
    for candidate in (character, character.upper()):
        if candidate in _LETTERS:
            return _LETTERS[candidate]
    return _LETTERS["?"]


def wrap(text: str, columns: int, lines: int) -> list[str]:
    """``text`` in lines of at most ``columns`` letters, broken between words where it can be; what is left ends in dots."""
    found, line = list[str](), ""
    for word in text.split():
        while len(word) > columns:
            if line:
                found.append(line)
                line = ""
            found.append(word[:columns])
            word = word[columns:]
        joined = f"{line} {word}" if line else word
        if len(joined) > columns:
            found.append(line)
            joined = word
        line = joined
    found += [line] if line else []
    if len(found) > lines:
        found = [*found[: lines - 1], f"{found[lines - 1][: columns - 3].rstrip()}..."]
    return found
