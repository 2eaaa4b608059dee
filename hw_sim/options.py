"""The world's options: names, defaults and checks, as ``docs/protocols/world.md`` lists them."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

from hw_sim.devices.power_on import Cameras, PowerOn
from hw_sim.drawings import DRAWINGS, USUAL, Drawing
from hw_sim.light.daylight import Daylight
from hw_sim.objects.motion import Motion
from hw_sim.objects.shapes import DEFAULT_POSE
from hw_sim.optics.beamer import Beamer
from hw_sim.optics.fog import Fog
from hw_sim.outside import ALL, FAMILIES, Outside, draw_outside
from hw_sim.scene import Imaging, Scene
from hw_sim.timing.calendar import Calendar
from hw_sim.water.drift import Drift
from hw_sim.water.medium import AIR, Water

Value = TypeVar("Value")
Pose = tuple[float, float, float, float, float, float]
MEDIA = ("water", "air")
PACES = ("lockstep", "realtime", "attended")


class OptionError(ValueError):
    """An option of the simulated world is unknown or out of range; the text has its name and the allowed values."""

    exit_code = 2


@dataclass(frozen=True, slots=True)
class WorldOptions:
    """The options of a world, as ``docs/protocols/world.md`` lists them. Raises OptionError."""

    world: str = "main"
    truth: str = "realistic"
    seed: int = 1
    width_px: int = 1600
    height_px: int = 1200
    object: str = "pipe"
    object_pose: Pose | None = None
    texture: str = "slight"
    medium: str = "water"
    water: Mapping[str, float] = field(default_factory=dict)
    ambient: float = 0.02
    noise: bool = True
    motion: Mapping[str, Any] = field(default_factory=dict)
    imaging: Mapping[str, Any] = field(default_factory=dict)
    daylight: Mapping[str, Any] = field(default_factory=dict)
    drift: Mapping[str, Any] = field(default_factory=dict)
    fog: Mapping[str, Any] = field(default_factory=dict)
    outside: Mapping[str, Any] = field(default_factory=dict)
    projector: str | Mapping[str, Any] = "ideal"
    cameras: Mapping[str, Any] = field(default_factory=dict)
    serials: Mapping[str, str] = field(default_factory=dict)
    pace: str = "lockstep"
    idle_speed: float = 1.0
    refresh_hz: float = 60.0
    faults: tuple[str, ...] = ()
    script: str | None = None
    chaos: Mapping[str, Any] = field(default_factory=dict)
    date: str | None = None
    status: str | None = None
    window: bool = False
    console: bool = False
    stills: bool = False
    housing: str = USUAL

    def __post_init__(self) -> None:
        if self.housing not in DRAWINGS:
            raise OptionError(f"housing '{self.housing}'; allowed are {', '.join(DRAWINGS)}")
        if self.pace not in PACES:
            raise OptionError(f"pace '{self.pace}'; allowed are {', '.join(PACES)}")
        if self.medium not in MEDIA:
            raise OptionError(f"medium '{self.medium}'; allowed are {', '.join(MEDIA)}")
        if self.medium == "air" and self.water:
            raise OptionError(f"water {dict(self.water)} in air; leave it out, or choose medium 'water'")
        if self.chaos and set(self.chaos) != {"seed", "scans", "report"}:
            raise OptionError(f"chaos has {', '.join(sorted(self.chaos))}; it needs seed, scans and report")
        if self.chaos and self.script is not None:
            raise OptionError("script and chaos: allowed is one diver; leave one out")
        if not 64 <= self.width_px <= 4096 or not 48 <= self.height_px <= 4096:
            raise OptionError(f"camera size {self.width_px}x{self.height_px}; allowed are 64x48 to 4096x4096")
        if self.date is not None:
            try:
                Calendar(lambda: 0, self.date)
            except ValueError as error:
                raise OptionError(f"date: {error}") from error
        self.beamer()
        for side in ("left", "right"):
            self.power_on(side)
        for side, serial in self.serials.items():
            if side not in ("left", "right") or not (
                isinstance(serial, str) and serial.isascii() and 1 <= len(serial) <= 63
            ):
                raise OptionError(
                    f"serials {side} = {serial!r:.80}; allowed are left and right, 1 to 63 ASCII characters"
                )
        if not 0.1 <= self.idle_speed <= 100.0:
            raise OptionError(f"idle_speed {self.idle_speed:g}; allowed are 0.1..100")
        if not 1.0 <= self.refresh_hz <= 60.0:
            raise OptionError(f"refresh_hz {self.refresh_hz:g}; allowed are 1..60")

    def power_on(self, side: str) -> PowerOn:
        """Return the state in which the camera of ``side`` powers up. Raises OptionError."""
        try:
            return _made(PowerOn, f"cameras {side}", _made(Cameras, "cameras", self.cameras).of(side))
        except (TypeError, ValueError) as error:
            raise OptionError(f"cameras {side}: {error}") from error

    def beamer(self) -> Beamer:
        """Return the projector. Raises OptionError."""
        table = {"kind": self.projector} if isinstance(self.projector, str) else self.projector
        if not isinstance(table, Mapping):
            raise OptionError(
                f'projector = {table!r:.80}; give the name of a kind, or a table with kind = "…" and more'
            )
        try:
            beamer = _made(Beamer, "projector", table)
        except OptionError:
            raise
        except (TypeError, ValueError) as error:
            raise OptionError(f"projector: {error}") from error
        if "response" in self.imaging and (beamer.kind != "ideal" or beamer.gamma is not None):
            raise OptionError(
                f"imaging response '{self.imaging['response']}' and projector kind '{beamer.kind}' both "
                "define the response; leave response out, and give the projector a gamma of 1..3 if it is not linear"
            )
        return beamer

    def drawing(self) -> Drawing:
        """Return the design of the housing."""
        return DRAWINGS[self.housing]

    def _pose(self) -> Pose | None:
        """Return the pose of the object; ``None``: the usual pose of the usual housing."""
        if self.object_pose is not None or self.housing == USUAL or self.object not in DEFAULT_POSE:
            return self.object_pose
        return self.drawing().pose(self.object)

    def scene(self) -> Scene:
        """Return the scene that these options describe. Raises OptionError."""
        try:
            return Scene(
                self.object,
                self._pose(),
                self.texture,
                _made(Water, "water", self.water) if self.medium == "water" else AIR,
                self.ambient,
                self.noise,
                _made(Motion, "motion", self.motion),
                _made(Imaging, "imaging", self.imaging),
                _made(Daylight, "daylight", self.daylight),
                _made(Drift, "drift", self.drift),
                _made(Fog, "fog", self.fog),
                outside=_outside(self.outside),
            )
        except (TypeError, ValueError) as error:
            raise OptionError(f"scene: {error}") from error


def _made(kind: Callable[..., Value], what: str, table: Mapping[str, Any]) -> Value:
    """Return a frozen dataclass from a rig file's table, whose lists are vectors.

    Raises OptionError and ValueError.
    """
    parameters = inspect.signature(kind).parameters
    for key in table:
        if key not in parameters:
            raise OptionError(f"{what}: unknown '{key}'{_nearest(key, set(parameters))}")
    return kind(**{key: tuple(value) if isinstance(value, list) else value for key, value in table.items()})


def _outside(table: Mapping[str, Any]) -> Outside:
    """Return the world ``outside`` of a rig file's table.

    ``seed`` draws ``families`` (all of the set, unless they are named); a table with a family's name sets strengths by
    hand, instead of the drawn ones or alone. Raises OptionError and ValueError.
    """
    allowed = {"seed", "families", *FAMILIES}
    for key in table:
        if key not in allowed:
            raise OptionError(f"outside: unknown '{key}'{_nearest(key, allowed)}")
    seed, families = table.get("seed"), table.get("families", ALL)
    if seed is None and "families" in table:
        raise OptionError("outside: families without a seed; add seed = 1, or give strengths by hand")
    if seed is not None and (not isinstance(seed, int) or isinstance(seed, bool) or seed < 0):
        raise OptionError(f"outside: seed = {seed!r:.80}; allowed are whole numbers from 0")
    if isinstance(families, str) or not all(isinstance(name, str) for name in families):
        raise OptionError(f"outside: families = {families!r:.80}; give a list of names: {', '.join(FAMILIES)}")
    world = Outside() if seed is None else draw_outside(seed, families)
    by_hand = {}
    for name in FAMILIES.keys() & table.keys():
        strengths = _made(FAMILIES[name].kind, f"outside {name}", table[name])
        drawn = getattr(world, name)
        by_hand[name] = (
            strengths if drawn is None else replace(drawn, **{key: getattr(strengths, key) for key in table[name]})
        )
    return replace(world, **by_hand)


def _nearest(key: str, allowed: set[str]) -> str:
    # A probable typing error gets the nearest name, any other error the list.
    near = difflib.get_close_matches(key, allowed, 1)
    return f"; did you mean '{near[0]}'?" if near else f"; known are {', '.join(sorted(allowed))}"


def options_from(mapping: Mapping[str, Any]) -> WorldOptions:
    """Return the options of a rig file's table. Raises OptionError for an unknown key, with the nearest one."""
    allowed = {f.name for f in fields(WorldOptions)}
    for key in mapping:
        if key not in allowed:
            raise OptionError(f"unknown option of the simulated world: '{key}'{_nearest(key, allowed)}")
    values = dict(mapping)
    for key in ("object_pose", "faults"):
        if isinstance(values.get(key), list):
            values[key] = tuple(values[key])
    return WorldOptions(**values)
