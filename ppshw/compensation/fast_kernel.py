"""One setpoint after the other in compiled code: the real chain, its wrenches, Newton's method.

The same equations as kinematics.py (eq. 5), statics.py (eq. 15) and inverse.solve_pose, written as loops over one
pose, because numpy's cost of a call (about 1 µs) is more than a whole 3 × 3 product. Vectors are tuples of 3, rotations
tuples of 9 by rows: the compiler keeps them in registers. Importing this file imports numba; only fast_setpoints.py
does. The first use on a computer compiles (some 5 s), later ones read numba's cache.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
OK, OUTSIDE, NOT_REACHED, TOO_LARGE = 0, 1, 2, 3
# Where Newton's method may stop and what it may leave [m, rad], as in inverse.py and compensator.py; a miss that one
# step takes away.
CONVERGED, REACHED, LAST = 1e-7, 1e-5, 1e-4
MOST_STEPS = 30


class Chain(NamedTuple):
    """A machine of n joints. Places are 12 numbers: rotation by rows, then position [m]."""

    prismatic: NDArray[np.bool_]  # (n,)
    axis: Array  # (n, 3)
    origin: Array  # (n, 12)
    body: Array  # (n, 4) mass [kg] and centre of mass [m]
    gravity: Array  # (3,)
    tip: Array  # (12,)
    sensor: Array  # (12,)
    hangs: bool  # whether a body bends its own joint, if any


class Functions(NamedTuple):
    """Generalized errors behind every frame: ε_i = K_i + Σ_c (C_ic + f_ic(q_i)) W_ic, and K, too, may vary with q_i.

    constant      (n+1, 7, 6)   what does not depend on position: without load, and per wrench component
    column        (m,)          of the 7, those of joint k that vary: column[first[k]] … column[first[k+1] − 1]
    breaks        cells of joint k: breaks[break_first[k]] … breaks[break_first[k+1] − 1]
    cubic         coefficients, flat: joint, cell, varying column, power, component; the variable runs 0 … 1 in a cell
    """

    constant: Array
    column: Index
    first: Index
    breaks: Array
    break_first: Index
    cubic: Array
    cubic_first: Index


class Allowed(NamedTuple):
    """Ends of what may be wanted, joints (n, 2) and loads (6, 2); the largest correction (n,); travel limits (n, 2)."""

    joints: Array
    loads: Array
    correction: Array
    limits: Array


class Work(NamedTuple):
    """What one pose needs while it is worked on; handed in so that nothing is allocated per pose."""

    frames: Array  # (n+1, 12) in the base
    errors: Array  # (n+1, 6)
    slopes: Array  # (n+1, 6) derivative by the joint's own position
    wrenches: Array  # (n+1, 6)
    powers: Array  # (24,) coefficients of one frame's cubic: power, component
    jacobian: Array  # (n, 6)
    square: Array  # (n, n)
    step: Array  # (n,)


def workspace(n: int) -> Work:
    """Room for one pose of a machine of n joints, all zeros; one for each thread that works."""
    sizes = ((n + 1, 12), (n + 1, 6), (n + 1, 6), (n + 1, 6), (24,), (n, 6), (n, n), (n,))
    return Work(*(np.zeros(size) for size in sizes))


compiled = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})


@compiled
def _vector(a):
    return a[0], a[1], a[2]


@compiled
def _rotation(a):
    return a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], a[8]


@compiled
def _position(a):
    return a[9], a[10], a[11]


@compiled
def _add(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def _scale(s, a):
    return s * a[0], s * a[1], s * a[2]


@compiled
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def _turn(r, v):
    return (
        r[0] * v[0] + r[1] * v[1] + r[2] * v[2],
        r[3] * v[0] + r[4] * v[1] + r[5] * v[2],
        r[6] * v[0] + r[7] * v[1] + r[8] * v[2],
    )


@compiled
def _transpose(r):
    return r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]


@compiled
def _multiply(a, b):
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
        a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
        a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
        a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
        a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
        a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
        a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
        a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )


@compiled
def _rodrigues(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = axis
    u = 1.0 - c
    return (
        c + u * x * x, u * x * y - s * z, u * x * z + s * y,
        u * x * y + s * z, c + u * y * y, u * y * z - s * x,
        u * x * z - s * y, u * y * z + s * x, c + u * z * z,
    )  # fmt: skip


@compiled
def _sine_cosine(x):
    """The series suffices for errors up to 20 mrad (next terms below 1e-17); the library beyond."""
    if abs(x) > 0.02:
        return np.sin(x), np.cos(x)
    y = x * x
    sine = x * (1.0 - y * (1 / 6) * (1.0 - y * (1 / 20) * (1.0 - y * (1 / 42))))
    return sine, 1.0 - y * (1 / 2) * (1.0 - y * (1 / 12) * (1.0 - y * (1 / 30)))


@compiled
def _small_rotation(e):
    """Rz Ry Rx of eq. (4)."""
    sx, cx = _sine_cosine(e[3])
    sy, cy = _sine_cosine(e[4])
    sz, cz = _sine_cosine(e[5])
    return (
        cy * cz, sx * sy * cz - cx * sz, cx * sy * cz + sx * sz,
        cy * sz, sx * sy * sz + cx * cz, cx * sy * sz - sx * cz,
        -sy, sx * cy, cx * cy,
    )  # fmt: skip


@compiled
def _place(chain, q, real, w):
    """Frames F_0 … F_n, with the errors in `w` where `real`; returns the tip's rotation and position   (eqs 3, 5)."""
    r, p = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
    for k in range(len(q) + 1):
        if k > 0:
            origin, axis = chain.origin[k - 1], _vector(chain.axis[k - 1])
            p = _add(p, _turn(r, _position(origin)))
            r = _multiply(r, _rotation(origin))
            if chain.prismatic[k - 1]:
                p = _add(p, _scale(q[k - 1], _turn(r, axis)))
            else:
                r = _multiply(r, _rodrigues(axis, q[k - 1]))
        if real:
            e = w.errors[k]
            p = _add(p, _turn(r, _vector(e)))
            r = _multiply(r, _small_rotation(e))
        for i in range(9):
            w.frames[k, i] = r[i]
        for i in range(3):
            w.frames[k, 9 + i] = p[i]
    return _multiply(r, _rotation(chain.tip)), _add(p, _turn(r, _position(chain.tip)))


@compiled
def _load(chain, payload, w):
    """The wrench on every frame where the frames now are   (eq. 15)."""
    n = len(w.frames) - 1
    last = w.frames[n]
    turned = _multiply(_rotation(last), _rotation(chain.sensor))
    where = _add(_position(last), _turn(_rotation(last), _position(chain.sensor)))
    force = _turn(turned, _vector(payload))
    moment = _add(_turn(turned, (payload[3], payload[4], payload[5])), _cross(where, force))
    for i in range(n, -1, -1):
        r, p = _rotation(w.frames[i]), _position(w.frames[i])
        pulls, turns = force, moment
        if i > 0:
            body = chain.body[i - 1]
            weight = _scale(body[0], _vector(chain.gravity))
            centre = _add(p, _turn(r, (body[1], body[2], body[3])))
            force = _add(force, weight)
            moment = _add(moment, _cross(centre, weight))
            if chain.hangs:
                pulls, turns = force, moment
        here = _add(turns, _cross(pulls, p))
        own_force, own_moment = _turn(_transpose(r), pulls), _turn(_transpose(r), here)
        for j in range(3):
            w.wrenches[i, j], w.wrenches[i, 3 + j] = own_force[j], own_moment[j]


@compiled
def _bend(f, q, w):
    """Generalized errors at q under the wrenches in `w`, with their derivatives by q   (model 17)."""
    sums = w.powers
    for i in range(len(q) + 1):
        load = w.wrenches[i]
        for j in range(6):
            sums[j] = f.constant[i, 0, j]
        for c in range(6):
            for j in range(6):
                sums[j] += load[c] * f.constant[i, 1 + c, j]
        for j in range(6, 24):
            sums[j] = 0.0
        u, rate = 0.0, 0.0
        if i > 0 and f.first[i] > f.first[i - 1]:
            first, count = f.first[i - 1], f.first[i] - f.first[i - 1]
            cell, u, rate = _cell(f.breaks[f.break_first[i - 1] : f.break_first[i]], q[i - 1])
            at = f.cubic_first[i - 1] + cell * 24 * count
            for c in range(count):
                column = f.column[first + c]
                factor = 1.0 if column == 0 else load[column - 1]
                for j in range(24):
                    sums[j] += factor * f.cubic[at + 24 * c + j]
        for j in range(6):
            w.errors[i, j] = sums[j] + u * (sums[6 + j] + u * (sums[12 + j] + u * sums[18 + j]))
            w.slopes[i, j] = rate * (sums[6 + j] + u * (2.0 * sums[12 + j] + u * 3.0 * sums[18 + j]))


@compiled
def _cell(breaks, x):
    """Which cell x lies in, how far (0 … 1), and the rate of that; beyond the ends a function is held."""
    last = len(breaks) - 1
    if not x > breaks[0]:
        return 0, 0.0, 0.0
    if not x < breaks[last]:
        return last - 1, 1.0, 0.0
    cell = int(last * (x - breaks[0]) / (breaks[last] - breaks[0]))  # cells are nearly equal: begin there
    while x < breaks[cell]:
        cell -= 1
    while x >= breaks[cell + 1]:
        cell += 1
    rate = 1.0 / (breaks[cell + 1] - breaks[cell])
    return cell, (x - breaks[cell]) * rate, rate


@compiled
def _miss(wanted, tip, left):
    """What the tip misses: translation, and the rotation vector of wanted · realᵀ; returns the largest component."""
    r = _multiply(wanted[0], _transpose(tip[0]))
    x, y, z = 0.5 * (r[7] - r[5]), 0.5 * (r[2] - r[6]), 0.5 * (r[3] - r[1])
    s = np.sqrt(x * x + y * y + z * z)
    factor = np.arctan2(s, 0.5 * (r[0] + r[4] + r[8] - 1.0)) / s if s > 1e-12 else 1.0
    left[3], left[4], left[5] = factor * x, factor * y, factor * z
    largest = 0.0
    for i in range(6):
        if i < 3:
            left[i] = wanted[1][i] - tip[1][i]
        if np.isnan(left[i]):
            return np.nan
        largest = max(largest, abs(left[i]))
    return largest


@compiled
def _differentiate(chain, tip, w):
    """How the real tip moves per joint: its own motion, and its errors that change with it (to first order in them)."""
    for k in range(len(chain.axis)):
        frame, d = w.frames[k + 1], w.slopes[k + 1]
        shift, spin = _vector(d), (d[3], d[4], d[5])
        if chain.prismatic[k]:
            shift = _add(shift, chain.axis[k])
        else:
            spin = _add(spin, chain.axis[k])
        r = _rotation(frame)
        turning = _turn(r, spin)
        arm = _add(tip[1], _scale(-1.0, _position(frame)))
        moving = _add(_turn(r, shift), _cross(turning, arm))
        for i in range(3):
            w.jacobian[k, i], w.jacobian[k, 3 + i] = moving[i], turning[i]


@compiled
def _step(w, left, q):
    """q += (JᵀJ + damping)⁻¹ Jᵀ left by Cholesky's method, no joint by more than 0.5; see inverse.solve_pose."""
    n, j, a, x = len(q), w.jacobian, w.square, w.step
    size = 0.0
    for i in range(6):
        size += left[i] * left[i]
    damping = 1e-12 + 1e-4 * min(1.0, size)
    for k in range(n):
        x[k] = 0.0
        for i in range(6):
            x[k] += j[k, i] * left[i]
        for m in range(k + 1):
            total = damping if k == m else 0.0
            for i in range(6):
                total += j[k, i] * j[m, i]
            for i in range(m):
                total -= a[k, i] * a[m, i]
            # the diagonal holds reciprocals: a division costs as much as a whole row
            a[k, m] = 1.0 / np.sqrt(total) if k == m else total * a[m, m]
    for k in range(n):
        for i in range(k):
            x[k] -= a[k, i] * x[i]
        x[k] *= a[k, k]
    largest = 0.0
    for k in range(n - 1, -1, -1):
        for i in range(k + 1, n):
            x[k] -= a[i, k] * x[i]
        x[k] *= a[k, k]
        largest = max(largest, abs(x[k]))
    shorter = min(1.0, 0.5 / max(largest, 1e-12))
    for k in range(n):
        q[k] += shorter * x[k]


@compiled
def errors_at(chain, functions, q, payload, w):
    """Generalized errors (n+1, 6) of one pose in the two passes of Model.errors: left in w.errors."""
    _place(chain, q, False, w)
    for _ in range(2):
        _load(chain, payload, w)
        _bend(functions, q, w)
        _place(chain, q, True, w)


@compiled
def _correct(chain, functions, allowed, wanted, payload, q, left, w):
    """One setpoint: `q` becomes the corrected one; returns OK or why not."""
    for k in range(len(q)):
        q[k] = wanted[k]
        if not allowed.joints[k, 0] <= wanted[k] <= allowed.joints[k, 1]:
            return OUTSIDE
    for k in range(6):
        if not allowed.loads[k, 0] <= payload[k] <= allowed.loads[k, 1]:
            return OUTSIDE
    ideal = _place(chain, wanted, False, w)
    largest, before = np.inf, np.inf
    for _ in range(MOST_STEPS):
        # The wrench is taken where the last step left the frames; they and it come to rest together.
        _load(chain, payload, w)
        _bend(functions, q, w)
        tip = _place(chain, q, True, w)
        largest, before = _miss(ideal, tip, left), largest
        if largest < CONVERGED:
            break
        _differentiate(chain, tip, w)
        _step(w, left, q)
        # A step leaves some 1e-3 of the motion before it, since the wrench lags by one step. No need to look when that
        # is enough: where this miss and the one before were small, so were both motions.
        if largest < REACHED and before < LAST:
            break
    if not largest <= REACHED:
        return NOT_REACHED
    for k in range(len(q)):
        if not abs(q[k] - wanted[k]) <= allowed.correction[k]:
            return TOO_LARGE
        if not allowed.limits[k, 0] <= q[k] <= allowed.limits[k, 1]:
            return TOO_LARGE
    return OK


@compiled
def correct_all(chain, functions, allowed, w, wanted, payload, corrected, left, code):
    """wanted (N, n), payload (N, 6) → corrected (N, n), left (N, 6), code (N,), all written in place."""
    for i in range(len(wanted)):
        code[i] = _correct(chain, functions, allowed, wanted[i], payload[i], corrected[i], left[i], w)
