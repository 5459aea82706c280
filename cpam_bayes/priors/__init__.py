"""Prior densities of one parameter: uniform, normal, log-normal, log-uniform, Student-t, mixtures of two."""

from cpam_bayes.priors.densities import Prior, ScaledStudentT, TruncatedNormal, Uniform
from cpam_bayes.priors.lognormal import LogUniform, TruncatedLogNormal
from cpam_bayes.priors.mixture import Mixture

__all__ = [
    "LogUniform",
    "Mixture",
    "Prior",
    "ScaledStudentT",
    "TruncatedLogNormal",
    "TruncatedNormal",
    "Uniform",
]
