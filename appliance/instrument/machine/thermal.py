"""Temperatures: bands with hysteresis, rationed light without a sensor, and the time to cool down.

Conditions follow from ``judge_temperatures``, light from ``may_aim_lit``; ``safety`` and ``step`` act on them.
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
"""Time without a value after which a sensor counts as absent."""
COOLED_S = 300.0
"""Time without a value after which a place that was hot counts as cool.

The ration of light protects it then.
"""
TREND_EVERY_S, TREND_S = 5.0, 60.0
COOLS_C_PER_S = 0.002
"""Slope below which the time to cool down cannot be estimated."""
LONGEST_ESTIMATE_S = 3600.0

RATION_S, PER_S = 20.0, 60.0
"""Light without a temperature sensor: RATION_S in any PER_S."""
RESERVE_S = 5.0
"""Part of the ration that is reserved for scans."""
RELIGHT_S = 8.0
"""Ration that must be available before aiming is illuminated again."""


def judge_temperatures(machine: Machine, telemetry: Telemetry) -> Machine:
    """Update the conditions by the temperatures of one heartbeat.

    A missing value is not a low one: after a while it is a condition itself.
    """
    values = {"case": telemetry.temperature_case_c, "projector": telemetry.temperature_projector_c}
    for place, limits in machine.settings.temperatures.items():
        # A place without limits in the rig file has no effect.
        value_c = values.get(place)
        if value_c is None:
            machine = _silent(machine, place)
        else:
            machine = _judge_bands(_record_value(machine, place, value_c), place, value_c, limits)
    return machine


def gather_light(machine: Machine, before_ns: int) -> Machine:
    """Update the ration of light by the time since ``before_ns``."""
    elapsed_s = max(0.0, (machine.now_ns - before_ns) / 1e9)
    thermal = machine.thermal
    # A leaky bucket: it fills at RATION_S / PER_S and empties at one second per second of light.
    ration_s = thermal.ration_s + elapsed_s * (RATION_S / PER_S - (1.0 if thermal.is_lit else 0.0))
    ration_s = min(max(ration_s, 0.0), RATION_S)
    # Hysteresis: once spent it stays so until enough has gathered, else the light would flicker at the limit.
    spent = ration_s <= RESERVE_S or (thermal.spent and ration_s < RELIGHT_S)
    return replace(machine, thermal=replace(thermal, ration_s=ration_s, spent=spent))


def spend(machine: Machine, light_s: float) -> Machine:
    """Take the light of the next sequence off the ration."""
    thermal = machine.thermal
    return replace(machine, thermal=replace(thermal, ration_s=max(0.0, thermal.ration_s - light_s)))


def may_aim_lit(machine: Machine) -> bool:
    """Return True if live views may be illuminated: the keys are in use, and the ration suffices."""
    return not rests(machine) and not (rationed(machine) is not None and machine.thermal.spent)


def rests(machine: Machine) -> bool:
    """Return True if the light is off since no key was pressed for a while; the next key restores it."""
    if machine.state is not State.AIM:
        return False
    warm = any(fault.code is FaultCode.WARM for fault in machine.conditions)
    settings = machine.settings
    # Entering AIM counts like a key, so that the live image is illuminated after a review.
    idle_since_ns = max(machine.since_ns, machine.last_key_ns or 0)
    return machine.now_ns - idle_since_ns >= seconds_ns(settings.dark_warm_s if warm else settings.dark_s)


def remaining_s(machine: Machine) -> float | None:
    """Estimate the time to cool down from the recent trend; ``None`` if it cannot be estimated."""
    longest_s = 0.0
    for fault in machine.conditions:
        if fault.code is not FaultCode.HOT or fault.device is None:
            continue
        slope = slope_c_per_s(machine.thermal.trend.get(fault.device, ()))
        # If one place does not cool, there is no estimate for the instrument.
        if slope is None or slope > -COOLS_C_PER_S:
            return None
        # The condition ends at the limit less the hysteresis.
        above_c = fault.numbers.get("temperature_c", 0.0) - fault.numbers.get("below_c", 0.0)
        longest_s = max(longest_s, above_c / -slope)
    return min(longest_s, LONGEST_ESTIMATE_S) if longest_s > 0.0 else None


def slope_c_per_s(trend: tuple[tuple[int, float], ...]) -> float | None:
    """Return the slope of the best-fit line through (time ns, °C); ``None`` with fewer than three points."""
    if len(trend) < 3:
        return None
    # Relative to the first, since squares of ns since boot exceed the precision of a float.
    times_s = [(time_ns - trend[0][0]) / 1e9 for time_ns, _ in trend]
    mean_s, mean_c = sum(times_s) / len(trend), sum(value for _, value in trend) / len(trend)
    spread = sum((time_s - mean_s) ** 2 for time_s in times_s)
    if spread <= 0.0:
        return None
    return sum((t - mean_s) * (v - mean_c) for t, (_, v) in zip(times_s, trend, strict=True)) / spread


# ---------------------------------------------------------------------------------------- sensors


def _record_value(machine: Machine, place: str, value_c: float) -> Machine:
    thermal, now_ns = machine.thermal, machine.now_ns
    trend = thermal.trend.get(place, ())
    # Thinned to one value in 5 s: a minute of heartbeats would be 120 values, copied at each event.
    if not trend or now_ns - trend[-1][0] >= seconds_ns(TREND_EVERY_S):
        trend = (*(sample for sample in trend if now_ns - sample[0] <= seconds_ns(TREND_S)), (now_ns, value_c))
    thermal = replace(thermal, heard_ns={**thermal.heard_ns, place: now_ns}, trend={**thermal.trend, place: trend})
    return cleared(replace(machine, thermal=thermal), FaultCode.TEMPERATURE_UNKNOWN, place)


def _silent(machine: Machine, place: str) -> Machine:
    heard_ns: Mapping[str, int] = machine.thermal.heard_ns
    if place not in heard_ns:  # it may only be slow to begin
        thermal = replace(machine.thermal, heard_ns={**heard_ns, place: machine.now_ns})
        return replace(machine, thermal=thermal)
    silent_s = (machine.now_ns - heard_ns[place]) / 1e9
    # A silent sensor would keep its last alarm for ever: after this time the ration protects instead.
    if silent_s >= COOLED_S:
        for code in (FaultCode.WARM, FaultCode.HOT, FaultCode.TOO_HOT):
            machine = cleared(machine, code, place)
    if silent_s < SILENT_S or has(machine, FaultCode.TEMPERATURE_UNKNOWN, place):
        return machine
    return raised(machine, Fault(FaultCode.TEMPERATURE_UNKNOWN, f"no value of {place} for {silent_s:.0f} s", {}, place))


def _judge_bands(machine: Machine, place: str, value_c: float, limits: TemperatureLimits) -> Machine:
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
