"""What several tests share: random images, a small classifier, the real data."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import settings
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC, LinearSVC

from vehicle_detection.classifier import Classifier, save_classifier
from vehicle_detection.media.encoder import video_writer
from vehicle_detection.media.videos import VideoInfo
from vehicle_detection.parameters import FEATURE_PRESETS, FeatureParams
from vehicle_detection.two_stage.features import CELL_FEATURES, N_FEATURES
from vehicle_detection.two_stage.model import N_OUTPUTS, Detector, KernelMachine, Template
from vehicle_detection.two_stage.proposals import WINDOW_COLUMNS, WINDOW_CONTEXT, WINDOW_ROWS

ROOT = Path(__file__).parent.parent
SHARED = ROOT.parent / "shared"
# Small files that once broke something, made from rendered scenes.
CASES = ROOT / "tests/cases"

# No limits of time: the first call of compiled code compiles it, and machines are busy.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.fixture
def real_data():
    """Folder of the real data; skips where there is none."""
    if not (SHARED / "udacity").is_dir():
        pytest.skip("no real data: ../shared is missing")
    return SHARED


def textured_image(seed, rows, columns):
    """An RGB image with smooth areas, edges in all directions, and flat spots."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 256, size=(rows // 8 + 2, columns // 8 + 2, 3)).astype(np.uint8)
    img = cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC)
    img = np.where(rng.random((rows, columns, 1)) < 0.3, rng.integers(0, 256, 3), img)
    img[: rows // 3, : columns // 4] = rng.integers(0, 256)
    return img.astype(np.uint8)


def random_classifier(params, seed=0, kernel="linear"):
    """A classifier fitted to noise: any weights do to compare two ways of scoring."""
    rng = np.random.default_rng(seed)
    features = rng.normal(5, 3, size=(40, params.n_features)).astype(np.float32)
    labels = np.arange(40) % 2
    scaler = StandardScaler().fit(features)
    svm = LinearSVC(C=0.01) if kernel == "linear" else SVC(kernel=kernel)
    svm.fit(scaler.transform(features), labels)
    return Classifier(svm, scaler, params, {"vehicles": 20, "non-vehicles": 20})


@pytest.fixture(scope="session")
def classifier_g():
    """A classifier of preset G with random weights."""
    return random_classifier(FEATURE_PRESETS["G"])


def random_detector(seed):
    """A two-stage detector with random weights, whose scores lie on both sides of zero."""
    rng = np.random.default_rng(seed)

    def normal(scale, *shape):
        return rng.normal(0, scale, shape).astype(np.float32)

    around = 2 * WINDOW_CONTEXT
    templates = tuple(
        Template(
            weights=normal(0.05, WINDOW_ROWS, columns, CELL_FEATURES),
            bias=0.0,
            shift_weights=normal(0.002, WINDOW_ROWS + around, columns + around, CELL_FEATURES, 4),
            shift_bias=normal(0.01, 4),
        )
        for columns in WINDOW_COLUMNS
    )
    weights = normal(1.0, N_OUTPUTS, 30)
    # The first is a score, the others are shares of a box.
    weights[1:] *= 0.02
    machine = KernelMachine(
        projection=normal(0.05, 20, N_FEATURES),
        offset=normal(0.1, 20),
        centers=normal(0.5, 30, 20),
        # What all patches have in common adds nothing.
        weights=weights - weights.mean(axis=1, keepdims=True),
        bias=normal(0.01, N_OUTPUTS),
        gamma=0.1,
    )
    return Detector(templates, machine)


def moving_frames(count, rows=180, columns=320):
    """Noise with a bright patch that wanders to the right."""
    ground = textured_image(0, rows, columns) // 2
    for i in range(count):
        frame = ground.copy()
        frame[110:150, 40 + 6 * i : 100 + 6 * i] = (250, 240, 60)
        yield frame


def write_video(path, frames, fps=25):
    frames = list(frames)
    rows, columns = frames[0].shape[:2]
    with video_writer(path, VideoInfo(columns, rows, fps, len(frames))) as write:
        for frame in frames:
            write(frame)
    return path


@pytest.fixture
def param(tmp_path):
    """Parameter file of a classifier with random weights; about half of all windows are hot."""
    path = tmp_path / "svc.p"
    save_classifier(random_classifier(FeatureParams(spatial_color="HLS", hist_color="RGB")), path)
    return path


def random_boxes(rng, count, extent=200):
    """Boxes of 5 to 90 pixels a side, within about `extent` pixels."""
    corner = rng.uniform(0, extent, size=(count, 2))
    return np.hstack([corner, corner + rng.uniform(5, 90, size=(count, 2))])


def lengths_and_units(cells):
    """Lengths of histograms, and the histograms at unit length."""
    lengths = np.linalg.norm(cells, axis=-1)
    return lengths, cells / np.maximum(lengths, 1e-9)[..., None]
