"""Damages real bytes, values and sentences as wires, disks and people do, and judges what a parser of them answers."""

from __future__ import annotations

import copy
import json
import math
import os
import resource
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

# Tests that damage their inputs are judged by what is answered, not by how busy the machine is.
settings.register_profile(
    "damage", settings(), deadline=None, suppress_health_check=list(HealthCheck),
    max_examples=int(os.environ.get("KINGFISHER_EXAMPLES", settings().max_examples)),
)  # fmt: skip
settings.load_profile("damage")

LONGEST_S = 2.0
"""Of CPU time for one input; the usual one takes some 0.0001 s."""
ROOM_BYTES = 2 << 30
"""Of address space beside what is taken: a length that lies must not be believed."""
NUMBERS = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 1 << 16, (1 << 31) - 1, 1 << 31, (1 << 32) - 1, (1 << 63) - 1, (1 << 64) - 1)  # fmt: skip
WORDS = (
    "", "0", "-1", "-0", "1e309", "-1e309", "nan", "inf", "1e-320", "1_000", "٣", "0x10", "1,2", "1;2", "+5", "9" * 5000, "true", "null", "-",
    "*", "$", "%s%n", "../..", "\x00", "é", "\U0001f41f", "=", "==", "a=b", " ", "\t",
)  # fmt: skip
VALUES: st.SearchStrategy[Any] = st.sampled_from((
    None, True, False, 0, -1, 1, 2**31, 2**63, 2**64, 10**400, -(10**400), 0.0, -0.0, 1e-320, 1e308, float("nan"), float("inf"),
    float("-inf"), 0.5, "x", "nan", "../../x", "/etc/passwd", "\ud800", "a\nb", "é" * 50, *WORDS, [], [[]], [0], [None] * 3, {}, {"": 0},
    {"x": {"x": {}}}, [0.0] * 5, [1e308] * 3,
))  # fmt: skip


@st.composite
def damaged(draw: st.DrawFn, wholes: Sequence[bytes], words: Sequence[bytes] = ()) -> bytes:
    """One of ``wholes`` of which pieces are lost, blank, doubled, noise, numbers that lie, ``words``, or the end of another."""
    body = draw(st.sampled_from(wholes))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(body)))
        size = draw(st.sampled_from((0, 1, 1, 2, 4, 8, 16, 512, len(body))))
        piece = body[at : at + size]
        number = draw(st.sampled_from(NUMBERS)) % (1 << 8 * len(piece))
        put = (b"", bytes(len(piece)), piece * 2, piece * 20, number.to_bytes(len(piece), "little"))
        noise = st.binary(min_size=min(len(piece), 16), max_size=max(min(len(piece), 60), 16))
        word = st.sampled_from((*words, *(word.encode() for word in WORDS)))
        other = draw(st.sampled_from(wholes))
        end = other[draw(st.integers(0, len(other))) :]
        body = body[:at] + draw(st.sampled_from((*put, end)) | noise | word) + body[at + size :]
    return body


@st.composite
def changed(draw: st.DrawFn, value: Any, words: Sequence[str] = ("x",)) -> Any:
    """A copy of a tree of dicts and lists with one to three changes that keep it such a tree."""
    tree = copy.deepcopy(value)
    for _ in range(draw(st.integers(1, 3))):
        spots = list(_spots(tree))
        if not spots:
            return draw(VALUES)
        parent, key = spots[draw(st.integers(0, len(spots) - 1))]
        match draw(st.sampled_from(("value", "slip", "loss", "move", "name", "nest"))):
            case "loss":
                del parent[key]
            case "slip":
                parent[key] = draw(st.sampled_from(_slips(parent[key])))
            case "move":
                other, name = spots[draw(st.integers(0, len(spots) - 1))]
                parent[key] = copy.deepcopy(other[name])
            case "name" if isinstance(parent, dict):
                parent[draw(st.sampled_from((*words, f"{key}x", key[1:], key.upper(), "")))] = parent.pop(key)
            case "nest":
                for _ in range(draw(st.sampled_from((1, 50)))):
                    parent[key] = [parent[key]]
            case _:
                parent[key] = copy.deepcopy(draw(VALUES))
    return tree


def _spots(tree: Any) -> Iterator[tuple[Any, Any]]:
    names = list(tree) if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    for name in names:
        yield tree, name
        yield from _spots(tree[name])


def _slips(value: Any) -> Sequence[Any]:
    """A unit slip, a sign, a little more than allowed, another type of the same look."""
    match value:
        case bool() | None:
            return (not value, str(value))
        case int() | float() if abs(value) < 1e300:
            return (
                value * 1000,
                value / 1000,
                -value,
                value + 1,
                value - 1,
                value * 1.0000001,
                str(value),
                float(value),
            )
        case str():
            return (value + "x", value[:-1], value.upper(), value * 100, 0, [value], value + "\n", value[::-1])
        case list():
            return (value[:-1], value + value, value[::-1], {"x": value}, value[:1] * 1000)
        case _:
            return (str(value), [value])


def toml_of(tree: Mapping[str, Any], path: tuple[str, ...] = ()) -> str:
    """The tree as TOML. What TOML has no word for (null, other numbers) comes out as text that is none."""
    inner = {key: value for key, value in tree.items() if isinstance(value, Mapping)}
    lines = [f"[{'.'.join(map(_key, path))}]\n"] if path else []
    lines += [f"{_key(key)} = {_value(value)}\n" for key, value in tree.items() if key not in inner]
    return "".join((*lines, *(toml_of(value, (*path, key)) for key, value in inner.items())))


def _key(key: str) -> str:
    return key if key.replace("_", "").replace("-", "").isalnum() and key.isascii() else json.dumps(key)


def _value(value: Any) -> str:
    match value:
        case bool() | None:
            return json.dumps(value)
        case float():
            return repr(value) if math.isfinite(value) else str(value)
        case int():
            return hex(value) if abs(value) > 10**300 else str(value)
        case Mapping():
            return "{" + ", ".join(f"{_key(key)} = {_value(one)}" for key, one in value.items()) + "}"
        case list():
            return "[" + ", ".join(map(_value, value)) + "]"
        case _:
            return json.dumps(str(value))


# ------------------------------------------------------------------------------------------------- judged


@dataclass(frozen=True, slots=True)
class Parser:
    """A parser of what comes from outside, and what is promised of it."""

    name: str
    inputs: st.SearchStrategy[Any]
    read: Callable[[Any, Path], object]
    """Reads an input, with a folder to write it to; asserts what must hold of whatever it accepts."""
    refusals: tuple[type[Exception], ...] = ()
    """The errors that it documents; empty: it never raises."""
    names: str = ""
    """What every refusal must name: the file, the device."""
    longest: int = 2000
    """In characters: a refusal that lists many faults is longer."""
    share: float = 1.0
    """Of the examples that others get: less for one that takes longer."""

    def judge(self, folder: Path) -> Counter[str]:
        """Ask it about many inputs and count its answers. Raises AssertionError for one that was not promised, and whatever it raises besides."""
        answers: Counter[str] = Counter()

        @settings(max_examples=max(5, round(self.share * settings().max_examples)))
        @given(self.inputs)
        def ask(case: Any) -> None:
            begun_s = time.process_time()
            try:
                self.read(case, folder)
                answers["accepted"] += 1
            except self.refusals as error:
                answers["refused"] += 1
                self._check_refusal(case, str(error))
            assert time.process_time() - begun_s < LONGEST_S

        with _little_room():
            ask()
        assert answers["refused"] or not self.refusals, "nothing was refused: the inputs are not damaged"
        return answers

    def _check_refusal(self, case: Any, message: str) -> None:
        said = len(case) if isinstance(case, str) else 0  # a sentence is quoted to who said it
        assert any(character.isalpha() for character in message), "it says nothing"
        assert len(message) <= self.longest + 3 * said
        assert self.names in message, f"it does not name {self.names}"


@contextmanager
def _little_room() -> Iterator[None]:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most, ever = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + ROOM_BYTES, ever))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (most, ever))
