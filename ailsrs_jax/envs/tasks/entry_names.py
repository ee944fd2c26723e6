"""Names of the numbers that a task observes and of its actuators, from its MuJoCo model."""

import mujoco

from ailsrs_jax.envs.tasks.mujoco_task import MujocoTask

# What a joint's numbers in qpos and in qvel are called, after its own name.
PARTS = {
    mujoco.mjtJoint.mjJNT_FREE: (
        (" x", " y", " z", " q0", " q1", " q2", " q3"),
        (" vx", " vy", " vz", " wx", " wy", " wz"),
    ),
    mujoco.mjtJoint.mjJNT_BALL: ((" q0", " q1", " q2", " q3"), (" wx", " wy", " wz")),
    mujoco.mjtJoint.mjJNT_SLIDE: (("",), (" velocity",)),
    mujoco.mjtJoint.mjJNT_HINGE: (("",), (" velocity",)),
}
IN_JOINT = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


def observation_names(task: MujocoTask) -> list[str]:
    """Return a name for each number of an observation; none if the task makes its own.

    Positions and velocities have the names of their joints. A number of another field of
    ``mjData`` has the field's name and its place there.
    """
    if not task.sets_observations:
        return []
    model, data = task.physics.model, mujoco.MjData(task.physics.model)
    names = {
        field: [
            name + part
            for joint, name in enumerate(_joint_names(model))
            for part in PARTS[mujoco.mjtJoint(model.jnt_type[joint])][is_velocity]
        ]
        for is_velocity, field in enumerate(("qpos", "qvel"))
    }
    observed = []
    for field, first, end, *_ in task._observed():
        plain = [f"{field} {place}" for place in range(getattr(data, field).size)]
        observed += names.get(field, plain)[first:end]
    return observed


def action_names(task: MujocoTask) -> list[str]:
    """Return the name of each actuator, or of the joint that it drives."""
    model, joints = task.physics.model, _joint_names(task.physics.model)
    return [
        model.actuator(index).name
        or (
            joints[model.actuator_trnid[index, 0]]
            if mujoco.mjtTrn(kind) in IN_JOINT
            else f"action {index}"
        )
        for index, kind in enumerate(model.actuator_trntype)
    ]


def _joint_names(model: mujoco.MjModel) -> list[str]:
    return [model.joint(index).name or f"joint {index}" for index in range(model.njnt)]
