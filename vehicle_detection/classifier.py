"""The trained classifier: scaler and SVM as one object, and its file."""

import pickle
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import sklearn
from sklearn.preprocessing import StandardScaler

from vehicle_detection.media.files import write_whole
from vehicle_detection.parameters import FeatureParams

FORMAT_VERSION = 1


@dataclass(frozen=True)
class Classifier:
    """Scaler and SVM, with the features they were trained on.

    Attributes
    ----------
    svm : sklearn.svm.LinearSVC or sklearn.svm.SVC
    scaler : sklearn.preprocessing.StandardScaler
    params : FeatureParams
    data_counts : dict of str to int
        How many images of each class it was trained on.
    """

    svm: object
    scaler: StandardScaler
    params: FeatureParams
    data_counts: dict

    def decision_function(self, features):
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
    def linear(self):
        """Scaler and linear SVM in one: w (x - mean) / scale + b = w' x + b'.

        Weights, ndarray of float32, shape (n_features,), and bias; None for
        other kernels.
        """
        if not hasattr(self.svm, "coef_"):
            return None
        weights = self.svm.coef_[0] / self.scaler.scale_
        bias = float(self.svm.intercept_[0] - weights @ self.scaler.mean_)
        return weights.astype(np.float32), bias


def save_classifier(classifier, path):
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


def load_classifier(path):
    """Read and check a classifier that `save_classifier` wrote.

    Unpickling runs code: load only files you trust.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        It is no parameter file, or one of another format, another
        scikit-learn, or of features of another length.
    """
    path = Path(path)
    again = "run train.py to make it anew"
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such parameter file: {again}")
    # Unpickling what is no such file can fail in any way whatever.
    try:
        content = pickle.loads(path.read_bytes())
        version, made_with = content["format_version"], content["sklearn_version"]
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
        fitted = (content["scaler"].n_features_in_, content["svm"].n_features_in_)
        lengths = {content["n_features"], params.n_features, *fitted}
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: not a parameter file of train.py: {again}") from error
    if len(lengths) > 1:
        raise ValueError(f"{path}: feature lengths {sorted(lengths)} do not agree: {again}")
    return Classifier(content["svm"], content["scaler"], params, content["data_counts"])
