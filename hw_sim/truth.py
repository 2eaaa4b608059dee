"""The true rig: the ground truth of the simulated instrument, which the product never sees.

It is drawn from a seed in sets of increasing imperfection (see ``draw_truth``). The tolerances are those of a carefully
built housing.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hw_sim.drawings import DRAWINGS, USUAL, Drawing
from hw_sim.objects.shapes import (
    BALL_DISTANCE_MM,
    BOARD_BOW,
    BOARD_FORM,
    BOARD_SCALE,
    HALF_BALL_DISTANCE,
    PLANE_BOW,
    PLANE_FORM,
    SIZES,
    SIZES_OUTSIDE,
)
from hw_sim.optics.aberrations import Aberrations, flawed
from hw_sim.optics.projector import FOCUS_MM
from hw_sim.optics.trace import FIELD, FIELD_ORDER, FOCUS, HAS_FIELD, PACKED, pixels_of, rays_of, refract
from hw_sim.outside import Outside, draw_outside
from hw_sim.workshop import drawn_tolerances

Array = NDArray[np.float64]

SETS = ("nominal", "realistic", "hard", "paper", "modelled", "outside")


@dataclass(frozen=True, slots=True)
class TruePort:
    """A port; the outer face is tilted against the inner one by the wedge, towards ``wedge_direction_deg``."""

    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    d_mm: float = 30.0
    th_mm: float = 5.0
    n_g: float = 1.77
    wedge_deg: float = 0.0
    wedge_direction_deg: float = 0.0

    @property
    def outer_normal(self) -> Array:
        """Unit normal of the outer face."""
        n = np.array(self.normal)
        # A frame about the inner normal; the wedge tilts the outer one by tan(wedge) in the plane of the faces.
        x = np.cross([0.0, 1.0, 0.0], n)
        x /= np.linalg.norm(x)
        angle, direction = math.radians(self.wedge_deg), math.radians(self.wedge_direction_deg)
        tilted = n + math.tan(angle) * (math.cos(direction) * x + math.sin(direction) * np.cross(n, x))
        return np.asarray(tilted / np.linalg.norm(tilted))


@dataclass(frozen=True, slots=True)
class TrueEye:
    """A camera, or the projector as an inverse camera, in the rig frame."""

    width_px: int
    height_px: int
    f_px: tuple[float, float]
    c_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float]
    R: tuple[tuple[float, float, float], ...]
    t_mm: tuple[float, float, float]
    port: TruePort
    lens_field: tuple[float, ...] | None = None
    """Cosine coefficients in px, FIELD_ORDER² (row = order in v) for u, then for v: see ``optics.trace.lens_field``."""
    aberrations: Aberrations | None = None
    """Flaws of the world ``outside``; ``None``: none."""
    focus_mm: float = FOCUS_MM
    """Distance, z in the rig frame, at which a projector is sharp."""

    def packed(self, n_water: float) -> Array:
        """Return the array (PACKED,) float64 for compiled tracing; longer for an eye with flaws."""
        eye = np.zeros(PACKED)
        eye[:9] = (*self.f_px, *self.c_px, *self.distortion)
        eye[9:18] = np.ravel(self.R)
        eye[18:21] = self.t_mm
        eye[21:24] = self.port.normal
        eye[24:27] = self.port.outer_normal
        eye[27:33] = (self.port.d_mm, self.port.th_mm, self.port.n_g, n_water, self.width_px, self.height_px)
        eye[FOCUS] = self.focus_mm
        if self.lens_field is not None:
            eye[HAS_FIELD] = 1.0
            eye[FIELD:] = self.lens_field
        return eye if self.aberrations is None else np.concatenate([eye, self.aberrations.packed()])


@dataclass(frozen=True, slots=True)
class Laser:
    """A laser pointer behind a port of its own: the beam as it is in the water."""

    origin_mm: tuple[float, float, float]
    """Point at which it leaves the port's outer face, rig frame."""
    direction: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Artefacts:
    """The true dimensions of the objects whose certificates state the nominal ones."""

    ball_distance_mm: float = BALL_DISTANCE_MM
    """Distance between the centres of the ball bar."""
    plane_bow_mm: float = 0.0
    """Half of the depth of the plane's middle behind the middles of its short edges: z = bow (1 − 2 r²/a²)."""
    board_bow_mm: float = 0.0
    """The same of the ChArUco board's plate."""
    board_scale: float = 1.0
    """Size of the board's print against its drawing."""
    plane_form_mm: tuple[float, float, float] | None = None
    """Saddle, twist and S of the plane (``objects.bent``); ``None``: none of these."""
    board_form_mm: tuple[float, float, float] | None = None
    """The same of the ChArUco board's plate."""

    def sizes(self) -> Array:
        """Return the array (SIZES,) float64 for compiled shapes; (SIZES_OUTSIDE,) if a plate has a form."""
        ordinary = self.plane_form_mm is None and self.board_form_mm is None
        sizes = np.zeros(SIZES if ordinary else SIZES_OUTSIDE)
        sizes[HALF_BALL_DISTANCE], sizes[PLANE_BOW] = 0.5 * self.ball_distance_mm, self.plane_bow_mm
        sizes[BOARD_BOW], sizes[BOARD_SCALE] = self.board_bow_mm, self.board_scale
        for index, form in ((PLANE_FORM, self.plane_form_mm), (BOARD_FORM, self.board_form_mm)):
            if form is not None:
                sizes[index : index + 3] = form
        return sizes

    def as_dict(self) -> dict[str, Any]:
        """Return the dimensions ready for JSON, without missing forms."""
        return {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(self).items() if v is not None}


@dataclass(frozen=True, slots=True)
class TrueRig:
    """The ground truth of one simulated instrument; frames and units as in ``docs/conventions.md``."""

    seed: int
    set: str
    n_water: float
    left: TrueEye
    right: TrueEye
    projector: TrueEye
    lasers: tuple[Laser, Laser]
    artefacts: Artefacts = Artefacts()

    def eye(self, name: str) -> TrueEye:
        """Return the eye called ``left``, ``right`` or ``projector``. Raises KeyError for another name."""
        return {"left": self.left, "right": self.right, "projector": self.projector}[name]

    def as_dict(self) -> dict[str, Any]:
        """Return the rig ready for JSON, with the names of ``docs/protocols/world.md``."""
        return {
            "seed": self.seed,
            "set": self.set,
            "n_water": self.n_water,
            "cameras": {name: _eye_dict(self.eye(name)) for name in ("left", "right", "projector")},
            "lasers": [{"origin_mm": list(b.origin_mm), "direction": list(b.direction)} for b in self.lasers],
            "artefacts": self.artefacts.as_dict(),
        }


@dataclass(frozen=True, slots=True)
class _Amounts:
    """Standard deviations (or ranges) of the errors of a built rig."""

    tilt_deg: tuple[float, float] = (0.0, 0.0)
    d_mm: float = 0.0
    th_mm: float = 0.0
    n_g: float = 0.0
    field_px: float = 0.0
    wedge_deg: float = 0.0
    mount_deg: float = 0.0
    mount_mm: float = 0.0
    focal: float = 0.0
    centre_px: float = 0.0
    distortion: float = 0.0
    artefact_mm: float = 0.0
    board_mm: float = 0.0
    board_scale: float = 0.0
    moved_deg: float = 0.0
    moved_mm: float = 0.0
    refocus: float = 0.0


_REALISTIC = _Amounts(
    tilt_deg=(0.2, 0.5),
    d_mm=1.5,
    th_mm=0.02,
    n_g=0.003,
    field_px=0.06,
    wedge_deg=1 / 60,
    mount_deg=0.15,
    mount_mm=0.4,
    focal=2e-3,
    centre_px=6.0,
    distortion=1.0,
    artefact_mm=0.003,
    board_mm=0.01,
    board_scale=1e-5,
    moved_deg=0.005,
    moved_mm=0.01,
    refocus=1e-4,
)
_HARD = _Amounts(
    tilt_deg=(0.5, 1.2),
    d_mm=3.5,
    th_mm=0.05,
    n_g=0.008,
    field_px=0.15,
    wedge_deg=3 / 60,
    mount_deg=0.3,
    mount_mm=0.9,
    focal=4e-3,
    centre_px=12.0,
    distortion=2.0,
    artefact_mm=0.006,
    board_mm=0.02,
    board_scale=2e-5,
    moved_deg=0.01,
    moved_mm=0.02,
    refocus=2e-4,
)
_AMOUNTS = {
    "nominal": _Amounts(),
    "realistic": _REALISTIC,
    "hard": _HARD,
    "paper": replace(_REALISTIC, tilt_deg=(1.0, 2.0), field_px=0.15),
    "modelled": replace(_REALISTIC, field_px=0.0, wedge_deg=0.0),
}


def _amounts_of(kind: str, seed: int) -> _Amounts | None:
    """Return the amounts of a set, for ``outside`` those of the seed; ``None`` for an unknown set."""
    if kind == "outside":
        drawn: dict[str, Any] = {**drawn_tolerances(seed)}
        return replace(_REALISTIC, **drawn)
    return _AMOUNTS.get(kind)


def draw_truth(
    kind: str, seed: int, width_px: int, height_px: int, n_water: float, drawing: Drawing = DRAWINGS[USUAL]
) -> TrueRig:
    """Return the true rig of a set (``SETS``), built to ``drawing``, or of a ``truth.toml`` (a path).

    Other image sizes bin the nominal pixel. Raises ValueError for an unknown set, OSError for an unreadable file.
    """
    if kind.endswith(".toml"):
        return load_truth(Path(kind), n_water)
    amounts = _amounts_of(kind, seed)
    if amounts is None:
        raise ValueError(f"truth '{kind}'; allowed are {', '.join(SETS)} or the path of a truth.toml")
    rng = np.random.default_rng([seed, 20])
    toe = math.radians(drawing.toe_in_deg)
    binning = drawing.camera_px / width_px
    f_px = drawing.focal_mm / drawing.pixel_mm / binning
    camera = TrueEye(
        width_px,
        height_px,
        (f_px, f_px),
        ((width_px - 1) / 2, (height_px - 1) / 2),
        (0.0,) * 5,
        (),
        (0.0,) * 3,
        TruePort(d_mm=drawing.port_mm),
    )
    f_projector = drawing.projector_focal_mm / drawing.projector_pixel_mm
    columns, rows = drawing.projector_px
    projector = replace(
        camera,
        width_px=columns,
        height_px=rows,
        f_px=(f_projector, f_projector),
        c_px=((columns - 1) / 2, (rows - 1) / 2),
        focus_mm=drawing.centre_mm,
    )
    left = _disturb(replace(camera, R=_turn_y(toe), t_mm=(-drawing.half_baseline_mm, 0.0, 0.0)), amounts, rng, binning)
    right = _disturb(replace(camera, R=_turn_y(-toe), t_mm=(drawing.half_baseline_mm, 0.0, 0.0)), amounts, rng, binning)
    beamer = _disturb(replace(projector, R=_turn_y(0.0), t_mm=(0.0, 0.0, 0.0)), amounts, rng, 1.0)
    beams = []
    for side in (-1.0, 1.0):
        lean = np.radians(rng.normal(0.0, 0.2 if amounts.mount_deg else 0.0, 2))
        beams.append(_pointer(side, lean, n_water, drawing))
    artefact_errors_mm = np.random.default_rng([seed, 21]).normal(0.0, 1.0, 2) * amounts.artefact_mm
    board = np.random.default_rng([seed, 23]).normal(0.0, 1.0, 2) * (amounts.board_mm, amounts.board_scale)
    artefacts = Artefacts(
        drawing.ball_distance_mm + float(artefact_errors_mm[0]),
        float(artefact_errors_mm[1]),
        float(board[0]),
        1.0 + float(board[1]),
    )
    rig = TrueRig(seed, kind, n_water, left, right, beamer, (beams[0], beams[1]), artefacts)
    return with_flaws(rig, draw_outside(seed)) if kind == "outside" else rig


def with_flaws(rig: TrueRig, outside: Outside) -> TrueRig:
    """Return the rig with the families of ``outside`` that belong to it.

    They are flaws of lens and port instead of its lens field, and the forms of plates. Each eye's are drawn by the
    rig's seed; families that are off change nothing.
    """
    if outside.lens is not None:
        eyes = {}
        for number, name in enumerate(("left", "right", "projector")):
            eye = rig.eye(name)
            rng = np.random.default_rng([rig.seed, 24, number])
            flaws = flawed(outside.lens, rng, eye.width_px, eye.height_px, eye.width_px / 1600.0)
            eyes[name] = replace(eye, lens_field=None, aberrations=flaws)
        rig = replace(rig, left=eyes["left"], right=eyes["right"], projector=eyes["projector"])
    if outside.plates is not None:
        forms = replace(rig.artefacts, plane_form_mm=outside.plates.plane, board_form_mm=outside.plates.board)
        rig = replace(rig, artefacts=forms)
    return rig


def _pointer(side: float, lean_rad: Array, n_water: float, drawing: Drawing) -> Laser:
    """Return the laser left (−1) or right (+1) of the projector, rotated in its mount by ``lean_rad`` (x, y).

    Its port is perpendicular to the nominal beam and refracts the rotated one (air, then water: its plane faces drop
    out).
    """
    x_mm, y_mm, z_mm = drawing.laser_mm
    origin = np.array([side * x_mm, y_mm, z_mm])
    drawn = np.array([side * drawing.laser_aim_x_mm, 0.0, drawing.centre_mm]) - origin
    drawn /= np.linalg.norm(drawn)
    right = np.cross([0.0, 1.0, 0.0], drawn)
    right /= np.linalg.norm(right)
    beam = drawn + math.tan(float(lean_rad[0])) * right + math.tan(float(lean_rad[1])) * np.cross(drawn, right)
    beam /= np.linalg.norm(beam)
    bent = refract(
        float(beam[0]), float(beam[1]), float(beam[2]), float(drawn[0]), float(drawn[1]), float(drawn[2]), 1.0 / n_water
    )
    return Laser(_triple(origin), _triple(np.array(bent)))


def in_air(rig: TrueRig) -> TrueRig:
    """Return the same instrument on the day of its calibration in air, before it was closed.

    There are no ports (their index and the water's are 1, so that light goes straight; nor their dents and striae).
    Later changes are undone: the cameras' mounting by 0.005° and 0.01 mm and the principal distance by 1e-4 (standard
    deviations of the realistic sets; the hard one doubles them, the nominal one has none). They follow from the rig's
    seed and set; a rig from a file whose set is not one of ``SETS`` has no changes.
    """
    a = _amounts_of(rig.set, rig.seed) or _Amounts()
    rng = np.random.default_rng([rig.seed, 22])
    before = {}
    for name in ("left", "right"):
        eye = rig.eye(name)
        rotation, shift = _rodrigues(np.radians(rng.normal(0.0, a.moved_deg, 3))), rng.normal(0.0, a.moved_mm, 3)
        focal = 1.0 + rng.normal(0.0, a.refocus)
        before[name] = replace(
            eye,
            f_px=(eye.f_px[0] * focal, eye.f_px[1] * focal),
            R=_rows(np.array(eye.R) @ rotation),
            t_mm=_triple(np.array(eye.t_mm) + shift),
            port=TruePort(n_g=1.0),
            aberrations=None if eye.aberrations is None else eye.aberrations.without_window(),
        )
    flaws = rig.projector.aberrations
    projector = replace(
        rig.projector, port=TruePort(n_g=1.0), aberrations=None if flaws is None else flaws.without_window()
    )
    return replace(rig, n_water=1.0, left=before["left"], right=before["right"], projector=projector)


def turned(eye: TrueEye, angles_deg: tuple[float, float, float]) -> TrueEye:
    """Return the eye rotated by a rotation vector, degrees in its own frame, together with its port."""
    return replace(eye, R=_rows(np.array(eye.R) @ _rodrigues(np.radians(np.array(angles_deg)))))


def with_glass(rig: TrueRig, more: float) -> TrueRig:
    """Return the rig with ports whose index is larger by ``more``, for light of another colour."""
    if more == 0.0:
        return rig
    eyes = {name: rig.eye(name) for name in ("left", "right", "projector")}
    coloured = {
        name: replace(eye, port=replace(eye.port, n_g=eye.port.n_g + more)) if eye.port.n_g != 1.0 else eye
        for name, eye in eyes.items()
    }
    return replace(rig, left=coloured["left"], right=coloured["right"], projector=coloured["projector"])


def load_truth(path: Path, n_water: float) -> TrueRig:
    """Read a ``truth.toml`` as ``save_truth`` writes it. Raises OSError, and KeyError for a missing key."""
    data = tomllib.loads(path.read_text())
    eyes = {}
    for name, table in data["cameras"].items():
        port = table["port"]
        eyes[name] = TrueEye(
            table["width_px"],
            table["height_px"],
            tuple(table["f_px"]),
            tuple(table["c_px"]),
            tuple(table["distortion"]),
            tuple(tuple(row) for row in table["R"]),
            tuple(table["t_mm"]),
            TruePort(**{**port, "normal": tuple(port["normal"])}),
            _flat_field(table.get("lens_field")),
            Aberrations.from_dict(table["aberrations"]) if "aberrations" in table else None,
            table.get("focus_mm", FOCUS_MM),
        )
    beams = [Laser(tuple(b["origin_mm"]), tuple(b["direction"])) for b in data["lasers"]]
    return TrueRig(
        data["seed"],
        data["set"],
        n_water,
        eyes["left"],
        eyes["right"],
        eyes["projector"],
        (beams[0], beams[1]),
        _artefacts(data.get("artefacts", {})),
    )


def _artefacts(table: dict[str, Any]) -> Artefacts:
    values: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in table.items()}
    return Artefacts(**values)


def save_truth(rig: TrueRig, path: Path) -> None:
    """Write ``rig`` as a ``truth.toml``. Raises OSError."""
    content = rig.as_dict()
    lines = [f"seed = {rig.seed}", f'set = "{rig.set}"']
    for name, table in content["cameras"].items():
        parts = {part: table.pop(part, None) for part in ("port", "lens_field", "aberrations")}
        lines += ["", f"[cameras.{name}]", *(f"{k} = {v}" for k, v in table.items())]
        for part, values in parts.items():
            if values is not None:
                lines += ["", f"[cameras.{name}.{part}]", *(f"{k} = {v}" for k, v in values.items())]
    lines += ["", "[artefacts]", *(f"{k} = {v}" for k, v in content["artefacts"].items())]
    for beam in content["lasers"]:
        lines += ["", "[[lasers]]", *(f"{k} = {v}" for k, v in beam.items())]
    path.write_text("\n".join(lines) + "\n")


def _disturb(eye: TrueEye, a: _Amounts, rng: np.random.Generator, binning: float) -> TrueEye:
    """Return the eye with the errors of a workshop.

    The order of the draws is part of each seed's rig: never change it.
    """
    # Machining errors of the port: tilt against the lens, distance and thickness.
    tilt = math.radians(rng.uniform(*a.tilt_deg))
    towards = rng.uniform(0.0, 2 * math.pi)
    lean = math.tan(tilt) * np.array([math.cos(towards), math.sin(towards)])
    normal = np.array([lean[0], lean[1], 1.0])
    normal /= np.linalg.norm(normal)
    port = TruePort(
        _triple(normal),
        eye.port.d_mm + rng.uniform(-a.d_mm, a.d_mm),
        5.0 + rng.uniform(-a.th_mm, a.th_mm),
        1.77 + rng.uniform(-a.n_g, a.n_g),
        a.wedge_deg,
        float(rng.uniform(0.0, 360.0)),
    )
    # Mounting, principal distance and point, and Brown's five coefficients of a typical small lens.
    rotation = _rodrigues(np.radians(rng.normal(0.0, a.mount_deg or 0.0, 3)))
    shift = rng.normal(0.0, a.mount_mm, 3)
    focal = 1.0 + rng.uniform(-a.focal, a.focal)
    centre = rng.normal(0.0, a.centre_px / binning, 2)
    # k1, k2, p1, p2, k3, each within 30 % of the lens's design.
    brown = np.array([-0.06, 0.08, 2e-4, -1.5e-4, 0.0]) * a.distortion * rng.uniform(0.7, 1.3, 5)
    field = None
    if a.field_px:
        field = rng.normal(size=(2, FIELD_ORDER, FIELD_ORDER))
        field[:, :2, :1] = field[:, :1, :2] = 0.0  # shift and the lowest scale belong to the linear part
        field *= 1.0 / (1.0 + np.add.outer(np.arange(FIELD_ORDER), np.arange(FIELD_ORDER)))
        power = np.where(np.arange(FIELD_ORDER) == 0, 1.0, 0.5)  # mean square of a cosine over the image
        rms = math.sqrt(float(np.mean(np.sum(field**2 * np.outer(power, power), axis=(1, 2)))))
        field *= a.field_px / binning / rms  # rms of each component
    return replace(
        eye,
        f_px=(eye.f_px[0] * focal, eye.f_px[1] * focal),
        c_px=(eye.c_px[0] + float(centre[0]), eye.c_px[1] + float(centre[1])),
        distortion=(float(brown[0]), float(brown[1]), float(brown[2]), float(brown[3]), float(brown[4])),
        R=_rows(np.array(eye.R) @ rotation),
        t_mm=_triple(np.array(eye.t_mm) + shift),
        port=port,
        lens_field=None if field is None else tuple(float(x) for x in field.ravel()),
    )


def _eye_dict(eye: TrueEye) -> dict[str, Any]:
    port = eye.port
    flaws = {} if eye.aberrations is None else {"aberrations": eye.aberrations.as_dict()}
    return {
        "width_px": eye.width_px,
        "height_px": eye.height_px,
        "f_px": list(eye.f_px),
        "c_px": list(eye.c_px),
        "distortion": list(eye.distortion),
        "R": [list(row) for row in eye.R],
        "t_mm": list(eye.t_mm),
        "port": {
            "normal": list(port.normal),
            "d_mm": port.d_mm,
            "th_mm": port.th_mm,
            "n_g": port.n_g,
            "wedge_deg": port.wedge_deg,
            "wedge_direction_deg": port.wedge_direction_deg,
        },
        "lens_field": _field_dict(eye.lens_field),
        **({} if eye.focus_mm == FOCUS_MM else {"focus_mm": eye.focus_mm}),
        **flaws,
    }


def _field_dict(field: tuple[float, ...] | None) -> dict[str, Any] | None:
    """Return the lens field as a table of cosine coefficients.

    A pixel (u, v) sees what an ideal five-parameter lens has at (u, v) − field; u_px[j][i] belongs to
    cos(iπ(u+½)/width) cos(jπ(v+½)/height), likewise v_px.
    """
    if field is None:
        return None
    u, v = np.reshape(field, (2, FIELD_ORDER, FIELD_ORDER)).tolist()
    return {"u_px": u, "v_px": v}


def _flat_field(table: dict[str, Any] | None) -> tuple[float, ...] | None:
    return None if table is None else tuple(float(x) for x in np.ravel([table["u_px"], table["v_px"]]))


def _turn_y(angle_rad: float) -> tuple[tuple[float, float, float], ...]:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return ((c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c))


def _rodrigues(vector_rad: Array) -> Array:
    angle = float(np.linalg.norm(vector_rad))
    if angle == 0.0:
        return np.eye(3)
    # Rodrigues: R = I + sin θ K + (1 − cos θ) K².
    x, y, z = vector_rad / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K)


def _triple(v: Array) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])


def _rows(m: Array) -> tuple[tuple[float, float, float], ...]:
    return tuple(_triple(row) for row in m)


def ray(truth: TrueRig, eye: str, uv_px: ArrayLike) -> tuple[Array, Array]:
    """Return the rays in water of pixels (n, 2) of ``left``, ``right`` or ``projector``, float64.

    Returns the points (n, 3) where they leave the outer glass face, in mm, and their unit directions (n, 3), both in
    the rig frame. Exact vector Snell; raises KeyError for another eye.
    """
    uv = np.ascontiguousarray(np.reshape(np.asarray(uv_px, np.float64), (-1, 2)))
    out = np.empty((len(uv), 6))
    rays_of(truth.eye(eye).packed(truth.n_water), uv, out)
    return out[:, :3].copy(), out[:, 3:].copy()


def project(truth: TrueRig, eye: str, points_rig_mm: ArrayLike) -> Array:
    """Return the pixels (n, 2) float64 of water points (n, 3) of the rig frame: Newton on the exact ray, 1e-9 px.

    NaN for a point behind the port. Raises KeyError for an unknown eye.
    """
    points = np.ascontiguousarray(np.reshape(np.asarray(points_rig_mm, np.float64), (-1, 3)))
    out = np.empty((len(points), 2))
    pixels_of(truth.eye(eye).packed(truth.n_water), points, out)
    return out
