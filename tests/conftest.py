"""Every test process finds the compiled kernels of this tree, also without ``./dev``, and begins as the instrument's do."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from appliance import kernel_cache
from appliance.process_start import use_one_blas_thread

if TYPE_CHECKING:
    import pytest

kernel_cache.use()
use_one_blas_thread(os.environ)  # before anything imports NumPy


def pytest_configure(config: pytest.Config) -> None:
    """Tell how long tests took."""
    from tests.support.durations import Durations

    config.pluginmanager.register(Durations())
