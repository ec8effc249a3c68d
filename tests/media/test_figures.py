"""Figures of the notebooks that can be moved."""

import builtins

import numpy as np
import pytest

from vehicle_detection.media.figures import live

VALUES = {"scale": [1, 2, 3], "color": ["RGB", "HLS"]}


@pytest.fixture
def drawn():
    """What was chosen, each time that something was shown; and the function that is told."""
    seen = []

    def function(scale, color):
        seen.append((scale, color))
        return [np.zeros((20, 40, 3), np.uint8)], [color]

    return seen, function


def test_sliders_draw_anew(drawn):
    pytest.importorskip("ipywidgets")
    seen, function = drawn
    panel = live(function, VALUES)
    assert set(seen) == {(2, "HLS")}
    panel.children[0].value = 3
    assert seen[-1] == (3, "HLS") and [one.value for one in panel.children[:2]] == [3, "HLS"]


def test_nobody_is_there(drawn):
    seen, function = drawn
    assert live(function, VALUES, widgets=False) is None
    assert seen == [(2, "HLS")]


def test_without_widgets_there_is_one_figure(monkeypatch, drawn):
    found = builtins.__import__

    def without(name, *rest):
        if name == "ipywidgets":
            raise ImportError(name)
        return found(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    seen, function = drawn
    assert live(function, VALUES) is None
    assert seen == [(2, "HLS")]
