"""A column with the wrong sign or unit is called what it is, and the rest of the recording is used all the same."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ppshw.diagnosis.columns import column_mistakes, doubts_of_gravity, levers, moments, plain_mistakes
from ppshw.diagnosis.columns.halves import in_blocks, left_of_the_others, of_each_load, plainly
from ppshw.errors import RecordingError
from ppshw.identification.joint import Estimate
from ppshw.machine import WRENCH_COMPONENTS, Machine, load_machine
from ppshw.recording import Recording, load_recording
from simulators.concealed.case import make_case


@pytest.fixture(scope="module", params=["pps", "arm6"])
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Machine, Recording]:
    out = tmp_path_factory.mktemp("case")
    make_case(11, request.param, "null", 0.0, out, tmp_path_factory.mktemp("sealed"), 200, 200)
    machine = load_machine(out / "machine.yaml")
    return machine, load_recording(out / "recording.csv", machine)


@pytest.fixture(scope="module", autouse=True)
def each_base_model_once() -> Iterator[None]:
    """Most tests end with the same sound recording, of which the sign of the moments is asked by two fits."""
    known: dict[tuple[object, ...], NDArray[np.float64]] = {}

    def once(
        machine: Machine,
        recording: Recording,
        fit_to: Callable[..., Estimate] = plainly,
        halves: Callable[..., NDArray[np.bool_]] = in_blocks,
    ) -> NDArray[np.float64]:
        arrays = recording.q, recording.points, recording.wrench, recording.time
        key = (machine.sha256, fit_to, halves, recording.load, *(array.tobytes() for array in arrays))
        if key not in known:
            known[key] = left_of_the_others(machine, recording, fit_to, halves)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        for module in (moments, levers):
            patch.setattr(module, "left_of_the_others", once)
        yield


def test_a_sound_recording_has_no_mistakes(case: tuple[Machine, Recording]) -> None:
    machine, recording = case
    same, found = column_mistakes(machine, recording)
    assert found == []
    assert same is recording


@pytest.mark.parametrize("joint", [0, 3, 4, 5])
def test_a_joint_that_counts_the_other_way(case: tuple[Machine, Recording], joint: int) -> None:
    """Tilts of short travel too, 5 to 26 mm off, which the base model took for a slope of -2."""
    machine, recording = case
    q = recording.q.copy()
    q[:, joint] *= -1
    mended, found = column_mistakes(machine, replace(recording, q=q))
    assert [(m.column, m.factor) for m in found] == [(f"q_{machine.joint_names[joint]}", -1.0)]
    assert np.array_equal(mended.q, recording.q)
    assert "opposite sign" in found[0].finding()["sentence"]


def test_a_coordinate_in_millimetres(case: tuple[Machine, Recording]) -> None:
    machine, recording = case
    points = recording.points.copy()
    points[:, 1, 2] *= 1000.0
    mended, found = column_mistakes(machine, replace(recording, points=points))
    assert [(m.column, m.factor) for m in found] == [(f"{recording.target_names[1]}_z", 1e-3)]
    assert np.allclose(mended.points, recording.points)


def test_one_reflector_in_millimetres(case: tuple[Machine, Recording]) -> None:
    machine, recording = case
    points, name = recording.points.copy(), recording.target_names[1]
    points[:, 1] *= 1000.0
    mended, found = column_mistakes(machine, replace(recording, points=points))
    assert [(m.column, m.factor) for m in found] == [(f"{name}_x … {name}_z", 1e-3)]
    assert np.allclose(mended.points, recording.points, equal_nan=True)


@pytest.mark.parametrize(("one", "other"), [(4, 5), (3, 5)])
def test_two_joints_that_are_exchanged(case: tuple[Machine, Recording], one: int, other: int) -> None:
    """Roll and pitch were two couplings of 0.95 (a reviewer's)."""
    machine, recording = case
    q = recording.q.copy()
    q[:, [one, other]] = q[:, [other, one]]
    mended, found = column_mistakes(machine, replace(recording, q=q))
    names = machine.joint_names
    assert [(m.column, m.factor) for m in found] == [(f"q_{names[one]} and q_{names[other]}", None)]
    assert found[0].said.endswith(" are exchanged")
    assert np.array_equal(mended.q, recording.q)


@pytest.mark.parametrize("joint", [0, 3])
def test_directions_of_approach_that_are_against_every_way(case: tuple[Machine, Recording], joint: int) -> None:
    """Play of 0.25 mm was friction that runs ahead, and setpoints by it twice as far off (a reviewer's)."""
    machine, recording = case
    approach = recording.approach.copy()
    approach[:, joint] *= -1
    mended, found = plain_mistakes(machine, replace(recording, approach=approach))
    assert [(m.column, m.factor) for m in found] == [(f"approach_{machine.joint_names[joint]}", -1.0)]
    assert np.array_equal(mended.approach, recording.approach)
    approach[: len(approach) // 3, joint] *= -1  # a third of the visits: it may have gone past where it came to
    assert plain_mistakes(machine, replace(recording, approach=approach))[1] == []


@pytest.mark.parametrize("ends", ["first", "last"])
def test_directions_of_approach_that_turn_over_at_some_visit(case: tuple[Machine, Recording], ends: str) -> None:
    """Of all joints at once, as by a controller's update: they were structure without a word (a reviewer's). Of one
    joint alone it may have gone past where it came to."""
    machine, recording = case
    wrong = slice(0, 80) if ends == "first" else slice(80, None)
    approach = recording.approach.copy()
    approach[wrong] *= -1
    mended, found = plain_mistakes(machine, replace(recording, approach=approach))
    assert [(m.column.split(" … ")[0], m.factor) for m in found] == [(f"approach_{machine.joint_names[0]}", None)]
    assert np.array_equal(mended.approach, recording.approach)
    assert found[0].said.endswith(
        "have the opposite sign " + ("up to visit 80" if ends == "first" else "from visit 81 on")
    )
    assert found[0].finding()["sentence"].endswith("; they were taken the other way round.")
    alone = recording.approach.copy()
    alone[wrong, 2] *= -1
    assert plain_mistakes(machine, replace(recording, approach=alone))[1] == []


def test_directions_of_all_joints_that_are_against_their_ways_are_one_mistake(case: tuple[Machine, Recording]) -> None:
    machine, recording = case
    mended, found = plain_mistakes(machine, replace(recording, approach=-recording.approach))
    names = machine.joint_names
    assert [(m.column, m.factor) for m in found] == [(f"approach_{names[0]} … approach_{names[-1]}", -1.0)]
    assert np.array_equal(mended.approach, recording.approach)


def test_directions_of_approach_that_are_exchanged(case: tuple[Machine, Recording]) -> None:
    """Play was structure over another joint's direction, without a word (a reviewer's)."""
    machine, recording = case
    approach = recording.approach.copy()
    approach[:, [1, 4]] = approach[:, [4, 1]]
    mended, found = plain_mistakes(machine, replace(recording, approach=approach))
    names = machine.joint_names
    assert [m.said for m in found] == [f"the columns approach_{names[1]} and approach_{names[4]} are exchanged"]
    assert np.array_equal(mended.approach, recording.approach)
    approach[:, [1, 4]] = 1  # always from one side, whichever way the last visit lies
    assert plain_mistakes(machine, replace(recording, approach=approach))[1] == []


def test_directions_that_go_by_positions_with_a_mistake_are_set_right_with_them(
    case: tuple[Machine, Recording],
) -> None:
    """As where nobody wrote directions down: they are those of the setpoints."""
    machine, recording = case
    q, approach = recording.q.copy(), recording.approach.copy()
    q[:, 3] *= -1
    approach[:, 3] *= -1
    mended, found = plain_mistakes(machine, replace(recording, q=q, approach=approach))
    assert [m.column for m in found] == [f"q_{machine.joint_names[3]}"]
    assert np.array_equal(mended.approach, recording.approach)


@pytest.mark.parametrize("lost", ["of the reflectors", "of the joints"])
def test_a_row_that_was_lost_in_some_of_the_columns(case: tuple[Machine, Recording], lost: str) -> None:
    """229 of 479 visits were simply wrong (a reviewer's)."""
    machine, recording = case
    at, points, whole = 120, recording.points, np.arange(len(recording))
    if lost == "of the reflectors":  # from there on those of the next visit
        sound = replace(recording.subset(whole[:-1]), points=points[:-1])
        given = replace(sound, points=np.concatenate([points[:at], points[at + 1 :]]))
    else:
        sound = recording.subset(whole != at)
        given = replace(sound, points=points[:-1])
    mended, found = plain_mistakes(machine, given)
    names = recording.target_names
    way = "early" if lost == "of the reflectors" else "late"
    assert [m.said for m in found] == [
        f"the columns {names[0]}_x … {names[-1]}_z are a row {way} from visit {at + 1} on"
    ]
    assert found[0].finding()["sentence"].endswith("; they were moved back.")
    same = mended.seen.all(axis=1) & sound.seen.all(axis=1)
    assert same.sum() >= sound.seen.all(axis=1).sum() - 1
    assert np.allclose(mended.points[same], sound.points[same])


@pytest.mark.long
@pytest.mark.parametrize("labelled", [True, False])
def test_the_reaction_instead_of_the_payload(case: tuple[Machine, Recording], labelled: bool) -> None:
    machine, recording = case
    recording = recording if labelled else without_labels(recording)
    mended, found = column_mistakes(machine, replace(recording, wrench=-recording.wrench))
    assert [m.column for m in found] == ["Fx … Mz"]
    assert np.array_equal(mended.wrench, recording.wrench)


def test_all_reflectors_in_millimetres(case: tuple[Machine, Recording]) -> None:
    machine, recording = case
    mended, found = column_mistakes(machine, replace(recording, points=1000.0 * recording.points))
    names = recording.target_names
    assert [(m.column, m.factor) for m in found] == [(f"{names[0]}_x … {names[-1]}_z", 1e-3)]
    assert found[0].finding()["sentence"] == (
        f"the columns {names[0]}_x … {names[-1]}_z are in millimetres, expected metres; they were taken times 0.001."
    )
    assert np.allclose(mended.points, recording.points, equal_nan=True)


def without_labels(recording: Recording) -> Recording:
    return replace(recording, load=("",) * len(recording))


@pytest.mark.parametrize("labelled", [True, False])
@pytest.mark.parametrize("columns", [(0, 1, 2), (3, 4, 5)])
def test_forces_or_moments_alone_with_the_opposite_sign(
    case: tuple[Machine, Recording], columns: tuple[int], labelled: bool
) -> None:
    """Of forces without labels nothing was said, and the moments were turned (a reviewer's)."""
    machine, recording = case
    recording = recording if labelled else without_labels(recording)
    wrench = recording.wrench.copy()
    wrench[:, columns] *= -1
    mended, found = column_mistakes(machine, replace(recording, wrench=wrench))
    assert [(m.column, m.factor) for m in found] == [("Fx … Fz" if columns[0] == 0 else "Mx … Mz", -1.0)]
    assert found[0].said == f"the columns {found[0].column} have the opposite sign"
    assert np.array_equal(mended.wrench, recording.wrench)


def test_forces_in_kilonewtons_beside_newton_metres(case: tuple[Machine, Recording]) -> None:
    machine, recording = case
    wrench = recording.wrench * np.repeat([1e-3, 1.0], 3)
    mended, found = column_mistakes(machine, replace(recording, wrench=wrench))
    assert [(m.column, m.factor) for m in found] == [("Fx … Fz", 1e3)]
    assert np.allclose(mended.wrench, recording.wrench)


def test_moments_in_newton_millimetres_beside_newtons(case: tuple[Machine, Recording]) -> None:
    """The lever is the same as of kilonewtons; the weight that hangs there is not."""
    machine, recording = case
    wrench = recording.wrench * np.repeat([1.0, 1e3], 3)
    mended, found = column_mistakes(machine, replace(recording, wrench=wrench))
    assert [(m.column, m.factor) for m in found] == [("Mx … Mz", 1e-3)]
    assert "are in newton millimetres, expected newton metres" in found[0].said
    assert np.allclose(mended.wrench, recording.wrench)


@pytest.mark.parametrize("case", ["pps"], indirect=True)  # the arm's loads lie so near that they are not far off
@pytest.mark.parametrize(
    ("force", "moment", "said"),
    [
        (9.80665, 1.0, ["Fx … Fz are in kilograms, expected newtons"]),
        (4.4482216, 0.11298483, ["Fx … Fz are in pounds-force, expected newtons",
                                 "Mx … Mz are in pound-force inches, expected newton metres"]),
        (1.0, 0.01, ["Mx … Mz are in newton centimetres, expected newton metres"]),
    ],
)  # fmt: skip
def test_units_by_which_loads_hang_metres_off_are_told_by_the_machine(
    case: tuple[Machine, Recording], force: float, moment: float, said: list[str]
) -> None:
    """Forces in kilograms beside N·m were a positioner's stiffness out of proportion, 0.95 (a reviewer's)."""
    machine, recording = case
    misread = replace(recording, wrench=recording.wrench / np.repeat([force, moment], 3))
    mended, found = column_mistakes(machine, misread)
    assert [m.said.removeprefix("the columns ").split(" (")[0] for m in found] == said
    assert np.allclose(mended.wrench, recording.wrench)
    assert plain_mistakes(machine, misread)[1] == [] or moment == 0.01


def test_a_weight_that_may_be_either_is_left_alone(case: tuple[Machine, Recording]) -> None:
    machine, recording = case
    hangs = np.median(np.linalg.norm(recording.wrench[:, :3], axis=1)[np.abs(recording.wrench).max(axis=1) > 20])
    wrench = recording.wrench * np.repeat([7.0 / hangs, 7.0], 3)
    for look in (plain_mistakes, column_mistakes):
        assert not [m for m in look(machine, replace(recording, wrench=wrench))[1] if m.factor in (1e3, 1e-3)]


@pytest.mark.parametrize("off", [1.0, 0.0])
def test_gravity_along_another_axis_is_no_unit_of_the_forces(case: tuple[Machine, Recording], off: float) -> None:
    machine, recording = case
    turned = replace(machine, gravity=np.roll(machine.gravity, 1))
    askew = replace(recording, wrench=recording.wrench + off)
    assert not [m for m in plain_mistakes(turned, askew)[1] if m.factor in (1e3, 1e-3)]
    assert doubts_of_gravity(turned, askew)[0].startswith("forces of loaded visits point 90° away from gravity")
    assert not doubts_of_gravity(machine, askew)
    assert not doubts_of_gravity(machine, replace(recording, wrench=-askew.wrench))


def test_without_a_fit_the_moments_sign_is_not_asked(case: tuple[Machine, Recording]) -> None:
    machine, recording = case
    _, found = plain_mistakes(machine, replace(recording, wrench=-recording.wrench))
    assert [m.said for m in found] == [
        "the columns Fx … Fz have the opposite sign (the moments too, if they go with the forces)"
    ]


def test_one_moment_with_the_opposite_sign(case: tuple[Machine, Recording]) -> None:
    machine, recording = case
    wrench = recording.wrench.copy()
    largest = 3 + int(np.argmax(wrench[:, 3:].std(axis=0)))
    wrench[:, largest] *= -1
    _, found = column_mistakes(machine, replace(recording, wrench=wrench))
    # a sensor that stays level cannot tell it from a load that lies on the other side
    expected = [] if machine.name == "pps" else [("Fx", "Fy", "Fz", "Mx", "My", "Mz")[largest]]
    assert [m.column for m in found] == expected


def test_all_angles_in_degrees(case: tuple[Machine, Recording]) -> None:
    machine, recording = case
    turning = [k for k, joint in enumerate(machine.joints) if not joint.prismatic]
    q = recording.q.copy()
    q[:, turning] *= 180 / np.pi
    mended, found = column_mistakes(machine, replace(recording, q=q))
    names = [machine.joint_names[k] for k in turning]
    assert [m.column for m in found] == [f"q_{names[0]} … q_{names[-1]}"]
    assert np.allclose(mended.q, recording.q)


@pytest.mark.parametrize(("targets", "axes", "expected"), [
    ([0, 1], None, "{0} and {1}"), ([2], [1, 2], "{2}_y and z"), ([0, 1, 2], [0, 1], "{0}_x … {2}_x and y"),
])  # fmt: skip
def test_reflectors_or_coordinates_that_are_exchanged_throughout(
    case: tuple[Machine, Recording], targets: list[int], axes: list[int] | None, expected: str
) -> None:
    machine, recording = case
    points = recording.points.copy()
    if axes is None:
        points[:, targets] = recording.points[:, targets[::-1]]
    else:
        for t in targets:
            points[:, t, axes] = recording.points[:, t, axes[::-1]]
    mended, found = column_mistakes(machine, replace(recording, points=points))
    assert [(m.column, m.factor) for m in found] == [(expected.format(*recording.target_names), None)]
    assert np.array_equal(mended.points, recording.points, equal_nan=True)
    said = found[0].finding()
    assert said["parameters"] == {}
    assert said["sentence"] == f"the columns {found[0].column} are exchanged; they were taken the other way round."


@pytest.mark.parametrize(
    ("a", "b", "labelled"), [(0, 1, True), (3, 4, True), (4, 5, True), (0, 1, False), (4, 5, False)]
)
def test_channels_of_the_force_sensor_that_are_exchanged(
    case: tuple[Machine, Recording], a: int, b: int, labelled: bool
) -> None:
    """Two forces or two moments, where what hangs there says which is which."""
    machine, recording = case
    if not labelled:
        recording = without_labels(recording)
    wrench = recording.wrench.copy()
    wrench[:, [a, b]] = recording.wrench[:, [b, a]]
    mended, found = plain_mistakes(machine, replace(recording, wrench=wrench))
    assert [(m.column, m.factor) for m in found] == [(f"{WRENCH_COMPONENTS[a]} and {WRENCH_COMPONENTS[b]}", None)]
    assert np.array_equal(mended.wrench, recording.wrench)


def test_wrenches_in_axes_of_the_base(case: tuple[Machine, Recording]) -> None:
    """Which some sensors can be set to: they were creep and a missing compliance for certain (a reviewer's)."""
    machine, recording = case
    in_base = np.empty_like(recording.wrench)
    for k, q in enumerate(recording.q):
        turn = np.eye(3)
        for joint, value in zip(machine.joints, q, strict=True):
            turn = turn @ joint.origin[:3, :3]
            if not joint.prismatic:
                turn = turn @ Rotation.from_rotvec(value * joint.axis).as_matrix()
        turn = turn @ machine.sensor_in_link[:3, :3]
        in_base[k] = np.concatenate([turn @ recording.wrench[k, :3], turn @ recording.wrench[k, 3:]])
    mended, found = plain_mistakes(machine, replace(recording, wrench=in_base))
    assert [m.said for m in found] == ["the columns Fx … Mz are in axes of the base, expected the force sensor's own"]
    assert found[0].finding()["sentence"].endswith("; they were turned by the ideal machine.")
    assert np.allclose(mended.wrench, recording.wrench)


def test_a_force_that_leaks_into_a_moment_is_no_exchange_of_moments(case: tuple[Machine, Recording]) -> None:
    """It was of the positioner, with My and Mz (and of a fifty-ninth author's, with Mx and Mz): another pair did nearly
    as well."""
    machine, recording = case
    wrench = recording.wrench.copy()
    wrench[:, 4] += 3.0 * wrench[:, 1]
    same, found = plain_mistakes(machine, replace(recording, wrench=wrench))
    assert found == []
    assert np.array_equal(same.wrench, wrench)


def test_moments_that_are_exchanged_show_under_one_label_too(case: tuple[Machine, Recording]) -> None:
    machine, recording = case
    label = max(set(recording.load), key=lambda load: np.abs(recording.wrench[np.array(recording.load) == load]).max())
    one = recording.subset(np.array(recording.load) == label)
    wrench = one.wrench.copy()
    wrench[:, [3, 4]] = one.wrench[:, [4, 3]]
    mended, found = plain_mistakes(machine, replace(one, wrench=wrench))
    assert [m.column for m in found] == ["Mx and My"]
    assert np.array_equal(mended.wrench, one.wrench)


@pytest.mark.parametrize("zero", [0.0, 0.5])
def test_what_a_sensor_reads_with_nothing_on_it_says_nothing_of_units(
    case: tuple[Machine, Recording], zero: float
) -> None:
    machine, recording = case
    noise = np.random.default_rng(0).normal(0.0, [0.1, 0.1, 0.1, 0.5, 0.5, 0.5], recording.wrench.shape)
    empty = replace(recording, wrench=noise + zero * np.array([0, 0.1, 0, 6, 0, 0]), load=("empty",) * len(recording))
    assert column_mistakes(machine, empty)[1] == []


def test_what_no_correction_of_a_column_makes_this_machine_s_is_refused(case: tuple[Machine, Recording]) -> None:
    machine, recording = case
    points = recording.points.copy()
    points[150:] *= 1000.0
    points[:100] += np.random.default_rng(0).normal(0, 1.0, (100, 1, 3))
    with pytest.raises(RecordingError, match="half of the targets are more than"):
        column_mistakes(machine, replace(recording, points=points))


@pytest.mark.parametrize("share", [0.1, 0.55])
def test_reflectors_that_are_exchanged_for_a_while_are_set_right_there(
    case: tuple[Machine, Recording], share: float
) -> None:
    """They were reflectors that had moved by 600 mm, or an internal error where it was more than half."""
    machine, recording = case
    points, swapped = recording.points.copy(), slice(40, 40 + int(share * len(recording)))
    points[swapped] = points[swapped][:, [2, 1, 0]]
    mended, found = column_mistakes(machine, replace(recording, points=points))
    assert np.array_equal(mended.points, recording.points, equal_nan=True)
    names = f"{recording.target_names[0]} and {recording.target_names[2]}"
    assert [(m.column, m.factor) for m in found] == [(names, None)]
    assert f"are exchanged in {int(share * len(recording))} visits (41, 42" in found[0].finding()["sentence"]


def test_a_few_visits_with_exchanged_reflectors_are_a_matter_of_those_visits(case: tuple[Machine, Recording]) -> None:
    machine, recording = case
    points = recording.points.copy()
    points[[5, 80, 120]] = points[[5, 80, 120]][:, [2, 1, 0]]
    mended, found = column_mistakes(machine, replace(recording, points=points))
    assert found == []
    assert np.array_equal(mended.points, points, equal_nan=True)


def test_one_force_in_kilonewtons(case: tuple[Machine, Recording]) -> None:
    machine, recording = case
    wrench = recording.wrench.copy()
    largest = int(np.argmax(np.abs(wrench[:, :3]).max(axis=0)))
    wrench[:, largest] *= 1e-3
    mended, found = column_mistakes(machine, replace(recording, wrench=wrench))
    assert [(m.column, m.factor) for m in found] == [(WRENCH_COMPONENTS[largest], 1e3)]
    np.testing.assert_allclose(mended.wrench, recording.wrench)


def test_both_halves_that_tell_the_moments_sign_have_every_load() -> None:
    """Of four loads one after the other a half saw two alone: what the others bend was guessed, and a right sign turned
    (a reviewer's lift and turntable)."""
    load = ("a",) * 15 + ("b",) * 13 + ("c",) * 17 + ("d",) * 15
    first = of_each_load(load)
    for label in "abcd":
        share = np.mean(first[np.array(load) == label])
        assert 0.4 <= share <= 0.62
    assert of_each_load(("once", *load)).tolist() == [True, *first.tolist()]
    many = of_each_load(("a",) * 300)
    assert np.flatnonzero(np.diff(many.astype(int))).tolist() == list(range(14, 299, 15))


@pytest.mark.parametrize("agree", [True, False])
def test_a_sign_that_only_loads_tell_which_a_half_never_saw_is_left_alone(
    case: tuple[Machine, Recording], monkeypatch: pytest.MonkeyPatch, agree: bool
) -> None:
    machine, recording = case

    def left(_: Machine, r: Recording, fit_to: object = None, halves: object = in_blocks) -> NDArray[np.float64]:
        turned = not np.array_equal(r.wrench, recording.wrench)
        return np.linspace(0.1, 2.0, len(r)) * (1e-4 if turned == (agree or halves is in_blocks) else 2e-4)

    monkeypatch.setattr(moments, "left_of_the_others", left)
    assert [m.factor for m in column_mistakes(machine, recording)[1]] == ([-1.0] if agree else [])
