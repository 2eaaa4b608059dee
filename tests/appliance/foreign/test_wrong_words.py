"""Wrong words and wrong cameras' numbers of drawn laboratories are named, and what is right is not doubted where it was checked."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.wrong_words import DRAWN, WRONG, Described, Own, Wrong, call, drawn_set, outcome

WIDTH_PX = 320
PAIR, PROJECTOR = DRAWN[0], DRAWN[3]

TOLD_WHERE_TOO_LARGE = ("period", "projector's width")
"""The code lies beyond the projector then; otherwise nothing tells in one direction."""


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Described]:
    root = tmp_path_factory.mktemp("sets")
    return {own.program.name: drawn_set(own, root, 5, WIDTH_PX) for own in (PAIR, PROJECTOR)}


def wrong(name: str, one: Described) -> Wrong:
    return next(each for each in WRONG if each.name == name and each.fits(one))


@pytest.mark.parametrize(
    ("of", "name", "wanted"),
    [
        (PAIR, "bright and dark", "named"),
        (PAIR, "R transposed, T negated", "named"),
        (PAIR, "turned about the rows", "named"),
        (PAIR, "turned about the columns", "unchecked"),
        (PROJECTOR, "sign", "named"),
        (PROJECTOR, "period", "named"),
        (PROJECTOR, "projector's width", "named"),
    ],
    ids=lambda value: value if isinstance(value, str) else value.program.name.replace(" ", "-"),
)
def test_a_mistake_is_named_or_said_to_be_unchecked(
    sets: dict[str, Described], tmp_path: Path, of: Own, name: str, wanted: str
) -> None:
    one = sets[of.program.name]
    mistake = wrong(name, one)
    said = call(one, mistake, tmp_path / "cloud.npz")
    assert outcome(said, mistake) == wanted, said
    right = call(one, None, tmp_path / "cloud.npz")
    assert right.code == 0
    unchecked = wanted == "unchecked" or name in TOLD_WHERE_TOO_LARGE
    assert (outcome(right, mistake) == "unchecked") == unchecked, right.unchecked
