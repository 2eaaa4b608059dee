"""Owns the surface that can be turned: plotly's own JavaScript within the page, fed with numbers as base64, and buttons to colour it."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.base import needed
from appliance.desk.report.charts import hex_of
from appliance.desk.report.content import Vector
from appliance.desk.report.shown import Colouring, ShownSurface
from appliance.desk.report.still import view_direction

_DISTANCE = 2.0
"""Distance of the eye from the middle of the scene, in plotly's units of the scene's size."""

_SCRIPT = """
(function () {
  var kinds = {f4: Float32Array, i4: Int32Array};
  var data = JSON.parse(document.getElementById('surface-data').textContent, function (name, value) {
    if (!value || !value.bdata) { return value; }
    var text = atob(value.bdata), bytes = new Uint8Array(text.length);
    for (var k = 0; k < text.length; k++) { bytes[k] = text.charCodeAt(k); }
    return new kinds[value.dtype](bytes.buffer);
  });
  var plot = document.getElementById('turned');
  var key = data.trace.type === 'mesh3d' ? '' : 'marker.';
  function look(k) {
    var c = data.colourings[k], change = {};
    change[key + (key ? 'color' : 'intensity')] = [c.values];
    change[key + 'colorscale'] = [c.scale];
    change[key + 'cmin'] = [c.low];
    change[key + 'cmax'] = [c.high];
    Plotly.restyle(plot, change);
    document.querySelectorAll('.colouring').forEach(function (one) {
      one.hidden = Number(one.dataset.colouring) !== k;
    });
    document.querySelectorAll('.look').forEach(function (one) {
      one.setAttribute('aria-pressed', String(Number(one.dataset.colouring) === k));
    });
  }
  document.querySelectorAll('.look').forEach(function (one) {
    one.addEventListener('click', function () { look(Number(one.dataset.colouring)); });
  });
  // A browser without WebGL keeps the still picture, which is in the page anyway.
  try {
    var canvas = document.createElement('canvas');
    if (!(canvas.getContext('webgl') || canvas.getContext('webgl2'))) { throw new Error('no WebGL'); }
    // ShownSurface first: what has no size yet would be drawn in plotly's default one.
    document.body.classList.add('turning');
    Plotly.newPlot(plot, [data.trace], data.layout, {displaylogo: false, responsive: true,
      modeBarButtons: [['toImage', 'zoom3d', 'pan3d', 'orbitRotation', 'resetCameraDefault3d']]}).then(function () { look(0); });
  } catch (error) {
    document.body.classList.remove('turning');
  }
})();
"""


def turned(shown: ShownSurface, up: Vector) -> tuple[str, str]:
    """Return the element of the surface with its buttons, and the scripts that fill it. Raises MissingLibraryError where plotly
    is absent."""
    library = needed("plotly.offline", "plotly", "a page with a surface that can be turned")
    buttons = "".join(
        f'<button type="button" class="look" data-colouring="{k}" aria-pressed="{"true" if k == 0 else "false"}">{one.name}</button>'
        for k, one in enumerate(shown.colourings)
    )
    content = {
        "trace": _trace(shown),
        "layout": _layout(shown, up),
        "colourings": [_as_json(one) for one in shown.colourings],
    }
    # "</script>" in a text would end the element: every "<" is written as its number.
    text = json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")
    scripts = (
        f'<script type="application/json" id="surface-data">{text}</script>\n<script>{library.get_plotlyjs()}</script>\n'
        f"<script>{_SCRIPT}</script>"
    )
    return f'<div class="looks" role="group" aria-label="Colours">{buttons}</div><div id="turned"></div>', scripts


def _trace(shown: ShownSurface) -> dict[str, Any]:
    first = shown.colourings[0]
    places = {axis: _packed(shown.points_mm[:, k], "<f4") for k, axis in enumerate("xyz")}
    scale = _scale(first)
    hover = "x %{x:.2f}  y %{y:.2f}  z %{z:.2f} mm<extra></extra>"
    if shown.faces is None:
        marker = {
            "size": 2.4,
            "color": _packed(first.values, "<f4"),
            "colorscale": scale,
            "cmin": first.low,
            "cmax": first.high,
        }
        return {"type": "scatter3d", "mode": "markers", **places, "marker": marker, "hovertemplate": hover}
    corners = {name: _packed(shown.faces[:, k], "<i4") for k, name in enumerate("ijk")}
    return {
        "type": "mesh3d", **places, **corners, "intensity": _packed(first.values, "<f4"), "colorscale": scale,
        "cmin": first.low, "cmax": first.high, "showscale": False, "hovertemplate": hover, "flatshading": False,
        "lighting": {"ambient": 0.62, "diffuse": 0.55, "specular": 0.08, "roughness": 0.9, "fresnel": 0.05},
    }  # fmt: skip


def _layout(shown: ShownSurface, up: Vector) -> dict[str, Any]:
    eye = _DISTANCE * view_direction(shown, up)
    axis = {
        "showbackground": False, "gridcolor": "#d5dde5", "zeroline": False, "tickfont": {"size": 11, "color": "#5b6b7b"},
        "ticksuffix": "", "nticks": 6,
    }  # fmt: skip
    return {
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "showlegend": False,
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": "#9aa8b5", "activecolor": "#0b3c5d"},
        "scene": {
            "aspectmode": "data",
            "dragmode": "orbit",
            "camera": {"eye": dict(zip("xyz", eye.tolist(), strict=True)), "up": dict(zip("xyz", up, strict=True))},
            **{f"{name}axis": {**axis, "title": {"text": f"{name} in mm"}} for name in "xyz"},
        },
    }


def _as_json(one: Colouring) -> dict[str, Any]:
    return {"values": _packed(one.values, "<f4"), "scale": _scale(one), "low": one.low, "high": one.high}


def _scale(one: Colouring) -> list[tuple[float, str]]:
    return [(k / (len(one.colours) - 1), hex_of(colour)) for k, colour in enumerate(one.colours)]


def _packed(values: NDArray[Any], kind: str) -> dict[str, str]:
    """Return an array as the script unpacks it: a third of the length of its digits."""
    data = np.ascontiguousarray(values, kind)
    return {"dtype": {"<f4": "f4", "<i4": "i4"}[kind], "bdata": base64.b64encode(data.tobytes()).decode()}
