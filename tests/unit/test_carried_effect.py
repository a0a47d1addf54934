"""A concealed effect on the machine that moves: it is what it would be on the whole campaign seen at once."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from simulators.clock import SteppedClock
from simulators.concealed.campaign import Campaign, draw_campaign
from simulators.concealed.catalogue import KNOWN
from simulators.concealed.live import CARRIED, CarriedEffect, _at_pace, conceal
from simulators.concealed.scene import Scene
from simulators.hardware import SimulatedHardware, ToConceal
from simulators.plant import Load, Plant

Array = NDArray[np.float64]
PPS = Path(__file__).parents[2] / "machines/pps.yaml"
VISITS = 60
AMPLITUDE = 1e-4


@pytest.fixture(scope="module")
def plant() -> Plant:
    return Plant.from_file(PPS, seed=5)


@pytest.fixture(scope="module")
def scene(plant: Plant) -> Scene:
    campaign = _at_pace(draw_campaign(plant.chain, VISITS, np.random.default_rng(8)), 6 * 3600.0)
    return Scene.of(plant, campaign, campaign.commanded, np.random.default_rng(9))


def loads(campaign: Campaign) -> list[Load | None]:
    """One object per load, as an operator puts it on."""
    out: list[Load | None] = []
    for k, (mass, com) in enumerate(zip(campaign.mass.tolist(), campaign.com, strict=True)):
        same = k > 0 and campaign.load[k] == campaign.load[k - 1]
        out.append(out[-1] if same else Load(mass, com) if mass > 0 else None)
    return out


@pytest.mark.parametrize("name", CARRIED)
def test_visit_by_visit_the_machine_does_what_it_does_on_the_whole_campaign(
    name: str, plant: Plant, scene: Scene
) -> None:
    concealed = KNOWN[name](scene, np.random.default_rng([3, *name.encode()]))
    live = CarriedEffect(plant, concealed, AMPLITUDE, b"", lambda: [])
    change = concealed.change(AMPLITUDE)
    points, wrench = scene.points([change]), scene.sensed([change])
    campaign, names = scene.campaign, tuple(plant.targets)
    for v, load in enumerate(loads(campaign)):
        time = float(campaign.time[v])
        said = live.sensed(time, scene.q[v], load)
        seen = live.seen(time, scene.q[v], load, scene.scatter[v : v + 1], names)
        np.testing.assert_allclose([seen[t] for t in names], points[v], atol=1e-12)
        np.testing.assert_allclose(said, wrench[v], atol=1e-9)
    quiet = scene.points()
    assert np.abs(points - quiet).max() > 1e-7 or np.abs(wrench - scene.wrench).max() > 1e-3


def test_a_pose_passed_without_looking_leaves_its_mark(plant: Plant, scene: Scene) -> None:
    """A joint with play that was sent past its place and back stands on the other side of its gap."""
    concealed = next(
        c for c in (KNOWN["backlash"](scene, np.random.default_rng(s)) for s in range(500))
        if (c.joint, c.form) == ("vertical", "play")
    )  # fmt: skip
    k = plant.joint_names.index("vertical")
    home, away = np.zeros(6), np.zeros(6)
    away[k] = 0.1
    ways: list[list[tuple[float, Array]]] = [[], [(10.0, home)], [(20.0, away), (30.0, home)]]
    live = CarriedEffect(plant, concealed, 4e-4, b"", lambda: ways.pop(0))
    still, names = np.zeros((1, 6, 6)), tuple(plant.targets)
    start = live.seen(0.0, -away, None, still, names)["P1"]
    from_below = live.seen(12.0, home, None, still, names)["P1"]
    from_above = live.seen(32.0, home, None, still, names)["P1"]
    assert np.linalg.norm(from_above - from_below) == pytest.approx(4e-4, rel=1e-3)
    assert np.linalg.norm(from_below - start) > 0.05


def test_the_seal_is_the_hash_of_the_truth_and_another_salt_makes_another(plant: Plant) -> None:
    one, again, other = (conceal(plant, 7, 5.0, salt, lambda: []) for salt in ("a", "a", "b"))
    assert one.seal == again.seal == hashlib.sha256(one.truth).hexdigest() != other.seal
    truth, salted = json.loads(one.truth), json.loads(other.truth)
    assert truth.pop("salt") == "a"
    assert salted.pop("salt") == "b"
    assert truth == salted
    assert truth["rms_mm"] == pytest.approx(2 * truth["repeatability_rms_mm"], rel=0.01)


@pytest.mark.long
def test_the_truth_says_its_parameters_with_their_units(plant: Plant) -> None:
    said: dict[str, set[str]] = {}
    for effect in CARRIED:
        for seed in range(4):
            truth = json.loads(conceal(plant, seed, 5.0, "", lambda: [], effect=effect).truth)
            assert truth["units"].keys() == truth["parameters"].keys()
            for name, unit in truth["units"].items():
                said.setdefault(name, set()).add(unit)
    assert said["after_s"] == {"s"}
    assert said["compliance"] == {"rad/(N m)"}  # of the floor
    assert said["gap"] == said["period"] == {"m", "rad"}  # rails and turning joints
    assert said["per_kelvin"] <= {"1/K", "m/K", "rad/K"}
    assert said["exponent"] == {"1"}


def test_seeds_pick_different_effects(plant: Plant) -> None:
    picked = {json.loads(conceal(plant, seed, 5.0, "", lambda: []).truth)["effect"] for seed in range(12)}
    assert len(picked) >= 5
    with pytest.raises(ValueError, match="no effect 'outliers' to carry"):
        conceal(plant, 0, 5.0, "", lambda: [], effect="outliers")


def test_simulated_hardware_carries_it_and_its_tracker_sees_it(tmp_path: Path) -> None:
    """The floor gives way under the machine itself: away from where the same machine stands without it."""
    seen = []
    for concealed in (None, ToConceal(1, 5.0, "", effect="missing_compliance")):
        clock = SteppedClock()
        with SimulatedHardware(PPS, clock, tmp_path, seed=3, concealed=concealed) as hardware:
            seen.append(hardware.live.visible_targets()["P1"])
            assert (hardware.carried is None) == (concealed is None)
    assert 2e-5 < np.linalg.norm(seen[1] - seen[0]) < 2e-3
