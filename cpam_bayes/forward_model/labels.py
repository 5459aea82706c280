"""Modes that are known by their labels or by measured shapes, followed through the parameters.

A label is that of a mode at one place, the reference constants. Elsewhere the mode is the one whose
shape is most like it, by modal assurance, so that modes which change their order keep their labels. A
measured shape says the same of the mode that it is most like at the reference constants.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.formatting import listed
from cpam_bayes.forward_model.mode_shapes.assurance import (
    AmbiguousShapesError,
    ShapePairing,
    pair_by_assurance,
)
from cpam_bayes.forward_model.model import PlateModel, Prediction, reference_vector
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.mechanics.modes import Spectrum
from cpam_bayes.mechanics.shapes import Mode
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Measurement, Specimen
from cpam_bayes.plate.mode_shapes.measured import MeasuredShapes

Array = NDArray[Any]

# Modes computed beyond the list, so that a labelled one which moves up is still among them.
SPARE_MODES = 4
# Probability of another mode from which a warning names it.
_DOUBT = 0.01
# Modal assurance below which none of the computed modes is the labelled one.
_LEAST_ASSURANCE = 0.1


class LabelError(ValueError):
    """A label of the plate file that names no mode of the model, or names one too often."""


@dataclass(frozen=True, slots=True, eq=False)
class Alternative:
    """One pairing of frequencies with modes.

    places : (n_modes,) place in the predictions of the mode that stands at each place by this pairing
    log_probability : of it, by the measured shapes
    """

    places: Array
    log_probability: float


@dataclass(frozen=True, slots=True)
class LabelledModel:
    """A reduced model whose modes stand where the list of frequencies has them.

    The mode of a labelled frequency stands at that frequency's own number, whatever its rank; the
    others fill the other places in ascending order.

    rows : (n_labels,) numbers of the labelled frequencies; of modes beyond the list, which may be those of
    some frequencies by their shapes, places after it.
    block : (n_labels,) block of the operator that holds each labelled mode.
    images : M psi of each reference shape psi in its block, with psi^T M psi = 1.
    weights : M of every block, at the reference.
    alternatives : where measured shapes are like several modes, all pairings with their probabilities.
    by_shape : what measured shapes say, None where labels say it.
    """

    reduced: ReducedModel
    rows: Array
    block: Array
    images: tuple[Array, ...]
    weights: tuple[Array, ...]
    alternatives: tuple[Alternative, ...] = ()
    by_shape: ShapePairing | None = None

    @property
    def full(self) -> PlateModel:
        """The model on its full space, modes in ascending order."""
        return self.reduced.full

    @property
    def fast(self) -> PlateModel:
        """The projected model, modes in ascending order."""
        return self.reduced.fast

    @property
    def n_modes(self) -> int:
        """Number of modes predicted."""
        return self.reduced.n_modes

    @property
    def parameters(self) -> ParameterSet:
        """The parameters that vary, in the order of the vectors."""
        return self.reduced.parameters

    def admissible(self, x: Array) -> Array:
        """Whether parameter vectors (m, n) satisfy the constraints of the material, (m,) bool."""
        return self.reduced.admissible(x)

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        """Frequencies at parameter vectors (m, n), in the places of the list, and derivatives."""
        spectrum = self.fast.spectrum(x, vectors=True)
        order = self._order(spectrum)
        frequencies = np.take_along_axis(spectrum.frequencies, order, axis=1)
        if not jacobian:
            return Prediction(frequencies, None)
        derivative = self.reduced.predict(x, jacobian=True).jacobian
        assert derivative is not None
        return Prediction(frequencies, np.take_along_axis(derivative, order[..., None], axis=1))

    def order(self, x: Array) -> Array:
        """Rank from 0 of the mode at each place, at parameter vectors (m, n), (m, n_modes)."""
        return self._order(self.fast.spectrum(x, vectors=True))

    def modes(self, x: Array) -> tuple[Mode, ...]:
        """Frequencies, kinds and labels at one parameter vector (n,), in the places of the list."""
        modes = self.full.modes(x)
        return tuple(modes[k] for k in self.order(x)[0])

    def _order(self, spectrum: Spectrum) -> Array:
        m, k = spectrum.eigenvalues.shape
        owner = self._owners(spectrum)
        claimed = np.zeros((m, k), dtype=bool)
        sets, which = np.nonzero(owner >= 0)
        claimed[sets, owner[sets, which]] = True
        order = np.empty((m, k), dtype=int)
        others = np.setdiff1d(np.arange(k), self.rows)
        order[:, others] = np.argsort(claimed, axis=1, kind="stable")[:, : len(others)]
        # a labelled mode above all that are computed is no lower than the last of them
        order[:, self.rows] = np.where(owner >= 0, owner, k - 1)
        return order

    def _owners(self, spectrum: Spectrum) -> Array:
        """The mode of each label, -1 where none is like it, (m, n_labels)."""
        assurance = self._assurance(spectrum)
        m, _, n_labels = assurance.shape
        owner = np.full((m, n_labels), -1)
        sets = np.arange(m)
        for _ in range(n_labels):  # the most certain label first, then those that are left
            flat = assurance.reshape(m, -1)
            best = flat.argmax(axis=1)
            sure = flat[sets, best] > _LEAST_ASSURANCE
            mode, label = np.divmod(best, n_labels)
            owner[sets[sure], label[sure]] = mode[sure]
            assurance[sets, mode] = 0.0
            assurance[sets, :, label] = 0.0
        return owner

    def _assurance(self, spectrum: Spectrum) -> Array:
        """Modal assurance of every mode with every reference shape, (m, n_modes, n_labels)."""
        assert spectrum.vectors is not None
        assurance = np.zeros((*spectrum.eigenvalues.shape, len(self.rows)))
        for b in np.unique(self.block):
            sets, modes = np.nonzero(spectrum.block == b)
            phi = spectrum.vectors[b][sets, :, spectrum.column[sets, modes]]
            labels = np.flatnonzero(self.block == b)
            cross = phi @ np.stack([self.images[i] for i in labels], axis=1)
            size = np.sum(phi * (phi @ self.weights[b]), axis=1)
            assurance[sets[:, None], modes[:, None], labels] = cross**2 / size[:, None]
        return assurance


def labelled_model(
    model: ReducedModel, measurement: Measurement, specimen: Specimen
) -> ReducedModel | LabelledModel:
    """The model with its modes in the places that the labels or the measured shapes of a list give them.

    The model itself where neither is given. Raises ``LabelError`` for a label that no mode of
    the model has at the reference constants, or that other numbers of frequencies and of modes bear, and
    for shapes that are like no mode or do not tell modes apart.
    """
    if not measurement.names_modes:
        return model
    x = reference_vector(specimen, model.parameters)
    modes = model.full.modes(x)
    alternatives: tuple[Alternative, ...] = ()
    pairing: ShapePairing | None = None
    if measurement.shapes is not None:
        points = measurement.shapes.points / (specimen.plate.length, specimen.plate.width)
        pairing = paired_shapes(measurement.shapes, model.full.shapes_at(x, points), modes, specimen)
        rows, columns, alternatives = _places(pairing, model.n_modes)
    else:
        rows = np.flatnonzero([bool(label) for label in measurement.labels])
        columns = np.array(_columns(measurement, modes, specimen.source))
    spectrum = model.fast.spectrum(x, vectors=True)
    _, mass = model.fast.coefficients(x[None])
    weights = tuple(block.mass.assemble(mass[0]) for block in model.fast.operator.blocks)
    blocks, images = [], []
    for j in columns:
        b, psi = spectrum.vector(0, int(j))
        blocks.append(b)
        images.append(weights[b] @ psi / np.sqrt(psi @ weights[b] @ psi))
    return LabelledModel(model, rows, np.array(blocks), tuple(images), weights, alternatives, pairing)


def paired_shapes(
    shapes: MeasuredShapes, predicted: Array, modes: tuple[Mode, ...], specimen: Specimen
) -> ShapePairing:
    """What measured shapes say against predicted ones (k, 3, n_nodes).

    Raises ``LabelError`` where they are like no mode or do not tell modes apart.
    """
    where = f"{specimen.source}: measurement.shapes"
    try:
        pairing = pair_by_assurance(shapes, predicted, modes)
    except AmbiguousShapesError as error:
        raise LabelError(f"{where}: {error}") from None
    if np.all(pairing.modes < 0):
        raise LabelError(
            f"{where}: no shape is like one of the first {len(modes)} modes, the largest modal assurance is "
            f"{pairing.assurance.max():.2f}; check the edges, the layup, and the places of the nodes"
        )
    return pairing


def _places(pairing: ShapePairing, n_modes: int) -> tuple[Array, Array, tuple[Alternative, ...]]:
    """Places and modes that are followed, and all pairings where there are several.

    A mode that a frequency may have, but has not in the most probable pairing, stands after the list.
    """
    n, first = len(pairing.modes), pairing.modes
    rows = np.flatnonzero(first >= 0)
    every = np.concatenate([one.modes[one.modes >= 0] for one in pairing.assignments])
    further = np.setdiff1d(every, first)[: n_modes - n]
    place = {int(j): int(i) for i, j in zip(rows, first[rows], strict=True)}
    place |= {int(j): n + e for e, j in enumerate(further)}
    alternatives = []
    for one in pairing.assignments:
        if all(int(j) in place for j in one.modes[rows]):
            places = np.full(n_modes, -1)
            places[rows] = [place[int(j)] for j in one.modes[rows]]
            places[places < 0] = np.setdiff1d(np.arange(n_modes), places)
            alternatives.append(Alternative(places, one.log_probability))
    followed = np.concatenate((rows, n + np.arange(len(further))))
    columns = np.concatenate((first[rows], further))
    return followed, columns, tuple(alternatives) if len(alternatives) > 1 else ()


def list_order(model: ReducedModel | LabelledModel, x: Array) -> Array:
    """Ranks of the modes in the places of the list at one parameter vector (n,), (n_modes,)."""
    return model.order(x)[0] if isinstance(model, LabelledModel) else np.arange(model.n_modes)


def by_shape(model: ReducedModel | LabelledModel) -> ShapePairing | None:
    """What measured shapes say against a model, None without them."""
    return model.by_shape if isinstance(model, LabelledModel) else None


def spare_modes(measurement: Measurement) -> int:
    """Modes to compute beyond the list: some where labelled ones may move up, none otherwise.

    More beside shapes, which may be those of a part of the modes.
    """
    if measurement.shapes is not None:
        return SPARE_MODES + measurement.size // 4
    return SPARE_MODES if any(measurement.labels) else 0


def shape_warnings(pairing: ShapePairing | None, measurement: Measurement) -> list[str]:
    """Measured shapes that are like no mode, and those that are like several."""
    if pairing is None:
        return []
    problems, several = [], []
    for f, mode, assurance, p in zip(
        measurement.frequencies, pairing.modes, pairing.assurance, pairing.probability, strict=True
    ):
        if mode < 0:
            problems.append(
                f"the shape of {f:.6g} Hz is like no mode of the model (modal assurance up to "
                f"{assurance.max():.2f}): it is paired by its place among the others"
            )
        elif p[mode] < 1.0 - _DOUBT:
            likely = [j for j in np.argsort(-p) if p[j] >= _DOUBT]
            said = listed([f"{pairing.candidates[j].label} with {100.0 * p[j]:.0f} %" for j in likely], "or")
            several.append(f"{f:.6g} Hz is {said}")
    if several:
        problems.append(f"shapes are like several modes: {'; '.join(several)}")
    return problems


def same_label(label: str) -> str:
    """A label without spaces, the parts of a combination in the order of the model's own."""
    return "+".join(sorted("".join(label.split()).split("+"), reverse=True))


def modes_of_labels(labels: Sequence[str], modes: Sequence[Mode]) -> dict[int, int]:
    """Number of each labelled frequency -> number of the mode that has the label, both from 0.

    Frequencies of equal labels take the modes of that label in ascending order; a label that no mode has
    is left out.
    """
    bearers = [same_label(mode.label) for mode in modes]
    free = set(range(len(modes)))
    found = {}
    for i, label in enumerate(labels):
        at = next((j for j in sorted(free) if label and bearers[j] == same_label(label)), None)
        if at is not None:
            free.remove(at)
            found[i] = at
    return found


def label_warnings(measurement: Measurement, modes: Sequence[Mode]) -> list[str]:
    """Labels of a list that none of the modes has."""
    known = modes_of_labels(measurement.labels, modes)
    lost = [
        f"{label} of {f:.6g} Hz"
        for i, (label, f) in enumerate(zip(measurement.labels, measurement.frequencies, strict=True))
        if label and i not in known
    ]
    if not lost:
        return []
    which = "the label" if len(lost) == 1 else "the labels"
    return [
        f"measurement.labels: none of the first {len(modes)} modes has {which} {listed(lost, 'and')}, which "
        "therefore stands beside no mode; check the label and the edges, or compute more modes (--modes N)"
    ]


def _columns(measurement: Measurement, modes: tuple[Mode, ...], source: str) -> list[int]:
    """The mode of each labelled frequency; those of equal labels are taken in ascending order."""
    bearers: dict[str, list[int]] = {}
    for j, mode in enumerate(modes):
        bearers.setdefault(same_label(mode.label), []).append(j)
    labels = [label for label in measurement.labels if label]
    given = Counter(same_label(label) for label in labels)
    left = {label: iter(candidates) for label, candidates in bearers.items()}
    columns = []
    for label in labels:
        candidates = bearers.get(same_label(label), [])
        in_list = sum(j < measurement.size for j in candidates)
        frequencies = given[same_label(label)]
        if not max(in_list, 1) <= frequencies <= len(candidates):
            there = ", ".join(f"{m.label} at {m.frequency:.4g} Hz" for m in modes)
            verb = "have" if len(candidates) > 1 else "has"
            raise LabelError(
                f"{source}: measurement.labels: received {label!r} for {_count(frequencies, 'frequency')}, "
                f"{_count(len(candidates), 'mode')} of the model {verb} it; label as many frequencies "
                f'as modes, or write "" where the mode is not known; the first {len(modes)} modes at the '
                f"reference constants: {there}"
            )
        columns.append(next(left[same_label(label)]))
    return columns


def _count(n: int, what: str) -> str:
    plural = f"{what[:-1]}ies" if what.endswith("y") else f"{what}s"
    return {0: f"no {what}", 1: f"one {what}"}.get(n, f"{n} {plural}")
