"""The simulated housing keeps the books of heat."""

from __future__ import annotations

import pytest

from hw_sim.heat import OUTSIDE_W_PER_K, PLACES, Housing, Powers

ON, OFF = Powers(True, True, True), Powers()


@pytest.mark.parametrize("medium", ["water", "air"])
@pytest.mark.parametrize("powers", [ON, OFF], ids=["on", "off"])
def test_in_the_end_all_heat_leaves_through_the_shell(medium: str, powers: Powers) -> None:
    shell_c = Housing(15.0, medium).settled(powers)["shell"]
    assert OUTSIDE_W_PER_K[medium] * (shell_c - 15.0) == pytest.approx(sum(powers.watts().values()), rel=1e-9)


def test_the_steps_do_not_matter() -> None:
    once, often = Housing(20.0), Housing(20.0)
    once.advance(600.0, ON)
    for _ in range(1200):
        often.advance(0.5, ON)
    for place in PLACES:
        assert once.temperature_c(place) == pytest.approx(often.temperature_c(place), abs=0.05)


def test_a_projector_that_goes_dark_cools_and_air_carries_less_than_water() -> None:
    housing = Housing(20.0)
    housing.advance(1800.0, ON)
    lit_c = housing.temperature_c("TPROJ")
    housing.advance(600.0, OFF)
    assert housing.temperature_c("TPROJ") < lit_c - 8.0
    assert Housing(20.0, "air").settled(ON)["TCASE"] > Housing(20.0).settled(ON)["TCASE"] + 20.0
