"""The screen of `sequence`: what the frequencies say about the plies."""

from __future__ import annotations

import numpy as np

from cpam_bayes.formatting import NOT_KNOWN, decimals_of, fixed, probable, signed, significant, with_spread
from cpam_bayes.inference.posterior import NOISE
from cpam_bayes.plate import to_user, user_name
from cpam_bayes.report.plates.head import plate_section
from cpam_bayes.report.sections import COMPUTATION, Section
from cpam_bayes.report.tables import Column, Table, facts, headed, remarks
from cpam_bayes.stacking.mixture import SampledComponent, StackingMixture
from cpam_bayes.stacking.queries.angle_information import AngleInformation
from cpam_bayes.stacking.queries.best_fit import BestFit
from cpam_bayes.stacking.queries.given_layup import GivenLayup
from cpam_bayes.stacking.records import StackingPosterior
from cpam_bayes.stacking.sequence import StackingResult

_SHOWN = 12
# Probability of an angle that is worth a place on the screen, beside the most probable one.
_SHOWN_PROBABILITY = 0.005


def sections(result: StackingResult) -> tuple[Section, ...]:
    """Plate, the most probable sequences, plies, constants, how it was done."""
    answer, information = result.answer, result.information
    return (
        plate_section(result.specimen, result.air_shifts),
        Section("Stacking sequences", (_sequences(answer),), ("credible_set",), folded=False),
        Section(
            "Angle by angle",
            (
                _plies(answer, information),
                remarks("Outer and inner plies", (outer_and_inner(information),)),
            ),
            ("angles",),
            folded=False,
        ),
        Section("Measured frequencies and the most probable sequence", _fit(answer, result.fit)),
        Section(
            "Constants over all sequences",
            (_mixture(answer, result.mixture, result.given),),
            ("constants",),
        ),
        Section(COMPUTATION, (_work(result),)),
    )


def _sequences(result: StackingPosterior) -> Table:
    columns = headed(
        "#rank", "unknown angles", "#probability of each", "#equivalent", "#together", "#log evidence", "#+-"
    )
    rows = [
        (
            str(i + 1),
            "/".join(f"{a:g}" for a in result.top[i]),
            probable(float(result.probability[i])),
            str(int(result.multiplicity[i])),
            probable(float(result.probability[i] * result.multiplicity[i])),
            fixed(float(result.log_evidence[i]), 2),
            fixed(float(result.log_evidence_error[i]), 2),
        )
        for i in range(min(_SHOWN, len(result.top)))
    ]
    return Table(
        "Most probable stacking sequences; those that no frequency distinguishes are merged",
        columns,
        tuple(rows),
    )


def _plies(result: StackingPosterior, information: AngleInformation) -> Table:
    columns = headed(
        "#unknown",
        "most probable angles and their probability",
        "#angles that hold 95 %",
        "#entropy, bits",
        "#fraction of D, %",
    )
    rows = []
    for j, p in enumerate(result.marginals):
        order = np.argsort(-p, kind="stable")
        needed = int(np.searchsorted(np.cumsum(p[order]), 0.95)) + 1
        best = ", ".join(
            f"{result.grid_deg[a]:g} ({p[a]:.2f})" for a in order[:4] if p[a] >= _SHOWN_PROBABILITY
        )
        bits, fraction = information.entropy_bits[j], information.bending_fraction[j]
        rows.append((str(j + 1), best, f"{needed} of {len(p)}", f"{abs(bits):.2f}", f"{100 * fraction:.1f}"))
    return Table("Angle by angle, from the bottom", columns, tuple(rows))


def outer_and_inner(information: AngleInformation) -> str:
    """Whether the list tells more about the outer plies, in one sentence."""
    bits = information.entropy_bits[information.outer_first]
    listed = ", ".join(f"{abs(b):.2f}" for b in bits)
    if len(bits) < 2:
        return f"one unknown angle: {listed} bits of {information.most_bits:.2f} are left open"
    verdict = "outer angles are not throughout better determined than inner ones"
    if information.outer_better:
        verdict = "outer angles are better determined than inner ones"
    return (
        f"{verdict}: entropy from the outermost in {listed} of {information.most_bits:.2f} bits; equally "
        "probable mirror images count 1 bit"
    )


def _fit(result: StackingPosterior, fit: BestFit) -> tuple[Table, ...]:
    """The list beside the most probable sequence, and what of its modes the list lacks."""
    measured = result.conditional.template.measurement.frequencies
    columns = tuple(Column(h, number=True) for h in ("measured Hz", "predicted Hz", "residual %"))
    decimals = decimals_of(measured)
    rows = tuple(
        (fixed(float(f), decimals), NOT_KNOWN, NOT_KNOWN)
        if np.isnan(p)
        else (fixed(float(f), decimals), fixed(float(p), decimals + 1), signed(100 * float(r), 2))
        for f, p, r in zip(measured, fit.predicted, fit.residual, strict=True)
    )
    lacks = ", ".join(fixed(float(f), decimals + 1) for f in fit.missed)
    return (
        Table("Measured frequencies and the most probable sequence", columns, rows),
        remarks(
            "Missing from the measured frequencies",
            (f"modes of the most probable sequence at {lacks} Hz",) if lacks else (),
        ),
    )


def _noise(result: StackingPosterior, fit: BestFit) -> str:
    """What noise the probabilities stand on, and how well the first sequence fits with it."""
    level = f"{significant(100 * fit.noise, 2)} % of a frequency"
    if result.conditional.template.noise_is_inferred:
        return f"{level}, inferred, given the most probable sequence"
    said = f"{level}, from the plate file"
    if fit.p_value is None:
        return said
    return f"{said}; alone it leaves residuals like these or larger with probability {fit.p_value:.2g}"


def _mixture(result: StackingPosterior, mixture: StackingMixture, given: GivenLayup | None) -> Table:
    first: SampledComponent | None = mixture.components[0] if mixture.components else None
    columns = (
        Column("name"),
        Column("mean", number=True),
        Column("sd", number=True),
        Column("given the first sequence", number=True),
        Column("sd", number=True),
        *((Column("given the printed one", number=True), Column("sd", number=True)) if given else ()),
        Column("reference", number=True),
    )
    rows = []
    reference = result.specimen.material.constants
    for i, name in enumerate(result.conditional.parameters.names):
        if name == NOISE:
            continue
        unit = to_user(name, 1.0)
        cells = [user_name(name)]
        moments = [(mixture.parameters[:, i].mean(), mixture.parameters[:, i].std())]
        moments.append((first.chains.mean[i], first.chains.sd[i]) if first else (np.nan, np.nan))
        if given and mixture.given:
            moments.append((mixture.given.chains.mean[i], mixture.given.chains.sd[i]))
        for mean, sd in moments:
            cells += with_spread(unit * float(mean), unit * float(sd))
        cells.append(significant(unit * float(reference[name])) if name in reference else "")
        rows.append(tuple(cells))
    return Table("Constants over all sequences", columns, tuple(rows))


def _work(screened: StackingResult) -> Table:
    result, mixture = screened.answer, screened.mixture
    images = ", ".join(s.name for s in result.symmetries) or "none"
    rows = [
        ("sequences", f"{result.enumerated} on the grid of {result.specimen.angle_grid_deg:g} degrees"),
        ("layup", result.specimen.plate.layup.text),
        ("noise", _noise(result, screened.fit)),
        ("symmetries", images),
        *_same_bending(result),
        *_printed(result, screened.given),
        ("95 % set", f"{result.credible_count} sequence" + ("s" if result.credible_count > 1 else "")),
        ("effective number", f"{significant(result.effective_count, 3)} sequences, exp of the entropy"),
        ("left out", f"{result.unaccounted:.1g} of the probability at most"),
        (
            "constants",
            f"emcee on the first {len(mixture.components)} of the list, "
            f"{100 * mixture.emcee_fraction:.1f} % of the probability; importance sampling on the rest",
        ),
    ]
    if result.check is not None:
        c = result.check
        rows.append(
            (
                "surrogate",
                f"trained on {c.training_size} sequences; off by {c.rms:.2f} (rms), {c.largest:.2f} (most) "
                "in log evidence on draws from the result, which correct its sum",
            )
        )
    rows.append(
        (
            "work",
            f"{result.seconds:.0f} s and {mixture.seconds:.0f} s for the constants, seed {screened.seed}",
        )
    )
    return facts("All stacking sequences", tuple(rows))


def _printed(result: StackingPosterior, given: GivenLayup | None) -> tuple[tuple[str, str], ...]:
    """The sequence printed for a specimen of the paper among all."""
    if given is None:
        return ()
    place = f"number {given.rank}" if given.rank else f"not among the first {len(result.top)}"
    angles = "/".join(f"{a:g}" for a in given.angles_deg)
    return (("printed", f"{angles}: probability {given.probability:.3g}, {place}"),)


def _same_bending(result: StackingPosterior) -> tuple[tuple[str, str], ...]:
    """Listed sequences that share their bending stiffness with others that are no images of them."""
    several = [i for i, others in enumerate(result.same_bending) if len(others)]
    if not several:
        return ()
    merged = sum(len(result.alike[i]) > 0 for i in several)
    one, other = result.top[several[0]], result.grid_deg[result.same_bending[several[0]][0]]
    names = " and ".join("/".join(f"{a:g}" for a in angles) for angles in (one, other))
    said = f"{len(several)} of {len(result.top)} listed have it in common with others, as {names}"
    return (("same bending", f"{said}; {merged} merged with them, as nothing else counts"),)
