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
    cb.diagnose(plate)              # what is wrong with plate, list or model
    cb.report(plate)                # constants, stacking sequences and diagnosis, for one page
    cb.batch(plate, other_plate)    # many plates, one row each, with limits and a control chart
    cb.compare(plate, other_plate)  # do their constants differ?
    cb.sensitivity(plate)           # the paper's noise study beside the posterior
    cb.calibrate(plate)             # do its intervals cover the truth as often as they claim?
    cb.app("plates")                # a page on this machine that updates the constants as you type
    cb.prove(plate, with_coin)      # what was stuck to the plate, how heavy, where?
    cb.paper(5)                     # a table of the paper beside what this package computes

Every result has `summary()`, `to_dict()`, `plot()`, `save()`, `warnings` and `status`. Names are loaded
when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:
    from cpam_bayes import effects as effects
    from cpam_bayes.identification.search import posterior
    from cpam_bayes.plate.reader import builtin_plates, read_plate
    from cpam_bayes.questions.app import app
    from cpam_bayes.questions.batch import batch
    from cpam_bayes.questions.calibrate import calibrate
    from cpam_bayes.questions.compare import compare
    from cpam_bayes.questions.design import design
    from cpam_bayes.questions.diagnose import diagnose
    from cpam_bayes.questions.export import export
    from cpam_bayes.questions.forward import forward
    from cpam_bayes.questions.identify.emcee import sample
    from cpam_bayes.questions.identify.pso import identify
    from cpam_bayes.questions.new import new
    from cpam_bayes.questions.paper import paper
    from cpam_bayes.questions.plates import plates
    from cpam_bayes.questions.poles import poles
    from cpam_bayes.questions.predict import predict
    from cpam_bayes.questions.prove import prove
    from cpam_bayes.questions.report import report
    from cpam_bayes.questions.sensitivity import sensitivity
    from cpam_bayes.questions.sequence import sequence
    from cpam_bayes.result import Result as Result
    from cpam_bayes.running import time_limit as time_limit

# Public name -> the module that holds it.
_PUBLIC = {
    "Result": "cpam_bayes.result",
    "app": "cpam_bayes.questions.app",
    "batch": "cpam_bayes.questions.batch",
    "builtin_plates": "cpam_bayes.plate.reader",
    "calibrate": "cpam_bayes.questions.calibrate",
    "compare": "cpam_bayes.questions.compare",
    "design": "cpam_bayes.questions.design",
    "diagnose": "cpam_bayes.questions.diagnose",
    "export": "cpam_bayes.questions.export",
    "forward": "cpam_bayes.questions.forward",
    "report": "cpam_bayes.questions.report",
    "identify": "cpam_bayes.questions.identify.pso",
    "new": "cpam_bayes.questions.new",
    "paper": "cpam_bayes.questions.paper",
    "plates": "cpam_bayes.questions.plates",
    "poles": "cpam_bayes.questions.poles",
    "posterior": "cpam_bayes.identification.search",
    "predict": "cpam_bayes.questions.predict",
    "prove": "cpam_bayes.questions.prove",
    "read_plate": "cpam_bayes.plate.reader",
    "sample": "cpam_bayes.questions.identify.emcee",
    "sensitivity": "cpam_bayes.questions.sensitivity",
    "sequence": "cpam_bayes.questions.sequence",
    "time_limit": "cpam_bayes.running",
}
_PACKAGES = ("effects",)

__all__ = [
    "Result",
    "app",
    "batch",
    "builtin_plates",
    "calibrate",
    "compare",
    "design",
    "diagnose",
    "effects",
    "export",
    "forward",
    "identify",
    "new",
    "paper",
    "plates",
    "poles",
    "posterior",
    "predict",
    "prove",
    "read_plate",
    "report",
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
