"""A new effect is one record and one line: a foam strip under an edge, which no file of the package knows."""

import inspect
import json
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from cpam_bayes.effects import CATALOGUE, Effect, PlateFacts, extend
from cpam_bayes.effects.effect import one_sided, stacked
from cpam_bayes.effects.table import catalogue_table
from cpam_bayes.mechanics.affine import ONE, Bell, Product
from cpam_bayes.mechanics.fem import discretise_sparse, fem_space
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.mechanics.problem import Array, Atom, Form, PlateState, Problem, Term, Values
from cpam_bayes.plate import Measurement, builtin
from cpam_bayes.questions.diagnose import DiagnosisResult, diagnose
from tests.effects import test_catalogue as contract
from tests.effects.cases import bare, facts

# Width of the strip over the plate's length; its stiffness fades with the distance from x = 0.
_STRIP = 0.12


def _foam(problem: Problem, facts: PlateFacts) -> Problem:
    """K += k integral of exp(-(x / (0.12 a))^2 / 2) w^2."""
    del facts
    form = Form(Atom("w"), Atom("w"), weight=Product(Bell(0.0, _STRIP), ONE))
    return replace(problem, supported=True).with_terms(Term("foam", "stiffness", (form,), _bedding))


def _bedding(state: PlateState, values: Values) -> Array:
    return stacked(values["foam_stiffness"] * state.area)


def _is_free(facts: PlateFacts) -> bool:
    return facts.edges == "FFFF"


def _weight(facts: PlateFacts) -> float:
    """A heavier plate presses the foam to a stiffer one."""
    return facts.thickness / 3e-3


FOAM = Effect(
    name="foam",
    title="foam strip under an edge",
    family="bedding",
    belongs_to="test",
    parameters=(one_sided("foam_stiffness", "N/m3", 1e5, 5e5, shown=("kN/m2/mm", 1e-6)),),
    note="k exp(-(x / (0.12 a))^2 / 2) on w, free plates only",
    check="Hang the plate on threads and measure again.",
    change=_foam,
    applies_to=_is_free,
    size_factor=_weight,
    sign=1,
)
CATALOGUE_WITH_FOAM = (*CATALOGUE, FOAM)

PLATE = "C1"


def _tests_of(*arguments: str) -> list[Callable[..., None]]:
    tests = [f for name, f in vars(contract).items() if name.startswith("test_")]
    return [f for f in tests if tuple(inspect.signature(f).parameters) == arguments]


# The contract of the catalogue


@pytest.mark.parametrize("claim", _tests_of("effect"), ids=lambda f: f.__name__)
def test_the_record_keeps_the_contract(claim: Callable[[Effect], None]) -> None:
    claim(FOAM)


@pytest.mark.parametrize("claim", _tests_of("plate", "effect"), ids=lambda f: f.__name__)
def test_the_model_keeps_the_contract(claim: Callable[[str, Effect], None]) -> None:
    claim(PLATE, FOAM)


@pytest.mark.parametrize("claim", _tests_of("plate", "effect", "sds"), ids=lambda f: f.__name__)
@pytest.mark.parametrize("sds", [0.0, 0.8])
def test_its_derivatives_keep_the_contract(claim: Callable[[str, Effect, float], None], sds: float) -> None:
    claim(PLATE, FOAM, sds)


def test_these_are_the_claims_of_the_contract() -> None:
    numbers = [len(_tests_of(*a)) for a in (("effect",), ("plate", "effect"), ("plate", "effect", "sds"))]
    assert numbers == [6, 6, 1]


def test_the_page_gets_its_rows() -> None:
    text = catalogue_table(CATALOGUE_WITH_FOAM)
    assert "| foam | foam strip under an edge | test | 0.1 kN/m2/mm | 0.5 kN/m2/mm |" in text
    assert text.startswith(catalogue_table()[:1000])


# The diagnosis


def listed_by_elements(size: float, n: int = 10) -> Measurement:
    """A frequency list of the plate on a foam, N/m3, by finite elements with 0.1 % of noise."""
    problem = extend(bare(PLATE), FOAM, facts(PLATE))
    values = {"foam_stiffness": np.array([size])}
    space = fem_space(problem.edges, problem.nominal, 20, 18)
    operator = discretise_sparse(problem, space, values)
    k, m = (np.atleast_2d(c) for c in operator.coefficients(values))
    f = solve(operator, k, m, n).frequencies[0] * (1.0 + 1e-3 * np.random.default_rng(1).standard_normal(n))
    return Measurement(np.round(f, 1), 0.1, 1e-3, None, ("",) * n, complete=True)


@lru_cache
def found() -> DiagnosisResult:
    hidden = replace(builtin(PLATE), measurement=listed_by_elements(2e5))
    return diagnose(hidden, catalogue=CATALOGUE_WITH_FOAM, next_test="never")


@pytest.mark.slow
@pytest.mark.weekly
def test_it_or_its_class_is_claimed_where_it_is_hidden() -> None:
    assert found().claim in ("named", "class")
    assert found().causes[0] == "foam"


@pytest.mark.slow
def test_it_is_in_the_document_with_its_unit_and_on_the_screen() -> None:
    document = json.loads(json.dumps(found().to_dict()))
    (entry,) = (h for h in document["hypotheses"] if h["cause"] == "foam")
    size = entry["parameters"]["foam_stiffness"]
    assert size["unit"] == "kN/m2/mm"
    assert size["mean"] == pytest.approx(0.2, abs=3.0 * size["sd"])
    # C1 is 3.2 mm thick
    assert document["priors"]["effects"]["foam"]["foam_stiffness"]["scale"] == pytest.approx(0.1 * 3.2 / 3)
    screen = found().summary(verbose=True)
    assert "foam" in screen
    assert "kN/m2/mm" in screen
    (line,) = (line for line in screen.splitlines() if FOAM.check in line)
    assert line.split() == f"{FOAM.title} {FOAM.check}".split()
