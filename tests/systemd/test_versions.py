"""A new version is used, kept or taken back whole, wherever in between the power fails."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from kingfisher_setup import versions
from kingfisher_setup.errors import SetupError
from kingfisher_setup.layout import Layout
from kingfisher_setup.pins import runtime_pins
from tests.systemd.installation import Installation, make

MOST_CHANGES = 60
"""No change of versions takes more steps."""


@pytest.fixture
def there(tmp_path: Path) -> Installation:
    return make(tmp_path)


def on_trial(there: Installation) -> versions.Trial:
    versions.try_out(there.layout, "new")
    at = versions.settle(there.layout)
    assert at is not None
    return at


def deaths(there: Installation, change: Callable[[Layout], object]) -> Iterator[int]:
    """The installation after each place where the power can fail in ``change``, and after none."""
    kept = there.layout.root.with_name(f"{there.layout.root.name}-kept")
    shutil.copytree(there.layout.root, kept, symlinks=True)
    for changes in range(MOST_CHANGES):
        shutil.rmtree(there.layout.root)
        shutil.copytree(kept, there.layout.root, symlinks=True)
        ended = there.dying(change, changes)
        yield changes
        if ended:
            assert changes > 5, "the death was never in between"
            return
    pytest.fail(f"more than {MOST_CHANGES} changes")


def test_power_fails_while_a_version_is_put_on_trial(there: Installation) -> None:
    seen = set()
    for _ in deaths(there, lambda layout: versions.try_out(layout, "new")):
        assert versions.current(there.layout) in ("old", "new")  # the link is never broken
        at = versions.settle(there.layout)
        assert versions.current(there.layout) == there.unit() == (at.version if at is not None else "old")
        seen.add(at is not None)
        if at is None:  # the second call goes through
            versions.try_out(there.layout, "new")
        assert versions.current(there.layout) == "new"
        assert there.layout.rescue.readlink() == Path("versions/old/systemd"), "a new one is not its own judge"
    assert seen == {False, True}


def test_power_fails_on_the_way_back(there: Installation) -> None:
    decided, finished = on_trial(there), 0
    for _ in deaths(there, lambda layout: versions.revert(layout, decided, "too slow")):
        at = versions.settle(there.layout)
        if at is not None:  # before it was decided
            assert there.unit() == "new"
            continue
        finished += 1
        assert versions.current(there.layout) == there.unit() == "old"
        assert versions.outcome(there.layout) == versions.Outcome("new", False, "too slow", "old")
    assert finished > 3
    there.add("newer", "newer")
    versions.prune(there.layout)
    assert versions.installed(there.layout) == ("new", "old"), "what failed is kept to be looked at"
    versions.try_out(there.layout, "new")
    assert versions.outcome(there.layout) is None, "of another trial"


def test_power_fails_while_a_version_is_accepted(there: Installation) -> None:
    there.add("older", "older")
    proved = on_trial(there)
    for _ in deaths(there, lambda layout: versions.accept(layout, proved)):
        assert versions.current(there.layout) == "new"
        at = versions.settle(there.layout)
        if at is not None:  # it is asked again at the next start
            versions.accept(there.layout, at)
        assert versions.previous(there.layout) == "old"
        assert there.unit() == "new"
        assert there.layout.rescue.readlink() == Path("versions/new/systemd")
        versions.prune(there.layout)
        assert versions.installed(there.layout) == ("new", "old")


def test_a_half_made_version_is_never_used_and_a_damaged_trial_file_does_not_stop_the_instrument(
    there: Installation,
) -> None:
    whole = there.layout.version("new") / versions.COMPLETE
    name = whole.read_text()
    whole.unlink()
    with pytest.raises(SetupError, match="not a whole version"):
        versions.try_out(there.layout, "new")
    assert versions.settle(there.layout) is None
    assert versions.current(there.layout) == there.unit() == "old"
    whole.write_text(name)
    versions.try_out(there.layout, "new")
    there.layout.trial.write_text('{"version": [')
    assert (versions.settle(there.layout), versions.current(there.layout)) == (None, "new")
    assert not there.layout.trial.exists()


def test_two_setups_do_not_work_at_once(there: Installation) -> None:
    with versions.locked(there.layout), pytest.raises(SetupError, match="another setup"):
        versions.locked(there.layout).__enter__()
    with versions.locked(there.layout):
        assert versions.current(there.layout) == "old"


def test_an_instrument_gets_what_the_program_needs_and_no_tool_that_it_is_made_with() -> None:
    pins = runtime_pins(Path(__file__).parents[2])
    names = set(re.findall(r"(?m)^([a-z0-9-]+)==", pins))
    assert names >= {"numpy", "numba", "llvmlite"}, "and what these need"
    assert names.isdisjoint({"pytest", "mypy", "ruff"})
    assert pins.count("==") <= pins.count("--hash=sha256:")
