"""Every test process finds the compiled kernels of this tree, also without ``./dev``: before anything imports them."""

from __future__ import annotations

from appliance import kernel_cache

kernel_cache.use()
