"""The experiment table: splits, resuming, and the same figures on a cluster."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT, textured_image
from experiments import table
from experiments.table import (
    feature_params,
    markdown,
    read_configurations,
    read_results,
    run_all,
    run_configuration,
    workers,
)
from vehicle_detection.media.images import write_image
from vehicle_detection.media.training_images import (
    TrainingImages,
    hold_out_ends,
    load_training_set,
    runs_of,
)

CONFIGURATIONS = read_configurations(ROOT / "experiments/results/configurations.csv")


def small_dataset():
    rng = np.random.default_rng(0)
    images = []
    for i in range(60):
        img = textured_image(i, 64, 64)
        if i < 30:
            img[20:30, 8:56] = img[44:50, 8:56] = rng.integers(150, 255, 3)
        images.append(img)
    labels = np.repeat([1, 0], 30)
    return TrainingImages(np.array(images), labels, np.repeat([0, 1, 2], 20))


def figures_of(row):
    """A row without the time it took."""
    return {name: value for name, value in row.items() if name != "fit_seconds"}


def test_published_feature_counts():
    wrong = {
        c["id"] for c in CONFIGURATIONS
        if feature_params(c).n_features != int(c["published_features"])
    }  # fmt: skip
    # These counts cannot follow from the stated parameters; all others do.
    assert wrong == {"5", "16", "17"}
    assert [c["id"] for c in CONFIGURATIONS] == [str(i) for i in range(1, 24)]


def test_the_ends_split_holds_out_whole_ends():
    held_out = hold_out_ends(np.repeat([0, 1], [10, 20]))
    expected = np.zeros(30, bool)
    expected[8:10] = expected[26:30] = True
    np.testing.assert_array_equal(held_out, expected)


def test_runs_are_neighbours_of_one_source():
    sources = np.repeat([0, 1, 0], [150, 50, 60])
    numbers = runs_of(sources)
    for number in np.unique(numbers):
        members = np.flatnonzero(numbers == number)
        assert len(set(sources[members])) == 1 and len(members) <= 100
    first = np.flatnonzero(sources == 0)
    assert len(set(numbers[first[:100]])) == 1 and numbers[first[99]] != numbers[first[100]]


def test_dataset_is_in_the_order_of_the_numbers(tmp_path):
    for name in ("vehicles/a", "vehicles/b", "non-vehicles"):
        for number in (10, 9, 1):
            img = np.full((64, 64, 3), number, np.uint8)
            write_image(tmp_path / name / f"image{number}.png", img)
    dataset = load_training_set(str(tmp_path))
    assert dataset.images[:, 0, 0, 0].tolist() == [1, 9, 10] * 3
    assert dataset.labels.tolist() == [1] * 6 + [0] * 3
    assert len(set(dataset.sources[:3])) == 1 and len(set(dataset.sources)) == 3


def test_resumes_where_it_stopped(tmp_path):
    path = tmp_path / "results.csv"
    calls = []

    def task(configuration, factor):
        calls.append(configuration["id"])
        if configuration["id"] == "3" and len(calls) == 3:
            raise KeyboardInterrupt
        identity = configuration["id"]
        return {"id": identity, "features": int(identity) * factor, "settings": "a"}

    with pytest.raises(KeyboardInterrupt):
        run_all(CONFIGURATIONS[:4], path, task, (10,), lambda c: "a")
    assert set(read_results(path)) == {"1", "2"}
    results = run_all(CONFIGURATIONS[:4], path, task, (10,), lambda c: "a")
    assert calls == ["1", "2", "3", "3", "4"]
    assert read_results(path).keys() == results.keys() == {"1", "2", "3", "4"}
    assert read_results(path)["4"]["features"] == "40"
    # What was finished with other settings is not finished.
    run_all(CONFIGURATIONS[:1], path, task, (20,), lambda c: "b")
    assert calls[5:] == ["1"] and read_results(path)["1"]["features"] == "20"


def test_row_of_a_configuration(tmp_path):
    dataset = small_dataset()
    row = run_configuration(CONFIGURATIONS[9], dataset, None, None, 0)
    assert row["id"] == "10" and row["features"] == 768
    assert float(row["accuracy"]) > 0.6 and 0 <= float(row["honest_accuracy"]) <= 1
    rest = dict.fromkeys(("recall", "precision", "false_positives_per_frame"), "0.5")
    text = markdown(CONFIGURATIONS, {"10": row | rest, "5": row | rest | {"id": "5"}})
    lines = text.splitlines()
    assert len(lines) == 4 and len({line.count("|") for line in lines}) == 1
    assert "768 (published 5264: cannot be)" in lines[2]


# A cluster of two worker processes on this machine.


def wanted(configuration):
    """Settings of no row: all are run."""
    return f"never run: {configuration['id']}"


def slow_configuration(configuration, dataset, folder):
    """`run_configuration`, long enough to be killed in the middle; leaves a note of its process."""
    Path(folder, f"{configuration['id']}-{os.getpid()}").touch()
    time.sleep(2)
    return run_configuration(configuration, dataset, None, None, 0)


@pytest.fixture
def cluster():
    distributed = pytest.importorskip("distributed", reason="dask.distributed is optional")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        yield cluster


def test_cluster_gives_the_same_table(cluster, tmp_path):
    dataset = small_dataset()
    chosen = [CONFIGURATIONS[i] for i in (6, 9, 18)]
    rest = dataset, None, None, 0
    with workers(None, 1, []):
        here = run_all(chosen, tmp_path / "here.csv", run_configuration, rest, wanted)
    with workers(cluster.scheduler_address, -1, [dataset]):
        there = run_all(chosen, tmp_path / "there.csv", run_configuration, rest, wanted)
    assert [figures_of(here[i]) for i in ("7", "10", "19")] == [
        figures_of(there[i]) for i in ("7", "10", "19")
    ]


def test_killed_worker_loses_nothing(cluster, tmp_path, monkeypatch):
    dataset = small_dataset()
    chosen = CONFIGURATIONS[6:10]
    notes = tmp_path / "notes"
    notes.mkdir()
    killed = []
    write_results = table.write_results

    def kill_after_first_result(path, results):
        write_results(path, results)
        if not killed:
            busy = [note.name.split("-") for note in notes.iterdir()]
            killed.extend(pid for identity, pid in busy if identity not in results)
            # Where all begun have ended, the next result is waited for.
            if killed:
                os.kill(int(killed[0]), signal.SIGKILL)

    monkeypatch.setattr(table, "write_results", kill_after_first_result)
    with workers(cluster.scheduler_address, -1, [dataset]):
        results = run_all(
            chosen, tmp_path / "r.csv", slow_configuration, (dataset, str(notes)), wanted
        )
    assert killed
    assert set(results) == set(read_results(tmp_path / "r.csv")) == {c["id"] for c in chosen}
