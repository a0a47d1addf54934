"""robotkinecal (product of exponentials), in pybotics' environment. Called by peers.py; see peer_tasks.py.

It takes revolute joints only, and no measuring frame: positions are handed to it in the base frame as first aligned.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import peer_tasks
from roboticstoolbox import ET, ETS, Link, Robot
from robotkinecal import SerialRobotKineCal
from spatialmath import SE3


def _calibrator(task: Any) -> Any:
    """Every joint's axis is its frame's z, as the UR5's are (its PoERobot way in fails with roboticstoolbox 1.4)."""
    links: list[Any] = []
    for k, origin in enumerate([*task["origins"], task["reflector"]]):
        joint = ET.SE3(SE3(origin)) * ET.Rz() if k < len(task["origins"]) else ETS(ET.SE3(SE3(origin)))
        links.append(Link(joint, name=f"l{k}", parent=links[-1] if links else None))
    return SerialRobotKineCal(Robot(links), ee_name=links[-1].name)


def kinematics(task: Any) -> dict[str, Any]:
    calibrator = _calibrator(task)
    calibrator.OBS_SIZE = 3
    rounds = int(task["rounds"])
    some = task["q"][: max(10, len(task["q"]) // 10)]
    return {
        "forward": peer_tasks.microseconds(lambda q: calibrator.forward_kinematics(7, q), some, rounds),
        "error_jacobian": peer_tasks.microseconds(calibrator.Q_Matrix, some, rounds),
        "tips": [calibrator.forward_kinematics(7, q).t for q in task["q"][:5]],
    }


def calibrate(task: Any) -> dict[str, Any]:
    np.random.seed(0)  # noqa: NPY002  its basis of each joint is drawn from the global generator
    started = time.process_time()
    calibrator = _calibrator(task)
    calibrator.set_observations(list(task["q"]), list(task["points_in_base"]))
    set_up = time.process_time()
    result = calibrator.solve()
    solved = time.process_time()
    base = np.linalg.inv(task["measuring_in_base"])
    tips = np.array([calibrator.forward_kinematics(7, q).t for q in task["q_test"]])
    return {
        "set_up_s": set_up - started,
        "solve_s": solved - set_up,
        "parameters": calibrator.N_PARAMS,
        "evaluations": result.nb_iterations_executed,
        "converged": bool(result.has_converged),
        "predicted": tips @ base[:3, :3].T + base[:3, 3],
    }


if __name__ == "__main__":
    peer_tasks.main({"kinematics": kinematics, "calibrate": calibrate})
