"""What belongs to heat, time and the instrument: growth, drift, wrong lengths, knocked reflectors, wrong visits."""

from __future__ import annotations

import numpy as np

from simulators.chain import Array
from simulators.concealed.by_load import lagged
from simulators.concealed.scene import COMPONENTS, Change, Concealed, Scene


def thermal_growth(scene: Scene, rng: np.random.Generator) -> Concealed:
    """A link grows or bends with the temperature of air or rail.

    grows       along itself, its free length with the joint's travel, after one lag
    two lags    a thin skin follows in minutes, the core in an hour
    bends       one side is warmer: an angle in proportion to how fast the temperature changes, and to the temperature
    """
    chain = scene.chain
    k = int(rng.integers(min(4, len(chain.joints))))
    joint = chain.joints[k]
    form = str(rng.choice(["grows", "two lags", "bends"]))
    place = str(rng.choice(["air", "rail"])) if k < 2 else "air"
    slow = rng.uniform(2400, 5400)
    part, fast = 1.0, 0.0
    if form == "two lags":
        part, fast = rng.uniform(0.3, 0.7), rng.uniform(300, 900)
    else:
        fast = rng.uniform(600, 3000)
    component, outside = (int(rng.integers(3, 6)), rng.uniform(0.5, 1.0)) if form == "bends" else (-1, 0.0)
    following = chain.joints[k + 1].origin[:3, 3] if k + 1 < len(chain.joints) else chain.tip[:3, 3]
    along = joint.axis if joint.prismatic else following / max(float(np.linalg.norm(following)), 1e-9)
    component = component if form == "bends" else int(np.argmax(np.abs(along)))

    def shape(s: Scene) -> Array:
        time, felt = s.campaign.time, s.campaign.temperature[place]
        warm = lagged(felt, time, fast)
        if form == "two lags":
            warm = part * warm + (1 - part) * lagged(felt, time, slow)
        warm = warm - warm[0]
        if form == "bends":
            warm = warm + outside * (felt - felt[0] - warm)
            return np.asarray(warm[:, None] * np.eye(6)[component])
        free = 0.3 * s.travel(k) + s.q[:, k] - joint.lower if joint.prismatic else np.ones(len(s))
        return np.concatenate([(warm * free)[:, None] * along, np.zeros((len(s), 3))], axis=1)

    covariates = (f"temp_{place}_C", *((f"q_{joint.name}",) if joint.prismatic and form != "bends" else ()))
    return Concealed(
        scene, "thermal_growth", form, joint.name, COMPONENTS[component], covariates,
        lambda s, size: Change(eps=s.eps(k, size * shape(s))), lambda size: {"per_kelvin": size}, start=2e-5,
    )  # fmt: skip


def drift(scene: Scene, rng: np.random.Generator) -> Concealed:
    """Base and tracker move against each other, all of the machine alike.

    warm-up  exponential;   settling: logarithmic;   wandering: a random walk, smooth over half an hour
    """
    form = str(rng.choice(["warm-up", "settling", "wandering"]))
    time = scene.campaign.time
    if form == "warm-up":
        course = -np.expm1(-time / rng.uniform(3600, 3 * 3600))
    elif form == "settling":
        course = np.log1p(time / rng.uniform(300, 1800))
    else:
        pace = np.sqrt(np.diff(time, prepend=0.0))
        course = lagged(np.cumsum(pace * rng.normal(size=len(time))), time, 1800.0)
    course = (course - course[0]) / max(float(np.std(course)), 1e-12)
    span = float(np.ptp(scene.points(random=False).reshape(-1, 3), axis=0).max())
    twist = np.concatenate([_direction(rng), _direction(rng) * rng.uniform(0.2, 0.8) / span])

    def at(s: Scene, size: float) -> Change:  # in time, from one campaign to another: between visits straight on
        now = course if s is scene else np.interp(s.campaign.time, time, course)
        return Change(base=size * now[:, None] * twist)

    return Concealed(
        scene, "drift", form, None, None, ("time",), at, lambda size: {"one_deviation": size}, start=5e-5,
    )  # fmt: skip


def tracker_scale(scene: Scene, rng: np.random.Generator) -> Concealed:
    """The tracker's metre is not a metre.

    constant    a wrong refraction or reflector constant
    air         wrong by so many ppm per kelvin, about the base's origin or about a station metres away
    """
    form = str(rng.choice(["constant", "with the air", "with the air, from a station"]))
    station = None if form != "with the air, from a station" else rng.uniform(2.5, 5.0) * _direction(rng)

    def shape(s: Scene) -> Array:
        return np.ones(len(s)) if form == "constant" else s.campaign.temperature["air"] - 20.0

    sign = float(rng.choice([-1.0, 1.0]))
    return Concealed(
        scene, "tracker_scale", form, None, None, () if form == "constant" else ("temp_air_C",),
        lambda s, size: Change(stretch=sign * size * shape(s), station=station),
        lambda size: {"scale": sign * size}, start=5e-5,
    )  # fmt: skip


def target_moved(scene: Scene, rng: np.random.Generator) -> Concealed:
    """A reflector is not where the machine file says: knocked at some moment, always, or sliding away from its seat."""
    form = str(rng.choice(["knocked", "always", "sliding"]))
    names = list(scene.plant.targets)
    which = int(rng.integers(len(names)))
    time = scene.campaign.time
    when = float(time[0] + (time[-1] - time[0]) * rng.uniform(0.2, 0.65))
    slow = rng.uniform(1200, 5400) if form == "sliding" else 1.0
    way = _direction(rng)

    def moved(s: Scene) -> Array:
        course, now = np.ones(len(s)), s.campaign.time
        if form == "knocked":
            course = (now >= when).astype(float)
        elif form == "sliding":
            course = -np.expm1(-np.maximum(now - when, 0.0) / slow)
        out = np.zeros((len(s), len(names), 3))
        out[:, which] = course[:, None] * way
        return out

    return Concealed(
        scene, "target_moved", form, None, None, () if form == "always" else ("time",),
        lambda s, size: Change(on_tip=size * moved(s)), lambda size: {"moved": size}, start=3e-4, target=names[which],
    )  # fmt: skip


def outliers(scene: Scene, rng: np.random.Generator) -> Concealed:
    """Some visits in a hundred are simply wrong.

    readings    one reflector each time: a reflex, a beam that was cut;   visits: somebody leaned on the couch
    mixed       either, and of very different sizes
    """
    form = str(rng.choice(["readings", "visits", "mixed"]))
    count = max(2, round(len(scene) * rng.uniform(0.007, 0.02)))
    wrong = np.zeros((len(scene), len(scene.targets), 3))
    for v in rng.choice(len(scene), count, replace=False):
        size = float(np.exp(rng.normal(0.0, 0.6))) if form == "mixed" else float(rng.uniform(0.8, 1.2))
        if form == "visits" or (form == "mixed" and rng.random() < 0.5):
            wrong[v] = size * _direction(rng)
        else:
            wrong[v, rng.integers(len(scene.targets))] = size * _direction(rng)
    return Concealed(
        scene, "outliers", form, None, None, (), lambda s, size: Change(readings=size * _there(wrong, s, scene)),
        lambda size: {"count": float(count), "size": size}, start=1e-3,
    )  # fmt: skip


def unsettled(scene: Scene, rng: np.random.Generator) -> Concealed:
    """The machine still swings when it is measured: scatter, in the direction in which it is soft.

    dying out         A exp(−t/τ) of the settling time
    after long moves  as far as the joint has come;   under load: as heavy as it is
    """
    form = str(rng.choice(["dying out", "after long moves", "under load"]))
    k = int(rng.integers(len(scene.chain.joints)))
    campaign = scene.campaign
    moved = np.abs(campaign.commanded - campaign.before)[:, k] / scene.travel(k)
    sizes = {
        "dying out": np.exp(-campaign.settle / rng.uniform(1.5, 3.5)),
        "after long moves": moved ** rng.uniform(0.7, 1.5),
        "under load": (campaign.mass / campaign.mass.max()) ** rng.uniform(1.0, 2.0),
    }
    twist = np.eye(6)[int(rng.integers(3, 6))] + 0.1 * np.concatenate([rng.normal(size=3), np.zeros(3)])
    shake = sizes[form] * np.sqrt(2) * np.sin(rng.uniform(0, 2 * np.pi, len(scene)))  # caught at any moment of a swing
    covariate = {
        "dying out": "settle_s",
        "after long moves": f"q_{scene.chain.joints[k].name}",
        "under load": "Fy",
    }
    return Concealed(
        scene, "unsettled", form, None, None, (covariate[form],),
        lambda s, size: Change(eps=s.eps(k, size * _there(shake, s, scene)[:, None] * twist)),
        lambda size: {"amplitude": size}, also=(scene.chain.joints[k].name,),
    )  # fmt: skip


def _there(drawn: Array, scene: Scene, there: Scene) -> Array:
    """What was drawn visit by visit belongs to the campaign that it was drawn for."""
    if scene is not there:
        raise ValueError("noise is drawn for each visit of one campaign and cannot be carried to another")
    return drawn


def _direction(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))
