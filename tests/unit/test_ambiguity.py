"""Identification says which parameters a recording cannot tell apart, and what to measure for it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ppshw.cli import main
from ppshw.identification.ambiguity import Ambiguity, _candidates, _load_words, ambiguities
from ppshw.identification.joint import estimate, lines
from ppshw.identification.strengths import Groups
from ppshw.identification.structure import joint_model
from ppshw.kinematics import frames
from ppshw.machine import Machine, load_machine
from ppshw.recording import Recording, load_recording
from simulators.offline import simulate_recording_csv
from simulators.plant import Plant

PPS = Path(__file__).parents[2] / "machines/pps.yaml"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Machine, Recording]:
    machine = load_machine(PPS)
    path = tmp_path_factory.mktemp("ambiguity") / "r.csv"
    return machine, load_recording(simulate_recording_csv(Plant.from_file(PPS, 5), path, 90), machine)


def found_in(machine: Machine, recording: Recording) -> dict[str, Ambiguity]:
    model = joint_model(machine, recording, waves=2)
    return {a.parameter: a for a in ambiguities(estimate(model, recording), recording)}


def test_rails_that_never_turn_share_one_offset_that_no_visit_splits(recorded: tuple[Machine, Recording]) -> None:
    """Base, lateral, vertical and longitudinal keep their axes parallel: of four offsets one sum is to be seen."""
    found = found_in(*recorded)
    for axis in ("tx", "ty", "tz"):
        frames = ("base", "lateral", "vertical", "longitudinal")
        alike = [found.get(f"{frame}.{axis}[0]") for frame in frames]
        told = [a for a in alike if a is not None]
        assert len(told) >= 3
        for one in told:
            assert one.visit is None
            assert "no visit separates them" in one.sentence
            assert one.like[0][0].split(".")[1] == f"{axis}[0]"
            assert one.like[0][1] == pytest.approx(1.0, abs=0.02)


def test_a_joint_that_never_moved_is_asked_for(recorded: tuple[Machine, Recording]) -> None:
    """With yaw at rest, what turns with it looks like what does not, until yaw stands elsewhere."""
    machine, recording = recorded
    q = recording.q.copy()
    q[:, 3] = 0.0
    plant = Plant.from_file(PPS, 5)
    seen = plant.true_points(q, recording.wrench, plant.draw_repeatability(len(q), np.random.default_rng(1)))
    still = replace(recording, q=q, q_cmd=q, points=np.stack(list(seen.values()), axis=1))
    asked = {n: a for n, a in found_in(machine, still).items() if n.startswith(("yaw.t", "roll.t", "pitch.t"))}
    shifts = [a for n, a in asked.items() if n.endswith("[0]") and "C[" not in n]
    assert shifts
    wanted = [a for a in shifts if a.visit is not None and "yaw at" in a.visit.words]
    assert wanted
    assert all(a.visit is not None and abs(a.visit.q[3]) > 0.5 for a in wanted)
    # the same offsets with yaw moving all over its range are told from the rails' by the recording itself
    assert "yaw.tx[0]" not in found_in(*recorded) or "roll.tx[0]" not in found_in(*recorded)


def test_without_loads_a_load_is_asked_for(recorded: tuple[Machine, Recording]) -> None:
    machine, recording = recorded
    plant = Plant.from_file(PPS, 5)
    seen = plant.true_points(recording.q, None, plant.draw_repeatability(len(recording), np.random.default_rng(2)))
    bare = replace(recording, wrench=np.zeros((len(recording), 6)), points=np.stack(list(seen.values()), axis=1))
    elastic = [a for n, a in found_in(machine, bare).items() if n.startswith("pitch.C[r") and a.visit is not None]
    assert elastic
    assert all("a load of" in a.visit.words for a in elastic if a.visit)


def test_loads_hang_down_whatever_the_pose_the_usual_one_too(
    recorded: tuple[Machine, Recording], tmp_path: Path
) -> None:
    """At A of -1.5 rad gravity was to pull sideways on a joint that stands upright (a reviewer's portal)."""
    tipping = tmp_path / "tipping.yaml"
    tipping.write_text(PPS.read_text(encoding="utf-8").replace("0.05235987755982989", "1.5"), encoding="utf-8")
    machine = load_machine(tipping)
    assert machine.limits()[1][4:].tolist() == [1.5, 1.5]

    def pull(q: NDArray[np.float64]) -> NDArray[np.float64]:
        sensor = frames(machine, q)[:, -1] @ machine.sensor_in_link
        return np.einsum("cji,j->ci", sensor[:, :3, :3], 80.0 * machine.gravity)

    q = np.random.default_rng(3).uniform(*machine.limits(), (len(recorded[1]), machine.n))
    wrench = np.hstack([pull(q), np.cross([0.1, 0.2, 0.4], pull(q))])
    visits, words = _candidates(machine, replace(recorded[1], q=q, wrench=wrench, load=("box",) * len(q)))
    down, force = pull(visits.q), visits.payload[:, :3]
    share = np.linalg.norm(force, axis=1, keepdims=True) / np.linalg.norm(down, axis=1, keepdims=True)
    np.testing.assert_allclose(force, share * down, atol=1e-6)
    usual = np.array(["load" not in each for each in words])
    assert usual.any()
    assert not usual.all()
    np.testing.assert_allclose(force[usual], down[usual], atol=1e-6)
    np.testing.assert_allclose(visits.payload[usual, 3:], np.cross([0.1, 0.2, 0.4], down[usual]), atol=1e-6)
    assert share.min() == 0.0


def test_its_sentence_says_nothing_twice_and_loads_without_powers_of_ten() -> None:
    waves = [(f"longitudinal.C[tz,Mz][{k}]", 1.0) for k in (1, 2, 4)]
    like = (*waves, ("longitudinal.C[rx,Mz][3]", 0.5))
    found = Ambiguity("longitudinal.C[tz,Mz][3]", like, 0.9, None)
    assert found.sentence == (
        "how its position changes tz per Mz of frame longitudinal, with other parts of itself and how its position "
        "changes rx per Mz of frame longitudinal: no visit separates them"
    )
    assert _load_words(np.array([0, -2009.6, 0, 0, 0, -1734.4])) == (
        "a load of 2010 N with moment about z (-1730 N·m)")  # fmt: skip


def test_a_joint_that_is_called_base_is_not_the_base() -> None:
    found = Ambiguity("ground.rz[0]", (("base.rz[0]", 1.0),), 0.9, None, "ground")
    assert found.sentence == "rz of the base, with rz of frame base: no visit separates them"


def test_the_command_says_it_in_words_in_json_and_in_the_calibration(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    simulate_recording_csv(Plant.from_file(PPS, 5), tmp_path / "r.csv", 40)
    command = ["identify", str(tmp_path / "r.csv"), "--machine", str(PPS), "--out"]
    assert main([*command, str(tmp_path / "a.json")]) == 0
    text = capsys.readouterr().out
    assert "move the targets like others do" in text
    assert main([*command, str(tmp_path / "b.json"), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)["ambiguous"]
    assert json.loads((tmp_path / "b.json").read_text(encoding="utf-8"))["ambiguous"] == answer
    with_visit = [a for a in answer if a["visit"]]
    assert with_visit
    for each in with_visit[:3]:  # on a line of its own
        assert f"\n    {each['sentence'][:30]}" in text
    assert set(with_visit[0]["visit"]["pose"]) == {"lateral", "vertical", "longitudinal", "yaw", "roll", "pitch"}


def test_a_joint_may_be_called_target_and_names_may_hold_dots() -> None:
    assert Ambiguity("target.tx[0]", (), 1.0, None).sentence.startswith("tx of frame target, ")
    assert Ambiguity("target.P.1.x", (), 1.0, None).sentence.startswith("x of target P.1, ")


def test_what_a_joint_is_called_changes_nothing(recorded: tuple[Machine, Recording]) -> None:
    machine, recording = recorded
    names = {"lateral": "band", "vertical": "w.3"}
    joints = tuple(replace(j, name=names.get(j.name, j.name)) for j in machine.joints)
    called = replace(machine, joints=joints)
    other = joint_model(called, recording, waves=4)
    model = joint_model(machine, recording, waves=4)
    assert lines(other).tolist() == lines(model).tolist()
    assert Groups.among(other.parameters()).kind.tolist() == Groups.among(model.parameters()).kind.tolist()
