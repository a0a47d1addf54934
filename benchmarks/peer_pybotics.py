"""pybotics, in an environment of its own. Called by peers.py; see peer_tasks.py. Lengths in mm, as in its manual."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import peer_tasks
from pybotics.kinematic_chain import MDHKinematicChain
from pybotics.optimization import OptimizationHandler, optimize_accuracy
from pybotics.robot import Robot
from scipy.optimize import least_squares

# Modified Denavit-Hartenberg: α, a, θ, d of the UR5; the reflector 33 mm beyond the flange.
UR5 = np.array(
    [
        [0, 0, 0, 89.159],
        [np.pi / 2, 0, 0, 0],
        [0, -425, 0, 0],
        [0, -392.25, 0, 109.15],
        [np.pi / 2, 0, 0, 94.65],
        [-np.pi / 2, 0, 0, 82.3],
    ]
)


def _robot() -> Any:
    robot = Robot(MDHKinematicChain.from_parameters(UR5))
    robot.tool.position = np.array([0, 0, 33.0])
    return robot


def kinematics(task: Any) -> dict[str, Any]:
    """No generalized-error Jacobian here: pybotics differentiates numerically, one forward solution per parameter."""
    robot = _robot()
    robot.joints = task["q"][0]
    chain = robot.kinematic_chain
    vector = chain.vector.copy()

    def errors(q: Any) -> Any:
        """Forward differences by its 24 link parameters, as its optimisation asks scipy for."""
        here = robot.fk(q)[:3, 3]
        out = np.empty((3, len(vector)))
        for k in range(len(vector)):
            moved = vector.copy()
            moved[k] += 1e-6
            chain.vector = moved
            out[:, k] = (robot.fk(q)[:3, 3] - here) / 1e-6
        chain.vector = vector
        return out

    rounds = int(task["rounds"])
    return {
        "forward": peer_tasks.microseconds(robot.fk, task["q"], rounds),
        "joint_jacobian": peer_tasks.microseconds(robot.jacobian_world, task["q"], rounds),
        "error_jacobian": peer_tasks.microseconds(errors, task["q"][: max(10, len(task["q"]) // 10)], rounds),
        "tips": [robot.fk(q)[:3, 3] / 1e3 for q in task["q"][:5]],
        "jacobians": [robot.jacobian_world(q)[:3] / 1e3 for q in task["q"][:5]],
    }


def calibrate(task: Any) -> dict[str, Any]:
    """All link parameters, the world frame and the reflector free; scalar distances as residuals, as it has them."""
    started = time.process_time()
    robot = _robot()
    robot.world_frame = np.linalg.inv(task["measuring_in_base"])
    robot.world_frame[:3, 3] *= 1e3
    handler = OptimizationHandler(robot, kinematic_chain_mask=True, tool_mask=[True] * 3 + [False] * 3, world_mask=True)
    x = handler.generate_optimization_vector()
    set_up = time.process_time()
    result = least_squares(
        optimize_accuracy, x, x_scale="jac", args=(handler, task["q"], task["points"] * 1e3),
        max_nfev=int(task["most_evaluations"]),
    )  # fmt: skip
    solved = time.process_time()
    handler.apply_optimization_vector(result.x)
    return {
        "set_up_s": set_up - started,
        "solve_s": solved - set_up,
        "parameters": len(result.x),
        "evaluations": int(result.nfev),
        "converged": bool(result.success),
        "predicted": [handler.robot.fk(q)[:3, 3] / 1e3 for q in task["q_test"]],
    }


if __name__ == "__main__":
    peer_tasks.main({"kinematics": kinematics, "calibrate": calibrate})
