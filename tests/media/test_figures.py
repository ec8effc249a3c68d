"""Figures of the notebooks that can be moved."""

import builtins

import pytest

from vehicle_detection.media.figures import live

VALUES = {"scale": [1, 2, 3], "color": ["RGB", "HLS"]}


def test_sliders_draw_anew():
    pytest.importorskip("ipywidgets")
    seen = []
    panel = live(lambda scale, color: seen.append((scale, color)), VALUES)
    assert set(seen) == {(2, "HLS")}
    panel.children[0].value = 3
    assert seen[-1] == (3, "HLS") and [one.value for one in panel.children[:2]] == [3, "HLS"]


def test_nobody_is_there():
    seen = []
    assert live(lambda scale, color: seen.append((scale, color)), VALUES, widgets=False) is None
    assert seen == [(2, "HLS")]


def test_without_widgets_there_is_one_figure(monkeypatch):
    found = builtins.__import__

    def without(name, *rest):
        if name == "ipywidgets":
            raise ImportError(name)
        return found(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    seen = []
    assert live(lambda scale, color: seen.append((scale, color)), VALUES) is None
    assert seen == [(2, "HLS")]
