"""The words beside the figures of `design`."""

from __future__ import annotations

from cpam_bayes.formatting import listed
from cpam_bayes.report.sections import Caption
from cpam_bayes.specimen_design.design import DesignResult


def captions(result: DesignResult) -> dict[str, Caption]:
    """A caption for each figure."""
    about = {"information": listed(list(result.asked), "and")}
    about |= {name: name for name in result.constants if len(result.constants) > 1}
    return {
        name: Caption(
            f"Darker: the frequencies of this specimen would say more about {what}. The number is the "
            "expected information in nats; for one constant, 1.2 nats make its standard deviation a third of "
            "the prior's, from which it counts as determined. Frame: the plate as it is. Star: the best.",
            f"Expected information about {what} over layups and length to width, a panel for each edges and "
            "number of modes.",
        )
        for name, what in about.items()
    }
