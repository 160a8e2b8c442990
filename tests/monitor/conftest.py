"""Recordings that several tests of monitors read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io


@pytest.fixture(scope="session")
def recordings(shared_data: Path) -> dict[str, np.ndarray]:
    folder = shared_data / "three_tank_dts200"
    content = scipy.io.loadmat(folder / "test_5ch.mat") | scipy.io.loadmat(folder / "train_5ch.mat")
    return {name: value for name, value in content.items() if not name.startswith("__")}
