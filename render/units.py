"""One system of units in a scene: mixing them without a stated factor is an error, never a guess.

The scene's irradiance unit is W m⁻² nm⁻¹ in an absolute scene, and that of the materials' reference lamp in a
relative one. A material in other units says by `irradiance_factor` how many of its irradiance units one of the
scene's is, and by `radiance_factor` how many of the scene's radiance units one of its own is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phoslab.errors import PhoslabError
from phoslab.material import Material

# Reference lamps that agree to this are the same lamp, written with fewer digits.
SAME_LAMP = 1e-6


@dataclass(frozen=True)
class Claim:
    """A phosphor and the factors that the scene file states for it (None: not stated)."""

    material: Material
    irradiance_factor: float | None
    radiance_factor: float | None


@dataclass(frozen=True)
class Units:
    """The factors of each phosphor, and what irradiance `irradiance_at_1m = 1` means.

    Args:
        factors: (irradiance_factor, radiance_factor) by the phosphor's name.
        irradiance_unit: the integral, over its bands, of the reference lamp; 1 in an absolute scene.
    """

    factors: Mapping[str, tuple[float, float]]
    irradiance_unit: float


def settle_units(
    system: str, scene_radiance_factor: float | None, claims: Mapping[str, Claim], file: Path
) -> Units:
    """Find every phosphor's factors, or refuse.

    Raises:
        PhoslabError: materials of unlike units meet without a stated factor; the remedy says what to add.
    """

    def refuse(name: str, problem: str, *missing: str) -> PhoslabError:
        lines = " and ".join(f"`{m} = ...`" for m in missing)
        return PhoslabError(
            problem, file=file, field=f"phosphors.{name}", remedy=f"Add {lines} under [phosphors.{name}]."
        )

    factors, lamp_of, unit_of = {}, None, None
    for name, claim in claims.items():
        material, irradiance, radiance = claim.material, claim.irradiance_factor, claim.radiance_factor
        if material.calibration != system:
            missing = [
                field
                for field, stated in (("irradiance_factor", irradiance), ("radiance_factor", radiance))
                if stated is None
            ]
            if missing:
                raise refuse(
                    name,
                    f"is calibrated {'absolutely' if material.calibration == 'absolute' else 'relatively'}"
                    f" in a scene of {system} units",
                    *missing,
                )
        elif system == "relative":
            if irradiance is None:
                if lamp_of is not None and not _same_lamp(material, claims[lamp_of].material):
                    raise refuse(
                        name, f"refers to another reference lamp than {lamp_of!r}", "irradiance_factor"
                    )
                lamp_of = lamp_of or name
            if radiance is None:
                if unit_of is not None and _radiance_unit(material) != _radiance_unit(
                    claims[unit_of].material
                ):
                    raise refuse(
                        name, f"has its radiance in another unit than {unit_of!r}", "radiance_factor"
                    )
                unit_of = unit_of or name
                if scene_radiance_factor is None:
                    raise PhoslabError(
                        "is missing, so that lamp light and glow cannot be compared",
                        file=file,
                        field="units.radiance_factor",
                        remedy="Add under [units] how much of the scene's radiance one unit of the materials' "
                        "is, such as `radiance_factor = 0.001`.",
                    )
        factors[name] = (
            1.0 if irradiance is None else irradiance,
            (scene_radiance_factor or 1.0) if radiance is None else radiance,
        )
    unit = 1.0
    if lamp_of is not None:
        lamp = claims[lamp_of].material
        if lamp.reference_irradiance is None or not lamp.reference_irradiance.any():
            raise refuse(lamp_of, "does not say to which lamp it refers", "irradiance_factor")
        unit = float(lamp.reference_irradiance @ lamp.bands.widths_nm)
    return Units(factors, unit)


def _same_lamp(one: Material, other: Material) -> bool:
    a, b = one.reference_irradiance, other.reference_irradiance
    if a is None or b is None:
        return a is b
    return one.bands == other.bands and np.allclose(a, b, rtol=SAME_LAMP, atol=0.0)


def _radiance_unit(material: Material) -> object:
    return material.provenance.get("radiance_unit")
