"""Identification of modes by labels or measured shapes at the reference constants (docs/mode_shapes.md).

At other constants a mode is the one with the highest modal assurance, whatever its rank.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import scipy.optimize
from scipy.special import logsumexp

from cpam_bayes.answer import Notice
from cpam_bayes.forward_model.model import Prediction, reference_vector
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.mechanics.modes import Mode, Spectrum
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.plate import Measurement, Specimen
from cpam_bayes.plate.records import MeasuredShapes

DEFAULT_MODES: Final = 10
"""Number of modes where none were measured."""


# Usual square of the relative error of a shape: a MAC of 0.98 with its own mode.
_USUAL_ERROR: Final = 0.02
# Modal assurance below which a measured shape is more likely no mode of the model.
_LEAST_ASSURANCE: Final = 0.3
# Assignments less probable than the best by this factor are left out, and at most this many are kept.
_NEGLIGIBLE, _MOST_KEPT = 1e-3, 64
# Most assignments tried of one group of shapes, and the least probability of those kept.
_MOST_TRIED, _LEAST_KEPT = 5000, 0.95
# A mode with less than this fraction of its square in the measured directions does not show.
_VISIBLE: Final = 0.01
# A mode that is at least this probable is certain, as if labelled.
_FIXED: Final = 0.999


class AmbiguousShapesError(ValueError):
    """Shapes that do not tell modes apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Assignment:
    """One assignment of measured shapes to modes.

    modes : (n,) mode of each shape, -1 for none
    log_probability : among all assignments that are kept
    """

    modes: Array
    log_probability: float


@dataclass(frozen=True, slots=True, eq=False)
class ShapePairing:
    """Probabilities of k modes for each measured shape.

    assurance : (n, k) modal assurance
    candidates : (k,) the modes, at the reference constants
    directions : effective number of independent shapes that the nodes resolve
    assignments : the most probable one first
    """

    assurance: Array
    candidates: tuple[Mode, ...]
    directions: float
    assignments: tuple[Assignment, ...]

    @property
    def modes(self) -> Array:
        """The most probable mode of each shape, -1 for none, (n,)."""
        return self.assignments[0].modes

    @property
    def probability(self) -> Array:
        """Probability of each mode for each shape, (n, k)."""
        p = np.zeros_like(self.assurance)
        for assignment in self.assignments:
            rows = np.flatnonzero(assignment.modes >= 0)
            p[rows, assignment.modes[rows]] += np.exp(assignment.log_probability)
        return p

    @property
    def fixed(self) -> Array:
        """True for shapes whose mode is certain, as if labelled, (n,)."""
        return np.asarray(self.probability.max(axis=1) >= _FIXED)


def modal_assurance(measured: MeasuredShapes, predicted: Array) -> Array:
    """MAC_ij = |phi_i^H psi_j|^2 / (phi_i^H phi_i  psi_j^H psi_j), (n, k).

    Allemang, Sound and Vibration 37, 2003. Directions in which no measured mode moves were not measured and
    are left out. The MAC of a mode that hardly moves in the others is 0.

    predicted : (k, 3, n_nodes) u, v, w at the nodes
    """
    seen = measured.directions
    phi = measured.values[:, seen].reshape(len(measured.values), -1)
    psi = predicted[:, seen].reshape(len(predicted), -1)
    own = np.sum(psi**2, axis=1)
    shows = own > _VISIBLE * np.sum(predicted**2, axis=(1, 2))
    sizes = np.sum(np.abs(phi) ** 2, axis=1)[:, None] * np.where(shows, own, 1.0)
    return np.asarray(np.where(shows, np.abs(phi.conj() @ psi.T) ** 2 / sizes, 0.0))


def pair_by_assurance(
    measured: MeasuredShapes, predicted: Array, candidates: tuple[Mode, ...]
) -> ShapePairing:
    """Probabilities of all one-to-one pairings of measured shapes with modes, by their assurance.

    A measured shape is its mode's times a factor plus an error in each of d directions, of one unknown size
    that is usually sqrt(0.02) of the shape: a Student-t, with
    p(shape i | mode j) ~ (0.02 + 1 - MAC_ij)^(-d/2). d is one less than the effective number of shapes that
    the nodes resolve, (sum s^2)^2 / sum s^4 of the singular values s of the predicted shapes. A shape whose
    assurance is below 0.3 with all modes is none of them.

    predicted : (k, 3, n_nodes) u, v, w of the candidates at the nodes
    Raises ``AmbiguousShapesError`` where the probability is spread over too many pairings.
    """
    assurance = modal_assurance(measured, predicted)
    directions = _directions(predicted[:, measured.directions].reshape(len(predicted), -1))
    power = -0.5 * max(directions - 1.0, 0.0)
    log_weight = power * np.log(_USUAL_ERROR + np.maximum(1.0 - assurance, 0.0))
    none = power * np.log(_USUAL_ERROR + 1.0 - _LEAST_ASSURANCE)
    modes = _most_probable(log_weight, none)
    rows = np.flatnonzero(modes >= 0)
    candidate = assurance >= _LEAST_ASSURANCE
    kept, lost = [(0.0, modes)], 0.0
    for group in _groups(candidate[rows] & _near(log_weight[rows], modes[rows])):
        found = _assignments(log_weight[rows[group]], candidate[rows[group]], modes[rows[group]])
        kept, dropped = _combined(kept, found, rows[group])
        lost += dropped
    if lost > -np.log(_LEAST_KEPT):
        raise AmbiguousShapesError(
            f"the shapes at {len(measured.nodes)} nodes do not tell the modes apart, accepted: shapes at "
            "more nodes, best along all edges, or a list of frequencies_hz without them"
        )
    values = np.array([value for value, _ in kept])
    values -= logsumexp(values)
    order = np.argsort(-values, kind="stable")
    assignments = tuple(Assignment(kept[i][1], float(values[i])) for i in order)
    return ShapePairing(assurance, candidates, directions, assignments)


def _directions(shapes: Array) -> float:
    sizes = np.linalg.norm(shapes, axis=1)
    s = np.linalg.svd(shapes[sizes > 0.0] / sizes[sizes > 0.0, None], compute_uv=False) ** 2
    return float(np.sum(s) ** 2 / np.sum(s**2))


def _most_probable(log_weight: Array, none: float) -> Array:
    """The most probable one-to-one pairing, (n,), -1 where a shape is more likely no mode."""
    n, k = log_weight.shape
    _, column = scipy.optimize.linear_sum_assignment(
        np.hstack((log_weight, np.full((n, n), none))), maximize=True
    )
    return np.where(column < k, column, -1)


def _near(log_weight: Array, modes: Array) -> Array:
    """True for modes that a shape may be: not negligibly probable beside its best one, (n, k)."""
    best = log_weight[np.arange(len(modes)), modes]
    return np.asarray(log_weight >= best[:, None] + np.log(_NEGLIGIBLE))


def _groups(candidate: Array) -> list[Array]:
    """Groups of rows that share candidates, without rows whose only candidate is their own."""
    touching = (candidate.astype(int) @ candidate.T.astype(int)) > 0
    groups, seen = [], np.zeros(len(candidate), dtype=bool)
    for i in range(len(candidate)):
        if seen[i]:
            continue
        group = np.zeros_like(seen)
        grown = touching[i]
        while (grown != group).any():
            group = grown
            grown = touching[group].any(axis=0)
        seen |= group
        if candidate[group].sum() > 1:
            groups.append(np.flatnonzero(group))
    return groups


def _assignments(log_weight: Array, candidate: Array, modes: Array) -> list[tuple[float, Array]]:
    """The best one-to-one pairings of a group, with their log weights relative to that of ``modes``."""
    n = len(modes)
    relative = np.where(candidate, log_weight - log_weight[np.arange(n), modes][:, None], -np.inf)
    top = relative.max(axis=1)
    rest = np.append(np.cumsum(top[::-1])[::-1], 0.0)  # the most that the rows from i on can add
    found: list[tuple[float, Array]] = []
    tried = 0

    def extend(i: int, value: float, taken: list[int]) -> None:
        nonlocal tried
        tried += 1
        if tried > _MOST_TRIED:
            raise AmbiguousShapesError(
                f"{n} shapes cannot be told apart by modal assurance, accepted: shapes at more nodes, or a "
                "list of frequencies_hz without them"
            )
        if i == n:
            found.append((value, np.array(taken)))
            return
        for j in np.flatnonzero(value + relative[i] + rest[i + 1] >= np.log(_NEGLIGIBLE)):
            if j not in taken:
                extend(i + 1, value + float(relative[i, j]), [*taken, int(j)])

    extend(0, 0.0, [])
    return found


def _combined(
    kept: Sequence[tuple[float, Array]], found: Sequence[tuple[float, Array]], rows: Array
) -> tuple[list[tuple[float, Array]], float]:
    """The best combinations of assignments of other rows and of these, and the log weight that is lost."""
    both = []
    for value, modes in kept:
        for added, of_rows in found:
            changed = modes.copy()
            changed[rows] = of_rows
            both.append((value + added, changed))
    both.sort(key=lambda one: -one[0])
    cut = [one for one in both[:_MOST_KEPT] if one[0] >= both[0][0] + np.log(_NEGLIGIBLE)]
    whole, left = (float(logsumexp([value for value, _ in some])) for some in (both, cut))
    return cut, whole - left


# Modes computed beyond the list, so that a labelled one which moves up is still among them.
SPARE_MODES = 4
# Probability of another mode from which a warning names it.
_DOUBT = 0.01
# Modal assurance below which no computed mode is the labelled one.
_LEAST_ASSURANCE_OF_LABELS = 0.1


class LabelError(ValueError):
    """A label of the plate file that no mode has, or that is given to a wrong number of frequencies."""


@dataclass(frozen=True, slots=True, eq=False)
class Alternative:
    """One pairing of frequencies with modes.

    places : (n_modes,) place in the predictions of the mode that this pairing has at each place
    log_probability : by the measured shapes
    """

    places: Array
    log_probability: float


@dataclass(frozen=True, slots=True)
class LabelledModel(ReducedModel):
    """A reduced model whose modes are in the order of the list of frequencies.

    The mode of a labelled frequency is at that frequency's own number, whatever its rank; the others fill
    the other places in ascending order.

    rows : (n_labels,) numbers of the labelled frequencies; of modes beyond the list, which may be those of
    some frequencies by their shapes, places after it.
    block : (n_labels,) block of the operator that holds each labelled mode.
    images : M psi of each reference shape psi in its block, with psi^T M psi = 1.
    weights : M of every block, at the reference.
    alternatives : where measured shapes are like several modes, all pairings with their probabilities.
    by_shape : the pairing by measured shapes, None where labels are used.
    """

    rows: Array
    block: Array
    images: tuple[Array, ...]
    weights: tuple[Array, ...]
    alternatives: tuple[Alternative, ...] = ()
    by_shape: ShapePairing | None = None

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        """Frequencies at parameter vectors (m, n), in the places of the list, and derivatives."""
        spectrum = self.fast.spectrum(x, vectors=True)
        order = self._order(spectrum)
        frequencies = self.fast.bias.of(np.take_along_axis(spectrum.frequencies, order, axis=1))
        if not jacobian:
            return Prediction(frequencies, None)
        derivative = self.fast.predict(x, jacobian=True).jacobian
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
        # a labelled mode above all computed ones is at least as high as the last of them
        order[:, self.rows] = np.where(owner >= 0, owner, k - 1)
        return order

    def _owners(self, spectrum: Spectrum) -> Array:
        """The mode of each label, -1 where none is similar, (m, n_labels)."""
        assurance = self._assurance(spectrum)
        m, _, n_labels = assurance.shape
        owner = np.full((m, n_labels), -1)
        sets = np.arange(m)
        for _ in range(n_labels):  # the most certain label first, then those that are left
            flat = assurance.reshape(m, -1)
            best = flat.argmax(axis=1)
            sure = flat[sets, best] > _LEAST_ASSURANCE_OF_LABELS
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


def labelled_model(model: ReducedModel, measurement: Measurement, specimen: Specimen) -> ReducedModel:
    """The model with its modes in the places given by the labels or measured shapes of a list.

    The model itself where there are neither. Raises ``LabelError`` for a label that no mode of the model
    has at the reference constants, or that different numbers of frequencies and modes have, and for shapes
    that are like no mode or do not tell modes apart.
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
    return LabelledModel(
        model.full,
        model.fast,
        model.tolerance,
        rows,
        np.array(blocks),
        tuple(images),
        weights,
        alternatives,
        pairing,
    )


def paired_shapes(
    shapes: MeasuredShapes, predicted: Array, modes: tuple[Mode, ...], specimen: Specimen
) -> ShapePairing:
    """The pairing of measured and predicted shapes (k, 3, n_nodes); ``LabelError`` where there is none."""
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

    A mode that a frequency may have, but not in the most probable pairing, is placed after the list.
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


def list_order(model: ReducedModel, x: Array) -> Array:
    """Ranks of the modes in the places of the list at one parameter vector (n,), (n_modes,)."""
    return model.order(x)[0] if isinstance(model, LabelledModel) else np.arange(model.n_modes)


def by_shape(model: ReducedModel) -> ShapePairing | None:
    """The pairing of measured shapes with the modes of a model, None without them."""
    return model.by_shape if isinstance(model, LabelledModel) else None


def spare_modes(measurement: Measurement) -> int:
    """Number of modes to compute beyond the list, as labelled ones may move up; more with shapes."""
    if measurement.shapes is not None:
        return SPARE_MODES + measurement.size // 4
    return SPARE_MODES if any(measurement.labels) else 0


def shape_notices(
    pairing: ShapePairing | None, measurement: Measurement, use: Literal["best", "all"] | None = None
) -> tuple[Notice, ...]:
    """Notices of measured shapes that are like no mode, and of those that are like several.

    use : of a shape that is like several, its most probable pairing, or all by their probability
    """
    if pairing is None:
        return ()
    notices, several = [], []
    for f, mode, assurance, p in zip(
        measurement.frequencies, pairing.modes, pairing.assurance, pairing.probability, strict=True
    ):
        if mode < 0:
            facts = {"frequency": float(f), "assurance": float(assurance.max())}
            notices.append(Notice("shape_without_mode", facts=facts))
        elif p[mode] < 1.0 - _DOUBT:
            likely = [j for j in np.argsort(-p) if p[j] >= _DOUBT]
            several.append((float(f), tuple((pairing.candidates[j].label, float(p[j])) for j in likely)))
    if several:
        notices.append(Notice("shapes_of_several", facts={"shapes": tuple(several), "use": use}))
    return tuple(notices)


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


def label_notices(measurement: Measurement, modes: Sequence[Mode]) -> tuple[Notice, ...]:
    """A notice of the labels of a list that none of the modes has."""
    known = modes_of_labels(measurement.labels, modes)
    lost = tuple(
        (label, float(f))
        for i, (label, f) in enumerate(zip(measurement.labels, measurement.frequencies, strict=True))
        if label and i not in known
    )
    return (Notice("label_without_mode", facts={"labels": lost, "modes": len(modes)}),) if lost else ()


def _columns(measurement: Measurement, modes: tuple[Mode, ...], source: str) -> list[int]:
    """The mode of each labelled frequency; those of equal labels are taken in ascending order."""
    bearers: dict[str, list[int]] = {}
    for j, mode in enumerate(modes):
        bearers.setdefault(same_label(mode.label), []).append(j)
    labels = [label for label in measurement.labels if label]
    given = Counter(same_label(label) for label in labels)
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
    return list(modes_of_labels(labels, modes).values())


def _count(n: int, what: str) -> str:
    plural = f"{what[:-1]}ies" if what.endswith("y") else f"{what}s"
    return {0: f"no {what}", 1: f"one {what}"}.get(n, f"{n} {plural}")


def measured_modes(specimen: Specimen) -> int:
    """Number of modes measured, plus some more with measured shapes; 10 without a measurement."""
    measurement = specimen.measurement
    if measurement is None:
        return DEFAULT_MODES
    return measurement.size + (spare_modes(measurement) if measurement.shapes is not None else 0)


@dataclass(frozen=True, slots=True)
class MeasuredFrequency:
    """A measured frequency beside a mode, Hz; by : its shape, its label, or its place in the list."""

    hz: float
    by: Literal["shape", "label", "order"]


def measured_of_modes(
    specimen: Specimen, modes: Sequence[Mode], by_shape: ShapePairing | None = None
) -> list[MeasuredFrequency | None]:
    """The measured frequency of every mode, by shape or label, the others in order.

    Those of an incomplete list are beside a mode only by shape or label.

    by_shape : the pairing by measured shapes; without it, shapes are beside no mode
    """
    found: list[MeasuredFrequency | None] = [None] * len(modes)
    measurement = specimen.measurement
    if measurement is None or (measurement.shapes is not None and by_shape is None):
        return found
    known = modes_of_labels(measurement.labels, modes)
    if by_shape is not None:
        known = {i: int(j) for i, j in enumerate(by_shape.modes) if j >= 0}
    for i, j in known.items():
        hz = float(measurement.frequencies[i])
        found[j] = MeasuredFrequency(hz, "label" if by_shape is None else "shape")
    if not measurement.complete:
        return found
    left = (j for j, taken in enumerate(found) if taken is None)
    plain = (
        f
        for i, (f, label) in enumerate(zip(measurement.frequencies, measurement.labels, strict=True))
        if not label and i not in known
    )
    for j, f in zip([*left], plain, strict=False):
        found[j] = MeasuredFrequency(float(f), "order")
    return found
