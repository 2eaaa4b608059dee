"""Picture of a point cloud: perspective, slow rotation, colour by value, shading from depth.

    CloudPainter    draws one cloud into a part of a picture
    Relief          a cloud as a coarse, smooth height over x and y, for light and shade

A scan is seen from one side, so the surface around a point is a height over x and y: its slope gives the surface normal
for the shading. Edges between near and far are darkened as in eye-dome lighting (C. Boucheny, thesis, Grenoble 2009).
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import moderngl
import numpy as np
from numpy.typing import NDArray

from appliance.instrument.screens.theme import colour_table

POINTS_PER_CELL = 4.0
MAX_CELLS = 512


class Relief:
    """Mean z of the points (n, 3) float32 mm in square cells between ``low`` and ``high`` (3,).

    Smoothed 3 × 3. Only for display, not for measurements.
    """

    def __init__(self, points: NDArray[np.float32], low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
        across_mm, down_mm = np.maximum(high[:2] - low[:2], 1e-3)
        # As fine as the cloud allows: about four points in each cell if they covered the whole box.
        cell_mm = float(np.sqrt(across_mm * down_mm * POINTS_PER_CELL / len(points)))
        self._cell_mm = max(cell_mm, across_mm / MAX_CELLS, down_mm / MAX_CELLS)
        self._low = low[:2]
        self._columns, self._rows = int(across_mm / self._cell_mm) + 1, int(down_mm / self._cell_mm) + 1
        cells = self._cells(points)
        shape = self._rows, self._columns
        size = self._rows * self._columns
        number = np.bincount(cells, minlength=size).reshape(shape)
        total = np.bincount(cells, weights=points[:, 2], minlength=size).reshape(shape)
        self.area_mm2 = max(1, int(np.count_nonzero(number))) * self._cell_mm**2
        """Area that the points cover as seen along z, without holes."""
        # Sums and counts are smoothed separately and then divided, so that empty cells do not affect the mean.
        weight = np.asarray(cv2.blur(number.astype(np.float64), (3, 3)), np.float64)
        height = np.asarray(cv2.blur(total, (3, 3)), np.float64)
        self._height = np.divide(height, weight, out=np.full(shape, np.nan), where=weight > 0.0)

    def slopes(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return (n, 2) float32: dz/dx and dz/dy of the surface around each point; 0 without neighbours."""
        down, across = np.gradient(self._height, self._cell_mm) if min(self._height.shape) > 1 else (0.0, 0.0)
        cells = self._cells(points)
        slopes = np.empty((len(points), 2), np.float32)
        slopes[:, 0] = np.broadcast_to(across, self._height.shape).ravel()[cells]
        slopes[:, 1] = np.broadcast_to(down, self._height.shape).ravel()[cells]
        return np.nan_to_num(slopes, nan=0.0)

    def _cells(self, points: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the flat index of each point's cell; points beyond the edge count to the cell at the edge."""
        column = np.clip((points[:, 0] - self._low[0]) / self._cell_mm, 0, self._columns - 1).astype(np.int64)
        row = np.clip((points[:, 1] - self._low[1]) / self._cell_mm, 0, self._rows - 1).astype(np.int64)
        flat: NDArray[np.int64] = row * self._columns + column
        return flat


MAX_POINTS = 40_000
"""More points cannot be distinguished at this size, and a software renderer needs 0.4 ms per thousand."""
TURN_DEG, TURN_S = 24.0, 11.0
"""Amplitude and period of the rotation about the vertical axis."""
NOD_DEG, NOD_S = 9.0, 17.0
"""Amplitude and period of the rotation about the horizontal axis. It begins at the camera's view."""
STEP_DEG = 20.0
"""Angle in degrees by which one step of the diver turns the cloud."""
EYE_RADII = 3.2
"""Distance of the eye from the middle of the cloud, in radii of the cloud."""

FILL = 0.9
"""Share of the picture that the cloud may take while it turns."""

_POINTS = """
#version 330
uniform mat3 turn;
uniform vec3 middle;
uniform float eye;     // mm from the middle
uniform vec2 focal;    // of clip space
uniform float lower;   // how far below the middle of the picture the cloud sits, in clip space
uniform float splat;   // pixels × mm
uniform sampler2D colours;
in vec3 point;
in vec2 slope;         // dz/dx, dz/dy of the surface around the point
in float value;
flat out vec4 paint;   // colour in light, nearness
const vec3 LIGHT = normalize(vec3(-0.45, -0.75, -0.75));  // over the diver's left shoulder, and it does not turn
void main() {
    vec3 p = turn * (point - middle);
    vec3 normal = turn * normalize(vec3(slope, -1.0));
    float z = p.z + eye;
    float depth = (z - 0.2 * eye) / (2.0 * eye);  // 0..1 from a fifth of the way to beyond the cloud
    gl_Position = vec4(focal * p.xy + vec2(0.0, lower * z), z * (2.0 * depth - 1.0), z);  // y downwards: row 0 is the top
    gl_PointSize = clamp(splat / z, 1.5, 14.0);
    float light = 0.34 + 0.78 * max(dot(normal, LIGHT), 0.0);
    float gleam = pow(max(dot(reflect(-LIGHT, normal), vec3(0.0, 0.0, -1.0)), 0.0), 24.0);
    vec3 tint = textureLod(colours, vec2(value * (255.0 / 256.0) + 0.5 / 256.0, 0.5), 0.0).rgb;
    paint = vec4(min(tint * light + 0.16 * gleam, 1.0), 1.0 - depth);
}
"""
_SPLAT = """
#version 330
flat in vec4 paint;
out vec4 result;
void main() { result = paint; }
"""
_COVER = """
#version 330
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }
"""
_RESOLVE = """
#version 330
uniform sampler2D result;
uniform ivec2 corner;
uniform float strength;  // of the shadow at an edge, per unit of nearness
out vec4 colour;
ivec2 at, last;
vec4 near(int x, int y) { return texelFetch(result, clamp(at + ivec2(x, y), ivec2(0), last), 0); }
void main() {
    at = ivec2(gl_FragCoord.xy) - corner;
    last = textureSize(result, 0) - 1;
    vec4 here = near(0, 0);
    vec4 a = near(-2, 0), b = near(2, 0), c = near(0, -2), d = near(0, 2);
    if (here.a == 0.0) {
        // A gap of a pixel or two between points of one surface is closed; more would be invention.
        vec4 found = step(1e-6, vec4(a.a, b.a, c.a, d.a));
        float number = dot(found, vec4(1.0));
        if (number < 3.0) discard;
        colour = vec4((a.rgb * found.x + b.rgb * found.y + c.rgb * found.z + d.rgb * found.w) / number, 1.0);
        return;
    }
    vec4 ahead = clamp((vec4(a.a, b.a, c.a, d.a) - here.a) * strength, 0.0, 0.7);
    colour = vec4(here.rgb * exp(-dot(ahead, vec4(0.5))), 1.0);
}
"""


def thin(number: int, limit: int = MAX_POINTS) -> NDArray[np.int64]:
    """Return sorted indices of at most ``limit`` of ``number`` points, one out of each equal run.

    Jittered, so that the rows of the camera make no moiré with the thinning; the same for the same numbers.
    """
    if number <= limit:
        return np.arange(number)
    edges = np.arange(limit + 1, dtype=np.int64) * number // limit
    jitter = np.random.default_rng(0).random(limit)
    return edges[:-1] + (jitter * np.diff(edges)).astype(np.int64)


def spread(values: NDArray[np.float32]) -> tuple[float, float]:
    """Return the range of the colours: 2nd to 98th percentile of the finite values, never empty."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(finite, (2.0, 98.0)))
    return (low, high) if high - low > 1e-6 * max(1.0, abs(high)) else (low - 0.5, low + 0.5)


class CloudPainter:
    """Draws one cloud repeatedly into a part of a picture; copies it to the GPU when it changes."""

    def __init__(self, context: moderngl.Context, size_px: tuple[int, int]) -> None:
        self._context = context
        self._size_px = size_px
        self._resources: list[Any] = []
        keep = self._keep
        self._result = keep(context.texture(size_px, 4, dtype="f4"))
        self._result.filter = moderngl.NEAREST, moderngl.NEAREST
        depth = keep(context.depth_renderbuffer(size_px))
        self._buffer = keep(context.framebuffer([self._result], depth))
        self._points = keep(context.program(vertex_shader=_POINTS, fragment_shader=_SPLAT))
        self._resolve = keep(context.program(vertex_shader=_COVER, fragment_shader=_RESOLVE))
        self._cover = keep(context.vertex_array(self._resolve, []))
        self._colours = keep(context.texture((256, 1), 3, colour_table(), alignment=1))
        self._vertices = keep(context.buffer(reserve=MAX_POINTS * 24, dynamic=True))
        layout = (self._vertices, "3f 2f 1f", "point", "slope", "value")
        self._splats = keep(context.vertex_array(self._points, [layout]))
        self._shown: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None
        self._number = 0
        self._middle = np.zeros(3)
        self._half_mm = np.ones(3)
        self._radius_mm = 1.0
        self._spacing_mm = 1.0
        self.range = (0.0, 1.0)
        """Values at both ends of the colours, of the cloud drawn last."""

    @property
    def empty(self) -> bool:
        return self._number == 0

    def show(self, points_mm: NDArray[np.float32], values: NDArray[np.float32], bright_is_high: bool) -> None:
        """Set the cloud (n, 3), (n,). Has no effect if it is shown already."""
        if self._shown is not None and _same(self._shown[0], points_mm) and _same(self._shown[1], values):
            return
        self._shown = points_mm, values
        chosen = thin(len(points_mm))
        points, picked = points_mm[chosen], values[chosen]
        finite = np.isfinite(points).all(axis=1)
        points, picked = points[finite], picked[finite]
        self._number = len(points)
        if not self._number:
            return
        low, high = self.range = spread(picked)
        level = np.nan_to_num(np.clip((picked - low) / (high - low), 0.0, 1.0), nan=0.0)
        # Percentiles, so that an outlier does not move the cloud out of the middle or make it small.
        near, far = np.percentile(points, (1.0, 99.0), axis=0)
        self._middle = (near + far) / 2.0
        self._half_mm = np.maximum((far - near) / 2.0, 1e-3)
        self._radius_mm = float(np.linalg.norm(self._half_mm))
        relief = Relief(points, near, far)
        # Mean distance of neighbours on the covered area only: holes would make the splats too large.
        self._spacing_mm = math.sqrt(relief.area_mm2 / self._number)
        packed = np.empty((self._number, 6), np.float32)
        packed[:, :3] = points
        packed[:, 3:5] = relief.slopes(points)
        packed[:, 5] = level if bright_is_high else 1.0 - level
        self._vertices.write(packed)

    def draw(
        self, target: moderngl.Framebuffer, room: tuple[int, int, int, int], time_s: float, turn_steps: int = 0
    ) -> None:
        """Draw over ``target``, in the middle of ``room`` (left, top, width, height in px); blending stays on.

        ``room`` starts at the left edge; points may leave it, but not the painter's size.
        """
        width, height = self._size_px
        place = (room[0], 0)
        eye = EYE_RADII * self._radius_mm
        fit = self._focal_px(eye, room[2:])
        context = self._context
        self._buffer.use()
        # Nearness (alpha) 0 marks empty pixels, by which `_RESOLVE` closes gaps and darkens edges.
        self._buffer.clear(0.0, 0.0, 0.0, 0.0)
        # Alpha is the nearness in this pass, and must not be blended.
        context.disable(moderngl.BLEND)
        context.enable(moderngl.DEPTH_TEST | moderngl.PROGRAM_POINT_SIZE)
        self._points["turn"] = tuple(_turn(time_s, turn_steps).T.ravel())
        self._points["middle"] = tuple(self._middle)
        self._points["eye"] = eye
        self._points["focal"] = (2.0 * fit / width, 2.0 * fit / height)
        self._points["lower"] = (2.0 * room[1] + room[3]) / height - 1.0
        # Nearly two distances wide, so that neighbouring splats overlap.
        self._points["splat"] = 1.9 * self._spacing_mm * fit
        self._colours.use(0)
        self._splats.render(moderngl.POINTS, vertices=self._number)
        context.disable(moderngl.DEPTH_TEST)
        target.use()
        context.viewport = (*place, width, height)
        self._result.use(0)
        self._resolve["corner"] = place
        self._resolve["strength"] = 2.0 * eye / (0.12 * self._radius_mm)
        self._cover.render(moderngl.TRIANGLES, vertices=3)
        context.viewport = (0, 0, *target.size)
        context.enable(moderngl.BLEND)

    def _focal_px(self, eye_mm: float, room_px: tuple[int, ...]) -> float:
        """Return the focal length at which the cloud fills its part of the picture, at any rotation."""
        half_x, half_y, half_z = self._half_mm
        across = math.hypot(half_x, half_z * math.sin(math.radians(TURN_DEG)) * 1.5)
        down = math.hypot(half_y, half_z * math.sin(math.radians(NOD_DEG)) * 1.5)
        width, height = room_px
        # For the nearest part of the cloud, which appears largest.
        return 0.5 * FILL * min(width / across, height / down) * (eye_mm - half_z)

    def close(self) -> None:
        """Release every GL object."""
        for resource in reversed(self._resources):
            resource.release()
        self._resources.clear()

    def _keep(self, resource: Any) -> Any:
        self._resources.append(resource)
        return resource


def _turn(time_s: float, steps: int) -> NDArray[np.float64]:
    """Return the rotation of the cloud about its middle; the identity at time 0 and step 0."""
    swing = TURN_DEG * math.sin(2.0 * math.pi * time_s / TURN_S)
    yaw = math.radians(swing + STEP_DEG * steps)
    pitch = math.radians(NOD_DEG) * math.sin(2.0 * math.pi * time_s / NOD_S)
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cp, -sp], [0.0, sp, cp]])
    turned: NDArray[np.float64] = about_x @ about_y
    return turned


def _same(held: NDArray[np.float32], candidate: NDArray[np.float32]) -> bool:
    """Return True if both arrays use the same memory.

    ``held`` is still referenced, so an equal address means the same cloud.
    """
    # Addresses are compared, not values: comparing a million points would cost more than drawing them.
    held_interface, candidate_interface = held.__array_interface__, candidate.__array_interface__
    return (
        held_interface["data"] == candidate_interface["data"]
        and held.shape == candidate.shape
        and held.strides == candidate.strides
    )
