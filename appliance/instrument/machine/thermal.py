"""Owns what warmth decides: bands with hysteresis, when light rests, how it is rationed without a sensor, how long to
cool.

Nothing here switches anything: conditions follow from ``felt``, light from ``may_aim_lit``, and ``safety`` and ``step``
ask.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from appliance.instrument.machine.conditions import cleared, has, raised, rationed
from appliance.instrument.machine.states import Machine, State, TemperatureLimits, seconds_ns
from appliance.measure import Fault, FaultCode
from drivers.api import Telemetry

HYSTERESIS_C = 3.0
SILENT_S = 5.0
"""A sensor that has said nothing for so long is not there."""
COOLED_S = 300.0
"""Time after which a place that was hot when its sensor fell silent is believed to have cooled down; the ration takes
the place of its limit."""
TREND_EVERY_S, TREND_S = 5.0, 60.0
COOLS_C_PER_S = 0.002
"""Slope below which nobody can say when it will have cooled down."""
LONGEST_ESTIMATE_S = 3600.0

RATION_S, PER_S = 20.0, 60.0
"""Light without a temperature sensor: so much in that time, however it is spent."""
RESERVE_S = 5.0
"""Part of the ration that aiming leaves for scans."""
RELIGHT_S = 8.0
"""Light that must have gathered before aiming is lit again."""


def felt(machine: Machine, telemetry: Telemetry) -> Machine:
    """Judge the conditions after one heartbeat's temperatures. Missing is not cold: after a while it is a condition
    of its own."""
    values = {"case": telemetry.temperature_case_c, "projector": telemetry.temperature_projector_c}
    for place, limits in machine.settings.temperatures.items():
        # A place without limits in the rig file decides nothing.
        value_c = values.get(place)
        if value_c is None:
            machine = _silent(machine, place)
        else:
            machine = _banded(_heard(machine, place, value_c), place, value_c, limits)
    return machine


def passed(machine: Machine, before_ns: int) -> Machine:
    """Account for the time since ``before_ns``: the ration of light that was spent and gathered."""
    elapsed_s = max(0.0, (machine.now_ns - before_ns) / 1e9)
    thermal = machine.thermal
    # A leaky bucket: it fills at RATION_S / PER_S and empties at one second per second of light.
    ration_s = thermal.ration_s + elapsed_s * (RATION_S / PER_S - (1.0 if thermal.lit else 0.0))
    ration_s = min(max(ration_s, 0.0), RATION_S)
    # Hysteresis: once spent it stays so until enough has gathered, else the light would flicker at the limit.
    spent = ration_s <= RESERVE_S or (thermal.spent and ration_s < RELIGHT_S)
    return replace(machine, thermal=replace(thermal, ration_s=ration_s, spent=spent))


def spend(machine: Machine, light_s: float) -> Machine:
    """Take the light of a sequence that is about to shine off what is left of the ration."""
    thermal = machine.thermal
    return replace(machine, thermal=replace(thermal, ration_s=max(0.0, thermal.ration_s - light_s)))


def may_aim_lit(machine: Machine) -> bool:
    """Tell whether live views may be lit now: somebody is at the keys, and there is light left where it is rationed."""
    return not rests(machine) and not (rationed(machine) is not None and machine.thermal.spent)


def rests(machine: Machine) -> bool:
    """Nobody has pressed a key for a while: live views go on without light. The next key brings it back."""
    if machine.state is not State.AIM:
        return False
    warm = any(fault.code is FaultCode.WARM for fault in machine.conditions)
    settings = machine.settings
    # Entering AIM counts like a key: who comes back from a review sees something.
    idle_since_ns = max(machine.since_ns, machine.last_key_ns or 0)
    return machine.now_ns - idle_since_ns >= seconds_ns(settings.dark_warm_s if warm else settings.dark_s)


def remaining_s(machine: Machine) -> float | None:
    """Estimate how long it still takes to cool down, from how it cooled lately; ``None`` where that says nothing."""
    longest_s = 0.0
    for fault in machine.conditions:
        if fault.code is not FaultCode.HOT or fault.device is None:
            continue
        slope = slope_c_per_s(machine.thermal.trend.get(fault.device, ()))
        # A place that does not cool makes every estimate a guess, whatever the other places do.
        if slope is None or slope > -COOLS_C_PER_S:
            return None
        # To where the band is left (limit less hysteresis), not to the limit itself.
        above_c = fault.numbers.get("temperature_c", 0.0) - fault.numbers.get("below_c", 0.0)
        longest_s = max(longest_s, above_c / -slope)
    return min(longest_s, LONGEST_ESTIMATE_S) if longest_s > 0.0 else None


def slope_c_per_s(trend: tuple[tuple[int, float], ...]) -> float | None:
    """Return the slope of the straight line that fits (time ns, °C) best; ``None`` with fewer than three points."""
    if len(trend) < 3:
        return None
    # Relative to the first: the squares of ns since boot are more than a float holds exactly.
    times_s = [(time_ns - trend[0][0]) / 1e9 for time_ns, _ in trend]
    mean_s, mean_c = sum(times_s) / len(trend), sum(value for _, value in trend) / len(trend)
    spread = sum((time_s - mean_s) ** 2 for time_s in times_s)
    if spread <= 0.0:
        return None
    return sum((t - mean_s) * (v - mean_c) for t, (_, v) in zip(times_s, trend, strict=True)) / spread


# ---------------------------------------------------------------------------------------- sensors


def _heard(machine: Machine, place: str, value_c: float) -> Machine:
    thermal, now_ns = machine.thermal, machine.now_ns
    trend = thermal.trend.get(place, ())
    # Thinned to one value in 5 s: a minute of heartbeats would be 120 values in a state that is copied at each
    # event.
    if not trend or now_ns - trend[-1][0] >= seconds_ns(TREND_EVERY_S):
        trend = (*(one for one in trend if now_ns - one[0] <= seconds_ns(TREND_S)), (now_ns, value_c))
    thermal = replace(thermal, heard_ns={**thermal.heard_ns, place: now_ns}, trend={**thermal.trend, place: trend})
    return cleared(replace(machine, thermal=thermal), FaultCode.TEMPERATURE_UNKNOWN, place)


def _silent(machine: Machine, place: str) -> Machine:
    heard_ns: Mapping[str, int] = machine.thermal.heard_ns
    if place not in heard_ns:  # it may only be slow to begin
        thermal = replace(machine.thermal, heard_ns={**heard_ns, place: machine.now_ns})
        return replace(machine, thermal=thermal)
    silent_s = (machine.now_ns - heard_ns[place]) / 1e9
    # A sensor that stays silent would keep its last alarm for ever: after this time the ration protects instead.
    if silent_s >= COOLED_S:
        for code in (FaultCode.WARM, FaultCode.HOT, FaultCode.TOO_HOT):
            machine = cleared(machine, code, place)
    if silent_s < SILENT_S or has(machine, FaultCode.TEMPERATURE_UNKNOWN, place):
        return machine
    return raised(machine, Fault(FaultCode.TEMPERATURE_UNKNOWN, f"no value of {place} for {silent_s:.0f} s", {}, place))


def _banded(machine: Machine, place: str, value_c: float, limits: TemperatureLimits) -> Machine:
    for code, limit_c in (
        (FaultCode.TOO_HOT, limits.off_c),
        (FaultCode.HOT, limits.hot_c),
        (FaultCode.WARM, limits.warm_c),
    ):
        # A limit is left only some degrees below it, so that a value at the limit does not raise and clear in turn.
        below_c = limit_c - HYSTERESIS_C
        if value_c >= limit_c or (has(machine, code, place) and value_c > below_c):
            detail = f"{place} {value_c:g} °C, limit {limit_c:g} °C"
            numbers = {"temperature_c": value_c, "below_c": below_c}
            machine = raised(machine, Fault(code, detail, numbers, place))
        else:
            machine = cleared(machine, code, place)
    return machine
