"""The file of the projector's response: small, checksummed, readable JSON, beside the calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated

from appliance.base import FINITE, LEFT_OUT, SealedFile, Within
from appliance.measure.light.response import Response

_WholeUs = Annotated[int, Within(0, math.inf, integers_only=True)]


@dataclass(frozen=True, slots=True)
class StoredResponse:
    """A response and its source. Raises ValueError for impossible harmonics."""

    rig_serial: str
    made_from: tuple[str, ...]
    """Ids of the scans."""
    residual: Annotated[float, FINITE]
    """RMS residual of the fit, as a fraction of the bright light."""
    harmonics: tuple[Annotated[float, FINITE], ...]
    """Harmonics of the response."""
    exposure_us: _WholeUs | None = field(default=None, metadata=LEFT_OUT)
    """Exposure of the measurement: a projector of bit planes has a response for each. ``None``: unknown."""
    trigger_delay_us: _WholeUs | None = field(default=None, metadata=LEFT_OUT)
    """Time from the vsync to the beginning of that exposure; ``None``: unknown."""

    def __post_init__(self) -> None:
        Response(self.harmonics)

    @property
    def response(self) -> Response:
        """The projector's response."""
        return Response(self.harmonics)


RESPONSE = SealedFile(
    StoredResponse,
    schema=1,
    max_bytes=64 * 1024,
    what="response",
    remedy="measure the response again, or remove the file: patterns are then made without response correction",
)
