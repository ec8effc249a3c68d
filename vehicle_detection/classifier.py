"""The trained classifier: scaler and SVM as one object, and its file."""

from __future__ import annotations

import os
import pickle
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import sklearn
from sklearn.preprocessing import StandardScaler

from vehicle_detection.media import safe_pickle
from vehicle_detection.media.files import write_whole
from vehicle_detection.parameters import FeatureParams

FORMAT_VERSION = 1


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
    write_whole(path, pickle.dumps(content))


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
        It is no parameter file, or one of another format, another scikit-learn, of features
        of another length, or of numbers that are not finite; or it names a class that is not
        admitted.
    """
    path = Path(path)
    again = "run train.py to make it anew"
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such parameter file: {again}")
    # What is no such file can fail in any way whatever.
    try:
        content = safe_pickle.loads(path.read_bytes(), trusted)
        version, made_with = content["format_version"], content["sklearn_version"]
    except pickle.UnpicklingError as error:
        raise ValueError(f"{path}: not a parameter file of train.py: {error}: {again}") from error
    except Exception as error:
        raise ValueError(f"{path}: not a parameter file of train.py: {again}") from error
    if version != FORMAT_VERSION:
        raise ValueError(f"{path}: format {version}, not {FORMAT_VERSION}: {again}")
    if made_with != sklearn.__version__:
        raise ValueError(
            f"{path}: made with scikit-learn {made_with}, "
            f"installed is {sklearn.__version__}: {again}"
        )
    try:
        params = FeatureParams(**content["params"])
        classifier = Classifier(content["svm"], content["scaler"], params, content["data_counts"])
        _require_sound(classifier, content["n_features"])
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"{path}: not a parameter file of train.py: {again}") from error
    except ValueError as error:
        raise ValueError(f"{path}: not a parameter file of train.py: {error}: {again}") from error
    return classifier


def _require_sound(classifier, n_features):
    """Raise ValueError unless lengths agree and numbers are finite, scales above 0."""
    scaler, svm = classifier.scaler, classifier.svm
    lengths = {n_features, classifier.params.n_features, scaler.n_features_in_, svm.n_features_in_}
    if len(lengths) > 1:
        raise ValueError(f"feature lengths {sorted(lengths)} do not agree")
    numbers = [scaler.mean_, scaler.scale_, svm.intercept_]
    numbers.append(svm.coef_ if hasattr(svm, "coef_") else svm.support_vectors_)
    if not all(np.isfinite(values).all() for values in numbers) or (scaler.scale_ <= 0).any():
        raise ValueError("numbers that are not finite, or scales that are not above 0")
