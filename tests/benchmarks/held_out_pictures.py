"""Fitted materials beside photographs that no fit has seen (Nalbach 2017, Fig. 8.13).

    python tests/benchmarks/held_out_pictures.py DIR [PAINT ...]

Each paint of the simulated bench is measured (`measure all`, 40 s of it), and its material fitted with one state, two,
and as many as the fit chooses. Then a sample that was at rest is charged anew, for as long, and photographed without
noise 0, 0.01 and 20 s after the lamp has faded: with the bench's physics, at moments that the decay's frames do not
have. The material is charged by the same lamp, its radiance goes through the camera's sensitivities band by band, and
both become colours by one matrix; DeltaE00 is of the mean colour of the sample, with its white at the brightest
photograph of the paint. The camera's unit stands between camera and material, as an aperture that is a little off what
is written on it makes it: one factor for the three pictures of a paint, the only thing that is adjusted here. How
brightness changes and every colour are the fit's.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phoslab import kinetics, spectra
from phoslab.fitting import fit_session
from phoslab.fitting.lvf import calibrate
from phoslab.fitting.lvf_file import save
from phoslab.instruments.bench.campaign import Campaign
from phoslab.instruments.bench.darkroom import NM, Darkroom, Stage
from phoslab.instruments.bench.paints import paint
from phoslab.instruments.bench.sample import Sample
from phoslab.material import Material
from phoslab.plan_parameters import Decay, Emission, Excitation, Flats, Lamp, Lvf

Array = NDArray[np.float64]

PAINTS = ("blue", "green", "orange", "pink", "purple", "red", "white", "yellow")
FILTERS = (
    "L002",
    "L035",
    "L101",
    "L122",
    "L147",
    "L179",
    "L201",
    "L225",
    "L279",
    "L366",
    "L603",
    "L714",
    "L736",
    "L775",
)
AT_S = (0.0, 0.01, 20.0)
"""After the lamp has faded."""

PLANS = {
    "flats": Flats(),
    "lamp": Lamp(),
    "lvf": Lvf(),
    "emission": Emission(),
    "decay": Decay(),
    "excitation": Excitation(),
}


def bench_sample(name: str) -> Sample:
    """A preset's paint, or the bench's own broad distribution of traps."""
    return Sample(name="broad") if name == "broad" else paint(name)


def measure(name: str, folder: Path, plans: tuple[str, ...] = tuple(PLANS)) -> None:
    """Record a campaign of a paint."""
    campaign = Campaign(Darkroom(11, bench_sample(name)), FILTERS)
    for plan in plans:
        campaign.record(folder / plan, PLANS[plan])


@dataclass(frozen=True, eq=False)
class Photographs:
    """Mean colour of a sample's middle (n_times, 3) in the camera's RGB, W m⁻² sr⁻¹ weighed by its sensitivities."""

    rgb: Array


def photographs(name: str, charge_s: float, fade_s: float = 0.32) -> Photographs:
    """What a perfect camera sees of a sample that was at rest, charged for `charge_s` and left in the dark."""
    room = Darkroom(12, bench_sample(name))
    room.place(0.0, Stage("sample"))
    room.lamp.switch(10.0, True)
    off_s = 10.0 + charge_s
    room.lamp.switch(off_s, False)
    light = np.array(room.afterglow(1, [off_s + fade_s + t for t in AT_S]))
    return Photographs(light[:, None] * (room.sample.emission(NM) @ room._sensitivity))


def pictures(material: Material, sensitivities: Any, charge_s: float, fade_s: float = 0.32) -> Array:
    """(n_times, 3) what the material shows to the same camera, charged by its own lamp."""
    assert material.reference_irradiance is not None
    r = kinetics.advance(material, np.zeros(material.n_states), material.reference_irradiance, charge_s)
    response = (
        spectra.band_means(lambda nm: sensitivities.at(nm).T, material.bands) * material.bands.widths_nm
    )
    seen = []
    for t in AT_S:
        faded = r * np.exp(-material.kr_per_s * (fade_s + t))
        seen.append(response @ kinetics.emitted_radiance(material, faded))
    return np.array(seen)


def delta_e(measured: Array, rendered: Array, matrix: Array) -> Array:
    """(n_times,) DeltaE00 of camera RGB (n_times, 3), white where the brightest measured one is."""
    import colour

    def lab(rgb: Array, white: float) -> Array:
        return np.asarray(colour.XYZ_to_Lab(rgb @ matrix.T / white, illuminant=np.array([1 / 3, 1 / 3])))

    # Each picture is exposed as the photograph of its moment asks for: a glow at 20 s would be black beside that at
    # 0 s.
    found = []
    for photo, picture in zip(measured, rendered, strict=True):
        white = float((photo @ matrix.T)[1])
        found.append(float(colour.delta_E(lab(photo, white), lab(picture, white), method="CIE 2000")))
    return np.array(found)


def camera_to_xyz(sensitivities: Any) -> Array:
    """(3, 3) the matrix that takes camera RGB nearest to XYZ for smooth spectra."""
    import colour

    nm = np.arange(400.0, 701.0, 2.0)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    cmfs = np.stack([np.interp(nm, observer.wavelengths, observer.values[:, k]) for k in range(3)], axis=1)
    found = np.linalg.lstsq(sensitivities.at(nm), cmfs, rcond=None)[0]
    return np.asarray(found.T)


def run(folder: Path, name: str) -> dict[str, Array]:
    """DeltaE00 at the three moments, by the number of states."""
    if not (folder / name).exists():
        measure(name, folder / name)
    lvf = folder / name / "lvf.json"
    if not lvf.exists():
        save(calibrate([folder / name / "lvf", folder / name / "flats"]), lvf)
    charge_s = PLANS["decay"].charge_s
    photos = photographs(name, charge_s)
    results = {}
    for states in (1, 2, "auto"):
        result = fit_session([folder / name], lvf=lvf, states=states)
        from phoslab.fitting.lvf_file import load

        sensitivities = load(lvf)[0].sensitivities
        # From the bench's unit to DN of 1 s at ISO 100 and f/1: what its camera is made for.
        unit = unit_of(name)
        rendered = pictures(result.material, sensitivities, charge_s)
        seen = photos.rgb * unit
        factor = float(np.exp(np.mean(np.log(seen[:, 1] / rendered[:, 1]))))
        results[f"{states}"] = delta_e(seen, factor * rendered, camera_to_xyz(sensitivities))
        results[f"{states} brightness"] = factor * rendered[:, 1] / seen[:, 1] - 1
        results[f"{states} factor"] = np.array([factor])
        results[f"{states} n"] = np.array([result.fit.n_states])
    return results


def unit_of(name: str) -> float:
    """DN of 1 s at ISO 100 and f/1 that a radiance of 1 in the green makes in the frame's middle; and the paint's."""
    camera = Darkroom(0).camera
    return camera.exposure_e / camera.full_scale_e * camera.full_scale_dn


def main() -> None:
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    folder, chosen = Path(sys.argv[1]), sys.argv[2:] or (*PAINTS, "broad")
    np.set_printoptions(precision=3, suppress=True)
    every: dict[str, list[Array]] = {}
    for name in chosen:
        found = run(folder, name)
        print(f"[[{name}]]", flush=True)
        for key, value in found.items():
            every.setdefault(key, []).append(value)
            print(f"  {key:18} {value}", flush=True)
    for key, values in every.items():
        if key in ("1", "2", "auto"):
            print(f"mean over all: {key:5} {np.mean(values):.2f} (by moment {np.mean(values, axis=0)})")


if __name__ == "__main__":
    main()
