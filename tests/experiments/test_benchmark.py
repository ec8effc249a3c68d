"""What the benchmark times, not how long it takes."""

import pytest

from conftest import random_detector, textured_image
from experiments import benchmark_two_stage
from experiments.timing import alternately
from rendered_road.render import render


@pytest.mark.parametrize("count", benchmark_two_stage.VEHICLE_COUNTS)
def test_so_many_vehicles_are_seen(count):
    _, truth = render(benchmark_two_stage.traffic(count), 0.0)
    assert sum(box.visible > 0.7 for box in truth) == count


def test_every_function_is_called_in_turn():
    calls = []
    times = alternately({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, 3)
    assert calls == ["a", "b"] * 3 and list(times) == ["a", "b"]


def test_stages_are_timed_on_proposals():
    frames = [textured_image(seed, 180, 320) for seed in range(3)]
    times = benchmark_two_stage.stages(frames, random_detector(3))
    assert times["proposals, for comparison"] > 0
    assert all(value > 0 for value in times.values())
