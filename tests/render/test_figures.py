"""Figures are drawn the same way every time, for every kind of mode."""

import re
from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.questions.forward import ModeShape
from cpam_bayes.render.figures import save_figures


def written(figures, directory):
    directory.mkdir()
    save_figures(figures, directory)
    return {path.name: path.read_bytes() for path in directory.iterdir()}


def test_two_figures_on_one_page_share_no_element_name(forward_result, tmp_path):
    files = written(forward_result.figures(), tmp_path / "figures")
    names = ("handling", "modes", "plate")
    assert set(files) == {f"{name}.{ending}" for name in names for ending in ("png", "svg")}
    assert not any(b"<dc:date>" in content for content in files.values())
    ids = [
        set(re.findall(rb'id="(m[0-9a-f]{10}|p[0-9a-f]{10})"', content))
        for name, content in files.items()
        if name.endswith(".svg")
    ]
    assert all(ids)
    assert not ids[0] & ids[1]


def test_every_mode_is_drawn_with_kind_label_and_frequency(forward_result):
    figure = forward_result.plot("modes")
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert re.fullmatch(r"1: 1351\.\d+ Hz\nbending \(1,1\)", titles[0])
    assert len(titles) == 3


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_in_plane_modes_and_modes_of_one_sign_are_drawn_too(forward_result, share, tmp_path):
    ramp = np.add.outer(np.linspace(0, 1, 41), np.linspace(0, 1, 41))
    mode = replace(forward_result.modes[0], in_plane_fraction=share)
    shape = ModeShape(ramp, -ramp, ramp)
    result = replace(forward_result, modes=(mode,), shapes=(shape,), error=np.array([1e-5]))
    assert len(written(result.figures(), tmp_path / "figures")["modes.png"]) > 1000


def test_a_shape_and_its_negative_are_the_same_picture(forward_result, tmp_path):
    turned = tuple(ModeShape(-s.u, -s.v, -s.w) for s in forward_result.shapes)
    first, second = (
        written(replace(forward_result, shapes=shapes).figures(), tmp_path / name)["modes.png"]
        for name, shapes in (("as found", forward_result.shapes), ("turned", turned))
    )
    assert first == second
