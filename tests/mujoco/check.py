"""Compares the torques of MuJoCo with those of armwatch for an arm that `armwatch robot mjcf` has written.

    check.py ARMWATCH

simulates a test, writes its arm as MJCF and as URDF, and compares the torques at states of moving joints: bodies with those
of the URDF file, armature and friction with the JSON output. Needs numpy and mujoco.
"""

import json
import os
import subprocess
import sys
import tempfile

import mujoco
import numpy as np

# Part of a joint's largest torque, and of its friction. MuJoCo diagonalises inertia in double precision.
EQUAL = 1e-9
STATES = 500
# s; in this time, MuJoCo's friction brings a joint to rest.
HORIZON = 0.002


def run(program, *arguments):
    done = subprocess.run([program, *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{' '.join(arguments)}: {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def inverse(model, data, q, qd, qdd):
    data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse.copy()


def main():
    program = os.path.abspath(sys.argv[1])
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        run(program, "simulate", "-o", "inbox", "--cycles", "3", "--warming-s", "0")
        run(program, "ingest", "inbox", "--db", "a.db")
        found = json.loads(run(program, "robot", "mjcf", "--run", "1", "-o", "arm.xml", "--json", "--db", "a.db"))
        run(program, "robot", "urdf", "--run", "1", "-o", "arm.urdf", "--db", "a.db")
        model = mujoco.MjModel.from_xml_path("arm.xml")
        rigid = mujoco.MjModel.from_xml_path("arm.xml")
        rigid.dof_damping[:] = 0
        rigid.dof_frictionloss[:] = 0
        plain = mujoco.MjModel.from_xml_path("arm.urdf")
    data, rigid_data, plain_data = (mujoco.MjData(of) for of in (model, rigid, plain))
    armature, damping, loss = (
        np.array([joint[name] for joint in found["joints"]])
        for name in ("armature_kg_m2", "damping_nm_s_rad", "frictionloss_nm")
    )
    if not np.array_equal(model.dof_armature, armature):
        sys.exit("the armature is not that of the output")
    plain.opt.gravity[:] = model.opt.gravity
    plain.dof_damping[:], plain.dof_frictionloss[:], plain.dof_armature[:] = 0, 0, 0
    random = np.random.default_rng(1)
    low, high = model.jnt_range.T
    worst = {"bodies": 0.0, "friction": 0.0}
    states = [
        (random.uniform(low, high), random.uniform(0.2, 3, model.nv) * random.choice([-1, 1], model.nv),
         random.uniform(-8, 8, model.nv))
        for _ in range(STATES)
    ]
    torques = [inverse(plain, plain_data, *state) + armature * state[2] for state in states]
    scale = np.abs(torques).max(axis=0)
    for state, expected in zip(states, torques):
        without = inverse(rigid, rigid_data, *state)
        worst["bodies"] = max(worst["bodies"], np.max(np.abs(without - expected) / scale))
        q, qd, qdd = state
        friction = inverse(model, data, *state) - without
        moving = np.abs(qd) > 2 * HORIZON * np.abs(qdd)
        difference = np.abs(friction - damping * qd - loss * np.sign(qd)) / (loss + damping * np.abs(qd))
        worst["friction"] = max(worst["friction"], np.max(difference[moving]))
    print(f"mujoco {mujoco.__version__}, {STATES} states: " + ", ".join(f"{k} {v:.1e}" for k, v in worst.items()))
    if max(worst.values()) > EQUAL:
        sys.exit(1)


main()
