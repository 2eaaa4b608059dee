"""Owns what the diver may choose: exposure, fringe period, water and object, the steps of each, and what one key
changes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

from appliance.measure import NOMINAL, PERIODS_PX, Exposure

T = TypeVar("T")

COLDEST_C, WARMEST_C = -2.0, 40.0
"""Limits of the water's temperature as the rig file has them: where the formula of the refractive index holds."""
FRESH_PSU, SALT_PSU = 0.0, 35.0
LANGUAGES = ("en", "de")
FRESHEST_SALT_PSU = 2.0
"""Water below is fresh to the diver."""


@dataclass(frozen=True, slots=True)
class Choices:
    """Choices for taking and measuring the next scan. Remembered over a restart."""

    exposure: Exposure = NOMINAL
    period_px: int = 16
    salinity_psu: float = FRESH_PSU
    water_c: float = 20.0
    """The water's temperature, stated by the diver: the instrument has no sensor for it."""
    language: str = "en"
    """Language of the screens; one of ``LANGUAGES``."""
    object: int | None = None
    """Number of the object that scans belong to from now on; ``None``: of none."""
    objects: int = 0
    """Largest number that was ever given to an object here."""
    transfer: bool = False
    """Scans may be taken off by whoever has a key. Never remembered: a dive does not begin with an open door."""

    @property
    def salt(self) -> bool:
        """True if the diver calls the water salt water."""
        return self.salinity_psu >= FRESHEST_SALT_PSU


@dataclass(frozen=True, slots=True)
class Offers:
    """Values that there are to choose from."""

    exposures: tuple[Exposure, ...] = (NOMINAL,)
    """Exposures from dark to bright."""
    periods_px: tuple[int, ...] = PERIODS_PX
    fresh_psu: float = FRESH_PSU
    salt_psu: float = SALT_PSU
    """The salinity of the rig file's water stands for whichever of the two it is."""


def offers_of(chosen: Choices, exposures: tuple[Exposure, ...], periods_px: tuple[int, ...] = PERIODS_PX) -> Offers:
    """Return the values to offer on an instrument whose rig file states ``chosen``."""
    if chosen.salt:
        return Offers(exposures, periods_px, salt_psu=chosen.salinity_psu)
    return Offers(exposures, periods_px, fresh_psu=chosen.salinity_psu)


def another_exposure(chosen: Choices, offers: Offers, by: int) -> Choices:
    """Choose the exposure ``by`` steps brighter; from a value that is no step, the next one in that direction. Stays at
    the ends."""
    # A proposed exposure need not be one of the menu's steps; sorted in among them, it has neighbours to go to.
    steps = sorted({*offers.exposures, chosen.exposure}, key=lambda step: step.light)
    return replace(chosen, exposure=_moved(steps, chosen.exposure, by))


def another_period(chosen: Choices, offers: Offers, by: int) -> Choices:
    """Choose the period ``by`` steps longer; stays at the ends."""
    return replace(chosen, period_px=_moved(sorted({*offers.periods_px, chosen.period_px}), chosen.period_px, by))


def other_water(chosen: Choices, offers: Offers) -> Choices:
    """Choose salt instead of fresh water, or fresh instead of salt."""
    return replace(chosen, salinity_psu=offers.fresh_psu if chosen.salt else offers.salt_psu)


def warmer(chosen: Choices, by: int) -> Choices:
    """Choose water warmer ``by`` whole degrees, within what the index is known for."""
    # Rounded first: the rig file may state 18.4 °C, and a press leads to a whole degree.
    return replace(chosen, water_c=min(max(float(round(chosen.water_c)) + by, COLDEST_C), WARMEST_C))


def another_language(chosen: Choices, by: int) -> Choices:
    """Choose the next language; stays at the ends."""
    return replace(chosen, language=_moved(sorted({*LANGUAGES, chosen.language}), chosen.language, by))


def another_object(draft: Choices, chosen: Choices, used: int | None, by: int) -> Choices:
    """Choose, upwards, no object, the one that is ``chosen`` now, or a new one; stays at the ends.

    ``used``: the largest number that the scans on the disk carry. While it is not known (``None``), no new one is
    offered: a number that is given twice would join two things at the desk.
    """
    steps: list[int | None] = [None]
    if chosen.object is not None:
        steps.append(chosen.object)
    if used is not None:
        steps.append(max(chosen.objects, used) + 1)
    # The disk may have told of more numbers while a new one was being looked at.
    wanted = _moved(steps, draft.object if draft.object in steps else steps[-1], by)
    return replace(draft, object=wanted, objects=max(chosen.objects, wanted or 0))


def other_transfer(chosen: Choices, by: int) -> Choices:
    """Choose that scans may be taken off, upwards, or that they may not; stays at the ends."""
    return replace(chosen, transfer=by > 0)


def _moved(steps: list[T], at: T, by: int) -> T:
    return steps[min(max(steps.index(at) + by, 0), len(steps) - 1)]
