"""Reference constants that are those of something else."""

from __future__ import annotations

from cpam_bayes.effects.effect import Effect, PlateFacts


def _has_references(facts: PlateFacts) -> bool:
    return facts.has_references


MATERIAL = Effect(
    name="material",
    title="another material than stated",
    family="material",
    belongs_to="material",
    parameters=(),
    note="[material.sd] is dropped: of the constants only the search bounds of [unknowns] are known",
    check="Read the material's certificate again, or test a coupon in tension.",
    drops_references=True,
    applies_to=_has_references,
)
