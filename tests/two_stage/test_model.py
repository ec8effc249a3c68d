"""Kernel machines, and the file of a detector."""

import tracemalloc
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.metrics.pairwise import rbf_kernel

from conftest import random_boxes, random_detector, textured_image
from vehicle_detection.tracking.boxes import move_edges
from vehicle_detection.two_stage.model import (
    FORMAT_VERSION,
    KernelMachine,
    load_detector,
    save_detector,
)
from vehicle_detection.two_stage.refinement import refine


def refined(img, boxes, detector):
    """Boxes and scores of `refine`."""
    candidates = refine(img, boxes, detector)
    return candidates.boxes, candidates.scores


@settings(max_examples=20)
@given(count=st.integers(0, 6), seed=st.integers(0, 1000))
def test_kernel_machine_is_a_sum_of_gaussians(count, seed):
    rng = np.random.default_rng(seed)
    arrays = [
        rng.normal(size=shape).astype(np.float32) for shape in ((7, 30), 7, (50, 7), (4, 50), 4)
    ]
    machine = KernelMachine(*arrays, gamma=0.05)
    features = rng.normal(size=(count, 30)).astype(np.float32)
    projection, offset, centers, weights, bias = arrays
    expected = np.empty((0, 4))
    if count:
        expected = bias + rbf_kernel(features @ projection.T + offset, centers, 0.05) @ weights.T
    np.testing.assert_allclose(machine.predict(features), expected, atol=1e-3)


def test_a_detector_is_read_as_it_was_written(tmp_path):
    detector = random_detector(1)
    save_detector(detector, tmp_path / "detector.npz")
    loaded = load_detector(tmp_path / "detector.npz")
    for old, new in zip(detector.templates, loaded.templates, strict=True):
        np.testing.assert_array_equal(old.weights, new.weights)
        np.testing.assert_allclose(old.shift_weights, new.shift_weights, atol=1e-5)
        np.testing.assert_array_equal(old.shift_bias, new.shift_bias)
        assert old.bias == pytest.approx(new.bias)
    img, boxes = textured_image(4, 240, 320), random_boxes(np.random.default_rng(0), 5)
    for old, new in zip(refined(img, boxes, detector), refined(img, boxes, loaded), strict=True):
        np.testing.assert_allclose(old, new, rtol=0.01, atol=0.02)


def test_what_is_no_detector_is_named(tmp_path):
    path = tmp_path / "detector.npz"
    with pytest.raises(FileNotFoundError, match=r"detector\.npz: no such parameter file"):
        load_detector(path)
    path.write_text("nothing of the kind")
    with pytest.raises(ValueError, match=r"detector\.npz: not a detector"):
        load_detector(path)
    save_detector(random_detector(1), path)
    whole = path.read_bytes()
    for damaged in (b"", whole[: len(whole) // 2], whole[:100]):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"detector\.npz: not a detector"):
            load_detector(path)
    good = random_detector(1)
    short = replace(good.machine, weights=good.machine.weights[1:])
    swapped = good.templates[::-1]
    for other in (replace(good, machine=short), replace(good, templates=swapped)):
        save_detector(other, path)
        with pytest.raises(ValueError, match="an array of"):
            load_detector(path)
    np.savez(path, format_version=0)
    with pytest.raises(ValueError, match=f"format 0, not {FORMAT_VERSION}"):
        load_detector(path)
    np.savez(path, format_version=FORMAT_VERSION)
    with pytest.raises(ValueError, match=r"detector\.npz: not a detector.*sha256"):
        load_detector(path)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("weights", np.nan, "not finite, or huge"),
        ("gamma", 0.0, "not above 0"),
        ("gamma", np.inf, "not finite"),
        ("bias", 1e30, "huge"),
        ("centers", -np.inf, "not finite"),
    ],
)
def test_impossible_numbers_are_refused(tmp_path, name, value, message):
    detector = random_detector(1)
    machine = detector.machine
    changed = value if name == "gamma" else np.full_like(getattr(machine, name), value)
    other = replace(detector, machine=replace(machine, **{name: changed}))
    save_detector(other, tmp_path / "detector.npz")
    with pytest.raises(ValueError, match=rf"detector\.npz: not a detector.*{message}"):
        load_detector(tmp_path / "detector.npz")


def repacked(path, **changes):
    """The archive with other arrays in it, and the checksum of those that were."""
    with np.load(path) as archive:
        arrays = dict(archive) | changes
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.zeros(1, np.float32), "checksum"),
        (np.array([{}], object), "not a detector"),
        (np.zeros(20_000_000, np.float32), "bytes when unpacked"),
    ],
)
def test_a_strange_array_is_refused(tmp_path, value, message):
    path = tmp_path / "detector.npz"
    save_detector(random_detector(1), path)
    with pytest.raises(ValueError, match=message):
        load_detector(repacked(path, machine_bias=value))


def test_a_bomb_is_not_unpacked(tmp_path):
    """Three gigabytes of zeros in three megabytes."""
    path = tmp_path / "detector.npz"
    save_detector(random_detector(1), path)
    with (
        zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive,
        archive.open("bomb.npy", "w", force_zip64=True) as file,
    ):
        for _ in range(3000):
            file.write(bytes(1_000_000))
    tracemalloc.start()
    with pytest.raises(ValueError, match="bytes when unpacked"):
        load_detector(path)
    assert tracemalloc.get_traced_memory()[1] < 50_000_000
    tracemalloc.stop()


def test_an_evil_machine_moves_no_edge_beyond_the_middle():
    """Whatever a file says, boxes stay boxes of about their size."""
    boxes = np.array([[10.0, 20, 50, 40]])
    for shifts in (np.full((1, 4), 1e30), np.array([[1e9, 1e9, -1e9, -1e9]])):
        left, top, right, bottom = move_edges(boxes, shifts)[0]
        assert 0 < right - left <= 80 and 0 < bottom - top <= 40
