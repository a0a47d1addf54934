"""What a demo with a concealed effect says of itself: figures, and in words what was hidden, found and taken out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ppshw.quantities import many, value_of

# Figures at the point, as the page calls them; and what else of the answer is a plain value.
FIGURES_OF = {"nominal": "uncompensated", "base": "base", "extended": "extended"}
VALUES = ("seal", "conceal", "seed", "visits", "verification_visits", "diagnose_seconds", "machine_hours", "seconds")
_YES = {True: "yes", False: "no", None: "-"}


def result_of(answer: Mapping[str, Any]) -> dict[str, Any]:
    """The answer as a run's figures, by their names on the page. Raises KeyError where some are missing."""
    return {**{name: answer[key] for key, name in FIGURES_OF.items()}, **{key: answer[key] for key in VALUES}}


def hidden(truth: Mapping[str, Any]) -> str:
    """What the machine carried: effect, where, form, parameters with their units, and how much it does."""
    where = f" of {truth['joint']}" if truth["joint"] else f" of {truth['target']}" if truth["target"] else ""
    units = truth.get("units", {})  # a truth written by an earlier version has none
    values = ", ".join(f"{name.replace('_', ' ')} {value_of({'value': value, 'unit': units.get(name, '1')})}"
                       for name, value in truth["parameters"].items())  # fmt: skip
    return (f"{truth['effect']}{where} ({truth['form']}): {values}; {truth['rms_mm']:.3f} mm rms at the reflectors "
            f"where the repeatability makes {truth['repeatability_rms_mm']:.3f}")  # fmt: skip


def named(answer: Mapping[str, Any]) -> list[str]:
    """Whether the diagnosis was right."""
    return [f"effect named: {_YES[answer['named']]}", f"joint right: {_YES[answer['joint_right']]}",
            f"other findings: {answer['false_findings']}"]  # fmt: skip


def treated(answer: Mapping[str, Any]) -> list[str]:
    """What of the findings was taken out at how many visits, what was not, and why."""
    lines = []
    for what, verdicts in (("compensated", answer["taken_out"]), ("not compensated", answer["not_compensated"])):
        for v in verdicts:
            joint = f" of {v['joint']}" if v["joint"] else ""
            why = f": {v['why']}" if v["why"] else ""
            lines.append(f"{what}, {many(v['visits'], 'visit')}: {v['effect']}{joint}{why}")
    return lines


def of_the_instrument(answer: Mapping[str, Any]) -> str | None:
    """What the figures are without what the instrument was found to err; None where it was not found to."""
    corrected = answer["instrument_corrected"]
    if not corrected:
        return None
    base, found = (float(corrected[row]["p98_6_mm"]) for row in ("base", "extended"))
    return (
        "The instrument was found to err, in the verification too. With its readings corrected for that, 98.6 % of the "
        f"errors are within {base:.3f} mm with the base calibration and {found:.3f} mm with the findings."
    )


def facts(answer: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Rows of what was hidden and what became of it."""
    rows = [("Hidden by the demo", hidden(answer["truth"])), ("Diagnosis", "; ".join(named(answer)))]
    return rows + [("Findings", line) for line in treated(answer)]
