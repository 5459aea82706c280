"""Prior densities of one parameter: uniform, normal, log-normal, Student-t, mixtures of two."""

from cpam_bayes.priors.densities import Prior, ScaledStudentT, TruncatedNormal, Uniform
from cpam_bayes.priors.lognormal import TruncatedLogNormal
from cpam_bayes.priors.mixture import Mixture

__all__ = ["Mixture", "Prior", "ScaledStudentT", "TruncatedLogNormal", "TruncatedNormal", "Uniform"]
