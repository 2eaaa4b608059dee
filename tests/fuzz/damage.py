"""How real bytes and values are damaged: what wires, disks and people do to them, and what an enemy would."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from random import Random
from typing import Any

NUMBERS = (0, 1, 2, 3, 0x7F, 0x80, 0xFF, 0x100, 0x7FFF, 0x8000, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF,
           1 << 32, (1 << 63) - 1, 1 << 63, (1 << 64) - 1)  # fmt: skip
WORDS = (
    "", "0", "-1", "-0", "1e309", "-1e309", "nan", "inf", "-inf", "1e-320", "1_000", "٣", "0x10", "1,2", "1;2", "+5", "9" * 30,
    "9" * 5000, "true", "null", "-", "*", "$", "%s%n", "../..", "\x00", "é", "\U0001f41f", "=", "==", "a=b", " ", "\t",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, 2**64, 10**400, -(10**400), 0.0, -0.0, 1e-320, 1e308, -1e308, float("nan"),
    float("inf"), float("-inf"), 0.5, "", "x", "0", "nan", "../../x", "/etc/passwd", "\x00", "\ud800", "a\nb", "é" * 50, "9" * 5000,
    [], [[]], [0], [None] * 3, {}, {"": 0}, {"x": {"x": {}}}, [0.0] * 5, [1e308] * 3,
)  # fmt: skip


def damaged(chance: Random, data: bytes, others: Sequence[bytes] = (), words: Sequence[bytes] = ()) -> bytes:
    """``data`` with one to a few wounds; ``others`` are spliced in, ``words`` inserted."""
    body = bytearray(data)
    for _ in range(min(8, 1 + int(chance.expovariate(0.8)))):
        chance.choice(_WOUNDS)(chance, body, others, words)
    return bytes(body)


Wound = Callable[[Random, bytearray, Sequence[bytes], Sequence[bytes]], None]


def _flip(chance: Random, body: bytearray, _o: Sequence[bytes], _w: Sequence[bytes]) -> None:
    if body:
        body[chance.randrange(len(body))] ^= 1 << chance.randrange(8)


def _byte(chance: Random, body: bytearray, _o: Sequence[bytes], _w: Sequence[bytes]) -> None:
    if body:
        body[chance.randrange(len(body))] = chance.choice((0, 0xFF, 0x0A, 0x7F, 0x80, chance.randrange(256)))


def _number(chance: Random, body: bytearray, _o: Sequence[bytes], _w: Sequence[bytes]) -> None:
    """A length, an address or a count that lies."""
    size = chance.choice((1, 2, 4, 8))
    if len(body) >= size:
        at = chance.randrange(len(body) - size + 1)
        if chance.random() < 0.8:
            at -= at % size
        now = int.from_bytes(body[at : at + size], "little")
        value = chance.choice((chance.choice(NUMBERS), now + 1, now - 1, now * 2, now // 2, len(body), len(body) - at))
        body[at : at + size] = (value % (1 << 8 * size)).to_bytes(size, "little")


def _cut(chance: Random, body: bytearray, _o: Sequence[bytes], _w: Sequence[bytes]) -> None:
    if body:
        del body[chance.randrange(len(body)) :]


def _lose(chance: Random, body: bytearray, _o: Sequence[bytes], _w: Sequence[bytes]) -> None:
    if body:
        at = chance.randrange(len(body))
        del body[at : at + chance.choice((1, 2, 4, chance.randrange(1, len(body) + 1)))]


def _repeat(chance: Random, body: bytearray, _o: Sequence[bytes], _w: Sequence[bytes]) -> None:
    if body:
        at = chance.randrange(len(body))
        piece = bytes(body[at : at + chance.randrange(1, 64)])
        body[at:at] = piece * chance.choice((1, 1, 2, 20))


def _noise(chance: Random, body: bytearray, _o: Sequence[bytes], _w: Sequence[bytes]) -> None:
    at = chance.randrange(len(body) + 1)
    body[at:at] = chance.randbytes(chance.choice((1, 2, 8, 60)))


def _splice(chance: Random, body: bytearray, others: Sequence[bytes], _w: Sequence[bytes]) -> None:
    other = chance.choice(others) if others else b""
    if body and other:
        body[chance.randrange(len(body)) :] = other[chance.randrange(len(other)) :]


def _word(chance: Random, body: bytearray, _o: Sequence[bytes], words: Sequence[bytes]) -> None:
    word = chance.choice(words) if words else chance.choice(WORDS).encode("utf-8", "surrogatepass")
    at = chance.randrange(len(body) + 1)
    body[at : at + chance.choice((0, len(word)))] = word


def _blank(chance: Random, body: bytearray, _o: Sequence[bytes], _w: Sequence[bytes]) -> None:
    """What a disk gives back for a block it never got."""
    if body:
        at = chance.randrange(len(body))
        end = min(len(body), at + chance.choice((4, 16, 512)))
        body[at:end] = bytes(end - at)


_WOUNDS: tuple[Wound, ...] = (
    _flip, _flip, _byte, _number, _number, _cut, _lose, _repeat, _noise, _splice, _word, _blank,
)  # fmt: skip


# ------------------------------------------------------------------------------------------------- values and text


def changed(chance: Random, value: Any, words: Sequence[str] = ()) -> Any:
    """A copy of a tree of dicts and lists with one to a few changes that keep it such a tree."""
    tree = _copy(value)
    for _ in range(min(5, 1 + int(chance.expovariate(1.0)))):
        tree = _change(chance, tree, words)
    return tree


def _copy(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _copy(one) for key, one in value.items()}
    return [_copy(one) for one in value] if isinstance(value, list | tuple) else value


def _change(chance: Random, tree: Any, words: Sequence[str]) -> Any:
    spots = _spots(tree)
    if not spots:
        return chance.choice(VALUES)
    parent, key = chance.choice(spots)
    match chance.randrange(10):
        case 0 | 1 | 2:
            parent[key] = _copy(chance.choice(VALUES))
        case 3 | 4:
            parent[key] = _nudged(chance, parent[key])
        case 5:
            del parent[key]
        case 6:
            other, name = chance.choice(spots)
            parent[key] = _copy(other[name]) if name in _names(other) else None
        case 7 if isinstance(parent, dict):
            parent[_misspelt(chance, str(key), words)] = parent.pop(key)
        case 8:
            if isinstance(parent, dict):
                parent[chance.choice(words) if words else "x"] = _copy(chance.choice(VALUES))
            else:
                parent.insert(key, _copy(chance.choice(VALUES)))
        case _:
            for _ in range(chance.choice((1, 2, 50))):
                parent[key] = [parent[key]] if chance.random() < 0.5 else {"x": parent[key]}
    return tree


def _spots(tree: Any) -> list[tuple[Any, Any]]:
    found: list[tuple[Any, Any]] = []
    rest = [tree]
    while rest:
        one = rest.pop()
        for key in _names(one):
            found.append((one, key))
            rest.append(one[key])
    return found


def _names(one: Any) -> Sequence[Any]:
    if isinstance(one, dict):
        return list(one)
    return range(len(one)) if isinstance(one, list) else ()


def _nudged(chance: Random, value: Any) -> Any:
    """A unit slip, a sign, a little more than allowed, another type of the same look."""
    if isinstance(value, bool) or value is None:
        return not value
    if isinstance(value, int | float):
        if abs(value) > 1e300:
            return -value
        scaled = [value * 1000, value / 1000, -value, value + 1, value - 1, value * 1.0000001, str(value), float(value)]
        return chance.choice(scaled)
    if isinstance(value, str):
        return chance.choice(
            (value + "x", value[:-1], value.upper(), value * 100, "", 0, [value], value + "\n", value[::-1])
        )
    if isinstance(value, list):
        return chance.choice((value[:-1], value + value, value[::-1], {"x": value}, [value], value[:1] * 1000))
    return list(value.items()) if isinstance(value, dict) else value


def _misspelt(chance: Random, word: str, words: Sequence[str]) -> str:
    at = chance.randrange(len(word) + 1)
    wrong = (
        word[:at] + word[at + 1 :],
        word[:at] + "x" + word[at:],
        word.upper(),
        word.replace("_ms", "_s"),
        word + "_mm",
        "",
    )
    return chance.choice((*wrong, chance.choice(words) if words else "x"))


def reworded(chance: Random, text: str, words: Sequence[str]) -> str:
    """A sentence with words lost, doubled, swapped, replaced or given another amount."""
    said = text.split(" ")
    for _ in range(min(4, 1 + int(chance.expovariate(1.0)))):
        at = chance.randrange(len(said)) if said else 0
        word = said[at] if said else ""
        match chance.randrange(7):
            case 0 if said:
                del said[at]
            case 1:
                said.insert(at, chance.choice(words))
            case 2 if said:
                said[at] = chance.choice(words)
            case 3 if said:
                said[at] = chance.choice(WORDS)
            case 4 if said and "=" in word:
                said[at] = word.partition("=")[0] + "=" + chance.choice(WORDS)
            case 5 if said:
                other = chance.randrange(len(said))
                said[at], said[other] = said[other], said[at]
            case _ if said:
                said[at] = _misspelt(chance, word, words)
            case _:
                said.append(chance.choice(WORDS))
    return " ".join(said)
