"""figaroh on pinocchio (C++), in its own environment. Called by peers.py; see peer_tasks.py."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import peer_tasks
import pinocchio as pin
import yaml

FRAME = "ee_link"


def kinematics(task: Any) -> dict[str, Any]:
    model = pin.buildModelFromXML(str(task["urdf"]))
    data, frame = model.createData(), model.getFrameId(FRAME)

    def forward(q: Any) -> None:
        pin.framesForwardKinematics(model, data, q)

    def joints(q: Any) -> Any:
        return pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)

    def errors(q: Any) -> Any:
        """As figaroh's calculate_kinematics_model does it, without the joint Jacobian beside it."""
        pin.forwardKinematics(model, data, q)
        pin.updateFramePlacements(model, data)
        return pin.computeFrameKinematicRegressor(model, data, frame, pin.LOCAL)

    tips, jacobians = [], []
    for q in task["q"][:5]:
        forward(q)
        tips.append(data.oMf[frame].translation.copy())
        jacobians.append(joints(q)[:3])
    rounds = int(task["rounds"])
    return {
        "forward": peer_tasks.microseconds(forward, task["q"], rounds),
        "joint_jacobian": peer_tasks.microseconds(joints, task["q"], rounds),
        "error_jacobian": peer_tasks.microseconds(errors, task["q"], rounds),
        "tips": tips,
        "jacobians": jacobians,
    }


def calibrate(task: Any) -> dict[str, Any]:
    """All geometric parameters that figaroh finds identifiable, the measuring frame and the reflector with them."""
    from figaroh.calibration.base_calibration import BaseCalibration
    from figaroh.calibration.calibration_tools import calc_updated_fkm
    from figaroh.tools.load_robot import load_robot

    class Arm(BaseCalibration):
        def cost_function(self, var: Any) -> Any:
            return self.PEE_measured - calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)

    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(folder) / "arm.urdf"
        urdf.write_text(str(task["urdf"]))
        robot = load_robot(str(urdf), load_by_urdf=True)
        names = list(robot.model.names)[1:]
        csv = Path(folder) / "measured.csv"
        table = np.hstack([task["points"], task["q"]])
        np.savetxt(csv, table, delimiter=",", header=",".join(["x1", "y1", "z1", *names]), comments="", fmt="%.12g")
        config = Path(folder) / "calibration.yaml"
        config.write_text(yaml.safe_dump(_config(csv)))
        started = time.process_time()
        arm = Arm(robot, str(config))
        arm.calib_config["known_baseframe"] = arm.calib_config["known_tipframe"] = False
        arm.initialize()
        set_up = time.process_time()
        result = arm.solve(enable_logging=False)
        solved = time.process_time()
    arm.calib_config["NbSample"] = len(task["q_test"])
    flat = calc_updated_fkm(arm.model, arm.data, result.x, task["q_test"], arm.calib_config)
    return {
        "set_up_s": set_up - started,
        "solve_s": solved - set_up,
        "parameters": len(result.x),
        "evaluations": int(result.nfev),
        "converged": bool(result.success),
        "predicted": np.asarray(flat).reshape(3, -1).T,
    }


def _config(csv: Path) -> dict[str, Any]:
    return {
        "robot": {"name": "ur5"},
        "tasks": {
            "calibration": {
                "enabled": True,
                "type": "kinematic_calibration",
                "kinematics": {"base_frame": "universe", "tool_frame": FRAME},
                "measurements": {
                    "markers": [{"measurable_dof": [True, True, True, False, False, False]}],
                    "poses": {"base_pose": [0.0] * 6, "tool_pose": [0.0] * 6},
                },
                "parameters": {"calibration_level": "full_params", "include_non_geometric": False},
                "data": {"source_file": str(csv)},
            }
        },
    }


if __name__ == "__main__":
    peer_tasks.main({"kinematics": kinematics, "calibrate": calibrate})
