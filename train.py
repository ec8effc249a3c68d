"""Train the classifier: two folders of images in, one parameter file out.

python train.py DATA/vehicles DATA/non-vehicles --out param/svc_pickle.p
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from sklearn.metrics import accuracy_score, confusion_matrix
from sklearn.model_selection import GridSearchCV, train_test_split
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC, LinearSVC

from pipeline_functions import FEATURE_PRESETS, extract_features
from vehicle_detection.classifier import Classifier, save_classifier
from vehicle_detection.media.images import find_images
from vehicle_detection.media.training_images import read_windows


def parse_arguments(arguments=None):
    """Command line to a namespace; `--help` explains it."""
    parser = argparse.ArgumentParser(
        description="Train scaler and SVM on images of vehicles and of everything else.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("vehicles", type=Path, help="folder of vehicle images, any depth")
    parser.add_argument("non_vehicles", type=Path, help="folder of other images, any depth")
    parser.add_argument(
        "--out", type=Path, default=Path("param/svc_pickle.p"), help="parameter file to write"
    )
    parser.add_argument(
        "--preset", choices=FEATURE_PRESETS, default="G", help="features of write-up G or B"
    )
    parser.add_argument("--C", type=float, default=0.001, help="regularisation of the SVM")
    parser.add_argument(
        "--search",
        action="store_true",
        help="pick kernel (linear, rbf), C (0.001, 0.01, 0.1) and gamma (0.1, 1) by "
        "cross-validation; takes hours on the full set",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the shuffled 80/20 split")
    parser.add_argument(
        "--jobs", type=int, default=-1, help="processes of --search; -1: one a core"
    )
    return parser.parse_args(arguments)


def fit_linear(features, labels, C, seed):
    """Scaler and linear SVM.

    Returns
    -------
    scaler : StandardScaler
    svm : LinearSVC
    """
    scaler = StandardScaler()
    svm = LinearSVC(C=C, random_state=seed, dual=True)
    svm.fit(scaler.fit_transform(features), labels)
    return scaler, svm


def fit_searched(features, labels, jobs, folds=5):
    """Scaler and the best SVM of G's grid; the scaler is fitted fold by fold.

    Parameters
    ----------
    features : ndarray of float32, shape (n, n_features)
    labels : ndarray of int, shape (n,)
    jobs : int
        Processes; -1 for one a core.
    folds : int, or list of (train indices, test indices)
        Of the cross-validation.

    Returns
    -------
    scaler : StandardScaler
    svm : SVC
    """
    values = {"svc__C": [0.001, 0.01, 0.1]}
    grid = [
        {"svc__kernel": ["linear"], **values},
        {"svc__kernel": ["rbf"], "svc__gamma": [0.1, 1], **values},
    ]
    search = GridSearchCV(
        make_pipeline(StandardScaler(), SVC()), grid, cv=folds, n_jobs=jobs, verbose=3
    )
    search.fit(features, labels)
    print(f"best: {search.best_params_}, cross-validated accuracy {search.best_score_:.4f}")
    return search.best_estimator_["standardscaler"], search.best_estimator_["svc"]


def train(vehicles, non_vehicles, params, arguments):
    """From lists of image files to a classifier; prints how good it is.

    Parameters
    ----------
    vehicles, non_vehicles : list of Path
    params : FeatureParams
    arguments : argparse.Namespace
        C, search, seed and jobs are used.

    Returns
    -------
    classifier : Classifier
    """
    start = time.perf_counter()
    features = extract_features(read_windows(vehicles + non_vehicles, params.window_size), params)
    labels = np.repeat([1, 0], [len(vehicles), len(non_vehicles)])
    print(f"features: {features.shape[1]} each, {time.perf_counter() - start:.1f} s")

    train_features, test_features, train_labels, test_labels = train_test_split(
        features, labels, test_size=0.2, shuffle=True, random_state=arguments.seed
    )
    start = time.perf_counter()
    if arguments.search:
        scaler, svm = fit_searched(train_features, train_labels, arguments.jobs)
    else:
        scaler, svm = fit_linear(train_features, train_labels, arguments.C, arguments.seed)
    print(f"fit: {len(train_labels)} images, {time.perf_counter() - start:.1f} s")

    counts = {"vehicles": len(vehicles), "non-vehicles": len(non_vehicles)}
    classifier = Classifier(svm, scaler, params, counts)
    report(classifier, test_features, test_labels)
    return classifier


def report(classifier, features, labels):
    """Print accuracy and confusion matrix on the held-out images."""
    start = time.perf_counter()
    predicted = classifier.decision_function(features) > 0
    microseconds = 1e6 * (time.perf_counter() - start) / len(labels)
    print(f"accuracy: {accuracy_score(labels, predicted):.4f} on {len(labels)} images")
    (true_negative, false_positive), (false_negative, true_positive) = confusion_matrix(
        labels, predicted, labels=[0, 1]
    )
    print(f"  vehicles:     {true_positive} found, {false_negative} missed")
    print(f"  non-vehicles: {true_negative} left alone, {false_positive} taken for vehicles")
    print(f"decision: {microseconds:.1f} us an image")


def main():
    """Run the command line."""
    arguments = parse_arguments()
    try:
        vehicles = find_images(arguments.vehicles)
        non_vehicles = find_images(arguments.non_vehicles)
        print(f"{len(vehicles)} vehicles, {len(non_vehicles)} non-vehicles")
        params = FEATURE_PRESETS[arguments.preset]
        # An hour's fit must not end at a folder that cannot be written to.
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        classifier = train(vehicles, non_vehicles, params, arguments)
        save_classifier(classifier, arguments.out)
    except (OSError, ValueError) as error:
        sys.exit(f"error: {error}")
    print(f"wrote {arguments.out}")


if __name__ == "__main__":
    main()
