"""What the diver may choose, and where each choice ends."""

from __future__ import annotations

import pytest

from appliance.machine.choices import (
    Choices,
    Offers,
    another_exposure,
    another_language,
    another_period,
    offers_of,
    other_water,
    warmer,
)
from appliance.scan.exposure import Exposure

STEPS = (Exposure(4_000), Exposure(8_000), Exposure(16_000), Exposure(16_000, 6.0))
OFFERS = offers_of(Choices(), STEPS)


def test_a_new_instrument_scans_in_fresh_water_of_20_degrees_with_the_finest_fringes_in_english() -> None:
    chosen = Choices()
    assert (chosen.period_px, chosen.salinity_psu, chosen.water_c, chosen.language) == (16, 0.0, 20.0, "en")
    assert not chosen.salt
    assert Offers().periods_px == (16, 32, 64)
    assert (Offers().fresh_psu, Offers().salt_psu) == (0.0, 35.0)


@pytest.mark.parametrize(("psu", "salt"), [(0.0, False), (1.9, False), (2.0, True), (7.0, True), (35.0, True)])
def test_water_is_salt_from_two_grams_in_a_kilogram_on(psu: float, salt: bool) -> None:
    chosen = Choices(salinity_psu=psu)
    assert chosen.salt == salt
    offers = offers_of(chosen, STEPS)
    assert (offers.salt_psu if salt else offers.fresh_psu) == psu, "the rig file's water can be chosen again"
    assert (offers.fresh_psu if salt else offers.salt_psu) == (0.0 if salt else 35.0)
    other = other_water(chosen, offers)
    assert other.salt != salt
    assert other_water(other, offers) == chosen


def test_exposures_go_by_the_light_they_give_and_stay_at_their_ends() -> None:
    chosen = Choices(exposure=STEPS[0])
    assert another_exposure(chosen, OFFERS, -1).exposure == STEPS[0]
    for expected in (*STEPS[1:], STEPS[-1]):
        chosen = another_exposure(chosen, OFFERS, 1)
        assert chosen.exposure == expected
    assert another_exposure(chosen, OFFERS, -2).exposure == STEPS[1]


def test_from_an_exposure_that_is_no_step_the_next_one_in_that_direction_is_taken() -> None:
    chosen = Choices(exposure=Exposure(12_000))
    assert another_exposure(chosen, OFFERS, 1).exposure == Exposure(16_000)
    assert another_exposure(chosen, OFFERS, -1).exposure == Exposure(8_000)


def test_periods_and_languages_stay_at_their_ends() -> None:
    chosen = Choices()
    assert [another_period(chosen, OFFERS, by).period_px for by in (-1, 0, 1, 2, 3)] == [16, 16, 32, 64, 64]
    assert another_period(Choices(period_px=24), OFFERS, 1).period_px == 32
    assert another_period(Choices(period_px=24), OFFERS, -1).period_px == 16
    assert [another_language(chosen, by).language for by in (-1, 1)] == ["de", "en"]
    assert another_language(Choices(language="de"), 1).language == "en"


@pytest.mark.parametrize(
    ("water_c", "by", "expected_c"),
    [
        (20.0, 1, 21.0),
        (20.0, -1, 19.0),
        (11.6, 1, 13.0),
        (11.4, -1, 10.0),
        (-1.0, -1, -2.0),
        (-2.0, -1, -2.0),
        (39.0, 1, 40.0),
        (40.0, 1, 40.0),
    ],
)
def test_the_waters_temperature_goes_by_whole_degrees_from_freezing_sea_water_to_40(
    water_c: float, by: int, expected_c: float
) -> None:
    assert warmer(Choices(water_c=water_c), by).water_c == expected_c
