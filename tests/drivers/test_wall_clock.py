"""A date is believed only where something from outside keeps the clock."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from drivers.wall_clock import STA_UNSYNC, TIME_ERROR, believed, set_from_outside


@pytest.mark.parametrize(
    ("state", "status", "expected"),
    [
        (0, 0x2001, True),
        (TIME_ERROR, STA_UNSYNC, False),
        (0, STA_UNSYNC, False),
        (TIME_ERROR, 0, False),
        (-1, 0, False),
    ],
)
def test_only_a_clock_that_is_kept_is_believed(state: int, status: int, expected: bool) -> None:
    assert believed(state, status) is expected


@pytest.mark.skipif(shutil.which("timedatectl") is None, reason="needs systemd's timedatectl as a second witness")
def test_the_kernel_is_asked_as_others_ask_it() -> None:
    asked = subprocess.run(
        ["timedatectl", "show", "--property=NTPSynchronized", "--value"], capture_output=True, text=True, timeout=10
    )
    if asked.returncode != 0:
        pytest.skip("timedatectl does not answer here")
    assert set_from_outside() == (asked.stdout.strip() == "yes")


def test_asking_changes_nothing() -> None:
    assert set_from_outside() == set_from_outside()
