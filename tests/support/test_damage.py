"""A parser that answers otherwise than it promises is noticed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import strategies as st

from tests.support.damage import ROOM_BYTES, Parser, damaged


def refuse(said: str) -> Callable[[bytes, Path], None]:
    def read(data: bytes, _: Path) -> None:
        if data:
            raise ValueError(said)

    return read


@pytest.mark.parametrize(
    ("read", "error", "said"),
    [
        (refuse(""), AssertionError, "says nothing"),
        (refuse("wrong"), AssertionError, "file.toml"),
        (refuse("file.toml " * 300), AssertionError, ""),
        (lambda data, _: {"x": 1}[str(data)], KeyError, ""),
        (lambda data, _: bytes(2 * ROOM_BYTES), MemoryError, ""),
        (lambda data, _: None, AssertionError, "nothing was refused"),
    ],
    ids=["says nothing", "names nothing", "says a page", "ends", "believes a length", "takes everything"],
)
def test_each_broken_promise_is_noticed(
    read: Callable[[bytes, Path], object], error: type[BaseException], said: str, tmp_path: Path
) -> None:
    with pytest.raises(error, match=said or None):
        Parser("bad", st.just(b"") | damaged([b"whole"]), read, (ValueError,), "file.toml").judge(tmp_path)
