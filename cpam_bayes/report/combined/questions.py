"""The questions that a reader asks a report first, each with its answer in a sentence."""

from __future__ import annotations

from typing import Final

from cpam_bayes import __version__
from cpam_bayes.combined import FullReport
from cpam_bayes.diagnosis.paired_modes import FrequencyRow
from cpam_bayes.effects import CATALOGUE
from cpam_bayes.formatting import listed, significant
from cpam_bayes.report.diagnosis.rows import DetectableRow, detectable_rows
from cpam_bayes.report.diagnosis.words import claim_sentence, detectable_size, probability_text
from cpam_bayes.report.plates.head import layup_text
from cpam_bayes.report.sentences import CONTAINED, plate_argument
from cpam_bayes.report.summary import ConstantLine, Summary, names_of
from cpam_bayes.report.tables import Table, facts

__all__ = ["QUESTIONS", "questions"]

QUESTIONS: Final = "Ten questions and their answers"

# The cause that an accelerometer is: the mass at a point.
_ADDED_MASS: Final = next(effect.name for effect in CATALOGUE if effect.local == "point")
# Modes named as the worst ones.
_WORST: Final = 2


def questions(result: FullReport, words: Summary) -> Table:
    """Ten questions and their answers; words : the summary of the report."""
    rows = (
        ("What are the constants?", _values(words.constants)),
        ("How sure are they?", _intervals(words)),
        ("Which are not determined by these frequencies?", _open(words.constants)),
        ("What is wrong with the plate model?", claim_sentence(result.diagnosis.diagnosis)),
        ("Would a forgotten accelerometer have shown?", _accelerometer(result)),
        ("Which noise do the intervals assume?", _noise(words)),
        ("Which modes fit worst?", _worst(result)),
        ("Are the ply angles determined?", _angles(result)),
        ("What should be done next?", words.next_steps[0] if words.next_steps else "Nothing."),
        (
            "Which version and seed repeat this page?",
            f"cpam_bayes {__version__} with seed {result.seed}: cpam-bayes report "
            f"{plate_argument(result.specimen)} --seed {result.seed}.",
        ),
    )
    return facts(QUESTIONS, rows)


def _values(constants: tuple[ConstantLine, ...]) -> str:
    said = [f"{c.symbol} = {c.value_text} {c.unit}".rstrip() for c in constants]
    return f"{listed(said, 'and')}."


def _intervals(words: Summary) -> str:
    """The intervals, and which errors they contain."""
    constants = words.constants
    contained = next((text for text in words.basis if text.startswith(CONTAINED)), "")
    said = [f"{c.symbol} in {c.interval_text} {c.unit}".rstrip() for c in constants if c.interval is not None]
    if not said:
        return "No intervals can be given."
    return f"With 95 % probability: {listed(said, 'and')}. {contained}"


def _open(constants: tuple[ConstantLine, ...]) -> str:
    left = [f"{c.symbol}, which is decided by {c.by}" for c in constants if c.determined == "no"]
    partly = [f"{c.symbol} is determined partly, with {c.by}" for c in constants if c.determined == "partly"]
    yes = names_of(constants, "yes")
    said = [f"Not determined: {'; '.join(left)}." if left else "None of them is left open."]
    said += [f"{text[:1].upper()}{text[1:]}." for text in partly]
    if yes:
        said.append(f"Determined: {yes}.")
    return " ".join(said)


def _accelerometer(result: FullReport) -> str:
    d = result.diagnosis.diagnosis
    if _ADDED_MASS in d.claim.causes and d.claim.kind != "undecided":
        return "It shows: an added mass is part of what is wrong with the plate model, see above."
    row = next((row for row in detectable_rows(d) if row.cause == _ADDED_MASS), None)
    if row is None:
        return "Not asked: an added mass was not among the causes that were weighed."
    if row.smallest is None:
        return (
            "No: these frequencies need not show an added mass of any size; constants and noise take it up. "
            "Look at the plate, or ask who tested it."
        )
    return f"From {detectable_size(row)} on, with 95 % probability{_of_plate(result, row)}."


def _of_plate(result: FullReport, row: DetectableRow) -> str:
    """The detectable mass as a part of the plate's, and what a lighter one is."""
    plate = result.specimen.plate
    mass = plate.mass or plate.density * plate.area * plate.thickness
    assert row.smallest is not None
    percent = significant(0.1 * row.smallest / mass, 2)
    return f", which is {percent} % of the plate's mass; a lighter one may be there unseen"


def _noise(words: Summary) -> str:
    return next((said for said in words.basis if "assume a noise" in said), "No noise could be inferred.")


def _worst(result: FullReport) -> str:
    rows = [row for row in result.diagnosis.plain.frequencies if row.residual_percent is not None]
    rows.sort(key=lambda row: -abs(row.residual_percent or 0.0))
    if not rows:
        return "No frequency belongs to a mode of the plate model."
    return f"Of the plate model as it stands: {'; '.join(_residual(row) for row in rows[:_WORST])}."


def _residual(row: FrequencyRow) -> str:
    assert row.residual_percent is not None
    label = f" {row.mode.label}" if row.mode is not None and row.mode.label else ""
    side = "too high" if row.residual_percent > 0.0 else "too low"
    off = significant(abs(row.residual_percent), 2)
    return f"mode {row.number}{label}, measured {row.measured:.6g} Hz, predicted {off} % {side}"


def _angles(result: FullReport) -> str:
    specimen = result.specimen
    if specimen.material.isotropic:
        return "There are none: the material is isotropic."
    if result.stacking is not None:
        answer = result.stacking.answer
        angles = "/".join(f"{a:g}" for a in answer.top[0])
        p = probability_text(float(answer.probability[0] * answer.multiplicity[0]))
        return f"The most probable ones for the unknown plies are {angles}; probability with its images {p}."
    if specimen.plate.layup.n_unknown:
        return "The swarm's best angles were taken; `cpam-bayes sequence` gives each layup its probability."
    return f"They were not asked for: the layup {layup_text(specimen)}, is taken from the plate file as true."
