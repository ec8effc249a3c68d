import argparse
import json
from dataclasses import asdict

import pytest

from experiments.leave_one_out import (
    compare,
    detector_path,
    results_path,
    setting,
    settings_of,
    training_params,
)
from experiments.table import write_results
from vehicle_detection.evaluation.stills import StillFigures
from vehicle_detection.parameters import QUICK_TRAINING


def figures(precision):
    """Figures of a folder, of which only the average precision counts."""
    counts = {name: 1 for name in StillFigures.__dataclass_fields__}
    return asdict(StillFigures(**counts | {"average_precision": precision}))


def write(path, precisions):
    """Results of one way, each folder a group of its own."""
    rows = {
        name: {"id": name, "settings": "s", "figures": json.dumps({name: figures(value)})}
        for name, value in precisions.items()
    }
    write_results(path, rows)


def test_compare_ranks_folders_and_settings(tmp_path):
    changes = [("machine_size", (200, 1000))]
    write(results_path(True, folder=tmp_path), {"a": 0.9, "b": 0.5, "c": 0.7, "d": 0.1})
    write(results_path(False, folder=tmp_path), {"a": 0.8, "b": 0.4, "c": 0.9})
    write(results_path(True, changes, tmp_path), {"a": 0.6, "b": 0.5, "c": 0.4})
    write(results_path(False, changes, tmp_path), {"a": 0.3, "b": 0.2, "c": 0.1})
    rows = [line.strip("| ").split(" | ") for line in compare(tmp_path).splitlines()]
    header, by_name = rows[0], {row[0]: row[1:] for row in rows}
    assert sorted(header[1:]) == sorted(
        ["quick", "full", "quick_machine_size=200,1000", "machine_size=200,1000"]
    )
    mean = dict(zip(header[1:], by_name["mean"], strict=True))
    assert mean["quick"] == "0.700" and mean["full"] == "0.700"
    assert mean["quick_machine_size=200,1000"] == "0.500"
    assert mean["machine_size=200,1000"] == "0.200"
    assert "d" not in by_name
    text = compare(tmp_path)
    assert "rank correlation of folders, quick and full: 0.50" in text
    assert "quick_machine_size=200,1000 and machine_size=200,1000: 1.00" in text


def test_compare_needs_both_ways(tmp_path):
    write(results_path(True, folder=tmp_path), {"a": 0.9})
    with pytest.raises(ValueError, match="--quick"):
        compare(tmp_path)


def test_other_settings_have_detectors_and_results_of_their_own(tmp_path):
    changes = [setting("machine_size=200,1000")]
    assert training_params(True, changes).machine_size == (200, 1000)
    assert training_params(True) == QUICK_TRAINING
    assert settings_of(True, changes) != settings_of(True) != settings_of(False)
    assert detector_path("a", True, tmp_path, changes) != detector_path("a", True, tmp_path)
    assert results_path(True, changes).name == "leave_one_out_quick_machine_size=200,1000.csv"


@pytest.mark.parametrize("text", ["machine=1", "machine_size", "machine_size=a b", "=3"])
def test_what_is_no_setting_is_refused(text):
    with pytest.raises(argparse.ArgumentTypeError):
        setting(text)
