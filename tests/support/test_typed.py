"""The check of generated values notices what strict typing would, at any depth, and takes no annotation for right unseen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import pytest
from hypothesis import find
from hypothesis import strategies as st

from appliance.machine import events as on
from appliance.machine.failure import Failure, FailureKind
from appliance.scan.fault import Fault, FaultCode
from tests.support.typed import MistypedError, built, well_typed


@dataclass(frozen=True)
class Inner:
    number: int


@dataclass(frozen=True)
class Outer:
    inner: Inner | None = None
    pair: tuple[float, float] = (0.0, 1.0)
    many: tuple[Inner, ...] = ()
    by_name: Mapping[str, float] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    kind: Literal["bar", "plane"] = "bar"


@dataclass(frozen=True)
class Unjudged:
    told: Callable[[], None]


RIGHT: dict[str, object] = {
    "inner": Inner(3),
    "pair": (1, 2.5),
    "many": (Inner(1), Inner(2)),
    "by_name": {"x": 1.0},
    "names": ["a"],
    "kind": "plane",
}
WRONG: list[tuple[str, object, str]] = [
    ("inner", Inner("3"), "Outer.inner is "),  # type: ignore[arg-type]
    ("inner", "no inner", "Outer.inner is 'no inner' of type str"),
    ("pair", (1.0, None), r"Outer.pair\[1\] is None"),
    ("pair", (1.0,), r"Outer.pair is \(1.0,\)"),
    ("pair", [1.0, 2.0], r"Outer.pair is \[1.0, 2.0\]"),
    ("many", (Inner(1), 2), r"Outer.many\[1\] is 2"),
    ("many", (Inner(1), Inner(None)), r"Outer.many\[1\].number is None"),  # type: ignore[arg-type]
    ("by_name", {"x": "1"}, r"Outer.by_name\{\} is '1'"),
    ("by_name", {1: 1.0}, r"Outer.by_name\{\} is 1"),
    ("names", ("a",), r"Outer.names is \('a',\)"),
    ("names", [b"a"], r"Outer.names\[\] is b'a'"),
    ("kind", "sphere", "Outer.kind is 'sphere'"),
]


@pytest.mark.parametrize(("name", "value"), RIGHT.items(), ids=list(RIGHT))
def test_a_value_of_the_annotated_types_passes(name: str, value: object) -> None:
    right = Outer(**{name: value})  # type: ignore[arg-type]
    assert well_typed(right) is right


@pytest.mark.parametrize(("name", "value", "complaint"), WRONG)
def test_a_value_of_another_type_is_named_with_its_path(name: str, value: object, complaint: str) -> None:
    with pytest.raises(MistypedError, match=complaint):
        well_typed(Outer(**{name: value}))  # type: ignore[arg-type]


def test_an_annotation_that_cannot_be_judged_is_not_taken_for_right() -> None:
    with pytest.raises(TypeError, match="cannot be judged"):
        well_typed(Unjudged(None))  # type: ignore[arg-type]


def test_a_strategy_that_gives_a_failure_as_text_is_refused() -> None:
    text = built(on.CalibrationFailed, st.just("the adjustment did not converge"))
    with pytest.raises(MistypedError, match=r"CalibrationFailed\.failure is 'the adjustment"):
        find(text, lambda _: True)
    whole = built(on.CalibrationFailed, st.just(Failure(FailureKind.BROKEN_OFF, "it did not converge")))
    assert find(whole, lambda _: True).failure.kind is FailureKind.BROKEN_OFF


def test_a_wrong_type_deep_inside_an_event_is_refused() -> None:
    mistyped = Fault(FaultCode.HOT, "case 61 °C", {"temperature_c": "61"})  # type: ignore[dict-item]
    with pytest.raises(MistypedError, match=r"ConditionRaised\.fault\.numbers\{\} is '61'"):
        find(built(on.ConditionRaised, st.just(mistyped)), lambda _: True)
