"""Effects that a plate model or a frequency list may lack: one record per effect, one file per family.

A new effect is one file and one line in ``CATALOGUE``; ``docs/effects.md`` shows how.
"""

from cpam_bayes.effects.edges import (
    CLAMP_ROTATION,
    CLAMP_SLIP,
    CLAMP_TRANSLATION,
    SOFT_CLAMP,
    SOFT_SUPPORT,
    SUPPORT,
)
from cpam_bayes.effects.effect import (
    FREQUENCY_SCALE,
    MODE_IDENTITY,
    OUTLIER,
    VISCOELASTIC,
    Effect,
    ListChange,
    ListVariant,
    PlateFacts,
    extend,
    scale_of,
    variants,
)
from cpam_bayes.effects.geometry import (
    CLAMP_LENGTH,
    DENSITY,
    LENGTH,
    OUTLINE,
    SKEW,
    SWAPPED_SIDES,
    TAPER_X,
    TAPER_Y,
    THICKNESS,
    WARP,
    WIDTH,
)
from cpam_bayes.effects.layup import LAYUP
from cpam_bayes.effects.masses import AIR, EDGE_MASS, SENSOR_MASS, add_air, add_known_mass
from cpam_bayes.effects.plies import (
    DAMAGE,
    INNER_PLY_ANGLE,
    MATERIAL,
    MEMBRANE_STRESS,
    MISORIENTATION,
    OUTER_PLY_ANGLE,
    RESIN_SKIN,
    SHEAR_RATIO,
    TRANSVERSE_SHEAR,
)

CATALOGUE: tuple[Effect, ...] = (
    CLAMP_ROTATION,
    CLAMP_TRANSLATION,
    SOFT_CLAMP,
    CLAMP_SLIP,
    CLAMP_LENGTH,
    SENSOR_MASS,
    EDGE_MASS,
    SUPPORT,
    SOFT_SUPPORT,
    AIR,
    THICKNESS,
    DENSITY,
    LENGTH,
    WIDTH,
    SWAPPED_SIDES,
    FREQUENCY_SCALE,
    TAPER_X,
    TAPER_Y,
    SKEW,
    OUTLINE,
    MISORIENTATION,
    OUTER_PLY_ANGLE,
    INNER_PLY_ANGLE,
    LAYUP,
    WARP,
    MEMBRANE_STRESS,
    TRANSVERSE_SHEAR,
    SHEAR_RATIO,
    DAMAGE,
    RESIN_SKIN,
    VISCOELASTIC,
    MODE_IDENTITY,
    OUTLIER,
    MATERIAL,
)


def applicable(facts: PlateFacts, effects: tuple[Effect, ...] = CATALOGUE) -> tuple[Effect, ...]:
    """Effects that a plate may have."""
    return tuple(effect for effect in effects if any(f.applies_to(facts) for f in effect.forms))


__all__ = [
    "CATALOGUE",
    "Effect",
    "ListChange",
    "ListVariant",
    "PlateFacts",
    "add_air",
    "add_known_mass",
    "applicable",
    "extend",
    "scale_of",
    "variants",
]
