"""The trained classifier: scaler and SVM as one object, and its file."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import sklearn
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from vehicle_detection.media import safe_pickle
from vehicle_detection.media.files import write_whole
from vehicle_detection.parameters import FeatureParams

FORMAT_VERSION = 1
_KERNELS = ("linear", "poly", "rbf", "sigmoid")


@dataclass(frozen=True)
class Classifier:
    """Scaler and SVM, with the features they were trained on.

    Attributes
    ----------
    svm : object
        LinearSVC, SVC, or any classifier of scikit-learn with a `decision_function`.
    scaler : sklearn.preprocessing.StandardScaler
    params : FeatureParams
    data_counts : dict of str to int
        How many images of each class it was trained on.
    """

    svm: Any
    scaler: StandardScaler
    params: FeatureParams
    data_counts: dict

    def decision_function(self, features: np.ndarray) -> np.ndarray:
        """Scores of feature vectors, positive for vehicles.

        Parameters
        ----------
        features : ndarray of float32, shape (n, n_features)
            Not yet scaled.

        Returns
        -------
        scores : ndarray of float, shape (n,)
        """
        if self.linear is not None:
            weights, bias = self.linear
            # Not `@`: for so small a product BLAS wakes threads that then spin,
            # and take from whatever runs beside the search.
            return np.einsum("ij,j->i", features, weights) + bias
        return self.svm.decision_function(self.scaler.transform(features))

    @cached_property
    def linear(self) -> tuple | None:
        """Scaler and linear SVM in one: w (x - mean) / scale + b = w' x + b'.

        Weights, ndarray of float32, shape (n_features,), and bias; None for
        other kernels.
        """
        if not hasattr(self.svm, "coef_"):
            return None
        weights = self.svm.coef_[0] / self.scaler.scale_
        bias = float(self.svm.intercept_[0] - weights @ self.scaler.mean_)
        return weights.astype(np.float32), bias


def save_classifier(classifier: Any, path: str | os.PathLike) -> None:
    """Write a classifier; the file appears under its name only when whole."""
    content = {
        "format_version": FORMAT_VERSION,
        "sklearn_version": sklearn.__version__,
        "n_features": classifier.params.n_features,
        "params": asdict(classifier.params),
        "data_counts": classifier.data_counts,
        "scaler": classifier.scaler,
        "svm": classifier.svm,
    }
    write_whole(path, safe_pickle.dumps(content))


def load_classifier(path: str | os.PathLike, trusted: Sequence = ()) -> Classifier:
    """Read and check a classifier that `save_classifier` wrote.

    Parameters
    ----------
    path : path
    trusted : sequence of str
        Classes to admit beside scikit-learn's scaler and SVMs, see `safe_pickle.loads`.

    Returns
    -------
    classifier : Classifier

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        It is no parameter file, or one of another format, of features of another length, or of
        numbers that are not finite; it is damaged, or names a class that is not admitted; its
        SVM is not linear and of another scikit-learn.

    Warns
    -----
    UserWarning
        It was made with another scikit-learn.
    """
    path = Path(path)
    again = "run train.py to make it anew"
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such parameter file: {again}")
    # What is no such file can fail in any way whatever.
    try:
        return _classifier_of(safe_pickle.loads(path.read_bytes(), trusted), path)
    except Exception as error:
        raise ValueError(f"{path}: not a parameter file of train.py: {error}: {again}") from error


def _classifier_of(content, path):
    """The classifier of the dict that a file holds, once it is checked."""
    version, made_with = content["format_version"], content["sklearn_version"]
    if type(version) is not int or version != FORMAT_VERSION:
        raise ValueError(f"format {version}, not {FORMAT_VERSION}")
    params = FeatureParams(**content["params"])
    if content["n_features"] != params.n_features:
        raise ValueError(f"feature lengths {content['n_features']} and {params.n_features}")
    scaler, svm = content["scaler"], content["svm"]
    _require_sound_scaler(scaler, params.n_features)
    safe_pickle.require_plain(svm)
    if isinstance(svm, SVC):
        _require_sound_svc(svm, params.n_features)
    if hasattr(svm, "coef_"):
        _require_array(svm.coef_, (1, params.n_features))
        _require_array(svm.intercept_, (1,))
    if made_with != sklearn.__version__:
        _accept_version(svm, made_with, path)
    svm.decision_function(np.zeros((1, params.n_features)))
    counts = {str(name): int(count) for name, count in content["data_counts"].items()}
    return Classifier(svm, scaler, params, counts)


def _accept_version(svm, made_with, path):
    """Of a linear SVM of another scikit-learn, the arrays are all that is needed."""
    if not hasattr(svm, "coef_"):
        raise ValueError(f"made with scikit-learn {made_with}, installed is {sklearn.__version__}")
    warnings.warn(
        f"{path}: made with scikit-learn {made_with}, installed is {sklearn.__version__}; "
        "the SVM is linear, so its weights serve",
        stacklevel=2,
    )


def _require_array(values, shape):
    """Raise ValueError unless these are finite numbers of this shape."""
    if not isinstance(values, np.ndarray) or values.dtype.kind != "f" or values.shape != shape:
        raise ValueError(f"no array of numbers of shape {shape}")
    if not np.isfinite(values).all():
        raise ValueError("numbers that are not finite")


def _require_sound_scaler(scaler, n_features):
    if type(scaler) is not StandardScaler:
        raise ValueError("no StandardScaler in it")
    safe_pickle.require_plain(scaler)
    if scaler.n_features_in_ != n_features:
        raise ValueError(f"feature lengths {scaler.n_features_in_} and {n_features} do not agree")
    _require_array(scaler.mean_, (n_features,))
    _require_array(scaler.scale_, (n_features,))
    if (scaler.scale_ <= 0).any():
        raise ValueError("scales that are not above 0")


def _require_sound_svc(svm, n_features):
    """Raise ValueError unless libsvm, which looks at no bounds, can use it."""
    n_vectors = len(svm.support_vectors_)
    if svm.kernel not in _KERNELS or svm._sparse or svm.probability not in (False, "deprecated"):
        raise ValueError(f"an SVC with kernel {svm.kernel} is not read")
    _require_array(svm.support_vectors_, (n_vectors, n_features))
    _require_array(svm._dual_coef_, (1, n_vectors))
    _require_array(svm._intercept_, (1,))
    _require_array(np.atleast_1d(np.asarray(svm._gamma, float)), (1,))
    if svm._n_support.shape != (2,) or svm._n_support.min() < 0:
        raise ValueError("support vectors of other than two classes")
    if len(svm.support_) != n_vectors or svm._n_support.sum() != n_vectors:
        raise ValueError("numbers of support vectors do not agree")
