"""`design` in plain words."""

from __future__ import annotations

from collections.abc import Sequence

from cpam_bayes.formatting import listed, significant
from cpam_bayes.plate import to_user, unit_of
from cpam_bayes.report.sentences import plate_sentence
from cpam_bayes.report.summary import Summary
from cpam_bayes.report.tables import Table, headed
from cpam_bayes.specimen_design.design import Candidate, DesignResult

_SHOWN = 8


def summary(result: DesignResult) -> Summary:
    """The best specimens, the plate as it is beside them, and what the ranking rests on."""
    shown = list(result.candidates[:_SHOWN])
    if result.present is not None and result.present not in shown:
        shown.append(result.present)
    best = result.candidates[0]
    return Summary(
        title=f"design {result.title}",
        headline=(
            f"Of {len(result.candidates)} specimens and lists one of {best.description} would say most about "
            f"{listed(list(result.asked), 'and')}: {_left(result, best)}{_present(result)}"
        ),
        tables=(candidates_table(result, shown, "Candidates, the most informative first"),),
        basis=(
            _noise(result),
            "The expected information is that of Laplace's approximation at the constants of [material], "
            "beside the priors of [unknowns]: it compares specimens, the intervals come from `identify`.",
            f"The plate that the others are made from: {plate_sentence(result.specimen).partition(': ')[2]}",
            *_sizes(result),
        ),
        warnings=result.warnings,
        next_steps=_next_steps(result),
    )


def candidates_table(result: DesignResult, candidates: Sequence[Candidate], title: str) -> Table:
    """A row for each candidate with the standard deviations that it would leave."""
    names = [f"#sd of {name}" + (f", {unit_of(name)}" if unit_of(name) else "") for name in result.constants]
    columns = headed("specimen", "#nats", *names, "determines", "")
    rows = []
    for c in candidates:
        sd = [
            significant(to_user(name, float(v)), 2)
            for name, v in zip(result.constants, c.expected.sd, strict=True)
        ]
        determined = " ".join(_determined(result, c)) or "none"
        rows.append(
            (c.description, f"{c.information:.2f}", *sd, determined, "as it is" if c.is_present else "")
        )
    flagged = frozenset(i for i, c in enumerate(candidates) if c.is_present)
    return Table(title, columns, tuple(rows), flagged)


def _determined(result: DesignResult, candidate: Candidate) -> list[str]:
    return [name for name, v in result.verdicts(candidate).items() if v == "determined by the data"]


def _left(result: DesignResult, candidate: Candidate) -> str:
    """What a candidate determines of the constants asked for."""
    determined = _determined(result, candidate)
    yes = [name for name in result.asked if name in determined]
    no = [name for name in result.asked if name not in determined]
    spreads = {
        name: f"{name} to +-{significant(2 * to_user(name, float(sd)), 2)} {unit_of(name)}".rstrip()
        for name, sd in zip(result.constants, candidate.expected.sd, strict=True)
    }
    if not no:
        return f"it would determine {listed([spreads[name] for name in yes], 'and')}."
    left = f"{listed(no, 'and')} would stay open"
    return f"{left}." if not yes else f"it would determine {listed(yes, 'and')}; {left}."


def _present(result: DesignResult) -> str:
    present = result.present
    if present is None or present is result.candidates[0]:
        return ""
    more = result.candidates[0].information - present.information
    modes = f"{present.n_modes} modes of the plate as it is"
    return f" That is {significant(more, 2)} nats more than {modes}."


def _noise(result: DesignResult) -> str:
    percent = significant(100.0 * result.test.relative_std, 2)
    source = (
        "that of a usual tap test, for the plate file gives none"
        if result.noise_is_usual
        else "as it was given"
    )
    rounding = f", and a resolution of {result.test.resolution:g} Hz" if result.test.resolution else ""
    return f"A frequency is taken to repeat to {percent} %, {source}{rounding}."


def _sizes(result: DesignResult) -> tuple[str, ...]:
    sd = list(result.specimen.plate.sd)
    if not sd:
        return ("Sizes and mass are taken for exact; [plate.sd] would say how far they are not.",)
    return (f"The stated uncertainty of {listed(sd, 'and')} is allowed for.",)


def _next_steps(result: DesignResult) -> tuple[str, ...]:
    best, asked = result.candidates[0], listed(list(result.asked), "and")
    steps = []
    if all(name in _determined(result, best) for name in result.asked):
        steps.append(f"Make the specimen and measure its {best.n_modes} lowest modes.")
    elif result.needed_std is not None:
        steps.append(
            f"Measure more exactly: the best of these specimens determines {asked} where a frequency "
            f"repeats to {significant(100.0 * result.needed_std, 1)} %."
        )
    else:
        steps.append(
            f"No repeatability makes the best of these specimens determine {asked}: ask for more modes, or "
            "give a prior from a tensile test in [unknowns]."
        )
    steps.append(
        "A list that has been measured says more than this: identify --backend emcee gives the posterior."
    )
    return tuple(steps)
