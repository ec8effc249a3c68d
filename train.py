"""Train the classifier: two folders of images in, one parameter file out.

python train.py                      data/ if it is there, else the rendered sample
python train.py path/to/folder       with vehicles/ and non-vehicles/ in it
"""

from __future__ import annotations

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from joblib import parallel_config
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import accuracy_score, confusion_matrix
from sklearn.model_selection import GridSearchCV, train_test_split
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC, LinearSVC

from pipeline_functions import extract_features
from vehicle_detection import command_line
from vehicle_detection.classifier import Classifier, save_classifier
from vehicle_detection.compiled.processes import begin_worker
from vehicle_detection.evaluation.confusion import draw_confusion
from vehicle_detection.media.files import written_whole
from vehicle_detection.media.training_images import HELD_OUT, hold_out_ends, load_training_set
from vehicle_detection.parameters import FEATURE_PRESETS

if TYPE_CHECKING:
    from vehicle_detection.media.training_images import TrainingImages
    from vehicle_detection.parameters import FeatureParams

DATA, SAMPLE = Path("data"), Path("output/sample")
CLASSIFIERS = {kind.__name__: kind for kind in (LinearSVC, LogisticRegression, SVC)}


def parse_arguments(arguments: list | None = None) -> argparse.Namespace:
    """Command line to a namespace; `--help` explains it."""
    parser = argparse.ArgumentParser(
        description="Train scaler and SVM on images of vehicles and of everything else.",
        epilog="examples: train.py; train.py data --preset B --out output/svc_b.p",
    )
    parser.add_argument(
        "data", nargs="?", type=Path,
        help="folder with vehicles/ and non-vehicles/; default: data/ if it is there, else the "
        "rendered sample, made if it is missing",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, default=Path("output/svc_pickle.p"), help="default: %(default)s"
    )
    parser.add_argument(
        "--preset", choices=FEATURE_PRESETS, default="G", help="features of write-up G or B"
    )
    parser.add_argument(
        "--C", type=float, default=0.001, help="regularisation of the SVM, default: %(default)s"
    )
    parser.add_argument(
        "--classifier", choices=CLASSIFIERS, default="LinearSVC",
        help="what takes the scaled features, default: %(default)s; any other with a decision "
        "function can be used from Python, see the README",
    )  # fmt: skip
    parser.add_argument(
        "--search", action="store_true",
        help="pick kernel (linear, rbf), C (0.001, 0.01, 0.1) and gamma (0.1, 1) by "
        "cross-validation; takes hours on the full set",
    )  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, help="of the random split, default: 0")
    parser.add_argument("--jobs", type=int, default=-1, help="processes of --search")
    command_line.add_version(parser)
    return parser.parse_args(arguments)


def find_data(folder: Path | None = None) -> Path:
    """The folder of training images: the one given, `data/`, or the rendered sample.

    Raises
    ------
    FileNotFoundError
        The folder given has no vehicles/ in it.
    """
    if folder is not None:
        return folder
    if (DATA / "vehicles").is_dir():
        return DATA
    if not (SAMPLE / "vehicles").is_dir():
        # Imported here: only machines without a training set render one.
        from rendered_road.sample import write_training_images

        print(f"no {DATA}/: rendering a sample into {SAMPLE}, some two minutes")
        write_training_images(SAMPLE)
    return SAMPLE


def fit_linear(
    features: np.ndarray, labels: np.ndarray, C: float, seed: int, loss: str = "squared_hinge"
) -> tuple:
    """Scaler and linear SVM.

    Parameters
    ----------
    features : ndarray of float32, shape (n, n_features)
    labels : ndarray of int, shape (n,)
    C : float
    seed : int
    loss : {"squared_hinge", "hinge"}

    Returns
    -------
    scaler : StandardScaler
    svm : LinearSVC
    """
    scaler = StandardScaler()
    svm = LinearSVC(C=C, loss=loss, random_state=seed, dual=True)
    svm.fit(scaler.fit_transform(features), labels)
    return scaler, svm


def fit_searched(features: np.ndarray, labels: np.ndarray, jobs: int, folds: int = 5) -> tuple:
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
    with parallel_config("loky", initializer=begin_worker):
        search.fit(features, labels)
    print(f"best: {search.best_params_}, cross-validated accuracy {search.best_score_:.4f}")
    return search.best_estimator_["standardscaler"], search.best_estimator_["svc"]


def fit(features: np.ndarray, labels: np.ndarray, arguments: argparse.Namespace) -> tuple:
    """Scaler and classifier as the command line asks for them."""
    if arguments.search:
        return fit_searched(features, labels, arguments.jobs)
    if arguments.classifier == "LinearSVC":
        return fit_linear(features, labels, arguments.C, arguments.seed)
    scaler = StandardScaler()
    classifier = CLASSIFIERS[arguments.classifier](C=arguments.C, random_state=arguments.seed)
    return scaler, classifier.fit(scaler.fit_transform(features), labels)


def train(
    training_set: TrainingImages, params: FeatureParams, arguments: argparse.Namespace
) -> Classifier:
    """From images to a classifier and its file; prints and draws how good it is.

    Parameters
    ----------
    training_set : TrainingImages
    params : FeatureParams
    arguments : argparse.Namespace
        C, search, seed, jobs and out are used.

    Returns
    -------
    classifier : Classifier
        Of the random split.
    """
    labels = training_set.labels
    features = extract_features(training_set.images, params)
    counts = {"vehicles": int(labels.sum()), "non-vehicles": int((labels == 0).sum())}

    def fitted_without(tested):
        """Classifier of all images but some, which it then classifies."""
        scaler, svm = fit(features[~tested], labels[~tested], arguments)
        classifier = Classifier(svm, scaler, params, counts)
        scores = classifier.decision_function(features[tested])
        report(scores, labels[tested])
        return classifier, scores

    print(f"{features.shape[1]} features an image")
    print("Tested on whole ends of every folder, of which no near copy is learned from:")
    fitted_without(hold_out_ends(training_set.sources))
    _, test = train_test_split(
        np.arange(len(labels)), test_size=HELD_OUT, shuffle=True, random_state=arguments.seed
    )
    print("Tested on images at random, neighbours of which are learned from:")
    tested = np.isin(np.arange(len(labels)), test)
    classifier, scores = fitted_without(tested)
    # Before the picture, which must not cost what took hours.
    save_classifier(classifier, arguments.out)
    with written_whole(arguments.out.with_suffix(".png")) as file:
        draw_confusion(training_set.images[tested], labels[tested], scores).savefig(file, dpi=90)
    return classifier


def report(scores: np.ndarray, labels: np.ndarray) -> None:
    """Print accuracy and confusion matrix on the held-out images."""
    predicted = scores > 0
    print(f"  accuracy: {accuracy_score(labels, predicted):.4f} on {len(labels)} images")
    (true_negative, false_positive), (false_negative, true_positive) = confusion_matrix(
        labels, predicted, labels=[0, 1]
    )
    print(f"  vehicles:     {true_positive} found, {false_negative} missed")
    print(f"  non-vehicles: {true_negative} left alone, {false_positive} taken for vehicles")


def main() -> None:
    """Run the command line."""
    arguments = parse_arguments()
    start = time.perf_counter()
    folder = find_data(arguments.data)
    print(f"training set: {folder}")
    # A long fit must not end at a folder that cannot be written to.
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    params = FEATURE_PRESETS[arguments.preset]
    train(load_training_set(folder), params, arguments)
    picture = arguments.out.with_suffix(".png")
    print(f"wrote {arguments.out} and {picture} after {time.perf_counter() - start:.0f} s")
    kind = CLASSIFIERS[arguments.classifier]
    is_known = kind is not LogisticRegression
    trust = "" if is_known else f" --trust {kind.__module__}.{kind.__name__}"
    print(f"try it: python detect.py --method {arguments.preset} --param {arguments.out}{trust}")


if __name__ == "__main__":
    command_line.run(main)
