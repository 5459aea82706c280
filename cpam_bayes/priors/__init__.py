"""Prior densities of one parameter: uniform, truncated normal, truncated Student-t, mixtures of two."""

from cpam_bayes.priors.densities import Prior, ScaledStudentT, TruncatedNormal, Uniform
from cpam_bayes.priors.mixture import Mixture

__all__ = ["Mixture", "Prior", "ScaledStudentT", "TruncatedNormal", "Uniform"]
