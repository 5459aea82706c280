"""The sentence of each notice, made from its facts; the only place with such sentences.

A sentence says what is wrong, with its number, and what to do about it; nothing parses it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from string import Formatter
from typing import Any, Final, TypeAlias

from cpam_bayes.answer import Notice, Severity
from cpam_bayes.formatting import listed, significant, with_spread
from cpam_bayes.forward_model.preconditions import likely_cure
from cpam_bayes.plate import Constraint, to_user, unit_of, user_name
from cpam_bayes.plate.edges import CONDITIONS, PLACES

Facts: TypeAlias = Mapping[str, Any]

# Frequencies and plates named before "and ... more".
_MOST_NAMED = 5


def sentences(notices: Iterable[Notice], *severities: Severity) -> tuple[str, ...]:
    """Sentences of the notices of some severities, of all if none is given; each once, in order."""
    said = (sentence_of(n) for n in notices if not severities or n.severity in severities)
    return tuple(dict.fromkeys(said))


def sentence_of(notice: Notice) -> str:
    """The sentence of a notice, in plate-file units.

    raises KeyError if its code has no sentence
    """
    return _written(notice.code, notice.facts)


def _written(code: str, facts: Facts) -> str:
    sentence = SENTENCES[code]
    return _Template().vformat(sentence, (), facts) if isinstance(sentence, str) else sentence(facts)


class _Template(Formatter):
    """Templates of sentences: "{noise:percent}" is a fact in one of `_WAYS`, "{chains}" one of `_PHRASES`."""

    def get_value(self, key: int | str, args: Sequence[Any], kwargs: Facts) -> Any:
        return kwargs[str(key)] if key in kwargs else _PHRASES[str(key)](kwargs)

    def format_field(self, value: Any, format_spec: str) -> str:
        way = _WAYS.get(format_spec)
        return format(value, format_spec) if way is None else way(value)


def capitalised(text: str) -> str:
    """A text as a sentence: a capital first letter and a full stop.

    A first word that is a key or a symbol keeps its lower case.
    """
    first = text.split(" ", 1)[0].rstrip(",;:")
    begun = text[:1].upper() + text[1:] if first.isalpha() and first.islower() else text
    return begun if begun.endswith((".", "!", "?")) else f"{begun}."


def _percent(fraction: float, digits: int = 2) -> str:
    return f"{significant(100.0 * fraction, digits)} %"


def _short_percent(fraction: float) -> str:
    """The percentage as stated, without rounding error of the product."""
    return f"{round(100.0 * fraction, 10):g} %"


def _hz(frequencies: Iterable[float]) -> str:
    each = [f"{f:.5g}" for f in frequencies]
    more = f" and {len(each) - _MOST_NAMED} more" if len(each) > _MOST_NAMED else ""
    return f"{', '.join(each[:_MOST_NAMED])} Hz{more}"


def _names(names: Iterable[str]) -> str:
    return listed(list(names), "and")


# Plate files and lists.


def _units(facts: Facts) -> str:
    cure = likely_cure(facts["median"], weighed=facts["weighed"])
    return f"A predicted frequency is {significant(facts['ratio'], 3)} times the measured one: {cure}."


def _reference_outside(facts: Facts) -> str:
    each = []
    for name, *values in facts["outside"]:
        value, low, high = (f"{to_user(name, v):.5g}" for v in values)
        each.append(f"{user_name(name)} = {value} (bounds {low} to {high})")
    return f"Reference outside its bounds: {_names(each)}. Correct the value or widen the bounds."


def _at_bound(facts: Facts) -> str:
    each = []
    for name, which, end in facts["bounds"]:
        bound = f"{to_user(name, end):.5g} {unit_of(name)}".rstrip()
        each.append(f"{name} lies at its {which} bound, {bound}")
    shifted = (
        "A bound that excludes the true constant shifts the others, or looks like an error of the plate."
    )
    return f"{'; '.join(each)}. {shifted}"


def _few_frequencies(facts: Facts) -> str:
    n, unknowns = facts["frequencies"], facts["unknowns"]
    return (
        f"{n} {'frequency' if n == 1 else 'frequencies'} for {unknowns} unknowns: the bounds decide the "
        f"answer. Measure at least {unknowns + 2} frequencies, or fix the known constants."
    )


def _no_frequency_over(facts: Facts) -> str:
    n = facts["count"]
    many = "1 frequency for 1 unknown" if n == 1 else f"{n} frequencies for {n} unknowns"
    return f"{many}: none is left to check the fit, and bounds or priors decide the rest."


def _large_stated_noise(facts: Facts) -> str:
    noise = facts["noise"]
    if "source" in facts:
        hz, most = facts["most"]
        what = f"{facts['source']} (largest at {hz:.6g} Hz, {_percent(most)})"
        meant = ""
    else:
        what = f"the stated repeatability, {noise:g},"
        meant = f" If {noise:g} % is meant, write {noise / 100.0:g}."
    return capitalised(
        f"{what} is {_percent(noise)} of a frequency; a tap test repeats to 1 % or better, and with so much "
        f"noise any misfit passes.{meant}"
    )


def _thicknesses_apart(facts: Facts) -> str:
    gauged, by_mass, taken = (_in_mm(*facts[key]) for key in ("gauged", "by_mass", "taken"))
    return (
        f"Thickness, mass and density{_of_plate(facts)} disagree: {gauged} as gauged, {by_mass} by mass over "
        f"density, {facts['apart']:.1f} standard deviations apart. One of them, or a side, is wrong; {taken} "
        "is used, which covers both."
    )


def _in_mm(value: float, sd: float) -> str:
    return f"{' +- '.join(with_spread(1e3 * value, 1e3 * sd))} mm"


def _equal_lists(facts: Facts) -> str:
    first, second = facts["plates"]
    apart = facts["apart"]
    how = "are equal" if apart == 0.0 else f"differ by at most {_percent(apart)}"
    return (
        f"The frequencies of {first} and {second} {how}: one plate measured twice is not two plates, and "
        "makes the intervals too narrow. Give one plate file with the mean of both lists."
    )


def _axes_exchange(facts: Facts) -> str:
    square = facts["square"]
    why = "the plate is square with four equal edges" if square else "ply angles are unknown"
    label = ", or label the modes" if square else ""
    return (
        f"E1 and E2 can be exchanged without changing a frequency, because {why}: this is one of two "
        f"answers. Give them bounds that do not overlap{label}."
    )


def _sizes_exact(facts: Facts) -> str:
    names = [user_name(name) for name in facts["names"]]
    if len(names) == 1:
        return f"{names[0]} is assumed exact here: its stated tolerance is ignored."
    return f"{_names(names)} are assumed exact here: their stated tolerances are ignored."


# Labels and shapes.


_USES: Final = {
    None: "",
    "best": " The most probable pairing is used; --backend emcee weighs them all.",
    "all": " All pairings are weighed by their probability.",
}


def _shapes_of_several(facts: Facts) -> str:
    each = [
        f"{f:.6g} Hz is {listed([f'{label} ({100.0 * p:.0f} %)' for label, p in likely], 'or')}"
        for f, likely in facts["shapes"]
    ]
    return f"Some shapes match several modes: {'; '.join(each)}.{_USES[facts['use']]}"


def _label_without_mode(facts: Facts) -> str:
    lost = [f"{label} at {f:.6g} Hz" for label, f in facts["labels"]]
    return (
        f"No mode of the first {facts['modes']} has the label {_names(lost)}. Check the label and the "
        "edges, or compute more modes (--modes N)."
    )


def _doubtful_list(facts: Facts) -> str:
    odds = f"{2.718281828 ** facts['log_odds']:.0f}" if facts["log_odds"] < 9.2 else "more than 10000"
    if facts["missed"] is not None:
        label, hz = facts["missed"]
        what = f"to lack the mode {label} near {hz:.4g} Hz"
    else:
        what = f"to contain a false peak, {facts['spurious']:.6g} Hz"
    return (
        f"The list seems {what}: that is {odds} times as probable as a complete list. If so, state "
        "that modes may be missing from it."
    )


# The fit.


def _frequencies_of(facts: Facts) -> str:
    """The frequencies of an answer, or of one of several plates, in words."""
    return f"the frequencies of {facts['plate']}" if "plate" in facts else "these frequencies"


def _of_plate(facts: Facts) -> str:
    return f" of {facts['plate']}" if "plate" in facts else ""


def _large_misfit(facts: Facts) -> str:
    return (
        f"The plate model does not describe {_frequencies_of(facts)}: its best fit is "
        f"{_percent(facts['misfit'])} off"
    ) + (
        _explained(facts)
        or ", where a tap test repeats to 1 % or better. Do not use the constants until units, sizes, "
        "edges, layup and the order of the list are checked."
    )


def _misfit_over_noise(facts: Facts) -> str:
    return (
        "The plate model does not describe these frequencies: the misfit is "
        f"{significant(facts['times'], 2)} times the stated noise"
    ) + (_explained(facts) or ", and the true constants can be far outside the intervals. Run `diagnose`.")


_OF_SLIP: Final = {
    "sides": "length and width exchanged",
    "layup": "the layup turned by 90 degrees",
    "edges": "the neighbouring edge held ({edges})",
    "supports": "clamped and simply supported edges exchanged ({edges})",
    "clamped": "the plate clamped at {clamped}, not free ({edges})",
    "free": "the plate free, not held ({edges})",
    "missed": "mode {number} missing from the list",
    "false": "frequency {number} ({frequency:.6g} Hz) left out",
    "misread": "frequency {number} ({frequency:.6g} Hz) misread",
    "decimal": "frequency {number} read as {frequency:.6g} Hz",
}


def _explained(facts: Facts) -> str:
    """The slips that explain a misfit, in words."""
    if not facts.get("slips"):
        return ""
    said = [
        _OF_SLIP[kind].format(number=number, frequency=frequency, edges=edges, clamped=_clamped(edges))
        + (" (or the layup turned by 90 degrees)" if kind == "sides" and len(set(edges)) == 1 else "")
        for kind, number, frequency, edges in facts["slips"]
    ]
    return f". With {listed(said, 'or')} it fits to {_percent(facts['fit'])}."


def _clamped(edges: str) -> str:
    return listed([p for p, e in zip(PLACES, edges, strict=True) if CONDITIONS[e].is_clamp], "and")


def _common_factor(facts: Facts) -> str:
    distances, ratio = facts["distances"], facts["ratio"]
    far = [f"{name} by {significant(abs(z), 2)}" for name, z in distances]
    side = "above" if distances[0][1] > 0.0 else "below"
    lie = "The modulus lies" if len(far) == 1 else "The moduli lie"
    begun = f"{lie} far {side} the reference ({', '.join(far)} standard deviations)"
    weighed = facts["weighed"]
    mass = "mass" if weighed else "density"
    if ratio is None:
        return (
            f"{begun}: check thickness, {mass}, the analyser's frequency scale, and whether the reference is "
            "this plate's material."
        )
    thickness = facts["thickness"] * 1e3
    true_thickness = thickness * ratio ** (1.0 / (3.0 if weighed else 2.0))
    attached = "a mass left on the plate, " if ratio < 1.0 else ""
    return (
        f"{begun}, all by a factor near {significant(ratio, 3)}. One wrong number explains it: a thickness "
        f"of {significant(true_thickness, 3)} mm instead of {thickness:g} mm, a {mass} "
        f"{significant(1.0 / ratio, 3)} times as large, {attached}or frequencies "
        f"{significant(ratio**0.5, 3)} times too high. Check these, and the material."
    )


def _far_reference(facts: Facts) -> str:
    far = [
        f"{name} lies {significant(abs(z), 2)} standard deviations {'above' if z > 0.0 else 'below'} it"
        for name, z in facts["distances"]
    ]
    return (
        f"The list contradicts the material's prior in the plate file: {listed(far, 'and')}. Such a prior "
        "distorts all constants: correct it, or use bounds alone."
    )


def _search_model(facts: Facts) -> str:
    unit, factor = ("%", 100.0) if facts["relative"] else ("Hz", 1.0)
    reduced, full = (significant(factor * facts[name], 3) for name in ("reduced", "full"))
    return (
        f"The search model fits to {reduced} {unit} at these constants and the full model to {full} {unit}: "
        "other constants fit better."
    )


def _constraint(constraint: Constraint) -> str:
    """A violated constraint with its material, and the model without it."""
    text = f"{constraint.text} of {constraint.of}" if constraint.of else constraint.text
    lifted = ""
    if constraint.symmetry == "transversely_isotropic":
        lifted = " Plies such as fabric need the orthotropic model of the material."
    return f"{text}: the frequencies call for constants beyond it.{lifted}"


def _soft_core(facts: Facts) -> str:
    error, limit = facts["error"], facts["limit"]
    begun = (
        "The faces of this sandwich bend separately on its soft core, which this theory neglects: the "
        f"model's frequencies are up to about {_percent(error, 1)} too low"
    )
    if error > limit:
        return f"{begun}, beyond its limit of {100.0 * limit:g} %. Do not use them; try forward --solver ccx."
    return f"{begun}, and identified moduli too high by up to twice as much."


def _repeatability(facts: Facts) -> str:
    return "any plausible repeatability" if facts["inferred"] else "the stated repeatability"


# Diagnoses.


def _several_optima(facts: Facts) -> str:
    percent = " and ".join(f"{100.0 * f:.0f} %" for f in facts["fractions"])
    text = (
        f"{facts['count']} optima fit the frequencies (probability of the first two {percent}), and "
        f"{facts['constant']} differs by {100.0 * facts['apart']:.2g} % between the first two."
    )
    swapped = facts["swapped"]
    if swapped is None:
        return text
    plate = f"{swapped['plate']}: " if swapped["plate"] else ""
    a, b = swapped["modes"]
    return (
        f"{text} They differ in the order of two modes ({plate}frequency {swapped['frequency']} is {a} or "
        f"{b}): look at its nodal lines and label it in the list."
    )


def _list_over_noise(facts: Facts) -> str:
    return (
        f"{facts['plate']}: the misfit is {significant(facts['times'], 2)} times the stated noise, which was "
        "scaled up to match"
    ) + (_explained(facts) or ": check this list, its edges and masses.")


# Stacking sequences.


def _check_layup(facts: Facts) -> str:
    missing = ", or a mode may be missing from the list" if facts["complete"] else ""
    return (
        f"The true layup may lie off the grid of angles{missing}. Check the list, the plate and the bounds, "
        "or `diagnose` a layup that you trust."
    )


def _sequence_at_bounds(facts: Facts) -> str:
    ends = [f"{user_name(name)} at its {which} bound" for name, which in facts["bounds"]]
    return f"The most probable sequence puts {_names(ends)}."


def _chains_of(facts: Facts) -> str:
    number = facts["number"]
    return "The chains of the given sequence" if number is None else f"The chains of sequence {number}"


# Noise studies.


def _level(facts: Facts) -> str:
    percent = _short_percent(facts["level"])
    if facts["reading"] == "rms":
        return f"{percent} of the rms frequency ({significant(facts['noise_sd'], 3)} Hz for all modes)"
    return f"{percent} of each frequency"


# The paper, batches, predictions.


def _failed_plates(facts: Facts) -> str:
    n = facts["count"]
    return f"{n} {'plate has' if n == 1 else 'plates have'} no answer: the rows say why."


def _disagreeing_plates(facts: Facts) -> str:
    names = facts["plates"]
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    shown = listed(names, "and") if not more else f"{', '.join(names[:_MOST_NAMED])}{more}"
    return (
        f"Thickness, mass and density of {shown} disagree: one of them, or a side, is wrong. Gauge and weigh "
        "again, and check the density."
    )


def _undescribed_plates(facts: Facts) -> str:
    worst = facts["plates"]
    shown = [f"{name} ({significant(times, 2)} times the noise)" for name, times in worst[:_MOST_NAMED]]
    more = f" and {len(worst) - _MOST_NAMED} more" if len(worst) > _MOST_NAMED else ""
    return (
        f"The plate model does not describe the frequencies of {', '.join(shown)}{more}. Do not trust "
        f"{'its' if len(worst) == 1 else 'their'} constants, nor means and limits from them, until the cause "
        "is known."
    )


def _no_population(facts: Facts) -> str:
    return capitalised(f"no mean and scatter of the material: {facts['reason']}")


def _other_sizes(facts: Facts) -> str:
    far = [
        f"{user_name(name)} {to_user(name, here):.5g} instead of {to_user(name, there):.5g}"
        for name, here, there in facts["sizes"]
    ]
    return (
        f"{facts['plate']} has the name of the measured plate but other sizes, {', '.join(far)}: "
        "those of its file are used. Give it its own `specimen`."
    )


def _other_constants(facts: Facts) -> str:
    each = [
        f"{user_name(name)} {to_user(name, here):.5g} instead of {to_user(name, there):.5g}"
        for name, there, here in facts["constants"]
    ]
    return f"The plate file has other values of constants that the posterior held fixed: {_names(each)}."


# Measured responses.


def _no_poles(facts: Facts) -> str:
    low, high = facts["range"]
    peaks = facts["peaks"]
    seen = f"peak at {_hz(peaks)}" if peaks else "have no clear peak"
    return (
        f"No mode found from {low:.4g} to {high:.4g} Hz, where the responses {seen}. Widen --range, raise "
        "--order, or look at the responses."
    )


def _close_poles(facts: Facts) -> str:
    close = ", ".join(f"{a:.5g} and {b:.5g} Hz" for a, b in facts["pairs"])
    return (
        f"Modes closer than a peak width: {close}. They may be one mode that shifts between hits; keep both "
        "only where another response shows them."
    )


def _hits_apart(facts: Facts) -> str:
    one = len(facts["hits"]) == 1
    return (
        f"{_hits(facts['hits']).capitalize()} of {facts['of']} {'shows' if one else 'show'} few of the "
        f"modes. {'Is it' if one else 'Are they all'} of this plate, held as in the others? Leave out any "
        "that is not."
    )


def _hits(numbers: Sequence[int]) -> str:
    said = _names(str(number) for number in numbers)
    return f"hit {said}" if len(numbers) == 1 else f"hits {said}"


def _short_hits(facts: Facts) -> str:
    short = [f"{length:.2g} s from {start:.2f} s of {file}" for file, start, length in facts["short"]]
    return (
        f"Left out, as less than half the length of a hit: {listed(short, 'and')}. Likely clicks, as of a "
        "stop button, or hits cut short by another or by the end of the record."
    )


def _silent_channels(facts: Facts) -> str:
    numbers = [str(number) for number in facts["channels"]]
    are = f"Channel {numbers[0]} is" if len(numbers) == 1 else f"Channels {listed(numbers, 'and')} are"
    return f"{are} constant or pure noise: is a sensor connected? Channels with modes are used."


# The time limit.


def _time_up(facts: Facts) -> str:
    missing = "; ".join(_written(code, known) for code, known in facts["missing"])
    return f"The time limit of {facts['seconds']:g} s ended the work early: {missing}."


_WAYS: Final[Mapping[str, Callable[[Any], str]]] = {
    "Hz": _hz,
    "all": _names,
    "angles": lambda angles: "/".join(f"{a:g}" for a in angles),
    "commas": ", ".join,
    "constraint": _constraint,
    "hits": _hits,
    "percent": _percent,
    "semicolons": "; ".join,
    "sentence": capitalised,
    "short percent": _short_percent,
    "signed percent": lambda fraction: f"{100.0 * fraction:+.1f} %",
    "two digits": lambda value: significant(value, 2),
    "whole percent": lambda fraction: f"{100.0 * fraction:.0f} %",
}
"""Format of a fact in a template -> function."""

_PHRASES: Final[Mapping[str, Callable[[Facts], str]]] = {
    "at_noise": _level,
    "chains": _chains_of,
    "check": _check_layup,
    "of_plate": _of_plate,
    "repeatability": _repeatability,
}
"""Phrases of several sentences that need more than one fact."""

SENTENCES: Final[Mapping[str, str | Callable[[Facts], str]]] = {
    "as_written": "{text:sentence}",
    "units": _units,
    "reference_outside": _reference_outside,
    "at_bound": _at_bound,
    "few_frequencies": _few_frequencies,
    "no_frequency_over": _no_frequency_over,
    "large_stated_noise": _large_stated_noise,
    "thicknesses_apart": _thicknesses_apart,
    "equal_lists": _equal_lists,
    "list_given_twice": (
        "The frequencies of {name} are those of {before}, digit for digit. Give the list measured "
        "with the mass."
    ),
    "axes_exchange": _axes_exchange,
    "prior_not_fitted": "The swarm uses only the bounds of {names:all}, not mean and sd.",
    "prior_not_inverted": (
        "The inversions use only the bounds of {names:all}; mean and sd enter only the posterior."
    ),
    "sizes_exact": _sizes_exact,
    "labels_not_used": "Labels and shapes are ignored here: frequencies are paired in their order.",
    "shape_without_mode": (
        "The shape at {frequency:.6g} Hz matches no mode (modal assurance at most {assurance:.2f}); the "
        "frequency is paired by its place in the list."
    ),
    "shapes_of_several": _shapes_of_several,
    "label_without_mode": _label_without_mode,
    "other_label": "Frequency {frequency} is labelled {given}, but its mode at these constants is {found}.",
    "doubtful_list": _doubtful_list,
    "large_misfit": _large_misfit,
    "misfit_over_noise": _misfit_over_noise,
    "high_noise": (
        "The noise inferred from the misfit{of_plate} is {noise:percent} of a frequency, high for a tap "
        "test: the plate model may lack something, and then the intervals can miss the true constants."
    ),
    "common_factor": _common_factor,
    "far_reference": _far_reference,
    "search_model": _search_model,
    "poor_fit": (
        "The best fit of mode {mode} is {residual:signed percent} off. Do not trust the constants until "
        "the plate, the edges and the order of the list are checked."
    ),
    "optimum_on_constraint": "The best constants lie on the constraint {constraint:constraint}",
    "cut_posterior": "The posterior is cut by the constraint {constraint:constraint}",
    "solver_error": (
        "The solver's error reaches {error:percent} of a frequency (mode {mode}), which matters here."
    ),
    "soft_core": _soft_core,
    "swarms_disagree": (
        "Only one swarm found the best fit: there may be a better one. Allow more swarms, or narrow the "
        "bounds."
    ),
    "angles_disagree": (
        "Only one swarm found the best angles: others may fit better. `sequence` compares all on the grid."
    ),
    "chains_not_converged": (
        "The chains did not converge in {steps} steps (R-hat {r_hat:.3f}, "
        "{ess_bulk:.0f} effective samples): do not rely on means and intervals. Allow more steps."
    ),
    "narrow_basis": (
        "The chains ran on a small basis; by the full one, {fraction:percent} of their draws count: means "
        "and intervals can be off. State the repeatability, and the basis will suit it."
    ),
    "unexplained_residuals": (
        "The residuals are larger than the stated noise explains (p = {p:.3f}): the plate model lacks "
        "something, or the noise is larger."
    ),
    "unexplained_by_none": (
        "The residuals are larger than {repeatability} explains (p = {p:.2g}), and no cause is more probable "
        "than none."
    ),
    "unexplained_by_claim": "The claimed cause does not explain all of the residuals (p = {p:.2g}).",
    "single_frequencies": (
        "Single frequencies decide the claim: it holds in {stable:whole percent} of the cases when one is "
        "left out."
    ),
    "several_optima": _several_optima,
    "differing_priors": (
        "The files give different priors of {names:all}; those of {taken} are used for all plates. Give all "
        "files the same."
    ),
    "list_over_noise": _list_over_noise,
    "rough_evidences": "Log evidences are known only to {error:two digits}: probabilities are rough.",
    "unweighed_sets": (
        "Combinations of causes that were not tested have a probability of about {probability:two digits}: "
        "no claim is made that they could overturn."
    ),
    "rough_surrogate": (
        "The log evidence of the surrogate is {rms:.2f} off (rms): the size of the credible set and the "
        "marginals are rough. The listed sequences are computed without it."
    ),
    "overlooked_sequence": (
        "A sequence drawn from the posterior beats every listed one by {better:.1f} in log evidence: the "
        "list is incomplete."
    ),
    "sequences_left_out": "Sequences with up to {probability:.2g} of the probability were left out.",
    "uncertain_evidences": (
        "The log evidence of {count} listed sequences is uncertain by up to {error:.2f}, the first of them "
        "number {first}."
    ),
    "no_sequence_explains": (
        "No sequence explains the list: the stated noise gives residuals as large as those of the best one "
        "with probability {p:.1g}. {check}"
    ),
    "frequencies_without_mode": (
        "{alone} of the {of} frequencies match no mode of the most probable sequence. {check}"
    ),
    "sequence_noise": "No sequence fits the list to better than {noise:percent}. {check}",
    "sequence_at_bounds": _sequence_at_bounds,
    "sequence_chains": "{chains} have not converged: R-hat {r_hat:.3f}, {ess_bulk:.0f} effective samples.",
    "sequence_disagrees": (
        "{chains} and importance sampling differ by {z:.1f} standard errors in a mean or an sd."
    ),
    "one_layup_taken": (
        "Constants and diagnosis assume the stacking sequence {angles_deg:angles}, whose probability with "
        "its images is {probability:.2g}."
    ),
    "misfit_beside_noise": (
        "Without added noise the plate model misses this list by {misfit:percent} (rms), more than the "
        "noise of {level:short percent}. --list model studies the noise alone."
    ),
    "constants_not_found_again": (
        "Without noise the swarm did not quite recover {names:all}: other constants fit nearly as well."
    ),
    "swarms_in_worse_optima": (
        "Without noise only {found} of {of} swarms found the best constants: a single swarm often misses "
        "them."
    ),
    "inversions_missed": (
        "{at_noise}: on {count} of {of} lists no swarm fitted as well as the constants found without noise."
    ),
    "noise_chains": (
        "{at_noise}: the posterior's chains did not converge within their budget ({ess_bulk:.0f} effective "
        "samples)."
    ),
    "noise_posterior_cut": "{at_noise}: the posterior is cut by the constraint {constraint:constraint}",
    "noise_swarms": "{at_noise}: {count} of {of} swarms did not converge within their budget.",
    "noise_redrawn": (
        "{at_noise}: {count} noisy frequencies were not positive and were drawn again, so the noise is not "
        "quite Gaussian."
    ),
    "quick": (
        "Do not quote these numbers: --quick uses small swarms and linearised intervals, and skips "
        "finite elements and angle searches."
    ),
    "unconverged_tasks": "Chains that have not converged: {titles:semicolons}.",
    "tasks_of_one_swarm": "The best fit was found by one swarm only: {titles:semicolons}.",
    "failed_plates": _failed_plates,
    "mixed_materials": (
        "The plates are of several materials: means and control limits are those of a mixture."
    ),
    "prior_of_former_plate": (
        "The prior of {plates:all} is the posterior of an earlier plate. If that is the plate compared with, "
        "the two are not independent and their difference is underestimated: compare with "
        "material.posterior left out."
    ),
    "disagreeing_plates": _disagreeing_plates,
    "undescribed_plates": _undescribed_plates,
    "no_population": _no_population,
    "population_chains": (
        "The chains of mean and scatter did not converge in {steps} steps (R-hat {r_hat:.3f}, "
        "{ess_bulk:.0f} effective samples)."
    ),
    "other_sizes": _other_sizes,
    "other_constants": _other_constants,
    "hum": (
        "The record ends in mains hum, {mains:g} Hz or a multiple, of {size:percent} of its "
        "largest value, which hides weak modes. Earth the sensor, keep cables away from mains, or use a "
        "battery."
    ),
    "modes_beyond_range": (
        "The responses exceed their noise up to {frequency:.4g} Hz: modes beyond the range are not sought."
    ),
    "largest_below_range": (
        "The responses are largest at {frequency:.4g} Hz, below the range: a mode, the plate on its support, "
        "or hum. Widen --range to include it."
    ),
    "no_poles": _no_poles,
    "peaks_without_pole": (
        "Peaks without a mode: {peaks:Hz}. They are missed modes, or steady tones such as hum: look at "
        "the stability diagram and try another --order."
    ),
    "close_poles": _close_poles,
    "poor_poles": "Standard deviation above {limit:short percent}: {frequencies:Hz}.",
    "drifting_modes": (
        "Modes that differ by more than {limit:percent} from hit to hit: {frequencies:Hz}. Causes: a loose "
        "clamp, a plate that warms up, hits that are too hard."
    ),
    "unlike_hit": (
        "All frequencies of hit {hit} differ from those of the other hits, by {shift:percent}. Was the "
        "plate, or something on it, moved? Leave that hit out."
    ),
    "hits_apart": _hits_apart,
    "double_hits": (
        "The hammer struck twice in {hits:hits} of {of}, and the ripples look like modes. Of free decays "
        "only the part after the last stroke was used; repeat these hits."
    ),
    "short_hits": _short_hits,
    "ringing_sensor": (
        "{share:percent} of the power of channel {channel} is a tone at {frequency:.4g} Hz, beyond the "
        "range: the sensor or its mount rings. Fix it more firmly, and keep records well below full scale."
    ),
    "silent_channels": _silent_channels,
    "left_out_peaks": (
        "Peaks as clear as modes that match no mode of the model: {peaks:Hz}. The plate may have what its "
        "file lacks: an accelerometer, a compliant clamp. State it, or run `diagnose`."
    ),
    "clipped_files": "Clipped and not used: {files:commas}. Lower the gain and hit again.",
    "repeated_files": "Given twice, or the same as another file, and counted once: {files:commas}.",
    "time_up": _time_up,
    # what is missing, in the sentence of time_up
    "cut_swarm": "a swarm ended after {done} of {of} iterations",
    "cut_swarms": "{done} of at least {of} swarms ran",
    "cut_chains": "emcee ended after {done} of at most {of} steps",
    "cut_hypotheses": "{count} hypotheses were not tested, of {causes:commas}",
    "cut_sets": "not all causes that may act at once were tested together",
    "cut_list_errors": "errors of the lists were not tested together with causes of the plates",
    "cut_leftovers": "misfit that remains beside a cause was not tested",
    "cut_evidences": "the evidence of the leading causes is approximate",
    "cut_gain": "neither the gain nor the detection limits were computed",
    "cut_next_tests": "no further tests were ranked",
    "cut_groups": "{done} of {of} groups of noisy lists were inverted",
    "cut_plates": "{late} of {of} plates were not computed",
    "cut_tasks": "the rows of {late} of {of} computations are left out; the same command resumes there",
    "cut_sequences": "the constants of {done} of {of} sequences were sampled by emcee",
    "cut_rounds": "the probabilities of sequences are those of an earlier round",
}
"""Code -> its sentence, a template of its facts or a function of them."""
