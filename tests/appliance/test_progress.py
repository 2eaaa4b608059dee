"""What the progress of a part of the work says of the whole."""

from __future__ import annotations

from appliance.base import part_of, silent
from tests.support.told import Told


def test_a_part_tells_its_own_share_of_the_whole_under_its_name() -> None:
    whole = Told()
    part = part_of(whole, 0.5, 0.75, "000007")
    part("decoding")
    part("matching", 0.5)
    part_of(whole, 0.75, 1.0)("writing", 1.0)
    silent("nothing", 0.5)
    assert whole.all == [("000007: decoding", 0.5), ("000007: matching", 0.625), ("writing", 1.0)]
