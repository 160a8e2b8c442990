"""Long recordings are run piece by piece, with the bits of one run over all of it."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from residua.errors import DataError, ModelError


def generator() -> rs.design.ResidualGenerator:
    plant = rs.Plant([[0.8, 0.1], [0, 0.6]], [[0.2], [0.4]], np.eye(2), dt=1).with_sensor_faults()
    return rs.design.kalman_filter(plant.with_noise(process=1e-4, measurement=1e-2))


@pytest.mark.parametrize("plants", [None, 3])
def test_pieces_have_the_bits_of_the_whole(plants: int | None) -> None:
    rng, made = np.random.default_rng(0), generator()
    shape = (20_001,) if plants is None else (plants, 20_001)
    u, y = rng.standard_normal((*shape, 1)), rng.standard_normal((*shape, 2))
    y[..., 12_345, 0] = np.nan
    x0 = np.array([3.0, -1.0])
    whole = made.system.simulate(np.concatenate([u, y], axis=-1), x0)
    assert np.array_equal(made.run(u, y, x0=x0), whole, equal_nan=True)
    with pytest.raises(ModelError, match="x0 must have 2 entries"):
        made.run(u, y, x0=[1.0])
    with pytest.raises(DataError, match="u must be"):
        made.run(u[..., 1:, :], y)
