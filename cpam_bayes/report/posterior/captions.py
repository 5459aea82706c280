"""The words beside the figures of a sampled posterior."""

from __future__ import annotations

from cpam_bayes.formatting import listed
from cpam_bayes.identification.sampled import SampledResult
from cpam_bayes.report.modal_assurance.rows import assurance_captions
from cpam_bayes.report.sections import Caption, modes_caption


def captions(result: SampledResult) -> dict[str, Caption]:
    """A caption for each figure."""
    names = listed(list(result.posterior.parameters.names), "and")
    constants = listed([p.name for p in result.assessment.profiles], "and")
    rows = [row for row in result.frequencies if row is not None]
    return {
        "posterior": Caption(
            "Diagonal: the posterior of each parameter. Below: how two parameters go together; a slanted "
            "cloud says that the frequencies determine a combination of both better than either.",
            f"Pairs of posterior draws of {names}.",
        ),
        "marginals_and_profiles": Caption(
            "Above: a posterior (blue) much narrower than its prior (grey line) is determined by the "
            "frequencies; one as wide as the prior is not. Below: the fit that the frequencies alone leave "
            "at each value; a curve that stays above the dashed line over the whole interval excludes no "
            "value.",
            f"Marginal posteriors, priors and profile likelihoods of {constants}.",
        ),
        "left_out": Caption(
            "Blue: what the model with all frequencies predicts. Orange: what the other frequencies "
            "predict for this one. A bar that misses zero is a frequency that the others contradict. "
            "Leverage near one: no other frequency checks this one.",
            f"Residuals of {len(rows)} modes by all and by the other modes, and the leverage of each.",
        ),
        "modes": modes_caption([(row.measured, row.mode.label or row.mode.kind) for row in rows]),
        **assurance_captions(result.by_shape),
    }
