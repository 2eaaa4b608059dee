"""The check of generated values notices what strict typing would, at any depth, and takes no annotation for right unseen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import pytest
from hypothesis import find
from hypothesis import strategies as st

from appliance.instrument.machine import events as on
from appliance.measure.fault import Fault, FaultCode
from tests.support.typed import MistypedError, built, well_typed


@dataclass(frozen=True)
class Outer:
    inner: Outer | None = None
    pair: tuple[float, float] = (1, 2.5)
    many: tuple[Outer, ...] = ()
    by_name: Mapping[str, float] | None = None
    names: list[str] | None = None
    kind: Literal["bar", "plane"] = "bar"


@dataclass(frozen=True)
class Unjudged:
    told: Callable[[], None]


@pytest.mark.parametrize(
    ("name", "value", "complaint"),
    [
        ("inner", "no inner", "Outer.inner is 'no inner' of type str"), ("inner", Outer(kind="x"), "Outer.inner is "),  # type: ignore[arg-type]
        ("pair", (1.0, None), r"Outer.pair\[1\] is None"), ("pair", (1.0,), r"Outer.pair is \(1.0,\)"), ("pair", [1.0, 2.0], r"Outer.pair is \[1.0"),
        ("many", (Outer(), 2), r"Outer.many\[1\] is 2"), ("many", (Outer(pair=(0, "1")),), r"Outer.many\[0\].pair\[1\] is '1'"),  # type: ignore[arg-type]
        ("by_name", {"x": "1"}, "Outer.by_name is "), ("by_name", {1: 1.0}, "Outer.by_name is "), ("names", [b"a"], "Outer.names is "),
        ("kind", "sphere", "Outer.kind is 'sphere'"), ("many", (Outer(inner=Outer(), many=(Outer(names=["a"], by_name={"x": 1}),)),), None),
    ],
)  # fmt: skip
def test_a_value_of_another_type_is_named_with_its_path(name: str, value: object, complaint: str | None) -> None:
    made = Outer(**{name: value})  # type: ignore[arg-type]
    if complaint is None:
        assert well_typed(made) is made
        return
    with pytest.raises(MistypedError, match=complaint):
        well_typed(made)


def test_a_wrong_type_deep_inside_an_event_and_an_annotation_that_cannot_be_judged_are_refused() -> None:
    mistyped = Fault(FaultCode.HOT, "case 61 °C", {"temperature_c": "61"})  # type: ignore[dict-item]
    with pytest.raises(MistypedError, match=r"ConditionRaised\.fault\.numbers\{\} is '61'"):
        find(built(on.ConditionRaised, st.just(mistyped)), lambda _: True)
    with pytest.raises(TypeError, match="cannot be judged"):
        well_typed(Unjudged(print))
