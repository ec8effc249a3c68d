"""Features of cells, against hand-computed values and NumPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vehicle_detection.compiled.cells import cell_lengths, describe_cells


def test_a_cell_is_held_against_what_is_around():
    histograms = np.array([[3.0, 4.0], [0.0, 0.0]], np.float32)
    colors = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], np.float32)
    np.testing.assert_allclose(cell_lengths(histograms), [5, 0])
    features = describe_cells(histograms, np.float32(2.5), colors)
    scaled = histograms / np.sqrt(25 + 6.25)
    np.testing.assert_allclose(features, np.hstack([scaled, colors]), atol=1e-6)
    nothing = np.zeros((2, 2), np.float32)
    assert not describe_cells(nothing, np.zeros(2, np.float32), nothing).any()


@settings(max_examples=40)
@given(
    shape=st.lists(st.integers(0, 5), min_size=1, max_size=3),
    orientations=st.integers(1, 12),
    n_colors=st.integers(0, 4),
    seed=st.integers(0, 10_000),
)
def test_cells_are_described_one_by_one(shape, orientations, n_colors, seed):
    rng = np.random.default_rng(seed)
    histograms = rng.random((*shape, orientations), np.float32)
    # Not contiguous.
    colors = rng.random((n_colors, *shape), np.float32).transpose(*range(1, len(shape) + 1), 0)
    around = rng.random(shape, np.float32)
    lengths = np.linalg.norm(histograms, axis=-1)
    np.testing.assert_allclose(cell_lengths(histograms), lengths, rtol=1e-5)
    features = describe_cells(histograms, around, colors)
    scaled = histograms / np.sqrt(lengths**2 + around**2 + 1e-6)[..., None]
    np.testing.assert_allclose(features, np.concatenate([scaled, colors], axis=-1), rtol=1e-4)
    assert features.dtype == np.float32


def test_colours_of_other_cells_are_refused():
    histograms = np.zeros((4, 9), np.float32)
    with pytest.raises(ValueError, match="colours"):
        describe_cells(histograms, np.float32(1), np.zeros((3, 3), np.float32))
