"""How much the air slows the light of a distance meter, and what to multiply a distance by because of it.

Phase index: P. E. Ciddor, "Refractive index of air: new equations for the visible and near infrared", Appl. Opt. 35
(1996) 1566–1573, equations 1–5 and Appendices A, B. Group index: P. E. Ciddor and R. J. Hill, Appl. Opt. 38 (1999)
1663–1667: a modulated beam travels at the group velocity, n_g = n + σ dn/dσ. Both are good to about 1e-7 indoors; one
degree of air temperature that nobody measured costs 1e-6.

A distance meter divides its time of flight by a reference index n₀. The distance in other air is therefore

    d = d_shown · n₀ / n_g(air)
"""

from __future__ import annotations

import math

from drivers.ports import Atmosphere

CO2_PPM = 450.0
_GAS_CONSTANT = 8.314510  # J/(mol K), the value Ciddor uses
_WATER_MOLAR_MASS = 0.018015  # kg/mol


def group_index(air: Atmosphere, wavelength_um: float, co2_ppm: float = CO2_PPM) -> float:
    """Group refractive index of moist air for a vacuum wavelength of 0.35–1.3 µm."""
    s = wavelength_um**-2
    dry = 1e-8 * (5792105.0 * (238.0185 + s) / (238.0185 - s) ** 2 + 167917.0 * (57.362 + s) / (57.362 - s) ** 2)
    water = 1.022e-8 * (295.235 + 3 * 2.6422 * s - 5 * 0.032380 * s**2 + 7 * 0.004028 * s**3)
    return _mix(air, dry, water, co2_ppm)


def phase_index(air: Atmosphere, wavelength_um: float, co2_ppm: float = CO2_PPM) -> float:
    """Phase refractive index: what an interferometer sees. Valid 0.3–1.7 µm, −40…100 °C."""
    s = wavelength_um**-2
    dry = 1e-8 * (5792105.0 / (238.0185 - s) + 167917.0 / (57.362 - s))
    water = 1.022e-8 * (295.235 + 2.6422 * s - 0.032380 * s**2 + 0.004028 * s**3)
    return _mix(air, dry, water, co2_ppm)


def correction_ppm(air: Atmosphere, wavelength_um: float, reference_index: float) -> float:
    """What a shown distance is short of, in parts per million: d = d_shown (1 + ppm·1e-6)."""
    return (reference_index / group_index(air, wavelength_um) - 1.0) * 1e6


def saturation_vapour_pressure(temperature_k: float) -> float:
    """Over water [Pa]; Giacomo (1982), Davis (1992), as in Ciddor's Appendix A."""
    t = temperature_k
    return math.exp(1.2378847e-5 * t**2 - 1.9121316e-2 * t + 33.93711047 - 6.3431645e3 / t)


def implausible(air: Atmosphere) -> str | None:
    """Why these readings cannot be the air of a treatment room or a workshop, or None."""
    for name, value, low, high, unit in (
        ("temperature", air.temperature_c, -40.0, 60.0, "°C"),
        ("pressure", air.pressure_hpa, 500.0, 1100.0, "hPa"),
        ("humidity", air.humidity_pct, 0.0, 100.0, "%"),
    ):
        if not low <= value <= high:  # also catches NaN
            return f"{name} {value:g} {unit} is not between {low:g} and {high:g} {unit}"
    return None


def _mix(air: Atmosphere, dry: float, water: float, co2_ppm: float) -> float:
    """Refractivities of the two standard gases, weighted by their densities in this air.

    n − 1 = (ρ_a/ρ_axs)(n_axs − 1) + (ρ_w/ρ_ws)(n_ws − 1)                 Ciddor eq. 5
    """
    temperature = air.temperature_c + 273.15
    pressure = 100.0 * air.pressure_hpa
    enhancement = 1.00062 + 3.14e-8 * pressure + 5.6e-7 * air.temperature_c**2
    x_w = enhancement * air.humidity_pct / 100.0 * saturation_vapour_pressure(temperature) / pressure
    dry *= 1.0 + 0.534e-6 * (co2_ppm - 450.0)
    dry_molar_mass = 1e-3 * (28.9635 + 12.011e-6 * (co2_ppm - 400.0))

    def molar_density(p: float, t: float, x: float) -> float:
        return p / (_compressibility(p, t, x) * _GAS_CONSTANT * t)

    here = molar_density(pressure, temperature, x_w)
    dry_share = here * (1.0 - x_w) * dry_molar_mass
    water_share = here * x_w * _WATER_MOLAR_MASS
    dry_standard = molar_density(101325.0, 288.15, 0.0) * dry_molar_mass
    water_standard = molar_density(1333.0, 293.15, 1.0) * _WATER_MOLAR_MASS
    return 1.0 + dry * dry_share / dry_standard + water * water_share / water_standard


def _compressibility(p: float, t_k: float, x_w: float) -> float:
    """BIPM 1981/91 density equation (Davis 1992); Ciddor's Appendix A, eq. 12."""
    t = t_k - 273.15
    first = 1.58123e-6 - 2.9331e-8 * t + 1.1043e-10 * t**2
    first += (5.707e-6 - 2.051e-8 * t) * x_w + (1.9898e-4 - 2.376e-6 * t) * x_w**2
    return 1.0 - p / t_k * first + (p / t_k) ** 2 * (1.83e-11 - 0.765e-8 * x_w**2)
