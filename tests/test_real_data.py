"""What is promised of the real data; skipped where it is missing."""

import re
import zipfile
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT
from experiments import reference
from pipeline_functions import find_cars
from train import parse_arguments, train
from vehicle_detection.classifier import load_classifier
from vehicle_detection.media.calibration import calibrate
from vehicle_detection.media.images import find_images
from vehicle_detection.media.training_images import load_training_set
from vehicle_detection.media.videos import read_frames
from vehicle_detection.parameters import FEATURE_PRESETS, SEARCH_PRESETS


@pytest.fixture
def frame(real_data):
    """First frame of the real test video."""
    return next(read_frames(real_data / "udacity/test_video.mp4"))


def test_search_of_preset_g_scores_like_the_published_way(frame):
    classifier = load_classifier(ROOT / "param/svc_pickle.p")
    windows, scores = find_cars(frame, classifier, SEARCH_PRESETS["G"])
    assert len(windows) == 790
    expected_windows, expected = reference.find_cars(frame, classifier, SEARCH_PRESETS["G"])
    np.testing.assert_array_equal(windows, expected_windows)
    np.testing.assert_allclose(scores, expected, atol=1e-4)
    np.testing.assert_array_equal(scores > 0, expected > 0)
    # The black and the white car of this frame.
    hot = windows[scores > 0]
    for x, y in ((875, 455), (1090, 450)):
        inside = (hot[:, 0] < x) & (x < hot[:, 2]) & (hot[:, 1] < y) & (y < hot[:, 3])
        assert inside.any()


def test_calibration_agrees_with_the_published_one(real_data):
    fit = calibrate(find_images(real_data / "udacity/camera_cal"))
    calibration, error, skipped = fit.calibration, fit.error, fit.skipped
    assert abs(calibration.mtx[0, 0] / 1154.0 - 1) < 0.01
    assert abs(calibration.mtx[1, 1] / 1148.0 - 1) < 0.01
    assert error < 1
    assert "calibration1.jpg" in {path.name for path in skipped}


def test_part_of_the_real_set_trains_well(real_data, tmp_path, capsys):
    # Every sixth image keeps this test short; the accuracy of all is in the README.
    for name in ("vehicles", "non-vehicles"):
        with zipfile.ZipFile(real_data / f"udacity/{name}.zip") as archive:
            images = sorted(n for n in archive.namelist() if Path(n).suffix == ".png")
            archive.extractall(tmp_path, images[::6])
    training_set = load_training_set(tmp_path)
    classifier = train(training_set, FEATURE_PRESETS["G"], parse_arguments([str(tmp_path)]))
    assert classifier.data_counts == {"vehicles": 1466, "non-vehicles": 1495}
    at_ends, at_random = re.findall(r"accuracy: (\d\.\d+) on \d+ images", capsys.readouterr().out)
    assert float(at_random) > 0.96 and float(at_ends) > 0.93
