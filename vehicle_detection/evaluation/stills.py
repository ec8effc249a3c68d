"""Average precision on folders of stills, each picture by itself.

    python -m vehicle_detection.evaluation.stills FOLDER... [--param DETECTOR]

A folder holds `images/` and `gt.txt`, MOTChallenge rows: frame n is the n-th picture in the
order of names.
"""

from __future__ import annotations

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vehicle_detection import command_line
from vehicle_detection.media.images import find_images, read_image
from vehicle_detection.media.mot import read_rows, require_within
from vehicle_detection.parameters import STILL_PARAMS
from vehicle_detection.tracking.boxes import box_areas, pairwise_iou, pairwise_overlap
from vehicle_detection.two_stage.vehicle import SHIPPED_DETECTOR, TwoStageVehicle

# Score from which a box of a still is a vehicle.
STILL_THRESHOLD = STILL_PARAMS.tracks.confirm_at + STILL_PARAMS.tracks.score_offset


@dataclass(frozen=True)
class StillFigures:
    """How well the vehicles of some stills were found.

    Attributes
    ----------
    average_precision : float
        Area under the precision envelope over recall, all scores [1]_.
    recall, precision : float
        Of the boxes that score at least the threshold.
    false_positives : float
        Of these, a picture.
    mean_iou : float
        Of the found vehicles, 0 if there is none.
    n_required : int

    References
    ----------
    .. [1] M. Everingham et al., "The PASCAL Visual Object Classes Challenge", IJCV 2015.
    """

    average_precision: float
    recall: float
    precision: float
    false_positives: float
    mean_iou: float
    n_required: int


def match_by_score(
    required: np.ndarray,
    ignored: np.ndarray,
    boxes: np.ndarray,
    scores: np.ndarray,
    iou_threshold: float = 0.5,
) -> np.ndarray:
    """Which boxes of one picture are right, best first; those in ignore regions do not count.

    Parameters
    ----------
    required, ignored, boxes : ndarray of float, shapes (n, 4), (m, 4), (k, 4)
    scores : ndarray of float, shape (k,)
    iou_threshold : float
        A box takes the free required one that it overlaps most, by at least this IoU. One
        that takes none and lies by half in an ignored box is left out.

    Returns
    -------
    counted : ndarray of float, shape (j, 3)
        Score, 1 for right or 0 for wrong, and IoU.
    """
    free = np.ones(len(required), bool)
    iou = pairwise_iou(boxes, required)
    covered = pairwise_overlap(boxes, ignored) / np.maximum(box_areas(boxes), 1e-9)[:, None]
    counted = []
    for i in np.argsort(-scores, kind="stable"):
        overlap = np.where(free, iou[i], 0)
        if overlap.max(initial=0) >= iou_threshold:
            free[overlap.argmax()] = False
            counted.append((scores[i], 1, overlap.max()))
        elif covered[i].max(initial=0) < 0.5:
            counted.append((scores[i], 0, 0))
    return np.array(counted, float).reshape(-1, 3)


def figures_of(
    counted: np.ndarray, n_required: int, n_pictures: int, threshold: float
) -> StillFigures:
    """Figures of the boxes of all pictures.

    Parameters
    ----------
    counted : ndarray of float, shape (n, 3)
        Rows of `match_by_score`.
    n_required, n_pictures : int
    threshold : float
        On the score, for all figures but the average precision.

    Returns
    -------
    figures : StillFigures
    """
    score, right, iou = counted[np.argsort(-counted[:, 0], kind="stable")].T
    n_right = right.cumsum()
    recall = n_right / max(1, n_required)
    precision = n_right / np.arange(1, len(right) + 1)
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    used = score >= threshold
    hits = used & (right > 0)
    return StillFigures(
        average_precision=float(np.sum(np.diff(recall, prepend=0) * envelope)),
        recall=float(hits.sum() / max(1, n_required)),
        precision=float(hits.sum() / max(1, used.sum())),
        false_positives=float((used & (right == 0)).sum() / max(1, n_pictures)),
        mean_iou=float(iou[hits].mean()) if hits.any() else 0.0,
        n_required=n_required,
    )


def score_folder(
    folder: Path, vehicle: TwoStageVehicle, threshold: float = STILL_THRESHOLD
) -> StillFigures:
    """Figures of a detector on a folder of stills.

    Parameters
    ----------
    folder : Path
        With `images/` and `gt.txt`.
    vehicle : TwoStageVehicle
        Is reset before each picture.
    threshold : float
        See `figures_of`.

    Returns
    -------
    figures : StillFigures
    """
    truth = read_rows(folder / "gt.txt", is_truth=True)
    paths, counted = find_images(folder / "images"), []
    required = truth.scores == 1
    for number, path in enumerate(paths, start=1):
        vehicle.reset()
        img = read_image(path)
        require_within(truth.within(range(number, number + 1)), img.shape, folder / "gt.txt")
        found = vehicle.detect(img)
        own = truth.frames == number
        boxes = truth.boxes[own & required], truth.boxes[own & ~required]
        counted.append(match_by_score(*boxes, found.candidates, found.candidate_scores))
    return figures_of(np.concatenate(counted), int(required.sum()), len(paths), threshold)


def table(figures: dict) -> str:
    """Figures by folder as a Markdown table with their mean.

    Parameters
    ----------
    figures : dict of str to StillFigures
    """
    columns = ("average_precision", "recall", "precision", "false_positives", "mean_iou")
    lines = [
        "| folder | required | AP | recall | precision | false a picture | mean IoU |",
        "|---|---|---|---|---|---|---|",
    ]
    rows = {name: [getattr(one, column) for column in columns] for name, one in figures.items()}
    for name, values in rows.items():
        lines.append(f"| {name} | {figures[name].n_required} | {_numbers(values)} |")
    lines.append(f"| mean | | {_numbers(np.mean(list(rows.values()), axis=0))} |")
    return "\n".join(lines)


def _numbers(values):
    return " | ".join(f"{value:.3f}" for value in values)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m vehicle_detection.evaluation.stills",
        description="Average precision of the two-stage detector on folders of stills.",
        epilog="example: %(prog)s footage/camvid footage/dusk_clip",
    )
    parser.add_argument(
        "folders", nargs="+", type=Path, metavar="FOLDER", help="with images/ and gt.txt"
    )
    parser.add_argument("--param", type=Path, default=SHIPPED_DETECTOR, help="default: shipped")
    arguments = parser.parse_args()
    vehicle = TwoStageVehicle(None, arguments.param, STILL_PARAMS)
    print(table({folder.name: score_folder(folder, vehicle) for folder in arguments.folders}))


if __name__ == "__main__":
    command_line.run(main)
