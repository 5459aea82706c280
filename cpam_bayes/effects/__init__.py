"""What a plate model or a frequency list may lack: one record an effect, one file a family.

A new effect is one file and one line in ``CATALOGUE``; ``docs/effects.md`` shows how.
"""

from cpam_bayes.effects.air import AIR, add_air
from cpam_bayes.effects.angles import INNER_PLY_ANGLE, MISORIENTATION, OUTER_PLY_ANGLE
from cpam_bayes.effects.clamps import CLAMP_ROTATION, CLAMP_SLIP, CLAMP_TRANSLATION, SOFT_CLAMP
from cpam_bayes.effects.damage import DAMAGE
from cpam_bayes.effects.effect import (
    Effect,
    ListChange,
    ListVariant,
    PlateFacts,
    extend,
    scale_of,
    variants,
)
from cpam_bayes.effects.frequency_list import MODE_IDENTITY, OUTLIER
from cpam_bayes.effects.material import MATERIAL
from cpam_bayes.effects.observation import FREQUENCY_SCALE, VISCOELASTIC
from cpam_bayes.effects.point_masses import SENSOR_MASS, add_known_mass
from cpam_bayes.effects.shape import SKEW, TAPER_X, TAPER_Y, WARP
from cpam_bayes.effects.sizes import CLAMP_LENGTH, DENSITY, LENGTH, THICKNESS, WIDTH
from cpam_bayes.effects.stiffness import RESIN_SKIN, SHEAR_RATIO, TRANSVERSE_SHEAR
from cpam_bayes.effects.stress import MEMBRANE_STRESS
from cpam_bayes.effects.support import SUPPORT

CATALOGUE: tuple[Effect, ...] = (
    CLAMP_ROTATION,
    CLAMP_TRANSLATION,
    SOFT_CLAMP,
    CLAMP_SLIP,
    CLAMP_LENGTH,
    SENSOR_MASS,
    SUPPORT,
    AIR,
    THICKNESS,
    DENSITY,
    LENGTH,
    WIDTH,
    FREQUENCY_SCALE,
    TAPER_X,
    TAPER_Y,
    SKEW,
    MISORIENTATION,
    OUTER_PLY_ANGLE,
    INNER_PLY_ANGLE,
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
    """The effects that a plate may have."""
    return tuple(effect for effect in effects if effect.applies_to(facts))


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
