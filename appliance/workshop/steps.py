"""The list of the steps of the guided bring-up in their order: a row each, and a module of its own."""

from __future__ import annotations

from appliance.workshop import (
    board,
    cameras,
    endurance,
    latency,
    light,
    pad,
    plane,
    projector,
    raster,
    sides,
    skew,
    trigger,
    vsync,
)
from appliance.workshop.step import GuideStep

_LIGHT_PATH = ("rig.wires", "camera", "board.url", "projector")
_EXPOSED = (*_LIGHT_PATH, "board", "scan")
_BOARD = ("rig.wires", "board.url", "board.firmware", "limits.supply_low_v")
_VSYNC = ("rig.wires", "board.url", "projector")

_ON_A_WALL = (("trigger",), _LIGHT_PATH, projector.measure_on_wall)
"""Columns of the steps that share one measurement of the projector: a measurement for each would take two minutes."""

# Name, title, steps that must be good before, keys of the rig file that it depends on, functions that do and judge it.
STEPS: tuple[GuideStep, ...] = (
    GuideStep("board", "The trigger board alone", (), _BOARD, board.do),
    GuideStep("pad", "The key pad", (), ("rig.wires", "keys"), pad.do),
    GuideStep("vsync", "The projector's vertical sync", ("board",), _VSYNC, vsync.do),
    GuideStep("cameras", "Both cameras", ("board", "vsync"), _LIGHT_PATH, cameras.do),
    GuideStep("trigger", "The trigger lines", ("board", "vsync", "cameras"), _LIGHT_PATH, trigger.do),
    GuideStep("raster", "The projector's raster", *_ON_A_WALL, lambda m, _: raster.judge(m.views, m.lines, m.photographs)),
    GuideStep("sides", "Left and right", *_ON_A_WALL, lambda m, _: sides.judge(m.views)),
    GuideStep("latency", "The projector's latency", *_ON_A_WALL, lambda m, _: latency.judge(m.lamp.timing.latency_blanks)),
    GuideStep(
        "light", "Light within the frame", ("trigger",), _EXPOSED, projector.measure_on_wall, lambda m, rig: light.judge(m.lamp, rig),
        uses_written=True, writes=light.KEYS,
    ),
    GuideStep("skew", "Both cameras at once", *_ON_A_WALL, lambda m, _: skew.judge(m.skew_us)),
    GuideStep("endurance", "Minutes at full rate", ("trigger",), (*_LIGHT_PATH, "limits"), endurance.do),
    GuideStep("plane", "The first plane", ("raster", "sides", "latency", "light"), _EXPOSED, plane.do, uses_written=True),
)  # fmt: skip
