"""The identified functions of one variable: geometric errors and compliances of a joint, with what is known of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ppshw.calibration import Calibration
from ppshw.machine import WRENCH_COMPONENTS
from ppshw.report.picture import INK, SERIES, Picture, canvas
from ppshw.terms import COMPONENTS
from ppshw.terms.basis import Constant
from ppshw.terms.elastic import Compliance, element_kind
from ppshw.terms.geometric import Geometric

Array = NDArray[np.float64]
SAMPLES = 81
SUBSCRIPT = {"tx": "x", "ty": "y", "tz": "z", "rx": "about x", "ry": "about y", "rz": "about z"}
# How compliances are said: kind of element → (what gives way, unit, factor from SI).
COMPLIANCE = {
    "tF": ("displacement per force", "µm/N", 1e6),
    "tM": ("rotation per force (displacement per moment)", "µrad/N", 1e6),
    "rM": ("rotation per moment", "µrad/(N m)", 1e6),
}


@dataclass(frozen=True)
class Curve:
    """A function of one joint's position: x (S,), value and std (S,) in SI."""

    label: str
    x: Array
    value: Array
    std: Array

    @property
    def shows(self) -> bool:
        """Somewhere farther from zero than two standard deviations."""
        return bool((np.abs(self.value) > 2 * self.std).any())


@dataclass(frozen=True)
class Element:
    """A compliance that does not depend on position, for the table."""

    joint: str
    name: str
    value: float
    std: float
    unit: str


def pictures(calibration: Calibration) -> tuple[list[Picture], list[str]]:
    """Per joint: displacements, rotations, and its compliances where they vary; and per joint a word on those whose
    change is nowhere beyond two standard deviations."""
    out: list[Picture] = []
    quiet: list[str] = []
    for term, at in _terms(calibration):
        if term.frame == 0 or isinstance(term.basis, Constant):
            continue
        name, unit = calibration.machine.joints[term.frame - 1].name, calibration.machine.joints[term.frame - 1].unit
        if isinstance(term, Geometric):
            out += [_geometric(calibration, term, at, name, unit, kind) for kind in "tr"]
        else:
            still: list[str] = []
            for kind in dict.fromkeys(element_kind(a, b) for a, b in term.elements):
                curves = compliance_curves(calibration, term, at, kind)
                still += [f"({c.label})" for c in curves if not c.shows]
                if shown := [c for c in curves if c.shows]:
                    out.append(_compliance(shown, name, unit, kind))
            if still:
                quiet.append(f"{name} {' '.join(still)}")
    return out, quiet


def constant_compliances(calibration: Calibration) -> tuple[list[Element], int]:
    """Those beyond two standard deviations, and how many others there are."""
    found: list[Element] = []
    others = 0
    std = calibration.std
    for term, at in _terms(calibration):
        if not isinstance(term, Compliance) or not isinstance(term.basis, Constant):
            continue
        for k, (a, b) in enumerate(term.elements):
            _, unit, factor = COMPLIANCE[element_kind(a, b)]
            value, sigma = float(calibration.theta[at + k]), float(std[at + k])
            if abs(value) > 2 * sigma:
                joint = calibration.machine.frame_names[term.frame]
                found.append(Element(joint, element_name(a, b), value * factor, sigma * factor, unit))
            else:
                others += 1
    return found, others


def element_name(a: int, b: int) -> str:
    """An element of a compliance as the page has it: "ty, Fx" is what component a moves under load component b."""
    return f"{COMPONENTS[a]}, {WRENCH_COMPONENTS[b]}"


def _terms(calibration: Calibration) -> Iterator[tuple[Geometric | Compliance, int]]:
    """Every term of these two kinds with where its parameters start in theta."""
    at = 0
    for term in calibration.model.terms:
        if isinstance(term, Geometric | Compliance):
            yield term, at
        at += len(term.parameters(calibration.machine.frame_names))


def geometric_curves(calibration: Calibration, term: Geometric, at: int, kind: str) -> list[Curve]:
    """ε(q) − ε(home): constants of neighbouring joints cannot be told apart, changes can."""
    x, rows = _from_home(calibration, term)
    return [
        _curve(calibration, SUBSCRIPT[c], x, rows, at + k * term.basis.size)
        for k, c in enumerate(COMPONENTS) if c[0] == kind
    ]  # fmt: skip


def compliance_curves(calibration: Calibration, term: Compliance, at: int, kind: str) -> list[Curve]:
    """C(q) − C(home), for the same reason."""
    x, rows = _from_home(calibration, term)
    return [
        _curve(calibration, element_name(a, b), x, rows, at + k * term.basis.size)
        for k, (a, b) in enumerate(term.elements) if element_kind(a, b) == kind
    ]  # fmt: skip


def _from_home(calibration: Calibration, term: Geometric | Compliance) -> tuple[Array, Array]:
    """Positions (S,) and the basis' change from home (S, m): q = 0 where that was sampled, else the middle."""
    low, high = calibration.joint_range[term.frame - 1]
    x = np.linspace(low, high, SAMPLES)
    home = 0.0 if low <= 0.0 <= high else (low + high) / 2
    return x, term.basis.values(x) - term.basis.values(np.array([home]))


def _curve(calibration: Calibration, label: str, x: Array, rows: Array, at: int) -> Curve:
    block = slice(at, at + rows.shape[1])
    variance = np.einsum("ni,ij,nj->n", rows, calibration.covariance[block, block], rows)
    return Curve(label, x, rows @ calibration.theta[block], np.sqrt(np.maximum(variance, 0.0)))


def _geometric(calibration: Calibration, term: Geometric, at: int, name: str, unit: str, kind: str) -> Picture:
    curves = geometric_curves(calibration, term, at, kind)
    word, symbol = ("displacement", "mm") if kind == "t" else ("rotation", "mrad")
    return _plot(curves, 1e3, f"{name} [{unit}]", f"{word} [{symbol}]", f"Geometric errors of {name}: {word}s", symbol)


def _compliance(curves: list[Curve], name: str, unit: str, kind: str) -> Picture:
    what, symbol, factor = COMPLIANCE[kind]
    label, title = f"change of compliance [{symbol}]", f"Compliance of {name}: {what}"
    return _plot(curves, factor, f"{name} [{unit}]", label, title, symbol)


def _plot(curves: list[Curve], factor: float, xlabel: str, ylabel: str, title: str, unit: str) -> Picture:
    with canvas() as c:
        ax = c.axes
        ax.axhline(0, color=INK, lw=0.7)
        for curve, colour in zip(curves, SERIES * 3, strict=False):
            value, band = factor * curve.value, 2 * factor * curve.std
            ax.fill_between(curve.x, value - band, value + band, color=colour, alpha=0.16, lw=0)
            ax.plot(curve.x, value, color=colour, label=curve.label)
        ax.set(xlabel=xlabel, ylabel=ylabel)
        ax.margins(x=0.01)
        c.figure.legend(loc="outside upper center", ncols=min(4, len(curves)), handlelength=1.4, columnspacing=1.2)
        said = "; ".join(
            f"{k.label} from {factor * k.value.min():.3g} to {factor * k.value.max():.3g} {unit}, "
            f"2σ up to {2 * factor * k.std.max():.2g} {unit}" for k in curves
        )  # fmt: skip
        alt = f"{title} over {xlabel} as change from home, with a band of two standard deviations: {said}."
        return c.picture(title, alt)
