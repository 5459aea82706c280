"""Models of plates with their effects, built side by side before hypotheses are fitted."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace

from cpam_bayes.deadline import TimeIsUpError
from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.diagnosis.hypotheses import Hypothesis
from cpam_bayes.diagnosis.models import (
    PlateModels,
    built_bare,
    built_model,
    extended_model,
    is_bare_stored,
    is_stored,
    needs_another_space,
    plate_models,
)
from cpam_bayes.effects import Effect, extend
from cpam_bayes.forward_model.local.model import LocalModel
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.forward_model.store import without_matrices
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.parallel import counted, run

Model = ReducedModel | LocalModel


def build_models(
    cases: Sequence[PlateCase],
    hypotheses: Sequence[tuple[Hypothesis, tuple[int, ...]]],
    executor: Executor | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Build the models that hypotheses need and that are not on disk, on all workers of an executor.

    Workers hand the models back and this process stores them, so that a worker that is stopped leaves no
    file. The models are the same bit for bit on any executor. What cannot be sent to a worker, an effect of a
    script for instance, is left to be built when it is asked for.
    """
    wanted = _wanted(cases, hypotheses)
    if not wanted:
        return
    plates = [replace(case.models, bare=without_matrices(case.models.bare)) for case in cases]

    count = counted(progress, len(wanted))

    def store(index: int, built: Model | None) -> None:
        i, effect = wanted[index]
        case = cases[i]
        if effect is None and isinstance(built, ReducedModel):
            specimen, n_modes = case.models.specimen, case.models.n_modes
            case.of_another_material.append(plate_models(specimen, n_modes, other_material=True, built=built))
        elif effect is not None and built is not None:
            model = extended_model(case.models, effect, built=built)
            case.extended[effect.name, effect.variant] = model
        count(index, None)

    progress(0, len(wanted))
    with suppress(TimeIsUpError):  # the hypotheses that need what is missing are not tested
        run(_built, plates, wanted, executor, batch_size=1, on_result=store, is_limited=True)


def _built(plates: Sequence[PlateModels], item: tuple[int, Effect | None]) -> Model | None:
    """The model of a plate with an effect, or of another material; ``None`` where it has no modes."""
    i, effect = item
    try:
        if effect is None:
            return built_bare(plates[i].specimen, plates[i].n_modes)
        return built_model(plates[i], effect)
    except RigidBodyError:  # it is said where the hypothesis is tested
        return None


def _wanted(
    cases: Sequence[PlateCase], hypotheses: Sequence[tuple[Hypothesis, tuple[int, ...]]]
) -> list[tuple[int, Effect | None]]:
    """Plates with the effects of their models, ``None`` for another material; what takes longest first."""
    wanted: dict[tuple[int, str, str], tuple[int, int, Effect | None]] = {}
    for hypothesis, plates in hypotheses:
        for i in plates:
            case = cases[i]
            models = case.models
            of_another = hypothesis.other_material and not case.of_another_material
            if of_another and not is_bare_stored(models.specimen, models.n_modes):
                wanted[i, "", ""] = (0, i, None)
            for effect in hypothesis.effects:
                key = (i, effect.name, effect.variant)
                known = key in wanted or key[1:] in case.extended or effect.change is None
                if not known and not is_stored(models, effect) and _can_be_sent(effect):
                    wanted[key] = (1 - int(_is_converged_anew(models, effect)), i, effect)
    return [(i, effect) for _, i, effect in sorted(wanted.values(), key=lambda entry: entry[0])]


def _is_converged_anew(models: PlateModels, effect: Effect) -> bool:
    if effect.is_anywhere:
        return False
    return needs_another_space(extend(models.problem, effect, models.facts), effect, models)


def _can_be_sent(effect: Effect) -> bool:
    try:
        pickle.dumps(effect)
    except (pickle.PicklingError, AttributeError, TypeError):
        return False
    return True
