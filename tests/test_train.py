"""Training on a small made-up set, and the parameter file."""

import os
import pickle
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression
from sklearn.preprocessing import StandardScaler
from sklearn.svm import LinearSVC

import train
from conftest import ROOT, random_classifier, textured_image
from pipeline_functions import extract_features
from vehicle_detection.classifier import load_classifier, save_classifier
from vehicle_detection.media import safe_pickle, training_images
from vehicle_detection.media.calibration import load_calibration
from vehicle_detection.media.images import read_image, write_image
from vehicle_detection.media.training_images import read_windows
from vehicle_detection.parameters import FEATURE_PRESETS, FeatureParams

# Files are packed by other means here, to put into them what no program would.
pytestmark = pytest.mark.filterwarnings("ignore:a parameter file without")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Two folders of images: bars on a dark ground, and noise."""
    folder = tmp_path_factory.mktemp("data")
    rng = np.random.default_rng(0)
    for i in range(60):
        bars = rng.integers(0, 60, size=(64, 64, 3)).astype(np.uint8)
        bars[20:28, 10:54] = bars[44:52, 10:54] = rng.integers(120, 255, 3)
        write_image(folder / "vehicles" / "a" / f"{i}.png", bars)
        write_image(folder / "non-vehicles" / f"{i}.png", textured_image(i, 64, 64))
    return folder


def run(*arguments):
    return subprocess.run(
        [sys.executable, "train.py", *map(str, arguments)], cwd=ROOT, capture_output=True, text=True
    )


def test_train_writes_what_it_reports(data, tmp_path):
    out = tmp_path / "param" / "svc.p"
    result = run(data, "--out", out)
    assert result.returncode == 0, result.stderr
    # On whole ends of the folders, and on images at random.
    assert result.stdout.count("accuracy: 1.0000 on 24 images") == 2
    assert result.stdout.splitlines()[-1] == f"try it: python detect.py --method G --param {out}"
    classifier = load_classifier(out)
    assert classifier.params == FEATURE_PRESETS["G"]
    assert classifier.data_counts == {"vehicles": 60, "non-vehicles": 60}
    assert classifier.scaler.n_samples_seen_ == 96
    again = tmp_path / "again.p"
    assert run(data, "--out", again).returncode == 0
    np.testing.assert_array_equal(load_classifier(again).svm.coef_, classifier.svm.coef_)


def test_scaler_never_sees_the_test_part(data):
    params = FeatureParams(hist_color="RGB", hist_bins=4)
    training_set = training_images.load_training_set(data)
    classifier = train.train(training_set, params, train.parse_arguments([str(data)]))
    everything = extract_features(training_set.images, params)
    assert classifier.scaler.n_samples_seen_ == 0.8 * len(everything)
    assert not np.allclose(classifier.scaler.mean_, everything.mean(axis=0))


def test_data_is_taken_where_it_is(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert train.find_data(tmp_path / "given") == tmp_path / "given"
    (tmp_path / "output/sample/vehicles").mkdir(parents=True)
    assert train.find_data() == train.SAMPLE
    (tmp_path / "data/vehicles").mkdir(parents=True)
    assert train.find_data() == train.DATA


def test_grid_search_picks_a_kernel(capsys):
    rng = np.random.default_rng(1)
    angle = rng.uniform(0, 2 * np.pi, 120)
    radius = np.where(np.arange(120) % 2, 1.0, 3.0)
    rings = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    scaler, svm = train.fit_searched(rings, np.arange(120) % 2, jobs=1)
    assert svm.kernel == "rbf"
    assert (svm.predict(scaler.transform(rings)) == np.arange(120) % 2).all()
    assert isinstance(scaler, StandardScaler)
    assert "best:" in capsys.readouterr().out


@pytest.fixture
def short_runs(monkeypatch):
    """Images are read in so many runs that all threads have some."""
    monkeypatch.setattr(training_images, "_IMAGES_PER_RUN", 7)


def test_windows_are_the_images_in_order(data, short_runs):
    paths = sorted(data.rglob("*.png"))
    images = read_windows(paths, 64)
    assert images.shape == (120, 64, 64, 3) and images.dtype == np.uint8
    for img, path in zip(images, paths, strict=True):
        np.testing.assert_array_equal(img, read_image(path))


def test_other_sizes_are_resized_and_said(data, tmp_path, capsys):
    write_image(tmp_path / "large.png", textured_image(0, 128, 128))
    paths = [*sorted((data / "vehicles").rglob("*.png")), tmp_path / "large.png"]
    assert read_windows(paths, 64).shape == (61, 64, 64, 3)
    said = capsys.readouterr().out
    assert "resized to 64x64: 1 images" in said and "large.png" in said


@pytest.mark.parametrize("place", [0, 30, 60])
def test_an_unreadable_image_is_named(data, tmp_path, short_runs, place):
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"not an image")
    paths = sorted((data / "vehicles").rglob("*.png"))
    paths.insert(place, broken)
    with pytest.raises(ValueError, match="broken.png"):
        read_windows(paths, 64)


@pytest.mark.parametrize("missing", ["vehicles", "non-vehicles"])
def test_a_class_without_images_is_named(data, tmp_path, missing):
    (tmp_path / missing).mkdir()
    (other,) = {"vehicles", "non-vehicles"} - {missing}
    (tmp_path / other).symlink_to(data / other)
    result = run(tmp_path, "--out", tmp_path / "svc.p")
    assert result.returncode == 1
    assert result.stderr.splitlines()[-1].startswith(f"error: {tmp_path / missing}: no images")
    assert not (tmp_path / "svc.p").exists()


def test_folded_weights_score_like_scaler_and_svm():
    classifier = random_classifier(FEATURE_PRESETS["G"])
    img = textured_image(5, 64, 64)
    features = extract_features(img[None], classifier.params)
    expected = classifier.svm.decision_function(classifier.scaler.transform(features))
    np.testing.assert_allclose(classifier.decision_function(features), expected, atol=1e-5)


# ----------------------------------------------------------- parameter files


def stored(path, **changes):
    """A parameter file with some of its entries changed."""
    save_classifier(random_classifier(FeatureParams(hist_color="RGB")), path)
    content = pickle.loads(path.read_bytes()) | changes
    path.write_bytes(pickle.dumps(content))
    return path


def test_saved_classifier_comes_back(tmp_path):
    classifier = random_classifier(FeatureParams(hist_color="RGB", hist_bins=7), kernel="rbf")
    save_classifier(classifier, tmp_path / "svc.p")
    loaded = load_classifier(tmp_path / "svc.p")
    assert loaded.params == classifier.params
    features = np.random.default_rng(0).random((3, 21), np.float32)
    np.testing.assert_array_equal(
        loaded.decision_function(features), classifier.decision_function(features)
    )


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"format_version": 99}, "format 99"),
        ({"format_version": np.zeros(3)}, "format"),
        ({"scaler": StandardScaler().fit(np.zeros((2, 3)))}, "feature lengths"),
        ({"svm": LinearSVC().fit(np.eye(2), [0, 1])}, "no array of numbers of shape"),
        ({"svm": "text"}, "not a parameter file"),
        ({"scaler": LinearSVC()}, "no StandardScaler"),
        ({"params": {"window_length": 64}}, "not a parameter file"),
    ],
)
def test_wrong_parameter_file_is_refused(tmp_path, changes, message):
    path = stored(tmp_path / "svc.p", **changes)
    with pytest.raises(ValueError, match=rf"svc\.p: .*{message}.*: run train\.py"):
        load_classifier(path)


def test_unreadable_parameter_file_is_refused(tmp_path):
    path = tmp_path / "svc.p"
    with pytest.raises(FileNotFoundError, match="no such parameter file"):
        load_classifier(path)
    for content in (b"", b"text", pickle.dumps([1, 2])):
        path.write_bytes(content)
        with pytest.raises(ValueError, match="not a parameter file"):
            load_classifier(path)


class Payload:
    """What a hostile file would run when it is read."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize(
    "payload",
    [
        Payload(os.system, "touch hacked"),
        Payload(eval, "open('hacked', 'w')"),
        Payload(subprocess.check_call, ["touch", "hacked"]),
        np.array([Payload(os.system, "touch hacked")], object),
        [{"nested": Payload(getattr, "text", "upper")}],
    ],
    ids=["system", "eval", "subprocess", "object array", "nested"],
)
def test_a_hostile_file_runs_nothing(tmp_path, monkeypatch, payload):
    monkeypatch.chdir(tmp_path)
    path = stored(tmp_path / "svc.p", svm=payload)
    with pytest.raises(ValueError, match="not admitted"):
        load_classifier(path)
    (tmp_path / "calib.p").write_bytes(pickle.dumps(payload))
    with pytest.raises(ValueError, match="not a calibration"):
        load_calibration(tmp_path / "calib.p")
    assert not (tmp_path / "hacked").exists()


def test_a_class_of_ones_own_is_admitted_by_name(tmp_path):
    logistic = random_classifier(FeatureParams(hist_color="RGB"))
    features = np.random.default_rng(0).normal(size=(40, 96))
    svm = LogisticRegression().fit(features, np.arange(40) % 2)
    path = tmp_path / "svc.p"
    save_classifier(replace(logistic, svm=svm), path)
    name = "sklearn.linear_model._logistic.LogisticRegression"
    with pytest.raises(ValueError, match=f"--trust {name}"):
        load_classifier(path)
    loaded = load_classifier(path, [name])
    np.testing.assert_allclose(loaded.svm.coef_, svm.coef_)


@pytest.mark.parametrize("damage", ["weights", "scale", "mean"])
def test_impossible_numbers_are_refused(tmp_path, damage):
    classifier = random_classifier(FeatureParams(hist_color="RGB"))
    if damage == "weights":
        classifier.svm.coef_[0, 3] = np.nan
    elif damage == "scale":
        classifier.scaler.scale_[5] = 0
    else:
        classifier.scaler.mean_[5] = np.inf
    save_classifier(classifier, tmp_path / "svc.p")
    with pytest.raises(ValueError, match="not finite|not above 0"):
        load_classifier(tmp_path / "svc.p")


def test_any_damage_is_noticed(tmp_path):
    """Of random damage, some used to change the boxes in silence."""
    path = tmp_path / "svc.p"
    save_classifier(random_classifier(FeatureParams(hist_color="RGB")), path)
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    for _ in range(60):
        content = bytearray(whole)
        content[rng.integers(len(content) - 40)] ^= 1 << rng.integers(8)
        path.write_bytes(content)
        with pytest.raises(ValueError, match="not a parameter file"):
            load_classifier(path)


def test_pickle_alone_reads_it_too(tmp_path):
    save_classifier(random_classifier(FeatureParams(hist_color="RGB")), tmp_path / "svc.p")
    assert "svm" in pickle.loads((tmp_path / "svc.p").read_bytes())


def test_a_linear_svm_of_another_scikit_learn_serves(tmp_path):
    path = stored(tmp_path / "svc.p", sklearn_version="0.1")
    with pytest.warns(UserWarning, match=r"made with scikit-learn 0\.1.*its weights serve"):
        load_classifier(path)
    rbf = random_classifier(FeatureParams(hist_color="RGB"), kernel="rbf")
    path = stored(path, sklearn_version="0.1", svm=rbf.svm)
    with pytest.raises(ValueError, match=r"made with scikit-learn 0\.1"):
        load_classifier(path)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("_n_support", np.array([10**6, 10**6], np.int32)),
        ("support_vectors_", np.zeros((3, 5))),
        ("_dual_coef_", np.zeros((1, 3))),
        ("support_", np.zeros(1, np.int32)),
        ("kernel", "precomputed"),
        ("_gamma", np.nan),
        ("decision_function", "text"),
    ],
)
def test_what_would_lead_libsvm_astray_is_refused(tmp_path, name, value):
    svm = random_classifier(FeatureParams(hist_color="RGB"), kernel="rbf").svm
    path = stored(tmp_path / "svc.p", svm=svm)
    load_classifier(path)
    vars(svm)[name] = value
    path = stored(tmp_path / "svc.p", svm=svm)
    with pytest.raises(ValueError, match="not a parameter file"):
        load_classifier(path)


def test_a_type_with_fields_is_refused(tmp_path):
    """Of such an array, an address in the file would be followed."""

    class Evil:
        def __reduce__(self):
            state = (3, "|", None, ("a",), {"a": (np.dtype("f8"), 0)}, 8, 1, 0)
            return np.dtype, ("V8", False, True), state

    path = stored(tmp_path / "svc.p", format_version=Evil())
    with pytest.raises(ValueError, match="arrays of .* are not admitted"):
        load_classifier(path)

    class Fields(Evil):
        def __reduce__(self):
            return np.dtype, ("f8", False, True), super().__reduce__()[2]

    with pytest.raises(ValueError, match="with fields is not admitted"):
        load_classifier(stored(path, format_version=Fields()))
    content = safe_pickle.loads(safe_pickle.dumps(np.arange(3, dtype=">i4")))
    np.testing.assert_array_equal(content, [0, 1, 2])


@pytest.mark.parametrize("kind", ["LinearSVC", "LogisticRegression", "SVC"])
def test_another_classifier_takes_the_svms_place(data, tmp_path, kind):
    out = tmp_path / "svc.p"
    result = run(data, "--out", out, "--classifier", kind, "--C", "0.1")
    assert result.returncode == 0, result.stderr
    trust = re.findall(r"--trust (\S+)", result.stdout)
    assert type(load_classifier(out, trust).svm).__name__ == kind
    assert out.with_suffix(".png").stat().st_size > 10_000
