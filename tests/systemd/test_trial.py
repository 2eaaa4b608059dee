"""A version on trial stays if the service says that its self-test passed, and goes in every other case."""

from __future__ import annotations

import json
import os
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from kingfisher_setup import trial, versions
from kingfisher_setup.layout import Layout
from tests.systemd.installation import Installation, make

LIMIT_S = 1.0


@pytest.fixture
def there(tmp_path: Path) -> Installation:
    made = make(tmp_path)
    versions.try_out(made.layout, "new", may_fail=("calibration",))
    return made


def service_says(layout: Layout, installation: str, *failed: str) -> None:
    """As the service itself writes it down (tests/appliance/instrument/service/test_watchdog.py)."""
    layout.self_test.parent.mkdir(parents=True, exist_ok=True)
    layout.self_test.write_text(json.dumps({"installation": installation, "failed": list(failed)}))


@contextmanager
def watched(layout: Layout) -> Iterator[None]:
    """Inside, the watch has let the service start; at the end it has decided."""
    address = layout.root / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager, pytest.MonkeyPatch.context() as patch:
        manager.bind(str(address))
        manager.settimeout(30)
        patch.setenv("NOTIFY_SOCKET", str(address))
        patch.setattr(trial, "BEAT_S", 0.1)
        watching = threading.Thread(target=trial.watch, args=(layout, LIMIT_S))
        watching.start()
        assert manager.recv(64) == b"READY=1"
        yield
        watching.join(30)
        assert not watching.is_alive()
        address.unlink()


@pytest.mark.parametrize(
    ("said", "stays", "reason"),
    [
        pytest.param([("new", "calibration")], True, "self-test passed", id="what failed before may fail"),
        pytest.param([("new", "camera.left"), ("new",)], True, "self-test passed", id="a device comes late"),
        pytest.param([("new", "calibration", "worker")], False, "its self-test failed: worker", id="something new fails"),
        pytest.param([], False, "no self-test within 1 s", id="nothing is said"),
        pytest.param([("old",)], False, "no self-test within 1 s", id="another version says it"),
    ],
)  # fmt: skip
def test_it_stays_when_nothing_fails_that_did_not_fail_before(
    there: Installation, said: list[tuple[str, ...]], stays: bool, reason: str
) -> None:
    service_says(there.layout, "new")  # before this start: it does not count
    with watched(there.layout):
        for number, words in enumerate(said):
            threading.Timer(0.2 * number, service_says, (there.layout, *words)).start()
    kept = "new" if stays else "old"
    assert versions.outcome(there.layout) == versions.Outcome("new", stays, reason, kept)
    assert (versions.current(there.layout), there.unit()) == (kept, kept)


def test_a_version_that_takes_the_machine_down_with_it_is_not_started_for_ever(there: Installation) -> None:
    for _ in range(versions.STARTS):
        at = versions.settle(there.layout)
        assert at is not None
        versions.started(there.layout, at)  # and then the power fails
    with watched(there.layout):
        assert versions.current(there.layout) == "old"  # before the service starts
    reason = "started 3 times without passing its self-test"
    assert versions.outcome(there.layout) == versions.Outcome("new", False, reason, "old")


def test_taken_back_by_hand_meanwhile_is_taken_back(there: Installation) -> None:
    with watched(there.layout):
        at = versions.settle(there.layout)
        assert at is not None
        versions.revert(there.layout, at, "taken back by hand")
        service_says(there.layout, "new")
    assert versions.outcome(there.layout) == versions.Outcome("new", False, "taken back by hand", "old")


def test_a_service_that_ends_by_itself_is_not_waited_for() -> None:
    assert trial.ended_by_itself("ActiveState=activating\nNRestarts=2\n") == "it ended 2 times by itself"
    assert trial.ended_by_itself("NRestarts=0\nActiveState=failed\n") == "it failed to start"
    for shown in ("NRestarts=0\nActiveState=activating\n", "NRestarts=1\nActiveState=active\n", ""):
        assert trial.ended_by_itself(shown) is None


def test_what_failed_before_the_change_is_known(there: Installation) -> None:
    service_says(there.layout, "old", "calibration", "keys")
    assert trial.failed_now(there.layout, "old") == ("calibration", "keys")
    assert trial.failed_now(there.layout, "new") == ()
    there.layout.self_test.write_bytes(os.urandom(4096))
    assert trial.failed_now(there.layout, "old") == ()
