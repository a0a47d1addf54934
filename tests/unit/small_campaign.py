"""A campaign of 120 random poses on the positioner, and the first joint of machines on which a design is quick."""

from __future__ import annotations

from pathlib import Path

from campaigns.plan import Plan, plan_campaign
from campaigns.script import load_script
from ppshw.machine import Machine, load_machine

RANDOM = """name: anywhere
seed: 4
order: as_written
reference: {every: 15, q: {}}
loads:
  - {name: empty, mass: 0}
  - {name: box, mass: 150, com: [0, 0.15, 0.6]}
  - {name: other, mass: 90, com: [0.1, 0.15, -0.4]}
steps:
  - {step: one, kind: random, count: 60}
  - {step: two, kind: random, count: 60}
"""
# A carriage; of a machine file what stands before its second joint.
SLIDE = """\
gravity: [0, 0, -9.80665]
joints:
  - name: slide
    type: prismatic
    axis: [1, 0, 0]
    limits: {lower: -0.5, upper: 0.5, velocity: 0.1, acceleration: 0.1}
    link: {mass: 300, com: [0, 0, 0.1]}
    elastic: {loads: [Fz, Mx, My], varies: false}
"""


def positioner() -> Machine:
    return load_machine(Path(__file__).parents[2] / "machines/pps.yaml")


def planned(text: str, machine: Machine, folder: Path) -> Plan:
    """The campaign of a script's text, which goes into the folder."""
    file = folder / "campaign.yaml"
    file.write_text(text, encoding="utf-8")
    return plan_campaign(load_script(file), machine)
