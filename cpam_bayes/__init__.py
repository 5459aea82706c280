"""Elastic constants of composite plates from their natural frequencies.

    import cpam_bayes as cb

    plate = cb.read_plate("C1")     # a built-in specimen, the path of a plate file, or its content
    cb.poles("tap.unv")             # from frequency responses to a table of modes
    cb.forward(plate)               # natural frequencies from the reference constants
    cb.identify(plate, seed=0)      # constants by the particle swarm
    cb.sample(plate, seed=0)        # their posterior by emcee
    cb.predict(posterior, plate)    # frequencies of another plate of the same material
    cb.design(plate)                # which specimen would determine the constants
    cb.sequence(plate)              # the probability of every stacking sequence
    cb.diagnose(plate)              # what the simulation gets wrong, and why
    cb.full_report(plate)           # constants, stacking sequences and diagnosis, for one page
    cb.batch(plate, other_plate)    # many plates, one row each, with limits and a control chart
    cb.sensitivity(plate)           # the paper's noise study beside the posterior

Every result has `summary()`, `to_dict()`, `plot()`, `save()`, `warnings` and `status`. Names are loaded
when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from cpam_bayes import effects as effects
    from cpam_bayes import paper as paper
    from cpam_bayes.batches.batch import batch as batch
    from cpam_bayes.combined import full_report as full_report
    from cpam_bayes.deadline import time_limit as time_limit
    from cpam_bayes.diagnosis.plates import diagnose as diagnose
    from cpam_bayes.forward_model.builtin import plates as plates
    from cpam_bayes.forward_model.export import export as export
    from cpam_bayes.forward_model.new_plate import new as new
    from cpam_bayes.forward_model.solve import forward as forward
    from cpam_bayes.forward_model.stored_models import cache as cache
    from cpam_bayes.identification.identify import identify as identify
    from cpam_bayes.identification.sampled import sample as sample
    from cpam_bayes.identification.starting import posterior as posterior
    from cpam_bayes.modal_analysis.poles import poles as poles
    from cpam_bayes.plate.reader import builtin_plates as builtin_plates
    from cpam_bayes.plate.reader import read_plate as read_plate
    from cpam_bayes.prediction.predict import predict as predict
    from cpam_bayes.repetition.sensitivity import sensitivity as sensitivity
    from cpam_bayes.result import Result as Result
    from cpam_bayes.specimen_design.design import design as design
    from cpam_bayes.stacking.sequence import sequence as sequence

# Public name -> the module that holds it.
_PUBLIC = {
    "Result": "cpam_bayes.result",
    "batch": "cpam_bayes.batches.batch",
    "builtin_plates": "cpam_bayes.plate.reader",
    "cache": "cpam_bayes.forward_model.stored_models",
    "design": "cpam_bayes.specimen_design.design",
    "diagnose": "cpam_bayes.diagnosis.plates",
    "export": "cpam_bayes.forward_model.export",
    "forward": "cpam_bayes.forward_model.solve",
    "full_report": "cpam_bayes.combined",
    "identify": "cpam_bayes.identification.identify",
    "new": "cpam_bayes.forward_model.new_plate",
    "plates": "cpam_bayes.forward_model.builtin",
    "poles": "cpam_bayes.modal_analysis.poles",
    "posterior": "cpam_bayes.identification.starting",
    "predict": "cpam_bayes.prediction.predict",
    "read_plate": "cpam_bayes.plate.reader",
    "sample": "cpam_bayes.identification.sampled",
    "sensitivity": "cpam_bayes.repetition.sensitivity",
    "sequence": "cpam_bayes.stacking.sequence",
    "time_limit": "cpam_bayes.deadline",
}
_PACKAGES = ("effects", "paper")

__all__ = [
    "Result",
    "batch",
    "builtin_plates",
    "cache",
    "design",
    "diagnose",
    "effects",
    "export",
    "forward",
    "full_report",
    "identify",
    "new",
    "paper",
    "plates",
    "poles",
    "posterior",
    "predict",
    "read_plate",
    "sample",
    "sensitivity",
    "sequence",
    "time_limit",
]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    if name in _PACKAGES:
        return import_module(f"cpam_bayes.{name}")
    raise AttributeError(f"module 'cpam_bayes' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
