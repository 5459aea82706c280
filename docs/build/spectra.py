"""The picture of real recordings with the modes that `poles` finds and the published peaks.

    python docs/build/spectra.py DIR

DIR holds a hit on a clamped copper plate, ``copper_H1.wav``, hits on plates of spruce, ``hammer_*.npz``, and
their published peaks, ``spruce_plates.csv``. The recordings are not part of the package; the picture is.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.io import wavfile

import cpam_bayes as cb
from cpam_bayes.render.spectrum import line_sizes

PROJECT: Final = Path(__file__).parents[2]
PICTURE: Final = PROJECT / "docs" / "pictures" / "real_hits.png"
# Published modes of the copper plate below 1000 Hz, and how far a single hit may be from them.
COPPER: Final = (73.2, 148.0, 376.0, 431.0, 559.0, 910.0)
WITHIN_HZ: Final = 1.0
WITHIN: Final = 0.03


def spruce(folder: Path) -> dict[str, np.ndarray]:
    """Published peaks, Hz, of the plates that have recordings."""
    rows = (folder / "spruce_plates.csv").read_text(encoding="utf-8").splitlines()
    cells = [row.split(",") for row in rows if row and not row.startswith("#")]
    at = cells[0].index("frequencies_hz")
    known = {row[0]: np.array(row[at].split(";"), dtype=float) for row in cells[1:]}
    return {name: f for name, f in known.items() if (folder / f"hammer_{name}.npz").exists()}


def hits_of(recording: Path, folder: Path) -> Path:
    """Write the hits of a file as a folder of .wav files, each with force and response."""
    hits = folder / recording.stem
    hits.mkdir()
    with np.load(recording) as arrays:
        for k, channels in enumerate(zip(arrays["force"], arrays["acceleration"], strict=True)):
            wavfile.write(hits / f"{k}.wav", 48000, np.stack(channels, axis=1))
    return hits


def draw(axes: Axes, result: cb.PolesResult, published: np.ndarray, within: np.ndarray, title: str) -> None:
    """Draw a spectrum; a published peak (Hz) is found if ``within`` Hz from a mode's pole or peak."""
    test = result.test
    for hit in test.responses.each_hit:
        axes.semilogy(*line_sizes(test, hit.frf), color="0.6", linewidth=0.5, rasterized=True, label="a hit")
    for mode in result.modes:
        axes.axvline(mode.frequency, color="#D55E00", linewidth=0.7, label="mode")
    for other in result.others:
        axes.axvline(other.frequency, color="0.3", linewidth=0.6, linestyle=":", label="pole that is no mode")
    top = axes.get_xaxis_transform()
    marks: dict[str, Any] = {"color": "#0072B2", "markersize": 4, "transform": top, "clip_on": False}
    axes.plot(published, np.ones(len(published)), "v", label="published peak", **marks)

    at = np.array([(mode.frequency, mode.peak) for mode in result.modes])
    # modes, published peaks, pole or peak
    near = np.abs(at[:, None] - published[:, None]) <= within[:, None]
    by_pole, by_peak = near.any(axis=0).sum(axis=0)
    further = int(np.sum(~near.any(axis=(1, 2))))
    axes.set_title(
        f"{title}: of {len(published)} published peaks {by_pole} at the pole, {by_peak} at its peak; "
        f"{further} further mode{'s' if further != 1 else ''}",
        fontsize=7.5,
        loc="left",
        pad=8,
    )
    axes.set(xlim=(test.low, test.high))
    axes.set_ylabel("response", fontsize=7.5)
    axes.tick_params(labelsize=7)


def main() -> None:
    """Draw one spectrum per plate, one below the other."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, metavar="DIR", help="the folder of the recordings")
    folder = parser.parse_args().folder
    if not folder.is_dir():
        sys.exit(f"{folder}: no such folder, accepted: one with the recordings")
    plates = spruce(folder)
    figure = Figure(figsize=(190.0 / 25.4, 200.0 / 25.4), layout="constrained")
    first, *others = figure.subplots(1 + len(plates), 1)
    copper = np.array(COPPER)
    result = cb.poles(folder / "copper_H1.wav", high_hz=1000.0)
    draw(first, result, copper, WITHIN * copper, "copper, clamped, one hit")
    with tempfile.TemporaryDirectory() as place:
        for axes, (name, published) in zip(others, plates.items(), strict=True):
            result = cb.poles(hits_of(folder / f"hammer_{name}.npz", Path(place)), high_hz=800.0)
            within = np.full(len(published), WITHIN_HZ)
            draw(
                axes,
                result,
                published,
                within,
                f"spruce {name}, free, {len(result.test.responses.each_hit)} hits",
            )
    others[-1].set_xlabel("frequency, Hz", fontsize=7.5)
    shown = dict(zip(*reversed(first.get_legend_handles_labels()), strict=True))
    figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=len(shown), fontsize=7.5)
    figure.savefig(PICTURE, dpi=130, metadata={"Software": None})


if __name__ == "__main__":
    main()
