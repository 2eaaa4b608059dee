"""The choices before an output is lit: its connector, its mode, and its CRTC."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.api import DeviceGone, DeviceRefused
from drivers.output.card import Connector
from drivers.output.drm import Mode
from drivers.output.spec import OutputSpec

REFRESH_TOLERANCE_HZ = 1.0
"""59.94 Hz and the 59.5 Hz of a coordinated video timing both pass for 60 Hz; 50 and 75 Hz do not."""


def choose_connector(device: str, spec: OutputSpec, connectors: Sequence[Connector]) -> Connector:
    """Return the connector that the rig file names, even if it is empty. Raises DeviceRefused."""
    for connector in connectors:
        if connector.name == spec.connector:
            return connector
    offered = ", ".join(f"{c.name} ({'connected' if c.connected else 'empty'})" for c in connectors) or "none"
    raise DeviceRefused(
        device, f"connector {spec.connector} is not on {spec.card}; it has {offered}", "Set connector to one of these"
    )


def choose_mode(device: str, spec: OutputSpec, connector: Connector) -> Mode:
    """Return the progressive mode of exactly the wanted size, nearest to the wanted refresh rate.

    Raises DeviceGone when no device is plugged in, DeviceRefused when no mode is within 1 Hz, listing the modes.
    """
    if not connector.connected:
        raise DeviceGone(device, f"nothing is plugged into {connector.name}", "Check its cable and its power")
    fitting = [
        mode
        for mode in connector.modes
        if (mode.width_px, mode.height_px) == (spec.width_px, spec.height_px)
        and mode.progressive
        and abs(mode.refresh_hz - spec.refresh_hz) <= REFRESH_TOLERANCE_HZ
    ]
    if not fitting:
        offered = ", ".join(dict.fromkeys(str(mode) for mode in connector.modes)) or "no modes"
        raise DeviceRefused(
            device,
            f"no mode {spec.width_px}×{spec.height_px} at {spec.refresh_hz:g} Hz on {connector.name}; "
            f"it offers {offered}",
            "Set width_px, height_px and refresh_hz to one of these, or add the mode to the kernel's command line",
        )
    return min(fitting, key=lambda mode: (abs(mode.refresh_hz - spec.refresh_hz), not mode.preferred))


def assign_crtcs(possible: Sequence[Sequence[int]]) -> tuple[int, ...] | None:
    """Return one CRTC for each head out of its possible ones, none twice; ``None`` when that cannot be.

    Earlier heads and earlier CRTCs are preferred; the search is exhaustive (cards have at most eight CRTCs).
    """

    def extend(chosen: tuple[int, ...]) -> tuple[int, ...] | None:
        if len(chosen) == len(possible):
            return chosen
        for crtc in possible[len(chosen)]:
            if crtc not in chosen and (assignment := extend((*chosen, crtc))) is not None:
                return assignment
        return None

    return extend(())
