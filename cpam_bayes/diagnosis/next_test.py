"""Further tests in the laboratory, ranked by the information of their data about the cause."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp, ndtri
from scipy.stats import qmc

from cpam_bayes.diagnosis.comparison import SCATTER, PlateCase
from cpam_bayes.diagnosis.diagnose import Diagnosis
from cpam_bayes.diagnosis.evidence.sampled import shared_out
from cpam_bayes.diagnosis.evidence.weighing import Tested, Weighed
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, inclusion_of
from cpam_bayes.diagnosis.models import ConvergedPlate, extended_on_space, plate_under_test
from cpam_bayes.effects import Effect, extend
from cpam_bayes.forward_model.composed import Change, ComposedModel, Part
from cpam_bayes.forward_model.local.modal import ModalPlate, changed_on_modes, on_modes
from cpam_bayes.forward_model.model import ForwardModel, PlateModel, model_on_basis
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Sensor
from cpam_bayes.plate.edges import ALL_FREE, CANTILEVER, conditions
from cpam_bayes.running import single_blas_thread

# Number of further modes; a known mass over the plate's, and its distance from a corner over the sides.
MORE_MODES = 4
_MASS_SHARE, _CORNER = 0.02, 0.05
# Relative standard deviations of weighing and of measuring the thickness at many points.
WEIGHED, GAUGED = 1e-3, 3e-3
# Least number of draws at which a test is solved, draws per term of the response surface that extends it to
# the other draws, and how far beyond the solved ones it is used, standard deviations.
_SOLVED, _PER_TERM, _BEYOND = 96, 2.5, 1.0
# Tail weight, on either side, beyond the draws at which the modes of a plate with an effect are taken.
_TAIL = 0.02


@dataclass(frozen=True, slots=True)
class Predicted:
    """Data of a test under one hypothesis.

    y : (d, n) at its draws, frequencies in Hz. missing : (n, n) relative covariance that y lacks. noise :
    (n,) relative standard deviations of data that are no frequencies, or ``None``. as_now : whether the
    unexplained discrepancy of the present list is in these data too.
    """

    y: Array
    missing: Array
    noise: Array | None = None
    as_now: bool = True


Predict = Callable[[Tested], Predicted]


@dataclass(frozen=True, slots=True)
class FurtherTest:
    """A possible test; ``prepare`` builds its models and returns the predictor of its data."""

    name: str
    description: str
    prepare: Callable[[], Predict]


def further_tests(
    cases: Sequence[PlateCase], about: int, last_mode: int, scatter: float
) -> list[FurtherTest]:
    """Possible tests of one plate; last_mode : number of the highest mode that any hypothesis lists."""
    case = cases[about]
    present = case.models.specimen
    plate, n = present.plate, case.measurement.size
    tests: list[FurtherTest] = []
    edges, held = (
        (CANTILEVER, "clamped on the edge x = 0") if plate.edges == ALL_FREE else (ALL_FREE, "hung free")
    )
    tried = {c.models.specimen.plate.edges for c in cases if c.models.specimen.specimen == present.specimen}
    if edges not in tried:

        def other_edges() -> Predict:
            specimen = replace(present, plate=replace(plate, edges=edges))
            converged, full = plate_under_test(specimen, n)
            return lambda t: _under_test(t, about, converged, full, np.arange(n))

        tests.append(FurtherTest("edge_condition", f"the same plate {held}, {n} modes", other_edges))

    def more_modes() -> Predict:
        converged, full = plate_under_test(present, last_mode + 1 + MORE_MODES)
        return lambda t: _under_test(t, about, converged, full, _next_modes(t, about))

    tests.append(FurtherTest("more_modes", f"the next {MORE_MODES} modes of the same plate", more_modes))
    mass = _MASS_SHARE * plate.density * plate.thickness * plate.area
    for name, where, (x, y) in places(plate.edges):
        sensor = Sensor(mass, x * plate.length, y * plate.width)

        def loaded(sensor: Sensor = sensor) -> Predict:
            full = model_on_basis(
                case.models.problem,
                case.models.samples.x,
                case.models.n_modes,
                case.models.error,
                (case.models.settings, case.models.keep),
            )
            return lambda t: _under_test(t, about, case.models, full, np.arange(n), (sensor,))

        text = f"the same plate with a known mass of {1e3 * mass:.3g} g {where}, {n} modes"
        tests.append(FurtherTest(name, text, loaded))
    text = f"a sister plate of the same material, {n} modes"
    tests.append(FurtherTest("sister_plate", text, lambda: lambda t: _sister(t, about, case, scatter)))
    # only what the file does not state as precisely already
    weighs, gauges = not plate.is_weighed_to(WEIGHED), not plate.is_gauged_to(GAUGED)
    steps = [f"weighing the plate to {100 * WEIGHED:g} %"] if weighs else []
    steps += [f"gauging its thickness to {100 * GAUGED:g} %"] if gauges else []
    if steps:

        def weighed() -> Predict:
            return lambda t: _weighing(t, about, case, weighs=weighs, gauges=gauges)

        tests.append(FurtherTest("weighing", " and ".join(steps), weighed))
    return tests


def places(edges: str) -> list[tuple[str, str, tuple[float, float]]]:
    """Places for a known mass: a corner between two free edges, and the centre."""
    held = conditions(edges)
    corners = [
        (x, y)
        for x, of_x in ((1.0 - _CORNER, 2), (_CORNER, 0))
        for y, of_y in ((1.0 - _CORNER, 3), (_CORNER, 1))
        if held[of_x].is_free and held[of_y].is_free
    ]
    corner = [("mass_at_corner", "at a free corner", at) for at in corners[:1]]
    return [*corner, ("mass_at_centre", "at the centre", (0.5, 0.5))]


def _next_modes(t: Tested, about: int) -> Array:
    """Modes after the last one that is listed under a hypothesis."""
    return int(t.marginal.comparison.model.parts[about].modes.max()) + 1 + np.arange(MORE_MODES)


@dataclass(frozen=True, slots=True)
class _Drawn:
    """Draws of a hypothesis for one plate: vectors (d, n) of constants and sizes, then of its effects.

    n_plate : number of constants and sizes
    effects : of this plate, with the columns of their parameters
    """

    v: Array
    n_plate: int
    effects: tuple[tuple[Effect, tuple[int, ...]], ...]


def _drawn(t: Tested, about: int) -> _Drawn:
    part, x = t.marginal.comparison.model.parts[about], t.marginal.draws
    columns, effects = [part.plate_vector(x)], []
    n = at = columns[0].shape[1]
    if part.changes:
        for effect, change in zip(t.hypothesis.effects, part.changes, strict=True):
            columns.append(x[:, list(change.columns)])
            effects.append((effect, tuple(range(at, at + len(change.columns)))))
            at += len(change.columns)
    return _Drawn(np.concatenate(columns, axis=1), n, tuple(effects))


def _composed(
    drawn: _Drawn, parameters: ParameterSet, bare: ForwardModel, modes: Array, changes: Sequence[Change]
) -> ComposedModel:
    further = tuple(p for effect, _ in drawn.effects for p in effect.parameters)
    every = ParameterSet((*parameters.parameters, *further))
    part = Part(bare, np.arange(drawn.n_plate), np.full(drawn.n_plate, -1), tuple(changes), modes)
    return ComposedModel(every, (part,))


def _under_test(
    t: Tested,
    about: int,
    plate: ConvergedPlate,
    full: PlateModel,
    modes: Array,
    masses: tuple[Sensor, ...] = (),
) -> Predicted:
    """Frequencies of the plate with its effects under a test; an effect that is impossible there is dropped.

    full : the plate without the known masses that the test adds
    """
    drawn, weight = _drawn(t, about), np.exp(t.marginal.log_weight)
    bare = on_modes(full, (weight / weight.sum() @ drawn.v)[None, : drawn.n_plate], masses)
    plate = replace(plate, facts=replace(plate.facts, loaded=plate.facts.loaded or bool(masses)))
    changes = []
    for effect, columns in drawn.effects:
        names = tuple(p.name for p in effect.parameters)
        if effect.change is None:
            changes.append(Change(names, columns, None, effect.observe))
        elif effect.applies_to(plate.facts):
            changes.append(
                Change(names, columns, _with_effect(plate, bare, effect, drawn, columns, weight, masses))
            )
    model = _composed(drawn, plate.parameters, bare.model, modes, changes)
    return _response(model, drawn, weight)


def _with_effect(
    plate: ConvergedPlate,
    bare: ModalPlate,
    effect: Effect,
    drawn: _Drawn,
    columns: tuple[int, ...],
    weight: Array,
    masses: tuple[Sensor, ...],
) -> ForwardModel:
    """Model of the plate with an effect under a test, on its own modes or the bare one's (free place)."""
    if effect.is_anywhere:
        return changed_on_modes(bare, effect)
    v = drawn.v[:, [*range(drawn.n_plate), *columns]]
    if not columns:
        return on_modes(extended_on_space(plate, effect), weight[None] / weight.sum() @ v, masses).model
    order = np.argsort(v[:, drawn.n_plate], kind="stable")
    below = np.cumsum(weight[order]) / weight.sum()
    tails = order[np.searchsorted(below, (_TAIL, 1.0 - _TAIL)).clip(max=len(v) - 1)]
    at = np.vstack((weight / weight.sum() @ v, v[tails]))
    return on_modes(extended_on_space(plate, effect), at, masses).model


def _response(model: ComposedModel, drawn: _Drawn, weight: Array) -> Predicted:
    """Frequencies at all draws, by a response surface from some of them where there are many.

    The relative scatter of the solved draws about the surface is ``missing``. Log frequencies are quadratic
    in each logarithm of a constant or size and in each parameter of an effect.
    """
    v, weight = drawn.v.copy(), weight / weight.sum()
    v[:, : drawn.n_plate] = np.log(v[:, : drawn.n_plate])
    mean = weight @ v
    sd = np.sqrt(weight @ (v - mean) ** 2)
    varied = np.flatnonzero(sd > 1e-12)
    n = 1 + 2 * len(varied)
    least = round(_PER_TERM * n)
    size = max(_SOLVED, least)
    if len(v) <= size:
        f = model.predict(drawn.v).frequencies
        return Predicted(f, np.zeros((f.shape[1], f.shape[1])))
    cumulative = np.cumsum(weight)
    levels = (np.arange(size) + 0.5) / size
    rows = np.unique(np.searchsorted(cumulative / cumulative[-1], levels).clip(max=len(v) - 1))
    if len(rows) < least:  # a few draws hold most of the weight, and a response needs more than these
        rows = np.argsort(-weight, kind="stable")[:least]
    u = (v[:, varied] - mean[varied]) / sd[varied]
    u = np.clip(u, u[rows].min(axis=0) - _BEYOND, u[rows].max(axis=0) + _BEYOND)
    terms = np.column_stack((np.ones(len(v)), u, u**2))
    log_f = np.log(model.predict(drawn.v[rows]).frequencies)
    slopes, *_ = np.linalg.lstsq(terms[rows], log_f, rcond=None)
    left = log_f - terms[rows] @ slopes
    missing = np.sum(left**2, axis=0) / max(len(rows) - n, 1)
    return Predicted(np.exp(terms @ slopes), np.diag(missing))


def _sister(t: Tested, about: int, case: PlateCase, scatter: float) -> Predicted:
    """Frequencies of a sister plate: its constants scatter about these, its sizes within their tolerances.

    The added covariance is propagated to the frequencies by their derivatives at the mean.
    """
    drawn = _drawn(t, about)
    parameters, unknowns = case.models.parameters.parameters, case.models.specimen.unknowns
    v = drawn.v.copy()
    for j, parameter in enumerate(parameters):
        if parameter.name not in unknowns:
            v[:, j] = parameter.prior.mean
    changes = []
    for effect, columns in drawn.effects:
        if effect.is_common_to_sisters:
            names = tuple(p.name for p in effect.parameters)
            own_model = None if effect.change is None else case.with_effect(effect)
            changes.append(Change(names, columns, own_model, effect.observe))
    modes = np.arange(case.measurement.size)
    model = _composed(drawn, case.models.parameters, case.models.bare, modes, changes)
    predicted = _response(model, replace(drawn, v=v), np.exp(t.marginal.log_weight))
    mean = np.average(v, axis=0, weights=np.exp(t.marginal.log_weight))
    at = model.predict(mean[None], jacobian=True)
    assert at.jacobian is not None
    spread = [scatter if p.name in unknowns else p.prior.sd / p.prior.mean for p in parameters]
    slope = at.jacobian[0, :, : drawn.n_plate] * mean[: drawn.n_plate] / at.frequencies[0, :, None] * spread
    return replace(predicted, missing=predicted.missing + slope @ slope.T, as_now=False)


def _weighing(
    t: Tested, about: int, case: PlateCase, *, weighs: bool = True, gauges: bool = True
) -> Predicted:
    """Mass, kg, and thickness, m, of the plate, or one of them; the clamped part is not weighed."""
    drawn = _drawn(t, about)
    problem, facts = case.models.problem, case.models.facts
    names = list(case.models.parameters.names)
    for effect, _ in drawn.effects:
        names += [p.name for p in effect.parameters]
        if effect.change is not None and effect.belongs_to != "test":
            # a balance does not see the place
            anywhere = {p.name: np.asarray(p.prior.mean) for p in effect.coordinates}
            problem = extend(problem, effect.fixed(anywhere), facts)
    values = dict(zip(names, drawn.v.T, strict=True))
    state = problem.state({name: values[name] for name in problem.parameters.names})
    one = np.ones(len(drawn.v))
    y = np.stack((state.density * state.thickness * state.area * one, state.thickness * one), axis=1)
    asked = np.array([weighs, gauges])
    y, noise = y[:, asked], np.array([WEIGHED, GAUGED])[asked]
    return Predicted(y, np.zeros((len(noise), len(noise))), noise, as_now=False)


# Causes to be distinguished: until they hold this probability, at most so many, in at most so many variants.
_ENOUGH, _MOST_CAUSES, _MOST_VARIANTS = 0.99, 6, 10
# Simulated data, log2, of each hypothesis; probability from which a cause counts as identified.
_LOG2_DATA, _IDENTIFIED = 10, 0.9


@dataclass(frozen=True, slots=True)
class Candidate:
    """A further test and its expected information.

    information : mutual information of its data and the cause, nats
    possible : upper bound of the information: the entropy of the cause, nats
    decided : probability that the true cause has a posterior above 0.9 afterwards
    """

    name: str
    description: str
    information: float
    possible: float
    decided: float


@dataclass(frozen=True, slots=True)
class Outlook:
    """Data of a test as predicted by k hypotheses, each a Gaussian.

    probability : (k,)
    cause : (k,) number of the cause that a hypothesis is a variant of
    mean : (k, n)
    covariance : (k, n, n), noise included
    """

    probability: Array
    cause: Array
    mean: Array
    covariance: Array


@single_blas_thread
def next_measurements(
    diagnosis: Diagnosis,
    *,
    always: bool = False,
    scatter: float = SCATTER,
    executor: Executor | None = None,
    notify: Callable[[str], None] = lambda text: None,
) -> tuple[Candidate, ...]:
    """Tests of the plate that the leading cause concerns, the most informative first.

    Another edge condition, four more modes, a known mass at a corner and at the centre, a sister plate of
    the same material, weighing and gauging where the file does not state as much. Every hypothesis predicts
    the data from its own posterior, with the stated noise of the list or its own posterior of an inferred
    one.

    always : also where nothing is wrong or the cause is named
    executor : where the tests are evaluated
    """
    if _is_settled(diagnosis) and not always:
        return ()
    leading = leading_hypotheses(diagnosis.weighed)
    if len({t.hypothesis.cause for t in leading}) < 2:
        return ()
    about = next((t.plates[0] for t in leading if t.hypothesis.cause not in (NONE, OTHER)), 0)
    last = max(int(t.marginal.comparison.model.parts[about].modes.max()) for t in leading)
    tests = further_tests(diagnosis.cases, about, last, scatter)
    notify(f"predicting {len(tests)} further tests")
    asked = _Asked(diagnosis.cases, about, last, scatter, leading)
    items = [(asked, number) for number in range(len(tests))]
    predicted = shared_out(_candidate, diagnosis.cases, items, executor, common=asked)
    candidates = []
    for test, candidate in zip(tests, predicted, strict=True):
        if candidate is None:
            notify(
                f"{test.description}: a cause leaves a plate that cannot be told from a rigid body; left out"
            )
        else:
            candidates.append(candidate)
    return tuple(sorted(candidates, key=lambda c: -c.information))


def _is_settled(diagnosis: Diagnosis) -> bool:
    """Whether no causes are left to distinguish: none is claimed, or one with nothing open beside it."""
    claim = diagnosis.claim
    return claim.kind == NONE or (claim.kind == "named" and not diagnosis.beside)


@dataclass(frozen=True, slots=True)
class _Asked:
    """Arguments that all tests share, as in `further_tests` and `outlook_of`."""

    cases: Sequence[PlateCase]
    about: int
    last_mode: int
    scatter: float
    leading: tuple[Tested, ...]


def _candidate(asked: _Asked, number: int) -> Candidate | None:
    """Candidate for the numbered test, ``None`` where its data cannot be predicted."""
    test = further_tests(asked.cases, asked.about, asked.last_mode, asked.scatter)[number]
    try:
        outlook = outlook_of(asked.leading, asked.cases[asked.about], test.prepare())
    except RigidBodyError:
        return None
    return Candidate(test.name, test.description, *information(outlook))


def leading_hypotheses(weighed: Weighed) -> tuple[Tested, ...]:
    """Best variants of the most probable causes, which carry the whole probability of these.

    Causes are taken until they hold 99 %, at most six, with at most ten variants in all. A set counts for its
    most probable cause where it is less probable than that.
    """
    weighed = replace(weighed, tested=tuple(_counted(weighed)))
    causes: dict[str, float] = {}
    for name, p in weighed.by_cause().items():
        if sum(causes.values()) >= _ENOUGH or len(causes) == _MOST_CAUSES:
            break
        causes[name] = p
    of_these = [t for t in weighed.tested if t.hypothesis.cause in causes]
    best = [next(t for t in of_these if t.hypothesis.cause == name) for name in causes]
    chosen = {
        id(t) for t in [*best, *(t for t in of_these if all(t is not b for b in best))][:_MOST_VARIANTS]
    }
    kept = [t for t in of_these if id(t) in chosen]
    held = {name: sum(t.probability for t in kept if t.hypothesis.cause == name) for name in causes}
    whole = [
        replace(t, probability=t.probability * causes[t.hypothesis.cause] / held[t.hypothesis.cause])
        for t in kept
        if held[t.hypothesis.cause] > 0.0
    ]
    return tuple(sorted(whole, key=lambda t: -t.probability))


def _counted(weighed: Weighed) -> Iterator[Tested]:
    """Hypotheses, each renamed to the cause or set it counts for."""
    probability = weighed.by_cause()
    inclusion = inclusion_of(probability)
    for t in weighed.tested:
        name = max(t.hypothesis.causes, key=lambda c: inclusion[c], default=t.hypothesis.cause)
        is_set = probability.get(name, 0.0) < probability[t.hypothesis.cause]
        yield t if is_set else replace(t, hypothesis=replace(t.hypothesis, cause=name))


def information(outlook: Outlook, log2_data: int = _LOG2_DATA) -> tuple[float, float, float]:
    """Mutual information of cause and data, entropy of the cause, and probability that it is identified.

    I = H(C) - E H(C | y), with data y drawn under every hypothesis by one scrambled Sobol sequence. The cause
    is identified where the true one has a posterior above 0.9.
    """
    n_data = outlook.mean.shape[1]
    p = outlook.probability / outlook.probability.sum()
    of_cause = (outlook.cause[:, None] == np.unique(outlook.cause)).astype(float)  # (k, n_causes)
    uniform = qmc.Sobol(n_data, rng=np.random.default_rng(0)).random_base2(log2_data)
    normal = ndtri(np.clip(uniform, 1e-12, 1 - 1e-12))
    factor = np.linalg.cholesky(outlook.covariance)
    y = outlook.mean[:, None] + normal @ np.swapaxes(factor, 1, 2)  # (k, draws, n)
    back = np.linalg.inv(factor)
    log_det = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
    z = np.einsum("jab,kdjb->kdja", back, y[:, :, None] - outlook.mean)
    with np.errstate(divide="ignore"):
        log_joint = np.log(p) - log_det - 0.5 * np.sum(z**2, axis=-1)  # (k, draws, k)
    after = np.exp(log_joint - logsumexp(log_joint, axis=-1, keepdims=True)) @ of_cause
    possible = float(_entropies(p @ of_cause))
    left = float(p @ _entropies(after).mean(axis=1))
    right = np.take_along_axis(after, of_cause.argmax(axis=1)[:, None, None], axis=-1)[..., 0]
    decided = float(p @ (right > _IDENTIFIED).mean(axis=1))
    return max(possible - left, 0.0), possible, decided


def _entropies(p: Array) -> Array:
    return np.asarray(-np.sum(p * np.log(np.maximum(p, 1e-300)), axis=-1))


def outlook_of(leading: Sequence[Tested], case: PlateCase, predict: Predict) -> Outlook:
    """Data of a test under each hypothesis, as relative deviations from the first one's prediction."""
    means, covariances = [], []
    unit: Array | None = None
    for t in leading:
        prediction = predict(t)
        weight = np.exp(t.marginal.log_weight)
        weight /= weight.sum()
        if unit is None:
            unit = np.asarray(weight @ prediction.y)
        y = prediction.y / unit
        mean = weight @ y
        if prediction.noise is not None:
            noise_variance = prediction.noise**2
        else:
            noise_variance = _noise(t, case, unit, prediction.as_now)
        spread = (y - mean).T @ ((y - mean) * weight[:, None])
        covariances.append(spread + np.diag(noise_variance) + prediction.missing)
        means.append(mean)
    causes = list(dict.fromkeys(t.hypothesis.cause for t in leading))
    return Outlook(
        np.array([t.probability for t in leading]),
        np.array([causes.index(t.hypothesis.cause) for t in leading]),
        np.stack(means),
        np.stack(covariances),
    )


def _noise(t: Tested, case: PlateCase, f: Array, as_now: bool) -> Array:
    """Relative variance of frequencies (n,) beyond the spread of the draws."""
    comparison, measurement = t.marginal.comparison, case.measurement
    weight = np.exp(t.marginal.log_weight)
    weight /= weight.sum()
    if measurement.frequency_sd is not None:
        variance = float(np.mean((measurement.frequency_sd / measurement.frequencies) ** 2))
    elif measurement.relative_std is not None:
        variance = measurement.relative_std**2
    else:
        # averaged over several lists: a further test is like any of them
        inferred = [c for c in comparison.amplitudes if c >= 0]
        variance = float(np.mean(weight @ t.marginal.draws[:, inferred] ** 2))
    if comparison.discrepancy is not None and as_now:
        variance += float(weight @ t.marginal.draws[:, comparison.discrepancy] ** 2)
    variance += float(np.mean(case.models.error**2))
    return np.asarray(variance + measurement.resolution**2 / 12 / f**2)
