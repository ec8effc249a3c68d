"""Ten thousand damaged files and odd command lines of each kind: `make fuzz`, some minutes.

Whatever they hold, they are read, or refused in one line that names the file.
"""

import contextlib
import hashlib
import io
import math
import os
import pickle
import warnings

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import detect
import train
from conftest import CASES, random_classifier, random_detector, textured_image
from vehicle_detection.classifier import load_classifier, save_classifier
from vehicle_detection.media import safe_pickle
from vehicle_detection.media.calibration import Calibration, load_calibration, save_calibration
from vehicle_detection.media.images import read_image
from vehicle_detection.media.mot import read_rows
from vehicle_detection.media.videos import VideoReader
from vehicle_detection.parameters import FeatureParams
from vehicle_detection.two_stage.model import load_detector, save_detector

N_CASES = int(os.environ.get("FUZZ_CASES", "10000"))
thorough = settings(
    max_examples=N_CASES, deadline=None, database=None, suppress_health_check=list(HealthCheck)
)
edits = st.lists(
    st.tuples(
        st.sampled_from(["flip", "cut", "insert", "zero"]), st.floats(0, 1), st.binary(max_size=8)
    ),
    min_size=1, max_size=6,
)  # fmt: skip


def damaged(content, changes):
    """Bytes with some of them flipped, cut, inserted, or set to zero."""
    content = bytearray(content)
    for kind, where, new in changes:
        place = int(where * len(content))
        if kind == "flip" and place < len(content):
            content[place] ^= new[0] if new else 1
        elif kind == "cut":
            del content[place : place + (new[0] if new else 1)]
        elif kind == "insert":
            content[place:place] = new
        elif kind == "zero":
            length = min(16, len(content) - place)
            content[place : place + length] = bytes(length)
    return bytes(content)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


def check(read, path, content):
    """What a reader makes of these bytes; None if it refuses them."""
    path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return read(path)
        except ValueError as error:
            assert path.name in str(error)
            return None


def sealed(content):
    """A damaged pickle with a checksum that agrees."""
    return content + safe_pickle._MARK + hashlib.sha256(content).digest()


@thorough
@given(changes=edits, kernel=st.sampled_from(["linear", "rbf"]), seal=st.booleans())
def test_classifiers(folder, changes, kernel, seal):
    good = folder / f"{kernel}.p"
    if not good.exists():
        save_classifier(random_classifier(FeatureParams(hist_color="RGB"), kernel=kernel), good)
    content = pickle.dumps(pickle.loads(good.read_bytes())) if seal else good.read_bytes()
    content = damaged(content, changes)
    classifier = check(load_classifier, folder / "svc.p", sealed(content) if seal else content)
    if classifier is not None:
        n_features = classifier.params.n_features
        with contextlib.suppress(FloatingPointError), np.errstate(all="ignore"):
            assert classifier.decision_function(np.ones((2, n_features), "f4")).shape == (2,)


@thorough
@given(changes=edits, seal=st.booleans())
def test_calibrations(folder, changes, seal):
    calibration = Calibration(np.diag([1000.0, 1000, 1]), np.zeros((1, 5)), (1280, 720))
    save_calibration(calibration, folder / "good.p")
    content = (folder / "good.p").read_bytes()
    content = (
        sealed(damaged(pickle.dumps(vars(calibration)), changes))
        if seal
        else damaged(content, changes)
    )
    loaded = check(load_calibration, folder / "calib.p", content)
    if loaded is not None:
        assert all(math.isfinite(value) for value in loaded.mtx.ravel())


@thorough
@given(changes=edits)
def test_detectors(folder, changes):
    good = folder / "good.npz"
    if not good.exists():
        save_detector(random_detector(0), good)
    check(load_detector, folder / "detector.npz", damaged(good.read_bytes(), changes))


@thorough
@given(
    content=st.binary(max_size=100)
    | st.text("0123456789,.-+e \n\r\t_xna", max_size=100).map(str.encode)
)
def test_box_files(folder, content):
    rows = check(lambda path: read_rows(path, is_truth=True), folder / "boxes.txt", content)
    if rows is not None:
        assert np.isfinite(rows.boxes).all() and (rows.frames >= 1).all()


@thorough
@given(changes=edits, suffix=st.sampled_from([".jpg", ".png", ".bmp", ".webp", ".tif"]))
def test_images(folder, changes, suffix):
    content = cv2.imencode(suffix, textured_image(0, 24, 32))[1].tobytes()
    img = check(read_image, folder / "image.jpg", damaged(content, changes))
    assert img is None or (img.dtype == np.uint8 and img.shape[2] == 3)


@settings(thorough, max_examples=max(1, N_CASES // 10))
@given(changes=edits, name=st.sampled_from(["av1.mp4", "gps_track.mp4"]))
def test_videos(folder, changes, name):
    def count(path):
        return sum(1 for _ in VideoReader(path))

    content = damaged((CASES / name).read_bytes(), changes)
    assert check(count, folder / "clip.mp4", content) != 0


WORDS = [
    "--out", "--method", "G", "two-stage", "--horizon", "0.5", "nan", "--preset", "--C", "--seed",
    "--jobs", "1e9", "-1", "", "--", "a.mp4", "--quiet", "--trust", "\udcff",
]  # fmt: skip


@thorough
@given(
    words=st.lists(st.sampled_from(WORDS) | st.text(max_size=5), max_size=6),
    parse=st.sampled_from([detect.parse_arguments, train.parse_arguments]),
)
def test_command_lines(words, parse):
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        try:
            parse(words)
        except SystemExit as end:
            assert end.code in (0, 2)
