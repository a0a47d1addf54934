"""The wrench on every link, by statics   (paper eq. 15).

W_i is what everything beyond frame i applies to it: the payload, as the force sensor measured it, and the weights of
the bodies from joint i outwards. Body i itself counts: it hangs on joint i, unless a recording says otherwise
(`Machine.bent_by`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ppshw.kinematics import tip_poses
from ppshw.machine import Machine

Array = NDArray[np.float64]


def gravity_in_sensor(machine: Machine, chain: Array) -> Array:
    """(N, 3) gravity in the force sensor's frame [m/s²], of chains (N, n+1, 4, 4)."""
    return np.asarray(np.einsum("nji,j->ni", sensor_axes(machine, chain), machine.gravity))


def sensor_axes(machine: Machine, chain: Array) -> Array:
    """(N, 3, 3) the force sensor's axes in the base, one a column, of chains (N, n+1, 4, 4)."""
    return np.asarray(chain[:, -1, :3, :3] @ machine.sensor_in_link[:3, :3])


def link_wrenches(machine: Machine, chain: Array, payload: Array, gravity: Array | None = None) -> Array:
    """Wrenches W_{i,i} on frames F_0 … F_n, each at its own origin and in its own axes.

    chain    (N, n+1, 4, 4)   frames in the base (with errors, if they are known)
    payload  (N, 6)           wrench that the payload applies to the sensor, sensor frame    [N, N·m]
    gravity  (N, 3)           in the base frame, where it is not the machine file's           [m/s²]
    returns  (N, n+1, 6)                                                                      [N, N·m]
    """
    count = len(chain)
    g = np.broadcast_to(machine.gravity if gravity is None else gravity, (count, 3))
    sensor = chain[:, -1] @ machine.sensor_in_link
    force = np.einsum("nij,nj->ni", sensor[:, :3, :3], payload[:, :3])
    moment = np.einsum("nij,nj->ni", sensor[:, :3, :3], payload[:, 3:])
    moment = moment + np.cross(sensor[:, :3, 3], force)  # about the base's origin, where forces just add up
    out = np.empty((count, machine.n + 1, 6))
    for i in range(machine.n, -1, -1):
        beyond = force, moment
        if i > 0 and machine.bent_by != "payload":
            body = machine.joints[i - 1]
            centre = np.einsum("nij,j->ni", chain[:, i, :3, :3], body.com) + chain[:, i, :3, 3]
            force = force + body.mass * g
            moment = moment + np.cross(centre, body.mass * g)
        pulls, turns = beyond if machine.bent_by == "beyond" else (force, moment)
        here = turns - np.cross(chain[:, i, :3, 3], pulls)
        out[:, i, :3] = np.einsum("nji,nj->ni", chain[:, i, :3, :3], pulls)
        out[:, i, 3:] = np.einsum("nji,nj->ni", chain[:, i, :3, :3], here)
    return out


def payload_at(machine: Machine, payload: Array, here: Array, there: Array) -> Array:
    """What the sensor will read at another pose, when the payload only weighs.

    The weight keeps its direction in space and its line of action in the payload; where on that line the centre of mass
    lies one reading cannot tell, so the point nearest to the sensor is taken. Exact where the sensor only turns about
    the vertical; for tilts of δ it is off by weight × height × δ.

    payload  (6,) read at joint values `here` (n,);  returns (6,) at `there` (n,)   [N, N·m]
    """
    turn = [(tip_poses(machine, q)[0, :3, :3] @ machine.tip_in_link[:3, :3].T @ machine.sensor_in_link[:3, :3])
            for q in (here, there)]  # fmt: skip
    force, moment = payload[:3], payload[3:]
    size = float(force @ force)
    lever = np.cross(force, moment) / size if size > 0 else np.zeros(3)
    turned = turn[1].T @ turn[0] @ force
    along = moment - np.cross(lever, force)  # a pure moment, if there is one, stays with the payload
    return np.concatenate([turned, np.cross(lever, turned) + along])
