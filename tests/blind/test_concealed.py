"""Concealed cases and the scoring of diagnoses: what is sealed stays sealed, what is scored is right."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ppshw.cli import main
from ppshw.errors import BadInput, SealBroken
from ppshw.identification import identify
from ppshw.machine import load_machine
from ppshw.prove import EFFECTS, SIZES, Spec, deck, removed_deck, run_prove
from ppshw.prove.score import bound, judge, least_left, open_seal, score_case, score_of
from ppshw.prove.table import half_power, share, summarise
from ppshw.recording import load_recording
from ppshw.terms.shapes import Column, Context
from simulators.chain import read_chain
from simulators.concealed import by_load
from simulators.concealed.campaign import draw_campaign
from simulators.concealed.case import dimension, make_case
from simulators.concealed.catalogue import KNOWN, UNKNOWN
from simulators.concealed.scene import Concealed, Scene, rms
from simulators.plant import Plant

MACHINES = Path(__file__).parents[2] / "machines"
VISITS = 360


# --- what a case consists of ---------------------------------------------------------------------------------------
def make(folder: Path, effect: str, seed: int = 5, size: float = 1.0, machine: str = "pps", visits: int = 200) -> Path:
    make_case(seed, machine, effect, size, folder / "case", folder / "sealed", visits, visits * 3 // 4)
    return folder / "case"


def columns(case: Path) -> dict[str, Any]:
    """Both recordings after each other: column → numbers, or texts where they are no numbers."""
    rows = [row for name in ("recording.csv", "held_out.csv") for row in csv.DictReader((case / name).open())]
    texts = ("time", "step", "load")
    return {k: [r[k] if k in texts else float(r[k]) for r in rows] for k in rows[0]}


def points(case: Path) -> np.ndarray[Any, Any]:
    table = columns(case)
    return np.array([[table[f"{t}_{axis}"] for axis in "xyz"] for t in ("P1", "P2", "P3")]).transpose(2, 0, 1)


def test_the_same_seed_makes_the_same_case_to_the_last_byte(tmp_path: Path) -> None:
    one, two, other = (make(tmp_path / n, "pair", seed) for n, seed in (("a", 5), ("b", 5), ("c", 6)))
    for name in ("machine.yaml", "recording.csv", "held_out.csv", "seal.sha256"):
        assert (one / name).read_bytes() == (two / name).read_bytes()
        assert (one / name).read_bytes() != (other / name).read_bytes()


@pytest.mark.parametrize("machine", ["pps", "arm6"])
@pytest.mark.parametrize("size", [0.3, 2.0])
def test_an_effect_moves_the_recorded_reflectors_by_the_size_that_was_asked(
    tmp_path: Path, machine: str, size: float
) -> None:
    """Machine, campaign and noise depend on the seed alone: two recordings differ by the effect and nothing else."""
    quiet = make(tmp_path / "null", "null", 8, 0.0, machine)
    floor = json.loads((tmp_path / "null/sealed/truth.json").read_text())["repeatability_rms_mm"]
    for effect in ("backlash", "thermal_growth", "clearance", "outliers", "resonance"):
        with_it = make(tmp_path / effect, effect, 8, size, machine)
        assert 1e3 * rms(points(with_it) - points(quiet)) == pytest.approx(size * floor, rel=0.05)


def test_the_repeatability_is_what_reflectors_scatter_by_when_a_pose_is_driven_to_again(tmp_path: Path) -> None:
    """At the reference pose, under no load, only the arrival's scatter and the tracker's 20 µm are left."""
    case = make(tmp_path, "null", 3, 0.0, visits=900)
    table, seen = columns(case), points(case)
    empty = np.hypot(table["Fy"], table["Mx"]) < 10
    home = np.array([s == "reference" for s in table["step"]]) & empty
    scatter = seen[home] - seen[home].mean(axis=0)
    found = np.sqrt((scatter**2).sum(axis=2).mean() * home.sum() / (home.sum() - 1))
    floor = 1e-3 * json.loads((tmp_path / "sealed/truth.json").read_text())["repeatability_rms_mm"]
    assert home.sum() >= 10
    assert found == pytest.approx(np.hypot(floor, 20e-6 * np.sqrt(3)), rel=0.35)


def seal_of(case: Path) -> str:
    return (case / "seal.sha256").read_text(encoding="utf-8").strip()


def test_nothing_in_the_case_folder_betrays_the_effect(tmp_path: Path) -> None:
    quiet = make(tmp_path / "null", "null", 4, 0.0)
    for effect in (*KNOWN, *UNKNOWN):
        case = make(tmp_path / effect, effect, 4)
        truth = json.loads((tmp_path / effect / "sealed/truth.json").read_text())
        told = truth["effects"][0]
        numbers = [f"{v:.5g}" for v in told["parameters"].values() if v != round(v)]
        assert sorted(p.name for p in case.iterdir()) == sorted(p.name for p in quiet.iterdir())
        for file in case.iterdir():
            text, usual = file.read_text(), (quiet / file.name).read_text()
            if file.name != "seal.sha256":
                assert set(re.findall("[A-Za-z_]{2,}", text)) == set(re.findall("[A-Za-z_]{2,}", usual)), file
            assert not [x for x in numbers if x in text], file
        if effect != "missing_compliance":  # whose machine file is the one that lacks something
            assert (case / "machine.yaml").read_bytes() == (quiet / "machine.yaml").read_bytes()


def test_a_truth_that_was_touched_after_sealing_is_refused(tmp_path: Path) -> None:
    case = make(tmp_path, "drift")
    assert open_seal(seal_of(case), tmp_path / "sealed")["effects"][0]["effect"] == "drift"
    file = tmp_path / "sealed/truth.json"
    file.write_text(file.read_text().replace("drift", "creep"))
    with pytest.raises(SealBroken, match=r"truth.json: hash \w{12}, but \w{12} was published"):
        open_seal(seal_of(case), tmp_path / "sealed")


def test_the_campaign_is_one_that_can_be_diagnosed(tmp_path: Path) -> None:
    """What physics asks for: both directions, references, many loads, moments of both signs, heat up and down."""
    table = columns(make(tmp_path, "null", 2, 0.0, visits=600))
    for joint in ("lateral", "yaw", "pitch"):
        assert 0.3 < np.mean(np.array(table[f"approach_{joint}"]) > 0) < 0.7
    assert 20 <= table["step"].count("reference") <= 60
    assert len(set(table["load"])) >= 15
    for moment in ("Mx", "Mz"):
        assert min(np.mean(np.array(table[moment]) > 5), np.mean(np.array(table[moment]) < -5)) > 0.05
    turns = np.diff(np.sign(np.diff(np.array(table["temp_rail_C"])[::10])))
    assert (turns != 0).sum() >= 4


# --- each effect's own mark ----------------------------------------------------------------------------------------
@cache
def scene() -> Scene:
    rng = np.random.default_rng(12)
    plant = Plant(read_chain(MACHINES / "pps.yaml"), seed=12)
    campaign = draw_campaign(plant.chain, VISITS, rng)
    return Scene.of(plant, campaign, campaign.commanded, rng)


def test_scatter_that_remembers_is_as_large_and_like_that_of_the_visit_before() -> None:
    still, remembers = scene().scatter, scene().remembering(0.6).scatter
    there = still.std(axis=0) > 0
    u, v = still[:, there] / still[:, there].std(axis=0), remembers[:, there] / still[:, there].std(axis=0)
    assert abs((u[1:] * u[:-1]).mean()) < 0.1
    assert abs((v[1:] * v[:-1]).mean() / (v**2).mean() - 0.6) < 0.1
    assert abs((v**2).mean() - 1.0) < 0.2


@pytest.mark.parametrize("correlation", [1.0, -1.5, float("nan")])
def test_a_correlation_that_no_noise_has_is_refused_before_anything_is_written(
    tmp_path: Path, correlation: float
) -> None:
    with pytest.raises(ValueError, match="expected one between -1 and 1"):
        make_case(1, "pps", "null", 0.0, tmp_path / "case", tmp_path / "sealed", 60, 45, remembers=correlation)
    assert not list(tmp_path.iterdir())


def drawn(effect: str, form: str, joints: tuple[str | None, ...] = ()) -> tuple[Concealed, np.ndarray[Any, Any], int]:
    """The effect in this form, its eps (N, 6) on its link and the link's number; sized to 1e-4 m at the reflectors."""
    for seed in range(300):
        found = {**KNOWN, **UNKNOWN}[effect](scene(), np.random.default_rng(seed))
        if found.form == form and (not joints or found.joint in joints):
            sized = dimension(scene(), found, 1e-4)
            names = [j.name for j in scene().chain.joints]
            k = names.index(found.joint) if found.joint else 0
            eps = sized.change.eps
            return found, np.zeros((VISITS, 6)) if eps is None else eps[:, k], k
    raise AssertionError(f"{effect} never came as {form}")


def along(effect: str, form: str) -> tuple[np.ndarray[Any, Any], int]:
    """The joint's own motion that the effect adds to, for a prismatic joint."""
    _, eps, k = drawn(effect, form, ("lateral", "vertical", "longitudinal"))
    return eps @ np.append(scene().chain.joints[k].axis, np.zeros(3)), k


def test_play_keeps_the_joint_half_a_gap_behind_whichever_way_it_came() -> None:
    lag, k = along("backlash", "play")
    approach = scene().campaign.approach[:, k]
    moved = np.flatnonzero(approach)[5:]
    assert np.array_equal(np.sign(lag[moved]), -approach[moved])
    assert np.abs(lag[moved]).std() < 1e-9


def test_friction_lags_more_the_farther_the_joint_has_come_since_it_turned() -> None:
    lag, k = along("friction_hysteresis", "Maxwell slip")
    approach, path = scene().campaign.approach[:, k], scene().campaign.commanded[:, k]
    same = (approach[1:] == approach[:-1]) & (np.abs(np.diff(path)) > 0)
    growth = -(np.diff(lag) * approach[1:])
    assert growth[same].min() > -1e-12
    assert (growth[same] > 1e-7).mean() > 0.3
    turned = approach[1:] * approach[:-1] < 0
    assert growth[turned].mean() > 3 * growth[same].mean()


def test_a_link_that_grows_follows_its_lagged_temperature_and_its_free_length() -> None:
    _, eps, k = drawn("thermal_growth", "grows", ("longitudinal",))
    time, air = scene().campaign.time, scene().campaign.temperature["air"]
    growth = eps[:, 2]
    lags = [by_load.lagged(air - air[0], time, 60.0 * m) for m in (1, 10, 20, 40, 60)]
    q = scene().q[:, k]
    design = np.column_stack([np.ones(VISITS), *lags, *(lag * q for lag in lags)])
    left = growth - design @ np.linalg.lstsq(design, growth, rcond=None)[0]
    assert growth[0] == 0.0
    assert left.std() < 0.05 * growth.std()


@pytest.mark.parametrize("form", ["warm-up", "settling", "wandering"])
def test_drift_moves_all_of_the_machine_and_slowly(form: str) -> None:
    found, _, _ = drawn("drift", form)
    base = found.change(1e-4).base
    assert base is not None
    assert found.joint is None
    course = np.linalg.norm(base - base[0], axis=1)
    assert np.abs(np.diff(base, axis=0)).max() < 0.3 * np.ptp(base, axis=0).max()
    assert course[-1] > 0


def test_a_wrong_metre_stretches_every_distance_alike() -> None:
    found, _, _ = drawn("tracker_scale", "constant")
    quiet, loud = scene().points(random=False), scene().points([found.change(1e-3)], random=False)
    sides = [np.linalg.norm(p[:, 0] - p[:, 1], axis=1) for p in (quiet, loud)]
    assert np.abs(sides[1] / sides[0] - 1) == pytest.approx(1e-3, rel=1e-6)


def test_a_transmission_repeats_its_error_turn_after_turn() -> None:
    found, _, k = drawn("periodic_transmission", "tooth")
    axis = np.abs(found.change(1e-4).eps[0, k]).argmax()  # type: ignore[index]
    period = found.parameters(1e-4)["period"]
    error = found.change(1e-4).eps[:, k, axis]  # type: ignore[index]
    order = np.argsort(np.mod(scene().q[:, k] / period, 1.0))
    folded = error[order]
    assert np.sort(np.abs(np.diff(folded)))[:-12].sum() < 10 * np.ptp(error)  # smooth but for the flank
    assert np.abs(np.diff(error[np.argsort(scene().q[:, k])])).sum() > 15 * np.ptp(error)


def test_a_shifted_zero_is_right_before_and_wrong_after() -> None:
    found, _, k = drawn("zero_shift", "jump")
    eps = found.change(1e-4).eps
    assert eps is not None
    size = np.linalg.norm(eps[:, k], axis=1)
    when = found.parameters(1e-4)["after_s"]
    assert np.array_equal(size > 0, scene().campaign.time >= when)
    assert size.max() == pytest.approx(1e-4)


def test_a_coupling_is_zero_where_either_joint_is_in_its_middle_and_flips_across_it() -> None:
    found, eps, k = drawn("cross_coupling", "bilinear")
    other = [j.name for j in scene().chain.joints].index(found.also[0])
    u, w = scene().unit_position(k), scene().unit_position(other)
    size = eps.sum(axis=1)
    assert np.all(
        np.sign(size[np.abs(u * w) > 1e-9]) == np.sign((u * w)[np.abs(u * w) > 1e-9]) * np.sign(size @ (u * w))
    )


def test_a_bearing_departs_from_the_straight_line_between_no_load_and_full_load() -> None:
    found, eps, k = drawn("nonlinear_stiffness", "contact")
    part = ("tx", "ty", "tz", "rx", "ry", "rz").index(found.component or "")
    load = scene().carried[:, k, part]
    share_of_full = np.abs(load) / np.abs(load).max()
    bent = eps[:, part] * np.sign(load)
    assert bent[share_of_full.argmax()] == pytest.approx(0.0, abs=1e-12)
    middle = (share_of_full > 0.1) & (share_of_full < 0.6)
    assert bent[middle].min() > 0.5 * bent.max()


@pytest.mark.parametrize("form", ["smooth", "asymmetric", "sticky"])
def test_a_joint_with_clearance_lies_on_the_side_to_which_the_moment_pushes(form: str) -> None:
    found, eps, k = drawn("clearance", form)
    part = ("tx", "ty", "tz", "rx", "ry", "rz").index(found.component or "")
    load = scene().carried[:, k, part]
    heavy = np.abs(load) > 0.3 * np.abs(load).max()
    assert heavy.sum() > 20
    assert np.array_equal(np.sign(eps[heavy, part]), np.sign(load[heavy]))
    side = np.abs(eps[heavy, part])
    assert side[load[heavy] > 0].std() < 0.05 * side.max()


def test_own_weight_bends_alike_whatever_lies_on_the_couch() -> None:
    _, eps, _ = drawn("moving_weight", "own bend")
    home = np.array([s == "reference" for s in scene().campaign.step])
    assert scene().campaign.mass[home].std() > 10
    assert np.abs(eps[home] - eps[home][0]).max() < 1e-9
    assert np.abs(eps).max() > 1e-6


def test_a_force_sensor_that_errs_moves_nothing_but_its_columns(tmp_path: Path) -> None:
    quiet, loud = make(tmp_path / "a", "null", 9, 0.0), make(tmp_path / "b", "wrench_error", 9)
    assert np.abs(points(loud) - points(quiet)).max() == 0.0
    a, b = columns(quiet), columns(loud)
    assert max(np.abs(np.subtract(b[c], a[c])).max() for c in ("Fy", "Mx", "My", "Mz")) > 1.0


@pytest.mark.parametrize("form", ["two exponentials", "logarithmic"])
def test_creep_is_greatest_when_the_load_has_just_changed(form: str) -> None:
    _, eps, _ = drawn("creep", form)
    size = np.linalg.norm(eps, axis=1)
    changed = np.flatnonzero(np.diff(scene().campaign.mass)) + 1
    ends = np.append(changed[1:], VISITS) - 1
    heavy = np.abs(np.diff(scene().campaign.mass)[changed - 1]) > 50
    assert size[changed][heavy].mean() > 1.7 * size[ends][heavy].mean()


def test_a_spring_that_the_file_leaves_out_gives_way_in_proportion_to_the_load(tmp_path: Path) -> None:
    """Twice the payload and the machine's own weight: a linear spring answers with twice the bend."""
    s = scene()
    rigid = Scene(**{**s.__dict__, "rigid": ("yaw",)})
    found = by_load.missing_compliance(rigid, np.random.default_rng(0))
    eps = found.change(1e-4).eps
    assert eps is not None
    assert found.joint == "yaw"
    strong = np.abs(s.carried[:, 3, 3]) > 10
    ratio = eps[strong, 3, 3] / s.carried[strong, 3, 3]
    assert ratio.std() < 1e-6 * np.abs(ratio).mean()
    lines = [make(tmp_path / str(k), "missing_compliance", k).joinpath("machine.yaml").read_text() for k in range(6)]
    assert {text.count("elastic") for text in lines} == {5, 6}


def test_a_knocked_reflector_moves_alone_and_from_some_moment() -> None:
    found, _, _ = drawn("target_moved", "knocked")
    moved = np.linalg.norm(scene().field(found.change(1e-3)), axis=2)
    which = list(scene().plant.targets).index(found.target or "")
    others = [k for k in range(3) if k != which]
    assert moved[:, others].max() < 1e-9
    first = int(np.flatnonzero(moved[:, which])[0])
    assert VISITS * 0.15 < first < VISITS * 0.7
    assert moved[first:, which] == pytest.approx(1e-3, rel=1e-6)


@pytest.mark.parametrize("form", ["readings", "visits", "mixed"])
def test_outliers_are_few_and_far_out(form: str) -> None:
    found, _, _ = drawn("outliers", form)
    sized = dimension(scene(), found, 1e-4)
    size = np.linalg.norm(sized.field, axis=2).max(axis=1)
    assert 2 <= (size > 0).sum() <= 0.02 * VISITS + 1
    assert np.median(size[size > 0]) > 5e-4


def test_an_unsettled_machine_scatters_the_more_the_sooner_it_is_measured() -> None:
    _, eps, _ = drawn("unsettled", "dying out")
    size = np.linalg.norm(eps, axis=1)
    settle = scene().campaign.settle
    assert np.sqrt((size[settle < 4] ** 2).mean()) > 3 * np.sqrt((size[settle > 9] ** 2).mean())
    assert np.abs(eps.mean(axis=0)).max() < 0.15 * size.max()


@pytest.mark.parametrize("effect", sorted(UNKNOWN))
def test_effects_outside_the_catalogue_can_be_drawn_and_say_where_they_sit(effect: str) -> None:
    found = UNKNOWN[effect](scene(), np.random.default_rng(1))
    sized = dimension(scene(), found, 1e-4)
    assert rms(sized.field) == pytest.approx(1e-4, rel=0.01)
    assert found.covariates
    assert found.joint is not None


# --- scoring -------------------------------------------------------------------------------------------------------
CONSISTENT: dict[str, Any] = {"verdict": "consistent", "findings": [], "unexplained": None}


def says_nothing(case: Path, answers: Path) -> dict[str, Any]:
    return CONSISTENT


def oracle(case: Path, answers: Path) -> dict[str, Any]:
    """Peeks: no diagnosis may, but the scoring must give full marks to one that does."""
    truth = json.loads((case.parents[1] / "sealed" / case.name / "truth.json").read_text())
    findings = [{"effect": e["effect"], "joint": e["joint"], "weight": 0.99} for e in truth["effects"] if e["known"]]
    strange = [e for e in truth["effects"] if not e["known"]]
    unexplained = {"covariates": strange[0]["covariates"][:2]} if strange else None
    verdict = "unexplained" if strange else "missing_physics" if findings else "consistent"
    return {"verdict": verdict, "findings": findings, "unexplained": unexplained}


def dies_on_the_first(case: Path, answers: Path) -> dict[str, Any]:
    if case.name == "1":
        os._exit(9)
    return oracle(case, answers)


TO_BE_RIGHT = (
    "effect of 1 × repeatability: right name",
    "effect of 1 × repeatability: right joint when named",
    "pair, 1 × each: both named",
    "outside the catalogue, 1 ×: unexplained, or a fair neighbour",
    "outside the catalogue, 1 ×: located",
    "√λ beside priors ≥ 6: detected",
)


def by_name(document: dict[str, Any]) -> dict[str, Any]:
    return {bar["what"]: bar for bar in document["bars"]}


def test_an_oracle_gets_full_marks_and_silence_none(tmp_path: Path) -> None:
    scores: dict[str, list[dict[str, Any]]] = {"oracle": [], "silent": []}
    for k, effect in enumerate(("null", "backlash", "cross_coupling", "drift", "target_moved", "pair", "unknown")):
        make_case(k, "arm6", effect, 1.0, tmp_path / f"cases/{k}", tmp_path / f"sealed/{k}", 60, 60)
        truth = open_seal(seal_of(tmp_path / f"cases/{k}"), tmp_path / f"sealed/{k}")
        told = [{**e, "sqrt_lambda": 7.0, "power": 1.0} for e in truth["effects"]]
        for who, answer in (("oracle", oracle(tmp_path / f"cases/{k}", tmp_path)), ("silent", CONSISTENT)):
            scores[who].append(score_of(truth, told, answer, None, 1.0))
    right, silent = summarise(scores["oracle"]), summarise(scores["silent"])
    for what in TO_BE_RIGHT:
        assert by_name(right)[what]["share"] == 1.0
        assert not by_name(silent)[what]["share"]
    assert by_name(right)["nulls: anything found"]["share"] == by_name(silent)["nulls: anything found"]["share"] == 0.0
    assert [(w["right"]["hits"], w["right"]["of"]) for w in right["weights"]] == [(6, 6)]
    assert silent["weights"] == []


def test_a_case_whose_name_was_taken_out_counts_for_that_bar_alone() -> None:
    """Two backlashes that the library must not know: one called hysteresis, one left unexplained."""
    truth = {"effect": "backlash", "form": "play", "joint": "yaw", "also": [], "neighbours": [], "known": True,
             "covariates": ["approach_yaw"], "sqrt_lambda": 9.0, "power": 1.0}  # fmt: skip
    about = dict.fromkeys(("seed", "machine", "asked", "repeatability_rms_mm"), 0) | {"size": 1.0}
    wrong = {**CONSISTENT, "verdict": "missing_physics", "findings": [
        {"effect": "friction_hysteresis", "joint": "yaw", "weight": 0.9, "covariate": "move_yaw"}]}  # fmt: skip
    unexplained = {**CONSISTENT, "verdict": "unexplained", "unexplained": {"covariates": ["q_yaw"]}}
    spec = {"without": "backlash"}

    def scored(left: float) -> list[dict[str, Any]]:
        more = {"spec": spec, "sqrt_lambda_left": left}
        return [{**more, **score_of(about, [truth], answer, None, 1.0)} for answer in (wrong, unexplained)]

    table = summarise(scored(7.5))
    bars = by_name(table)
    out = bars["its name taken out of the library: another name"]
    assert (out["hits"], out["nobody_could_tell"], len(table["removed"])) == (1, 0, 2)
    alike = by_name(summarise(scored(2.0)))["its name taken out of the library: another name"]
    assert (alike["hits"], alike["nobody_could_tell"], alike["met"]) == (1, 1, "no")
    assert alike["text"].endswith("; of the rest 1 leave √λ < 3.2")
    assert bars["√λ beside priors ≥ 6: detected"]["met"] == "open"
    assert bars["effect of 1 × repeatability: right name"]["met"] == "open"
    assert {c.effect == c.without for c in removed_deck(20, 3)} == {True}
    assert not {c.seed for c in removed_deck(20, 3)} & {c.seed for c in deck(400, 3)}


def test_a_lost_worker_costs_its_case_alone_and_a_second_run_takes_up_where_it_stopped(tmp_path: Path) -> None:
    """The oracle leaves no calibration: it gains nothing, though the true form would."""
    cases = [Spec(1, "pps", "null", 0.0, 80, 80), Spec(2, "pps", "backlash", 1.0, 120, 80)]
    first = run_prove(tmp_path, cases, dies_on_the_first, workers=2)
    assert first["lost"] == {"1": "its workers died, one after the other"}
    done = tmp_path / "scores/2.json"
    before, score = done.stat().st_mtime_ns, json.loads(done.read_text())
    held_out = score["held_out"]
    assert score["truth"][0]["sqrt_lambda"] > 6
    assert held_out["rms_true_form_mm"] < held_out["rms_before_mm"] == held_out["rms_after_mm"]
    assert held_out["realised"] == 0.0

    second = run_prove(tmp_path, cases, says_nothing, workers=0)
    assert second["lost"] == {}
    assert done.stat().st_mtime_ns == before
    seals = dict(line.split()[:2] for line in (tmp_path / "seals.txt").read_text().splitlines())
    assert {k: (tmp_path / f"cases/{k}/seal.sha256").read_text().strip() for k in ("1", "2")} == seals
    assert "| backlash | 1 × | 1/1 |" in (tmp_path / "prove.md").read_text()
    page = (tmp_path / "prove.html").read_text()
    assert page.count("<table>") == page.count("</table>") == 4
    assert "http" not in page


def cheats(case: Path, answers: Path) -> dict[str, Any]:
    """Writes the truth that it answers, and its hash where it lies in its own folder."""
    truth = case.parents[1] / "sealed" / case.name / "truth.json"
    truth.write_text(truth.read_text().replace("backlash", "drift"))
    (case / "seal.sha256").write_text(hashlib.sha256(truth.read_bytes()).hexdigest() + "\n")
    return CONSISTENT


def test_a_diagnosis_that_writes_its_own_truth_is_lost_and_so_is_a_truth_that_is_touched_later(tmp_path: Path) -> None:
    (case,) = cases = [Spec(2, "pps", "backlash", 1.0, 80, 60)]
    broken = r"truth.json: hash \w{12}, but \w{12} was published"
    cheated = run_prove(tmp_path / "a", cases, cheats, workers=0)
    assert re.search(broken, cheated["lost"][case.name])
    assert cheated["broken"] == [case.name]
    assert run_prove(tmp_path / "b", cases, says_nothing, workers=0)["lost"] == {}
    scores, answer = tmp_path / f"b/scores/{case.name}.json", tmp_path / f"b/answers/{case.name}/answer.json"
    for file, before, after, said in (
        (scores, '"known": true', '"known": false', f"{scores}: tells of another truth than was sealed"),
        (answer, '"consistent"', '"unexplained"', f"{scores}: tells of another answer than {answer}"),
    ):
        sound = file.read_text()
        file.write_text(sound.replace(before, after))
        assert run_prove(tmp_path / "b", cases, says_nothing, workers=0)["lost"][case.name] == said
        file.write_text(sound)
    assert run_prove(tmp_path / "b", cases, says_nothing, workers=0)["lost"] == {}
    truth = tmp_path / "b/sealed" / case.name / "truth.json"
    truth.write_text(truth.read_text().replace("backlash", "drift"))
    assert re.search(broken, run_prove(tmp_path / "b", cases, says_nothing, workers=0)["lost"][case.name])
    truth.unlink()
    gone = run_prove(tmp_path / "b", cases, says_nothing, workers=0)
    assert gone["lost"][case.name].endswith("truth.json: No such file or directory")
    assert gone["broken"] == [case.name]


@pytest.mark.parametrize(
    ("file", "text", "said"),
    [
        ("scores/2.json", "{}", r"scores/2\.json: damaged, expected the score of a case"),
        ("scores/2.json", '{"spec": ', r"scores/2\.json: damaged, expected the score of a case"),
        ("seals.txt", "2 abc\n", r"seals\.txt:1: '2 abc', expected a case, the hash"),
    ],
)
def test_scores_and_seals_that_are_damaged_are_refused_before_anything_is_written(
    tmp_path: Path, file: str, text: str, said: str
) -> None:
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text(text)
    with pytest.raises(BadInput, match=said):
        run_prove(tmp_path, [Spec(2, "pps", "backlash", 1.0, 80, 60)], says_nothing, workers=0)
    assert not (tmp_path / "cases").exists()


def test_a_deck_of_two_cases_of_one_seed_and_a_scheduler_without_a_port_leave_no_folder(tmp_path: Path) -> None:
    cases = [Spec(2, "pps", "backlash", 1.0), Spec(2, "pps", "drift", 1.0)]
    with pytest.raises(BadInput, match="two cases of one seed"):
        run_prove(tmp_path / "a", cases, says_nothing, workers=0)
    with pytest.raises(BadInput, match="foo: no scheduler's address, expected one like tcp://host:8786"):
        run_prove(tmp_path / "a", cases[:1], says_nothing, scheduler="foo")
    assert not (tmp_path / "a").exists()


def test_a_broken_seal_is_no_success(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def touched(*given: object, **more: object) -> dict[str, Any]:
        return {"cases": 2, "lost": {"7": "x"}, "broken": ["7"], "bars": []}

    monkeypatch.setattr("ppshw.prove.run_prove", touched)
    assert main(["prove", "--cases", "2", "--out", str(tmp_path / "p")]) == 1
    assert "broken seals: 7" in capsys.readouterr().err


def test_a_name_with_the_wrong_joint_is_no_right_joint_and_a_wrong_name_is_wrong() -> None:
    truth = [
        {
            "effect": "backlash",
            "joint": "yaw",
            "also": [],
            "covariates": ["approach_yaw"],
            "neighbours": [],
            "known": True,
        }
    ]
    finding = {"effect": "backlash", "joint": "roll", "weight": 0.7}
    wrong = {
        "effect": "creep",
        "joint": "yaw",
        "weight": 0.9,
        "alternatives": [{"effect": "backlash", "joint": "yaw", "weight": 0.1}],
    }
    one = judge(truth, {"verdict": "missing_physics", "findings": [finding]})
    assert (one["named"], one["joint_right"], one["wrong"], one["located"]) == ([True], [False], [], [False])
    two = judge(truth, {"verdict": "missing_physics", "findings": [wrong]})
    assert (two["named"], two["joint_right"], two["wrong"], two["in_aliases"]) == (
        [False],
        [None],
        ["creep"],
        [True],
    )
    assert two["weights"] == [[0.9, False], [0.1, True]]
    assert two["wrong_apart"] == ["creep"]
    told = {**wrong, "alternatives": [], "aliases": [{"effect": "backlash", "joint": "yaw"}]}
    three = judge(truth, {"verdict": "missing_physics", "findings": [told]})
    assert (three["wrong"], three["wrong_apart"], three["in_aliases"]) == (["creep"], [], [True])
    none = judge([], {"verdict": "unexplained", "findings": [], "unexplained": {"covariates": ["time"]}})
    assert none["false_alarm"]


def test_a_wrong_name_is_scored_with_what_it_leaves(tmp_path: Path) -> None:
    """Its field goes on over the later visits; what the name leaves of it is of those that were fitted."""
    case = make(tmp_path, "zero_shift", 7, 1.0, visits=120)
    joint = open_seal(seal_of(case), tmp_path / "sealed")["effects"][0]["joint"]
    said = {"effect": "thermal_growth", "joint": joint, "component": "ty", "covariate": "temp_air_C", "weight": 0.9,
            "alternatives": [], "aliases": []}  # fmt: skip
    answer = {"visits": 90, "verdict": "missing_physics", "findings": [said], "unexplained": None}
    found = score_case(case, tmp_path / "sealed", seal_of(case), answer, None, 1.0)
    assert found["wrong"] == ["thermal_growth"]
    (truth,) = found["truth"]
    assert 0.0 < found["sqrt_lambda_left"] < truth["sqrt_lambda"]
    assert found["held_out"]["rms_after_mm"] == found["held_out"]["rms_before_mm"]
    scatter = {**said, "effect": "outliers", "joint": None, "component": None, "covariate": "visit", "weight": 1.0}
    both = score_case(case, tmp_path / "sealed", seal_of(case), {**answer, "findings": [scatter, said]}, None, 1.0)
    assert both["sqrt_lambda_left"] == found["sqrt_lambda_left"]  # moves nothing


def test_the_bound_grows_with_the_effect_and_sees_nothing_of_what_the_base_model_can_be(tmp_path: Path) -> None:
    case = make(tmp_path, "zero_shift", 7, 1.0, visits=200)
    truth = open_seal(seal_of(case), tmp_path / "sealed")
    machine = load_machine(case / "machine.yaml")
    recording = load_recording(case / "recording.csv", machine)
    base = identify(machine, recording)
    field = 1e-9 * np.array(truth["effects"][0]["field_nm"], dtype=float)[: len(recording)]
    one, two = bound(machine, recording, base, field, truth), bound(machine, recording, base, 2 * field, truth)
    assert two["sqrt_lambda"] == pytest.approx(2 * one["sqrt_lambda"], rel=1e-6)
    half = bound(machine, recording, base, 3.19 / one["sqrt_lambda"] * field, truth)
    assert half["power"] == pytest.approx(0.5, abs=0.02)  # normal limit: z = 3.19 at α = 0.05/35, two-sided
    assert one["sqrt_lambda_free"] <= one["sqrt_lambda"] * (1 + 1e-9)
    # what another name's best form leaves: nothing of its own field, all of it where the library has none there
    context = Context.of(base.model, base.theta, recording, base.measuring_in_base)
    step = Column("frame", "step", {"visit_time": float(np.median(context.hours))}, 4, 4)
    moved = 2e-4 * step.evaluate(context).reshape(field.shape)
    whole = bound(machine, recording, base, moved, truth)["sqrt_lambda"]

    def left(effect: str, joint: str) -> float | None:
        return least_left(machine, recording, base, moved, truth, {(effect, joint)})

    jump, growth = left("zero_shift", "yaw"), left("thermal_growth", "yaw")
    assert jump is not None
    assert growth is not None
    assert jump < 0.2 * whole  # moments are tried on a grid
    assert 0.2 * whole < growth < whole
    assert left("zero_shift", "no such joint") is None
    # beside nothing all of it is left; beside two names no more than beside either
    assert least_left(machine, recording, base, moved, truth, set()) == pytest.approx(whole, rel=1e-6)
    two = least_left(machine, recording, base, moved, truth, {("zero_shift", "yaw"), ("thermal_growth", "yaw")})
    assert two is not None
    assert two <= jump * (1 + 1e-6)
    still = np.broadcast_to([3e-5, 0.0, 1e-5], field.shape)  # the whole base shifted: the model's own constant
    assert bound(machine, recording, base, still, truth)["sqrt_lambda_free"] < 1e-3
    # pure noise of the plant's own, whitened: one per coordinate, whatever is projected away makes it less
    plant = Plant(read_chain(case / "machine.yaml"))
    rng = np.random.default_rng(1)
    scatter = np.array(truth["scatter"]) * rng.normal(size=(len(recording), machine.n, 6))
    moved = plant.true_points(recording.q, None, scatter)
    quiet = plant.true_points(recording.q, None)
    noise = np.stack([moved[t] - quiet[t] for t in machine.targets], axis=1)
    noise = noise + truth["instrument_sigma"] * rng.normal(size=noise.shape)
    found = bound(machine, recording, base, noise, truth)
    assert found["sqrt_lambda"] ** 2 / found["share_visible"] == pytest.approx(noise.size, rel=0.1)


def test_shares_come_with_the_interval_that_few_cases_deserve() -> None:
    none = share([False] * 20)
    assert none["high"] == pytest.approx(1 - 0.05 ** (1 / 20))  # 13.9 %: the rule of three at 95 %
    assert (none["low"], none["share"]) == (0.0, 0.0)
    some = share([True] * 3 + [False] * 7)
    assert (some["low"], some["high"]) == pytest.approx((0.087264, 0.606624), abs=1e-6)  # Clopper & Pearson's, 90 %
    assert share([True] * 20)["low"] == pytest.approx(0.05 ** (1 / 20))
    assert share([])["share"] is None


def test_bars_stand_beside_what_could_be_found_and_count_by_either_strength() -> None:
    """Four effects of which the recordings show two; by the plain projection only one is strong."""
    truth = {"effect": "drift", "form": "linear", "joint": None, "also": [], "neighbours": [], "known": True,
             "covariates": ["time"]}  # fmt: skip
    about = dict.fromkeys(("seed", "machine", "asked", "repeatability_rms_mm"), 0) | {"size": 2.0}
    found = {**CONSISTENT, "verdict": "missing_physics", "findings": [
        {"effect": "drift", "joint": None, "weight": 0.9, "covariate": "time"}]}  # fmt: skip
    strengths = [
        (9.0, 7.0, 1.0, found), (6.5, 4.0, 0.9, CONSISTENT), (1.0, 0.5, 0.06, CONSISTENT), (0.5, 0.1, 0.0, CONSISTENT),
    ]  # fmt: skip
    scores = [
        score_of(about, [{**truth, "sqrt_lambda": a, "sqrt_lambda_free": b, "power": power}], answer, None, 1.0)
        for a, b, power, answer in strengths
    ]
    bars = by_name(summarise(scores))
    projected, held_back = (bars[f"√λ {which} ≥ 6: detected"] for which in ("after projection", "beside priors"))
    assert (projected["hits"], projected["of"]) == (1, 1)
    assert (held_back["hits"], held_back["of"]) == (1, 2)
    named = bars["effect of 2 × repeatability: right name"]
    assert named["share"] == 0.25
    assert named["bound"] == pytest.approx(0.49)
    assert "the bound 49 %" in named["text"]
    scores.append(score_of(about, [{**truth, "power": None}, {**truth, "power": 0.5}], CONSISTENT, None, 1.0))
    assert by_name(summarise(scores))["pair, 1 × each: both named"]["bound"] == pytest.approx(0.5)


def test_half_power_is_found_where_half_are_detected() -> None:
    rng = np.random.default_rng(0)
    strength = rng.uniform(0, 9, 600)
    detected = rng.random(600) < 1 / (1 + np.exp(-2 * (strength - 3.4)))
    assert half_power(strength, detected) == pytest.approx(3.4, abs=0.25)
    assert half_power([1.0, 2.0], [True, True]) is None
    assert half_power([1.0, 2.0, 3.0, 18.0, 20.0], [False, True, True, False, False]) is None  # it falls
    assert half_power([10.0, 11.0, 12.0, 13.0, 14.0], [True, False, True, True, True]) is None  # below the least


def test_a_deck_holds_every_effect_at_every_size_and_a_longer_one_begins_alike() -> None:
    cards = deck(108, 3)
    known = {(c.effect, c.size) for c in cards if c.effect in EFFECTS}
    assert known == {(e, s) for e in EFFECTS for s in SIZES}
    assert sum(c.effect == "null" for c in cards) == 20
    assert deck(30, 3) == cards[:30]
    assert set(EFFECTS) == set(KNOWN)
