"""The diver's choices (exposure, fringe period, water, object), and how one key changes each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

from appliance.measure import NOMINAL, PERIODS_PX, Exposure

T = TypeVar("T")

COLDEST_C, WARMEST_C = -2.0, 40.0
"""Limits of the water's temperature in the rig file: where the formula of the refractive index holds."""
FRESH_PSU, SALT_PSU = 0.0, 35.0
LANGUAGES = ("en", "de")
FRESHEST_SALT_PSU = 2.0
"""Salinity below which the water counts as fresh."""


@dataclass(frozen=True, slots=True)
class Choices:
    """Choices for capturing and measuring the next scan. Kept over a restart."""

    exposure: Exposure = NOMINAL
    period_px: int = 16
    salinity_psu: float = FRESH_PSU
    water_c: float = 20.0
    """Temperature of the water, stated by the diver: the instrument has no sensor for it."""
    language: str = "en"
    """Language of the screens; one of ``LANGUAGES``."""
    object: int | None = None
    """Number of the object that scans belong to from now on; ``None``: of none."""
    objects: int = 0
    """Largest object number that was ever given here."""
    transfer: bool = False
    """True if a desk may fetch scans. Not kept over a restart: a dive does not begin with an open door."""

    @property
    def salt(self) -> bool:
        """True if the diver calls the water salt water."""
        return self.salinity_psu >= FRESHEST_SALT_PSU


@dataclass(frozen=True, slots=True)
class Offers:
    """Values to choose from."""

    exposures: tuple[Exposure, ...] = (NOMINAL,)
    """Exposures from dark to bright."""
    periods_px: tuple[int, ...] = PERIODS_PX
    fresh_psu: float = FRESH_PSU
    salt_psu: float = SALT_PSU
    """The salinity of the rig file's water replaces that of fresh or of salt water."""


def offers_of(chosen: Choices, exposures: tuple[Exposure, ...], periods_px: tuple[int, ...] = PERIODS_PX) -> Offers:
    """Return the values to offer on an instrument whose rig file states ``chosen``."""
    if chosen.salt:
        return Offers(exposures, periods_px, salt_psu=chosen.salinity_psu)
    return Offers(exposures, periods_px, fresh_psu=chosen.salinity_psu)


def another_exposure(chosen: Choices, offers: Offers, steps: int) -> Choices:
    """Choose the exposure ``exposures`` brighter; stays at the ends.

    From a value that is no step, the first step is the next one in that direction.
    """
    # A proposed exposure need not be one of the menu's; sorted in among them, it has neighbours.
    exposures = sorted({*offers.exposures, chosen.exposure}, key=lambda step: step.light)
    return replace(chosen, exposure=_moved(exposures, chosen.exposure, steps))


def another_period(chosen: Choices, offers: Offers, steps: int) -> Choices:
    """Choose the period ``steps`` longer; stays at the ends."""
    return replace(chosen, period_px=_moved(sorted({*offers.periods_px, chosen.period_px}), chosen.period_px, steps))


def other_water(chosen: Choices, offers: Offers) -> Choices:
    """Choose salt instead of fresh water, or fresh instead of salt."""
    return replace(chosen, salinity_psu=offers.fresh_psu if chosen.salt else offers.salt_psu)


def warmer(chosen: Choices, degrees: int) -> Choices:
    """Choose water warmer by ``degrees``, within the range of the refractive index's formula."""
    # Rounded first: the rig file may state 18.4 °C, and a press leads to a whole degree.
    return replace(chosen, water_c=min(max(float(round(chosen.water_c)) + degrees, COLDEST_C), WARMEST_C))


def another_language(chosen: Choices, steps: int) -> Choices:
    """Choose the next language; stays at the ends."""
    return replace(chosen, language=_moved(sorted({*LANGUAGES, chosen.language}), chosen.language, steps))


def another_object(draft: Choices, chosen: Choices, used: int | None, steps: int) -> Choices:
    """Choose, upwards, no object, the current one, or a new one; stays at the ends.

    ``used``: the largest number on the disk. While it is not known (``None``), no new one is offered: the desk would
    join two objects with the same number.
    """
    numbers: list[int | None] = [None]
    if chosen.object is not None:
        numbers.append(chosen.object)
    if used is not None:
        numbers.append(max(chosen.objects, used) + 1)
    # The disk may have been read while a new number was shown, which is then no longer among these.
    selected = _moved(numbers, draft.object if draft.object in numbers else numbers[-1], steps)
    return replace(draft, object=selected, objects=max(chosen.objects, selected or 0))


def other_transfer(chosen: Choices, steps: int) -> Choices:
    """Choose, upwards, that a desk may fetch scans, or that it may not; stays at the ends."""
    return replace(chosen, transfer=steps > 0)


def _moved(values: list[T], current: T, steps: int) -> T:
    return values[min(max(values.index(current) + steps, 0), len(values) - 1)]
