"""Inverse dynamics and tool pose of URDF files by Pinocchio, as reference tables.

    python inverse_dynamics.py er3a.urdf tx40.urdf standard_dh.urdf

writes NAME_inverse_dynamics.csv beside each NAME.urdf: states inside the joints' limits, the torque of the
rigid links (recursive Newton-Euler; no friction, no rotor inertia) and the pose of the link "tool" in the
base. Gravity is (0, 0, -9.81) m/s^2. Made with pin 4.1.0, numpy 2.x, Python 3.
"""

import csv
import pathlib
import sys

import numpy as np
import pinocchio as pin

STATES = 40
SEED = 20260105
# Accelerations stand in no URDF file.
LARGEST_ACCELERATION = 10.0


def table(path: pathlib.Path) -> None:
    model = pin.buildModelFromUrdf(str(path))
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    data = model.createData()
    tool = model.getFrameId("tool")
    n = model.nq
    assert model.nv == n, "each joint must have one coordinate"
    random = np.random.default_rng(SEED)
    names = [f"{quantity}_{j}" for quantity in ("q", "qd", "qdd", "tau_nm") for j in range(1, n + 1)]
    names += ["px", "py", "pz"] + [f"r{i}{k}" for i in (1, 2, 3) for k in (1, 2, 3)]
    target = path.with_name(path.stem + "_inverse_dynamics.csv")
    with open(target, "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        for _ in range(STATES):
            q = random.uniform(model.lowerPositionLimit, model.upperPositionLimit)
            qd = random.uniform(-1.0, 1.0, n) * model.upperVelocityLimit
            qdd = random.uniform(-1.0, 1.0, n) * LARGEST_ACCELERATION
            tau = pin.rnea(model, data, q, qd, qdd)
            pin.framesForwardKinematics(model, data, q)
            pose = data.oMf[tool]
            row = np.concatenate([q, qd, qdd, tau, pose.translation, pose.rotation.ravel()])
            writer.writerow([format(x, ".15g") for x in row])


if __name__ == "__main__":
    for name in sys.argv[1:]:
        table(pathlib.Path(name))
