"""A machine that is not there is skipped at a desk and fails in continuous integration."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.support import micropython


@pytest.mark.parametrize(("ci", "outcome"), [("true", pytest.fail.Exception), ("", pytest.skip.Exception)])
def test_without_the_machine_a_test_is_skipped_at_a_desk_and_fails_in_ci(
    ci: str, outcome: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CI", ci)
    monkeypatch.setattr(shutil, "which", lambda _: "/usr/bin/node")
    monkeypatch.setattr(micropython, "MODULE", micropython.ROOT / "nowhere" / "micropython.mjs")
    # Not pytest.raises of one of the two: a skip that escapes from it would skip this test as well.
    with pytest.raises((pytest.fail.Exception, pytest.skip.Exception), match=r"nowhere/micropython\.mjs") as raised:
        micropython.require()
    assert raised.type is outcome


def test_with_it_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CI", "true")
    monkeypatch.setattr(shutil, "which", lambda _: "/usr/bin/node")
    monkeypatch.setattr(micropython, "MODULE", Path(__file__))
    micropython.require()
    assert micropython.missing() is None
