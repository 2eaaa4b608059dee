"""The scene before the instrument: object, light, water and imaging effects."""

from __future__ import annotations

from dataclasses import dataclass, field

from hw_sim.light.daylight import Daylight
from hw_sim.objects.motion import Motion
from hw_sim.objects.shapes import DEFAULT_POSE, NAMES
from hw_sim.objects.texture import NAMES as TEXTURES
from hw_sim.optics.fog import Fog
from hw_sim.optics.light_engine import REFERENCE_NM, sapphire_index
from hw_sim.outside import Outside
from hw_sim.water.drift import Drift
from hw_sim.water.medium import Water, refractive_index

RESPONSES = ("measured", "linear", "gamma")


@dataclass(frozen=True, slots=True)
class Imaging:
    """The causes of imperfect sine fringes; each can be switched off, so that its effect can be measured.

    Raises ValueError for a response that is not one of ``RESPONSES``.
    """

    response: str = "measured"
    """The projector's response: a measured one, linear, or a pure gamma of 2.2."""
    projector_defocus: bool = True
    """Blur of the light away from the projector's focus."""
    camera_defocus: bool = False
    """Blur of the images away from the cameras' focus: at f/8 by 0.46 px (of 1600) at a distance of ``FAR_MM``, added
    in squares to that of the lens. Off, since it costs time and is negligible within the working volume."""

    def __post_init__(self) -> None:
        if self.response not in RESPONSES:
            raise ValueError(f"response '{self.response}'; allowed are {', '.join(RESPONSES)}")


@dataclass(frozen=True, slots=True)
class Scene:
    """Object, light, water and hands. Raises ValueError for unknown names and impossible numbers."""

    object: str = "pipe"
    pose: tuple[float, float, float, float, float, float] | None = None
    """[x, y, z, rx_deg, ry_deg, rz_deg] in the rig frame at time 0; ``None``: where both cameras see it well."""
    texture: str = "slight"
    """Texture of every object except the board, which has its print."""
    water: Water = field(default_factory=Water)
    ambient: float = 0.02
    noise: bool = True
    motion: Motion = field(default_factory=Motion)
    imaging: Imaging = field(default_factory=Imaging)
    daylight: Daylight = field(default_factory=Daylight)
    """Variation of the ambient light, and other lamps."""
    drift: Drift = field(default_factory=Drift)
    """Snow, bubbles and fish in the water between."""
    fog: Fog = field(default_factory=Fog)
    """A fogged or scratched place on the cameras' ports."""
    capped: frozenset[str] = frozenset()
    """Cameras whose lens has its cap on: ``left``, ``right``."""
    outside: Outside = field(default_factory=Outside)
    """The families of harsher physics that are switched on, with their strengths."""

    def __post_init__(self) -> None:
        for value, allowed, what in ((self.object, NAMES, "object"), (self.texture, TEXTURES, "texture")):
            if value not in allowed:
                raise ValueError(f"{what} '{value}'; allowed are {', '.join(allowed)}")

        if not self.capped <= {"left", "right"}:
            raise ValueError(f"capped {sorted(self.capped)}; allowed are left and right")
        if self.pose is not None and len(self.pose) != 6:
            raise ValueError(f"object_pose {self.pose}; give six numbers: x, y, z in mm, rx, ry, rz in degrees")
        if not 0.0 <= self.ambient <= 10.0:
            raise ValueError(f"ambient {self.ambient}; allowed are 0..10 (1 is as bright as the projector's white)")

    @property
    def start_pose(self) -> tuple[float, float, float, float, float, float]:
        """The pose at time 0."""
        return self.pose or DEFAULT_POSE[self.object]

    @property
    def moves(self) -> bool:
        """True if the object moves before the rig, or is not rigid."""
        return not self.motion.still or self.outside.hands is not None or self.outside.soft is not None

    @property
    def index(self) -> float:
        """Refractive index of the water, relative to air, for the projected light; true rigs are drawn for it."""
        engine = self.outside.projector
        if engine is None:
            return self.water.index
        wavelengths_nm, shares = engine.spectrum(self.water.temperature_c)
        refractive_indices = [
            refractive_index(self.water.temperature_c, self.water.salinity_psu, float(nm)) for nm in wavelengths_nm
        ]
        return float(shares @ refractive_indices)

    @property
    def glass_more(self) -> float:
        """Index of the sapphire ports for that light, minus that at 530 nm, which true rigs state."""
        engine = self.outside.projector
        if engine is None:
            return 0.0
        wavelengths_nm, shares = engine.spectrum(self.water.temperature_c)
        return float(shares @ [sapphire_index(float(nm)) for nm in wavelengths_nm]) - sapphire_index(REFERENCE_NM)

    @property
    def still(self) -> bool:
        """True if the same light makes the same image at any time."""
        if self.outside.projector is not None:
            return False
        return not self.moves and self.daylight.steady and self.drift.nothing
