"""The refractive index of air, against its authors' tables and the formula a maker prints in its manual."""

from __future__ import annotations

import math

import pytest

from drivers.atmosphere import (
    correction_ppm,
    group_index,
    implausible,
    phase_index,
    saturation_vapour_pressure,
)
from drivers.ports import Atmosphere


# Ciddor (1996), Table 1: dry air with 450 ppm CO₂, 633 nm, 1e8 (n − 1).
@pytest.mark.parametrize(
    ("t", "kpa", "refractivity"),
    [(20, 80, 21458.0), (20, 100, 26824.4), (20, 120, 32191.6), (10, 100, 27774.7), (30, 100, 25937.2)],
)
def test_dry_air_agrees_with_ciddors_table_1(t: float, kpa: float, refractivity: float) -> None:
    n = phase_index(Atmosphere(t, 10 * kpa, 0), 0.633)
    assert 1e8 * (n - 1) == pytest.approx(refractivity, abs=0.15)


# Ciddor (1996), Table 2: moist air of Birch and Downs, 633 nm: °C, Pa, vapour pressure Pa, ppm CO₂, 1e8 (n − 1).
@pytest.mark.parametrize(
    ("t", "p", "vapour", "co2", "refractivity"),
    [
        (19.526, 102094.8, 1065, 510, 27392.9),
        (19.173, 102993.0, 641, 450, 27682.4),
        (19.188, 102918.8, 706, 450, 27658.7),
        (19.532, 103603.2, 986, 600, 27802.0),
    ],
)
def test_moist_air_agrees_with_ciddors_table_2(
    t: float, p: float, vapour: float, co2: float, refractivity: float
) -> None:
    # The table's vapour pressure is x_w p: it holds the enhancement factor already.
    enhancement = 1.00062 + 3.14e-8 * p + 5.6e-7 * t**2
    humidity = 100 * vapour / saturation_vapour_pressure(t + 273.15) / enhancement
    n = phase_index(Atmosphere(t, p / 100, humidity), 0.633, co2_ppm=co2)
    assert 1e8 * (n - 1) == pytest.approx(refractivity, abs=0.6)


# NIST Engineering Metrology Toolbox, Ciddor calculator: 20 °C, 101.325 kPa and the corners of its range, 633 nm.
@pytest.mark.parametrize(
    ("t", "kpa", "humidity", "n"),
    [
        (20, 101.325, 0, 1.000271800),
        (20, 60, 0, 1.000160924),
        (5, 100, 0, 1.000282756),
        (20, 100, 100, 1.000267394),
        (40, 120, 75, 1.000299418),
    ],
)
def test_index_agrees_with_nists_calculator(t: float, kpa: float, humidity: float, n: float) -> None:
    assert phase_index(Atmosphere(t, 10 * kpa, humidity), 0.633) == pytest.approx(n, abs=2e-9)


@pytest.mark.parametrize("wavelength", [0.633, 0.658, 0.78, 0.85])
def test_group_index_is_phase_index_minus_dispersion(wavelength: float) -> None:
    air, h = Atmosphere(22, 1005, 45), 1e-4
    slope = (phase_index(air, wavelength + h) - phase_index(air, wavelength - h)) / (2 * h)
    expected = phase_index(air, wavelength) - wavelength * slope
    assert group_index(air, wavelength) == pytest.approx(expected, abs=1e-11)


@pytest.mark.parametrize("t", [5.0, 12.0, 20.0, 30.0])
@pytest.mark.parametrize("p", [930.0, 1013.25, 1040.0])
def test_correction_agrees_with_the_makers_formula(t: float, p: float) -> None:
    """Leica TPS1200 manual, technical data, red laser 670 nm (Barrell and Sears; the manual claims 1 ppm)."""
    h, alpha = 60.0, 1 / 273.15
    vapour = 4.126e-4 * h / (1 + alpha * t) * 10 ** (7.5 * t / (237.3 + t) + 0.7857)
    printed = 285.93 - (0.29493 * p / (1 + alpha * t) - vapour)
    assert correction_ppm(Atmosphere(t, p, h), 0.670, 1.00028593) == pytest.approx(printed, abs=0.8)


def test_the_reference_air_needs_no_correction() -> None:
    # TPS1200 manual: 1013.25 mbar, 12 °C, 60 % is where the red laser's index 1.0002859 holds.
    assert correction_ppm(Atmosphere(12, 1013.25, 60), 0.670, 1.0002859) == pytest.approx(0, abs=0.6)


def test_warm_thin_air_makes_a_shown_distance_too_short() -> None:
    assert correction_ppm(Atmosphere(35, 900, 60), 0.658, 1.000286338) > 40


@pytest.mark.parametrize(
    ("air", "said"),
    [
        (Atmosphere(math.nan, 1013, 50), "temperature nan °C"),
        (Atmosphere(20, 101325, 50), "pressure 101325 hPa"),
        (Atmosphere(20, 1013, 140), "humidity 140 %"),
    ],
)
def test_a_broken_thermometer_is_called_implausible(air: Atmosphere, said: str) -> None:
    assert said in (implausible(air) or "")


def test_a_room_is_plausible() -> None:
    assert implausible(Atmosphere(21, 1009, 43)) is None
