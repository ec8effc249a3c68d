"""Hold detections against the truth.

python -m vehicle_detection.evaluation TRUTH DETECTIONS [--frames A:B[:STEP]] [--json]
"""

from __future__ import annotations

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
import json
from pathlib import Path

from vehicle_detection import command_line
from vehicle_detection.evaluation.metrics import evaluate
from vehicle_detection.evaluation.plots import draw_evaluation, table
from vehicle_detection.media.files import written_whole
from vehicle_detection.media.formats import frame_size, read_boxes
from vehicle_detection.media.mot import all_frames, frame_range, require_sizes


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m vehicle_detection.evaluation",
        description="Hold detections against the truth.",
        epilog="example: %(prog)s truth.txt boxes.txt --frames 631:1260",
    )
    parser.add_argument(
        "truth", type=Path, help="MOTChallenge rows, conf 0 to ignore; COCO (.json); YOLO (.zip)"
    )
    parser.add_argument("detections", type=Path, help="boxes of detect.py")
    parser.add_argument("--size", type=frame_size, metavar="WxH", help="of frames, for YOLO")
    parser.add_argument("--frames", metavar="A:B[:STEP]", help="both included")
    parser.add_argument("--iou", type=float, default=0.5, help="of a match, default: 0.5")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument("--picture", type=Path, help="png to write curve and timeline to")
    arguments = parser.parse_args()
    if not 0 < arguments.iou <= 1:
        raise ValueError(f"--iou lies between 0 and 1, not at {arguments.iou}")
    truth = read_boxes(arguments.truth, arguments.size, is_truth=True)
    detections = read_boxes(arguments.detections, arguments.size)
    require_sizes(truth, arguments.truth)
    asked_for = arguments.frames
    frames = frame_range(asked_for) if asked_for else all_frames(truth, detections)
    figures = evaluate(truth, detections, frames, arguments.iou)
    print(json.dumps(figures, indent=1, allow_nan=False) if arguments.json else table(figures))
    if arguments.picture:
        figure = draw_evaluation(truth, detections, frames, arguments.iou)
        with written_whole(arguments.picture) as file:
            figure.savefig(file, dpi=90)


if __name__ == "__main__":
    command_line.run(main)
