"""Train and judge a table of configurations, and show what their accuracy hides.

    python -m experiments.table run FOLDER --video V --truth T
    python -m experiments.table report
    python -m experiments.table grid FOLDER --id 19

`run` takes the configurations of a small CSV file one after the other, as many
at a time as there are cores or workers, and resumes where it was stopped.
"""

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
import csv
import hashlib
import io
import time
from itertools import islice
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from joblib import Parallel, delayed
from scipy.stats import spearmanr
from sklearn.metrics import roc_auc_score
from sklearn.model_selection import GroupKFold, train_test_split
from tqdm.auto import tqdm

from pipeline_functions import extract_features
from train import fit_linear, fit_searched
from vehicle import Vehicle
from vehicle_detection import command_line
from vehicle_detection.classifier import Classifier
from vehicle_detection.compiled.processes import workers
from vehicle_detection.evaluation.metrics import evaluate
from vehicle_detection.media.files import write_whole, written_whole
from vehicle_detection.media.mot import read_rows, rows_of
from vehicle_detection.media.training_images import (
    HELD_OUT,
    hold_out_ends,
    load_training_set,
    runs_of,
)
from vehicle_detection.media.videos import read_frames
from vehicle_detection.parameters import FeatureParams, SearchParams

RESULTS = Path(__file__).parent / "results"
SEEDS = (0, 1, 2)
# The bands of G's video as published; the preset begins at 380, see docs/reproduction.md.
_BANDS = ((1, 400, 550), (2, 400, 650), (3, 400, 720), (4, 400, 720))
# G's windows lie 16 pixels apart at scale 1, whatever the size of a cell.
_PIXELS_PER_STEP = 16
# --------------------------------------------------------- one configuration


def read_configurations(path):
    """Rows of a CSV file of configurations, as dicts of str."""
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def feature_params(configuration):
    """Features of a configuration; an empty colour leaves a group out."""
    numbers = (
        "orientations", "pix_per_cell", "cells_per_block", "spatial_size", "hist_bins",
    )  # fmt: skip
    colors = ("spatial_color", "hist_color", "hog_color")
    return FeatureParams(
        **{name: configuration[name] or None for name in colors},
        **{name: int(configuration[name]) for name in numbers},
    )


def run_configuration(configuration, dataset, video, truth, frames):
    """All figures of one configuration.

    Parameters
    ----------
    configuration : dict
    dataset : TrainingImages
    video, truth : Path or None
        Without them the figures of the detector stay empty.
    frames : int
        How many frames of the video are judged, from the first.

    Returns
    -------
    row : dict
        With the keys of the results file.
    """
    params, C = feature_params(configuration), float(configuration["C"])
    features = extract_features(dataset.images, params)
    indices = np.arange(len(features))
    accuracies, classifiers, seconds = [], [], []
    for seed in SEEDS:
        chosen, test = train_test_split(indices, test_size=HELD_OUT, random_state=seed)
        start = time.perf_counter()
        classifier = fitted(features[chosen], dataset.labels[chosen], params, C, seed)
        seconds.append(time.perf_counter() - start)
        predicted = classifier.decision_function(features[test]) > 0
        accuracies.append(np.mean(predicted == dataset.labels[test]))
        classifiers.append(classifier)

    held_out = hold_out_ends(dataset.sources)
    honest = fitted(features[~held_out], dataset.labels[~held_out], params, C, SEEDS[0])
    scores = honest.decision_function(features[held_out])
    row = {
        "id": configuration["id"],
        "settings": configuration_hash(configuration, dataset, video, frames),
        "features": params.n_features,
        "accuracy": f"{np.mean(accuracies):.4f}",
        "accuracy_spread": f"{np.ptp(accuracies):.4f}",
        "honest_accuracy": f"{np.mean((scores > 0) == dataset.labels[held_out]):.4f}",
        "honest_auc": f"{roc_auc_score(dataset.labels[held_out], scores):.5f}",
        "fit_seconds": f"{np.median(seconds):.1f}",
    }
    if video is not None:
        row |= judge_detector(classifiers[0], video, truth, frames)
    return row


def configuration_hash(configuration, dataset, video, frames):
    """Short text that changes with whatever the figures depend on."""
    numbers = *configuration.values(), SEEDS, len(dataset.labels), dataset.labels.sum()
    judged = (Path(video).name, frames) if video else ()
    return hashlib.sha1(repr((numbers, judged)).encode()).hexdigest()[:8]


def fitted(features, labels, params, C, seed):
    """Classifier fitted to features."""
    scaler, svm = fit_linear(features, labels, C, seed)
    counts = {"vehicles": int(labels.sum()), "non-vehicles": int((1 - labels).sum())}
    return Classifier(svm, scaler, params, counts)


def judge_detector(classifier, video, truth, frames):
    """Precision, recall and false positives on the first frames of a video, with G's filter."""
    cells_per_step = max(1, _PIXELS_PER_STEP // classifier.params.pix_per_cell)
    search = SearchParams(_BANDS, cells_per_step)
    vehicle = Vehicle(None, classifier, search)
    boxes = [vehicle.detect(frame).boxes for frame in islice(read_frames(video), frames)]
    figures = evaluate(read_rows(truth, is_truth=True), rows_of(boxes), range(1, frames + 1))
    return {
        "recall": f"{figures['recall']:.3f}",
        "precision": f"{figures['precision']:.3f}",
        "false_positives_per_frame": f"{figures['false positives per frame']:.3f}",
    }


# ------------------------------------------------------------------- the table


def read_results(path):
    """Finished rows of a results file, by id; none if there is no file yet.

    Raises
    ------
    ValueError
        The file is damaged.
    """
    if not Path(path).is_file():
        return {}
    try:
        rows = read_configurations(path)
        results = {row["id"]: row for row in rows}
    except (KeyError, csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: damaged: delete it and run again") from error
    if any(None in row or None in row.values() for row in rows):
        raise ValueError(f"{path}: damaged, rows of other lengths: delete it and run again")
    return results


def write_results(path, results):
    """Write rows, by id, in the order of the ids."""
    text = io.StringIO()
    columns = list(dict.fromkeys(name for row in results.values() for name in row))
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    for identity in sorted(results, key=lambda value: (len(value), value)):
        writer.writerow(results[identity])
    write_whole(path, text.getvalue())


def run_all(configurations, results_path, task, arguments, wanted_settings):
    """Run the configurations that have no result yet; every result is kept at once.

    Parameters
    ----------
    configurations : list of dict
    results_path : Path
    task : callable
        Takes a configuration and `arguments`, returns a row.
    arguments : tuple
    wanted_settings : callable
        Takes a configuration, returns the `settings` a finished row must have.
    """
    results = read_results(results_path)
    missing = [
        c for c in configurations
        if results.get(c["id"], {}).get("settings") != wanted_settings(c)
    ]  # fmt: skip
    rows = Parallel(return_as="generator_unordered", pre_dispatch="all", batch_size=1)(
        delayed(task)(configuration, *arguments) for configuration in missing
    )
    n_all = len(configurations)
    for row in tqdm(rows, "configurations", n_all, initial=n_all - len(missing)):
        results[row["id"]] = row
        write_results(results_path, results)
    return results


# ------------------------------------------------------------------ the report


def markdown(configurations, results):
    """The table of all configurations as Markdown."""
    lines = [
        "| ID | spatial / histogram / HOG | C | features | published | random split (spread) | "
        "difference | honest split | AUC | fit, s | recall | precision | false positives a frame |",
        "|" + "---|" * 13,
    ]
    for c in configurations:
        row = results.get(c["id"])
        if row is None:
            continue
        hog = f"{c['hog_color']},{c['orientations']},{c['pix_per_cell']},{c['cells_per_block']}"
        what = f"{c['spatial_color'] or '-'} / {c['hist_color'] or '-'} / {hog}"
        count = str(row["features"])
        if count != c["published_features"]:
            count += f" (published {c['published_features']}: cannot be)"
        difference = f"{float(row['accuracy']) - float(c['published_accuracy']):+.4f}"
        lines.append(
            f"| {c['id']} | {what} | {c['C']} | {count} | {c['published_accuracy']} | "
            f"{row['accuracy']} ({row['accuracy_spread']}) | {difference} | "
            f"{row['honest_accuracy']} | "
            f"{row['honest_auc']} | {row['fit_seconds']} | {row['recall']} | "
            f"{row['precision']} | {row['false_positives_per_frame']} |"
        )
    return "\n".join(lines) + "\n"


def draw_report(configurations, results):
    """Figure: published against reproduced, random against honest, honest against the video."""
    chosen = [c for c in configurations if c["id"] in results]
    rows = [results[c["id"]] for c in chosen]
    published = np.array([float(c["published_accuracy"]) for c in chosen])
    names = "accuracy", "honest_accuracy", "false_positives_per_frame"
    random, honest, alarms = (np.array([float(row[n] or "nan") for row in rows]) for n in names)
    pairs = (
        (published, random, "published accuracy", "reproduced accuracy"),
        (random, honest, "accuracy, random split", "accuracy, honest split"),
        (honest, alarms, "accuracy, honest split", "false positives a frame"),
    )
    figure, axes = plt.subplots(1, 3, figsize=(15, 5), layout="constrained")
    for axis, (x, y, x_name, y_name) in zip(axes, pairs, strict=True):
        axis.scatter(x, y, s=14)
        for c, place in zip(chosen, zip(x, y, strict=True), strict=True):
            if np.isfinite(place).all():
                axis.annotate(c["id"], place, (3, 3), textcoords="offset points", fontsize=8)
        axis.set(xlabel=x_name, ylabel=y_name)
    axes[0].axline((0.98, 0.98), slope=1, color="gray", lw=0.8)
    return figure


# ---------------------------------------------------------------- command line


def search_grid(configuration, dataset, jobs, count):
    """G's grid search on one configuration, runs of neighbours kept together.

    Parameters
    ----------
    configuration : dict
    dataset : TrainingImages
    jobs : int
    count : int
        Images to take, evenly spread: an SVM with a kernel takes the square
        of it in time.
    """
    chosen = np.linspace(0, len(dataset.labels) - 1, min(count, len(dataset.labels))).astype(int)
    params = feature_params(configuration)
    features = extract_features(dataset.images[chosen], params)
    folds = GroupKFold(5).split(features, groups=runs_of(dataset.sources)[chosen])
    fit_searched(features, dataset.labels[chosen], jobs, list(folds))


def parse_arguments(arguments=None):
    """Command line to a namespace; `--help` explains it."""
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog="example: %(prog)s run data",
    )
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="train and judge what has no result yet")
    grid = commands.add_parser("grid", help="grid search over kernel, C and gamma")
    report = commands.add_parser("report", help="write the table and the figure")
    for command in (run, grid, report):
        command.add_argument("--configurations", type=Path, default=RESULTS / "configurations.csv")
    for command in (run, report):
        command.add_argument("--results", type=Path, default=RESULTS / "experiments.csv")
    for command in (run, grid):
        command.add_argument("data", type=Path, help="folder with vehicles/ and non-vehicles/")
        command.add_argument("--jobs", type=int, default=-1, help="processes; -1: one a core")
    run.add_argument("--video", type=Path, help="to judge the detector on")
    run.add_argument("--truth", type=Path, help="true boxes of the video")
    run.add_argument("--frames", type=int, default=630, help="of the video, from the first")
    run.add_argument(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="of a Dask cluster whose workers "
        "run in a clone of this project and see video and truth at the same place",
    )
    grid.add_argument("--id", default="19", help="configuration to search on")
    grid.add_argument("--images", type=int, default=2000, help="images to take of the set")
    return parser.parse_args(arguments)


def main():
    """Run the command line."""
    arguments = parse_arguments()
    configurations = read_configurations(arguments.configurations)
    COMMANDS[arguments.command](arguments, configurations)


def _run(arguments, configurations):
    if (arguments.video is None) != (arguments.truth is None):
        raise ValueError("--video and --truth belong together")
    dataset = load_training_set(arguments.data)
    rest = dataset, arguments.video, arguments.truth, arguments.frames
    with workers(arguments.scheduler, arguments.jobs, [dataset]):
        run_all(
            configurations,
            arguments.results,
            run_configuration,
            rest,
            lambda c: configuration_hash(c, dataset, arguments.video, arguments.frames),
        )


def _grid(arguments, configurations):
    by_id = {c["id"]: c for c in configurations}
    if arguments.id not in by_id:
        raise ValueError(f"{arguments.configurations}: no configuration {arguments.id}")
    dataset = load_training_set(arguments.data)
    search_grid(by_id[arguments.id], dataset, arguments.jobs, arguments.images)


def _report(arguments, configurations):
    results = read_results(arguments.results)
    if not results:
        raise ValueError(f"{arguments.results}: no results yet: use run first")
    write_whole(arguments.results.with_suffix(".md"), markdown(configurations, results))
    with written_whole(arguments.results.with_suffix(".png")) as file:
        draw_report(configurations, results).savefig(file, dpi=90)
    judged = [row for row in results.values() if row["false_positives_per_frame"]]
    alarms = [float(row["false_positives_per_frame"]) for row in judged]
    for column in ("accuracy", "honest_accuracy", "honest_auc"):
        values = [float(row[column]) for row in judged]
        rank = spearmanr(values, alarms).statistic
        print(f"rank correlation of {column} with false positives a frame: {rank:.2f}")


COMMANDS = {"run": _run, "grid": _grid, "report": _report}


if __name__ == "__main__":
    command_line.run(main)
