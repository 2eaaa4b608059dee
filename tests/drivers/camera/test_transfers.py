"""An image is cut into whole units, none of them longer than a piece, and nothing of it is left out."""

from __future__ import annotations

import pytest

from drivers.camera.transfers import Transfers, transfers_of

MIB = 1 << 20


@pytest.mark.parametrize(
    ("payload", "alignment", "piece", "cut"),
    [
        (1_920_000, 1024, None, Transfers(1_920_000, 1, 0, 0)),
        (1_920_001, 1024, None, Transfers(1_921_024, 1, 0, 0)),
        (1_920_000, 1024, MIB, Transfers(MIB, 1, 871_424, 0)),
        (2 * MIB, 1024, MIB, Transfers(MIB, 2, 0, 0)),
        (2 * MIB + 1, 1024, MIB, Transfers(MIB, 2, 1024, 0)),
        (MIB, 1, MIB, Transfers(MIB, 1, 0, 0)),
        (MIB - 5, 1, MIB, Transfers(MIB - 5, 1, 0, 0)),
        (5000, 2048, 1024, Transfers(2048, 2, 2048, 0)),
    ],
)
def test_transfers(payload: int, alignment: int, piece: int | None, cut: Transfers) -> None:
    got = transfers_of(payload, alignment, piece)
    assert got == cut
    assert payload <= sum(got.sizes) < payload + alignment
