"""Figures: drawn from saved results, with captions, legible in print, the same bytes each time."""

import hashlib
import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import draw
import journal
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from PIL import Image

from tests.test_studies import PROJECT, SAVED, listed, quick_text, weekly_if_long

FIGURES = PROJECT / "figures"
QUICKLY_DRAWN = "20_swarms"


def source_of(path: Path) -> str:
    with Image.open(path, formats=["PNG"]) as image:
        return str(image.info["Source"])


@pytest.mark.parametrize("name", draw.NAMES)
def test_a_figure_is_the_kept_one_and_legible_and_names_its_seeds(name, tmp_path):
    drawing = draw.drawing(name)
    source = hashlib.sha256((SAVED / f"{drawing.study}.json").read_bytes()).hexdigest()
    pictures = drawing.drawn(SAVED)
    written = drawing.write(pictures, SAVED, tmp_path)
    assert {path.stem for path in written} == drawn_by(name)
    for path, picture in zip(written, pictures, strict=True):
        assert path.stat().st_size < 300e3
        kept = FIGURES / path.name
        assert source_of(path) == source == source_of(kept), "drawn from other results: run figures/draw.py"
        ours, theirs = (png.with_suffix(".md").read_text(encoding="utf-8") for png in (path, kept))
        assert theirs == ours
        assert faults(picture.figure) == []
    study = (PROJECT / "studies" / f"{drawing.study}.py").read_text(encoding="utf-8")
    if stated := re.search(r"^(SEEDS?) = (\d+)", study, re.MULTILINE):
        last = int(stated[2])
        assert drawing.seeds == (f"seed {last}" if stated[1] == "SEED" else f"seeds 0 to {last - 1}")


def drawn_by(name: str) -> set[str]:
    captions = (path for path in FIGURES.glob("*.md") if path.name != "README.md")
    said = f"`python figures/draw.py {name}`"
    return {path.stem for path in captions if said in path.read_text(encoding="utf-8")}


@pytest.mark.slow
@pytest.mark.parametrize("name", weekly_if_long(draw.NAMES))
def test_a_figure_is_drawn_from_a_small_run(name, tmp_path):
    drawing = draw.drawing(name)
    (tmp_path / f"{drawing.study}.json").write_text(quick_text(drawing.study), encoding="utf-8")
    assert drawing(tmp_path, tmp_path)


@pytest.mark.parametrize("kind", journal.KINDS)
def test_the_same_results_give_the_same_bytes(kind, tmp_path):
    drawing = draw.drawing(QUICKLY_DRAWN)
    first, again = ([path.read_bytes() for path in drawing(SAVED, tmp_path, kind)] for _ in range(2))
    assert first == again


def texts(figure: Figure) -> Iterator[tuple[str, float, Bbox]]:
    """Texts with their size in points and their box, without ticks beyond the ends."""
    beyond: set[int] = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            slack = 1e-9 * (high - low)
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
                if not (axes.axison and low - slack <= tick.get_loc() <= high + slack):
                    beyond |= {id(tick.label1), id(tick.label2)}
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip() and id(text) not in beyond:
            yield text.get_text(), float(text.get_fontsize()), text.get_window_extent()


def faults(figure: Figure) -> list[str]:
    """Defects that a reader of the printed figure would see."""
    width, height = (figure.get_size_inches() * 25.4).tolist()
    found = [f"{width:.1f} mm wide"] * (round(width, 6) not in (journal.SINGLE_MM, journal.DOUBLE_MM))
    found += [f"{height:.1f} mm tall"] * (height > journal.TALLEST_MM)
    written = list(texts(figure))
    page = figure.bbox.padded(1.0)
    for text, points, box in written:
        if points < journal.LEAST_POINTS:
            found.append(f"{text!r} in {points:.1f} points")
        if box.x0 < page.x0 or box.y0 < page.y0 or box.x1 > page.x1 or box.y1 > page.y1:
            found.append(f"{text!r} beyond the page")
    for axes in figure.axes:
        scaled = axes.axison and axes.has_data() and axes.xaxis.get_ticklabels()
        common = figure.get_supxlabel() + figure.get_supylabel()
        if scaled and not (axes.get_xlabel() or axes.get_ylabel() or common):
            found.append("axes without a quantity")
    for (text, _, box), (other, _, beside) in itertools.combinations(written, 2):
        common = Bbox.intersection(box, beside)
        if common is not None and min(common.width, common.height) > 1.0:
            found.append(f"{text!r} over {other!r}")
    return found


def test_what_is_not_legible_is_found():
    figure = journal.figure(100.0, 300.0)
    figure.text(0.5, 0.5, "one")
    figure.text(0.5, 0.5, "two", fontsize=5.0)
    figure.text(0.99, 0.9, "a long text at the edge")
    figure.add_subplot().plot([0.0, 1.0])
    figure.draw_without_rendering()
    small, beyond = "'two' in 5.0 points", "'a long text at the edge' beyond the page"
    others = ["axes without a quantity", "'one' over 'two'"]
    assert faults(figure) == ["100.0 mm wide", "300.0 mm tall", small, beyond, *others]


def test_one_command_draws_what_it_is_asked_for(tmp_path, capsys):
    new = tmp_path / "new"
    draw.main([QUICKLY_DRAWN, "--out", str(new), "--format", "svg"])
    assert {path.name for path in new.iterdir()} == {f"{QUICKLY_DRAWN}.md", f"{QUICKLY_DRAWN}.svg"}
    assert capsys.readouterr().out == f"{new / QUICKLY_DRAWN}.svg\n"


def test_each_figure_is_listed_and_nothing_else_is_kept():
    readme = FIGURES / "README.md"
    assert listed(readme) == set(draw.NAMES)
    kept = {path.stem for path in FIGURES.glob("*.png")}
    assert kept == {path.stem for path in FIGURES.glob("*.md")} - {"README"}
    assert kept == set().union(*map(drawn_by, draw.NAMES))
    assert set(re.findall(r"`([\w.&]+)\.png`", readme.read_text(encoding="utf-8"))) <= kept
