"""One tick of a robot under its low-level law, with and without an object in its grasp, as CasADi functions.

The law sets the force once, where the tick begins; limits, thrusters and wheels make of it what acts; classical
Runge-Kutta steps integrate the motion, its impulse and its work.
"""

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from psmpc_cli.plant.base import JointFriction, limited_force
from psmpc_cli.plant.grasp import Capture, GraspLaw
from psmpc_cli.robot.actuators.wheels import Wheels, clip_expressions
from psmpc_cli.robot.configuration import ConfigurationSpace
from psmpc_cli.robot.dynamics import law_with_driven_coordinates, with_stored
from psmpc_cli.robot.free_body import FreeBody
from psmpc_cli.robot.held_load import held_force, pushed_held_force
from psmpc_cli.robot.kinematics import runge_kutta
from psmpc_cli.robot.model import RobotModel
from psmpc_cli.specs.object import GRASP_LOADS

LOADS = len(GRASP_LOADS)


@dataclass(frozen=True)
class TickKind:
    """What distinguishes functions of a tick: each takes no more arguments than a plant and its task need.

    Attributes:
        tick: Length of the tick [s].
        substeps: Steps of the integrator in it.
        disturbed: Whether noise, an external force and inertial parameters are arguments.
        limited: Whether limits of the force are an argument.
        in_task_space: Whether the law follows rates of the velocities J_C v.
        varies: Whether the law is told what of the base is driven.
        is_pushed: Whether thrusters push the base.
    """

    tick: float
    substeps: int
    disturbed: bool
    limited: bool
    in_task_space: bool = False
    varies: bool = False
    is_pushed: bool = False


def capture_tick(capture: Capture, kind: TickKind) -> ca.Function:
    """Return one tick of robot and object z, u -> z_next, F, commanded F, wrenches, torques of wheels.

    z = [state; impulse; work; momenta of wheels; object; filtered loads]. In task space the rates of the frames'
    velocities follow u, then what of the base is driven if that varies, see `tick_function`. Further arguments: noise
    (2n,) of a disturbed tick; external force (n,); parameters of the bushings, then which of them are closed; the
    inertial parameters of the robot and of the law, a `JointFriction`, the object and what the law knows of it, and the
    filter of the loads; the vector of `ForceLimits` of a limited tick. Wrenches and loads are those at the beginning of
    the tick. The object counts in the law while all grippers hold it, where it is known. See `tick_function` for a tick
    in which thrusters push the base.
    """
    law = capture.law
    known = bool(capture.spec.known)
    return law.model.derived((capture_tick, law.grippers, known, kind), lambda: _capture_tick(law, known, kind))


def _capture_tick(law: GraspLaw, known: bool, kind: TickKind) -> ca.Function:
    """Derive what `capture_tick` returns."""
    model = law.model
    n = model.n
    nx = model.nq + n
    grippers = len(law.grippers)
    w = model.nominal.vector.size
    of_body = 1 + len(law.body.inertia)
    flow = _capture_flow(law)
    rates = model.n_twists if kind.in_task_space else 0
    driven = model.space.n_twist * kind.varies
    sizes = {
        "z": flow.size1_in(0) + LOADS * grippers,
        "u": n + rates + driven,
        "noise": 2 * n,
        "external_force": n,
        "grasps": (law.n_parameters + 1) * grippers,
        "p": 2 * w + 2 * n + 1 + 2 * of_body + 1,
        "limits": 2 * n + model.space.n_twist * kind.is_pushed,
    }
    z, u, noise, external_force, grasps, p, limits = (ca.MX.sym(name, size) for name, size in sizes.items())
    moving, filtered = ca.vertsplit(z, [0, flow.size1_in(0), sizes["z"]])
    wheels = Wheels.of(model.spec)
    of_object = flow.size1_in(0) - sum(law.object_sizes)
    state, _, momenta, target_object = ca.vertsplit(
        moving, [0, nx, of_object - wheels.count, of_object, flow.size1_in(0)]
    )
    bushings, closed = ca.vertsplit(grasps, [0, law.n_parameters * grippers, sizes["grasps"]])
    robot, believed, friction, body, described, follows = ca.vertsplit(
        p, np.cumsum([0, w, w, 2 * n + 1, of_body, of_body, 1]).tolist()
    )
    pose, rate = ca.vertsplit(target_object, [0, law.object_sizes[0], sum(law.object_sizes)])
    Q, v = ca.vertsplit(state, [0, model.nq, nx])
    _, _, _, wrenches, loads = law.forces(Q, v, pose, rate, bushings)
    holding = ca.vec(ca.repmat(closed.T, LOADS, 1))
    load = filtered + follows * holding * (ca.vec(loads) - filtered)
    measured = ca.vertsplit(_measured(model)(state, noise) if kind.disturbed else state, [0, model.nq, nx])
    by_gripper = ca.horzsplit(ca.reshape(bushings, law.n_parameters, grippers))
    stiff = ca.vertcat(*(bushing[:-2] for bushing in by_gripper))  # without the dampings
    if wheels.count:
        believed = with_stored(model.spec, believed, ca.DM(wheels.axes) @ momenta)
    inputs = *ca.vertsplit(u, [0, n, n + rates, n + rates + driven]), stiff, believed, described
    if kind.is_pushed:
        on_base = _force_on_base(model, wheels, kind.tick)
        inputs = *inputs, ca.vertcat(*(on_base(measured[0], wrench, momenta) for wrench in _thrust(model, limits)))
    commanded = _law(law, known, kind)(ca.mmin(closed), *measured, *inputs)
    of_base = u[n + rates :] if kind.varies else ca.DM(model.driven())
    commanded, F, external, torque = _with_wheels(model, wheels, kind)(Q, commanded, limits[: 2 * n], momenta, of_base)
    acting = ca.vertcat(external + external_force, torque)
    held_arguments = [acting, bushings, ca.vertcat(robot, friction, body)]
    attitudes = model.space.attitudes_at(0, flow.size1_in(0) - sum(law.object_sizes))
    after = _runge_kutta(flow, moving, held_arguments, kind, attitudes)
    arguments = [
        z,
        u,
        *([noise] if kind.disturbed else []),
        external_force,
        grasps,
        p,
        *([limits] if kind.limited else []),
    ]
    results = [ca.vertcat(after, load), F, commanded, ca.vec(wrenches), *([torque] if wheels.count else [])]
    return ca.Function("capture", arguments, results)


def _capture_flow(law: GraspLaw) -> ca.Function:
    """Derive the rates of robot and object together under a force that is held over a tick, for the integrator.

    Args:
        law: The bushings between grippers and object.

    Returns:
        z, F, parameters of the bushings, p -> dz/dt, with z = [Q; v; impulse; work; momenta of wheels; pose and
        velocity of the object]. F is the external force, then the torques of wheels, see `_gyrostat`. p are the
        inertial parameters of the robot, viscous and Coulomb friction and its width, mass and inertia of the object.
    """
    model = law.model
    n = law.model.n
    nq = law.model.nq
    momentum_size = law.model.parts["base"].stop
    n_inertial = model.nominal.vector.size
    object_size = sum(law.object_sizes)
    n_moments = len(law.body.inertia)
    wheels = Wheels.of(model.spec)
    sizes = (
        ("z", nq + n + momentum_size + 1 + wheels.count + object_size),
        ("F", n + wheels.count),
        ("g", law.n_parameters * len(law.grippers)),
    )
    z, F, bushings = (ca.SX.sym(*size) for size in sizes)
    p = ca.SX.sym("p", n_inertial + 2 * n + 1 + 1 + n_moments)
    robot, viscous, coulomb, width, object_parameters = ca.vertsplit(
        p, np.cumsum([0, n_inertial, n, n, 1, 1 + n_moments]).tolist()
    )
    Q = z[:nq]
    v = z[nq : nq + n]
    object_pose = z[z.numel() - object_size : z.numel() - law.object_sizes[1]]
    object_velocity = z[z.numel() - law.object_sizes[1] :]
    momenta = z[z.numel() - object_size - wheels.count : z.numel() - object_size]
    grasp_force, wrench_on_object, power, _, _ = law.forces(Q, v, object_pose, object_velocity, bushings)
    F_external, net_force, torque, power_of_wheels, robot = _gyrostat(model, wheels, F, momenta, robot)
    acting = net_force - viscous * v - coulomb * ca.tanh(v / width)
    target_object = FreeBody(object_parameters[0], ca.vertsplit(object_parameters[1:]))
    pose_rate, velocity_rate = target_object.rates(
        ca.vertsplit(object_pose), ca.vertsplit(object_velocity), ca.vertsplit(wrench_on_object)
    )
    vdot = model.dynamics.forward(Q, v, acting + grasp_force, robot)
    Qdot = model.space.rate(ca.vertsplit(Q), ca.vertsplit(v))
    # on a base that does not move, it is the force of its mount
    external_force = (
        F_external if model.spec.moved_by.moves else model.dynamics.inverse(Q, v, vdot, robot) - grasp_force
    )
    external_wrench = model.space.external_wrench(ca.vertsplit(Q), ca.vertsplit(external_force))
    power += ca.dot(acting, v) + power_of_wheels
    zdot = ca.vertcat(*Qdot, vdot, *external_wrench, power, torque, *pose_rate, *velocity_rate)
    return ca.Function("flow", [z, F, bushings, p], [zdot])


def _law(grasp_law: GraspLaw, object_is_known: bool, kind: TickKind) -> ca.Function:
    """Build the low-level law of a robot that may hold an object, as a function that switches between two laws.

    While all grippers hold an object that the law knows of, the force is that of `held_force`, which moves the object
    too. Otherwise it is the law of the robot alone.

    Args:
        grasp_law: The bushings between grippers and object.
        object_is_known: Whether the law may count with the object.
        kind: Which arguments the tick has.

    Returns:
        all_hold (1 or 0), Q, v, u, rates in task space, driven coordinates of the base, grasps, inertial parameters,
        object -> F (n,). Where thrusters push the base, the last argument is the force on it and its mean over the
        period of pulses.
    """
    model = grasp_law.model
    space = model.space
    argument_sizes = {
        "Q": model.nq,
        "v": model.n,
        "u": model.n,
        "rates": model.n_twists if kind.in_task_space else 0,
        "driven": space.n_twist * kind.varies,
        "grasps": (space.n_pose + 2) * len(grasp_law.grippers),
        "w": model.nominal.vector.size,
        "body": 1 + space.n_principal,
        "base_force": 2 * space.n_twist * kind.is_pushed,
    }
    arguments = [ca.SX.sym(name, size) for name, size in argument_sizes.items()]
    Q, v, u, twist_rates, driven, grasps, inertial_parameters, object_parameters, base_force = arguments
    base_argument = [driven] if kind.varies else []
    now_and_mean = ca.vertsplit(base_force, space.n_twist) if kind.is_pushed else []
    if kind.is_pushed:
        base_argument = now_and_mean[:1]
    F_alone = law_of(model, kind)(Q, v, twist_rates if kind.in_task_space else u, inertial_parameters, *base_argument)
    if not kind.is_pushed:
        arguments = arguments[:-1]
    if not object_is_known:
        return ca.Function("law", [ca.SX.sym("all_hold"), *arguments], [F_alone])
    law_alone = ca.Function("free", arguments, [F_alone])
    if kind.is_pushed:
        law_with_object = pushed_held_force(model, grasp_law.grippers)
    elif kind.varies:
        law_with_object = law_with_driven_coordinates(model.spec, held_force(model, grasp_law.grippers), driven)
    else:
        law_with_object = held_force(model, grasp_law.grippers, model.driven())
    F_with_object = law_with_object(
        Q, v, u, grasps, inertial_parameters, object_parameters, *(now_and_mean or base_argument)
    )
    return ca.Function.if_else("law", ca.Function("loaded", arguments, [F_with_object]), law_alone)


def _measured(model: RobotModel) -> ca.Function:
    """Return the state that the law reads where it is moved by noise (2n,)."""
    n = model.n
    state, noise = (ca.SX.sym(name, size) for name, size in (("x", model.nq + n), ("noise", 2 * n)))
    Q = _integrated(model.space, state[: model.nq], noise[:n])
    return ca.Function("measured", [state, noise], [ca.vertcat(Q, state[model.nq :] + noise[n:])])


def law_of(model: RobotModel, kind: TickKind) -> ca.Function:
    """Return the low-level law Q, v, u, w -> F (n,) of a robot that holds nothing.

    Its last argument is the force on the base where thrusters push it, or else what of the base is driven if that
    varies. In task space the rates of the frames' velocities take the place of u.
    """
    if kind.in_task_space:
        return _pushed_task_law(model) if kind.is_pushed else model.task_space.law
    if kind.is_pushed:
        return model.pushed_law
    if not kind.varies:
        return model.law()
    every = (1.0,) * model.space.n_twist
    return law_with_driven_coordinates(model.spec, model.law(every), ca.SX.sym("driven", model.space.n_twist))


def _pushed_task_law(model: RobotModel) -> ca.Function:
    """Return Q, v, rates, w, force on the base -> F (n,), of joints under which they accelerate as in task space."""
    task_space = model.task_space
    motion = task_space.law.sx_in()
    base_force = ca.SX.sym("base_force", model.space.n_twist)
    Q, v, _, w = motion
    pushed = model.pushed_law(Q, v, task_space.acceleration(*motion), w, base_force)
    asked = task_space.law(*motion)
    F = ca.vertcat(asked[model.space.base], pushed[model.space.joint_rates])
    return ca.Function("pushed_task_law", [*motion, base_force], [ca.cse(F)])


def _force_on_base(model: RobotModel, wheels: Wheels, tick: float) -> ca.Function:
    """Return Q, wrench of thrusters along the base's axes, momenta -> generalized force on the base (n_twist,).

    It is what motors that unload wheels leave of the wrench; see `WheelDrive.against_unloading`.
    """
    space = model.space
    sizes = ("Q", model.nq), ("wrench", space.n_twist), ("momenta", wheels.count)
    Q, wrench, momenta = (ca.SX.sym(*size) for size in sizes)
    components = [*ca.vertsplit(wrench), *np.zeros(space.joints)]
    force = ca.vertcat(*space.along_inertial_axes(ca.vertsplit(Q), components))
    if wheels.count:
        torques = wheels.unloading_torques(ca.vertsplit(momenta), tick, clip_expressions)
        force[space.rotation] -= ca.vertcat(*wheels.along_base(torques))
    return ca.Function("force_on_base", [Q, wrench, momenta], [ca.cse(force[space.base])])


def _thrust(model: RobotModel, limits: ca.MX) -> list[ca.MX]:
    """Return the wrench of thrusters and its mean over the period, which the limits of a tick have."""
    return [limits[: model.space.n_twist], limits[2 * model.n :]]


def tick_function(model: RobotModel, kind: TickKind) -> ca.Function:
    """Return the simulation of one tick as a CasADi function: the law (7) sets F once, then the motion is integrated.

    It maps z, u to z_next, F, torques of wheels, with z = [Q; v; impulse (3,) or (6,); work; momenta of wheels]. Where
    these hold of `kind`, there are other arguments and results:

    - in_task_space: the law is `F = J' F_m`, and u are the rates of the frames' velocities.
    - varies: which coordinates of the base are driven (n_twist,) follows u.
    - disturbed: noise (2n,), external force (n,) and p: the inertial parameters of the robot and of the law, then the
      vector of a `JointFriction`.
    - limited: the vector of `ForceLimits` is the last argument; the force before it was cut is returned after F.
    - is_pushed: thrusters push the base. The limits are those of `ForceLimits.holding_base`, followed by the mean
      wrench of the period (n_twist,), which the torques of joints need; see `LowLevelLaw.force`.

    The function is derived once for each model and kind.
    """
    return model.derived((tick_function, kind), lambda: _tick_function(model, kind))


def _tick_function(model: RobotModel, kind: TickKind) -> ca.Function:
    """Derive one tick of a robot without an object, see `tick_function`: law, limits, wheels, then integration.

    Args:
        model: The robot.
        kind: Which arguments the tick has.
    """
    n = model.n
    nx = model.nq + model.n
    law, flow = _law_and_flow(model, kind)
    wheels = Wheels.of(model.spec)
    sizes = (
        ("z", flow.size1_in(0)),
        ("u", law.size1_in(1)),
        ("noise", 2 * n),
        ("external_force", n),
        ("limits", 2 * n + model.space.n_twist * kind.is_pushed),
    )
    z, u, noise, external_force, limits = (ca.MX.sym(*size) for size in sizes)
    p = ca.MX.sym("p", flow.size1_in(2) if kind.disturbed else 0)
    wheel_momenta = z[z.numel() - wheels.count :]
    law_state = ca.vertcat(z[:nx], wheel_momenta) if wheels.count else z[:nx]
    wrench_of_thrusters = _thrust(model, limits)[:1] if kind.is_pushed else []
    commanded = law(law_state, u, *([noise, p] if kind.disturbed else []), *wrench_of_thrusters)
    driven = u[u.numel() - model.space.n_twist :] if kind.varies else ca.DM(model.driven())
    commanded, F, external, torque = _with_wheels(model, wheels, kind)(
        z[: model.nq], commanded, limits[: 2 * n], wheel_momenta, driven
    )
    held_arguments = (
        [ca.vertcat(external + external_force, torque), p] if kind.disturbed else [ca.vertcat(external, torque)]
    )
    z_next = _runge_kutta(flow, z, held_arguments, kind, model.space.attitudes_at(0))
    arguments = [z, u, *([noise, external_force, p] if kind.disturbed else []), *([limits] if kind.limited else [])]
    results = [z_next, F, *([commanded] if kind.limited else []), *([torque] if wheels.count else [])]
    return ca.Function("disturbed" if kind.disturbed else "tick", arguments, results)


def _cut(model: RobotModel) -> ca.Function:
    """Return the function Q, F, limits -> F that cuts a generalized force at the vector of `ForceLimits`."""
    n = model.n
    Q, F, limits = (ca.SX.sym(*size) for size in (("Q", model.nq), ("F", n), ("limits", 2 * n)))
    within = limited_force(
        model.space,
        ca.vertsplit(Q),
        ca.vertsplit(F),
        ca.vertsplit(limits[:n]),
        ca.vertsplit(limits[n:]),
        lambda component, low, high: ca.fmin(ca.fmax(component, low), high),
    )
    return ca.Function("cut", [Q, F, limits], [ca.cse(ca.vertcat(*within))])


def _with_wheels(model: RobotModel, wheels: Wheels, kind: TickKind) -> Callable[..., list[ca.MX]]:
    """Build what limits and reaction wheels make of the force that the law commands, as a function of expressions.

    Motors of wheels either unload them, where thrusters push the base, or turn the base. See `WheelDrive`, which does
    the same with numbers.

    Args:
        model: The robot.
        wheels: Its wheels; without any only the limits act.
        kind: Which arguments the tick has.

    Returns:
        Q, commanded force, limits, momenta of wheels, driven coordinates of the base -> the commanded force with what
        balances the unloading of wheels; the force that acts; the part of it that is external, without the motors of
        wheels; and their torques (W,).
    """
    cut = _cut(model) if kind.limited else None
    if not wheels.count:

        def limited_alone(Q: ca.MX, commanded: ca.MX, limits: ca.MX, momenta: ca.MX, driven: ca.MX) -> list[ca.MX]:
            F = commanded if cut is None else cut(Q, commanded, limits)
            return [commanded, F, F, ca.MX(0, 1)]

        return limited_alone
    n = model.n
    rotation = model.space.rotation
    F, h, driven = (ca.SX.sym(*size) for size in (("F", n), ("h", wheels.count), ("driven", model.space.n_twist)))
    stored = ca.vertsplit(h)

    def force_of_moment(torque: ca.SX) -> ca.SX:
        """Return the generalized force (n,) of the moment that torques of wheels (W,) make along the base's axes."""
        force = ca.SX.zeros(n)
        force[rotation] = ca.vertcat(*wheels.along_base(ca.vertsplit(torque)))
        return force

    # thrusters push the base where its first coordinate is driven; wheels turn it where only its attitude is
    is_pushed = driven[0]
    wheels_turn = (1 - driven[0]) * driven[-1]
    unloading = is_pushed * ca.vertcat(*wheels.unloading_torques(stored, kind.tick, clip_expressions))
    with_unloading = ca.Function("unloads", [F, h, driven], [F + force_of_moment(unloading)])
    moment = ca.vertsplit(F[rotation])
    turning = wheels_turn * ca.vertcat(*wheels.turning_torques(moment, stored, kind.tick, clip_expressions))
    torque = unloading + turning
    external = ca.SX(F)
    external[rotation] *= 1 - wheels_turn
    with_turning = ca.Function("turns", [F, h, driven], [external - force_of_moment(torque), external, torque])

    def limited_with_wheels(Q: ca.MX, commanded: ca.MX, limits: ca.MX, momenta: ca.MX, driven: ca.MX) -> list[ca.MX]:
        commanded = with_unloading(commanded, momenta, driven)
        within = commanded if cut is None else cut(Q, commanded, limits)
        return [commanded, *with_turning(within, momenta, driven)]

    return limited_with_wheels


def _gyrostat(
    model: RobotModel, wheels: Wheels, F: ca.SX, momenta: ca.SX, inertial_parameters: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX | float, ca.SX]:
    """Split what acts on a robot with wheels into what the dynamics of robot and of wheels need.

    The motors' torques act on the base and, opposite, on the wheels, whose momentum is that of a gyrostat.

    Args:
        model: The robot.
        wheels: Its wheels.
        F: External generalized force, then the torques of the motors (n + W,).
        momenta: Angular momenta that the wheels store (W,).
        inertial_parameters: Those of the robot.

    Returns:
        The external force (n,), that with what the motors do to the base (n,), their torques (W,), the power of what
        they do to the wheels, and the inertial parameters with what the wheels store.
    """
    if not wheels.count:
        return F, F, ca.SX(0, 1), 0.0, inertial_parameters
    external, torque = ca.vertsplit(F, [0, model.n, model.n + wheels.count])
    net_force = ca.SX(external)
    net_force[model.space.rotation] -= ca.vertcat(*wheels.along_base(ca.vertsplit(torque)))
    power = ca.dot(torque, momenta / ca.DM(wheels.inertia))
    return (
        external,
        net_force,
        torque,
        power,
        with_stored(model.spec, inertial_parameters, ca.DM(wheels.axes) @ momenta),
    )


def _law_and_flow(model: RobotModel, kind: TickKind) -> tuple[ca.Function, ca.Function]:
    """Derive the two functions that a tick of a robot consists of: its law, and its motion under a held force.

    Args:
        model: The robot.
        kind: Which arguments the tick has. Of an undisturbed one noise and p are constant, and no arguments.

    Returns:
        The law: [Q; v; momenta of wheels], u, noise, p -> F; where thrusters push the base, their wrench along its axes
        is the last argument. And the motion: z, [F; torques of wheels], p -> dz/dt, with the external force in F. p are
        the true inertial parameters, those that the law takes for them, then the vector of a `JointFriction`.
    """
    n = model.n
    w = model.nominal.vector
    nominal = np.concatenate([w, w, JointFriction.none(n).vector])
    p = ca.SX.sym("p", nominal.size) if kind.disturbed else ca.SX(nominal)
    true_robot, robot_of_law, friction = ca.vertsplit(p, np.cumsum([0, w.size, w.size, 2 * n + 1]).tolist())
    arguments, F = _law_at_state(model, kind, robot_of_law)
    z, held, rate = _motion(model, true_robot, friction)
    if not kind.disturbed:
        state, u, _, *wrench = arguments
        law = ca.Function("law", [state, u, *wrench], ca.cse([F]))
        return law, ca.Function("flow", [z, held], ca.cse([rate]))
    state, u, noise, *wrench = arguments
    return ca.Function("law", [state, u, noise, p, *wrench], [F]), ca.Function("flow", [z, held, p], [rate])


def _law_at_state(model: RobotModel, kind: TickKind, robot: ca.SX) -> tuple[list[ca.SX], ca.SX]:
    """Derive the force of the low-level law at a state that it reads with noise.

    Args:
        model: The robot.
        kind: Which arguments the tick has.
        robot: Inertial parameters that the law takes for the robot's.

    Returns:
        Its arguments: [Q; v; momenta of wheels], u, noise and, where thrusters push the base, their wrench. And F.
    """
    n = model.n
    nq = model.nq
    law = law_of(model, kind)
    wheels = Wheels.of(model.spec)
    driven_size = model.space.n_twist * kind.varies
    state = ca.SX.sym("x", nq + n + wheels.count)
    u = ca.SX.sym("u", law.size1_in(2) + driven_size)
    noise = ca.SX.sym("noise", 2 * n)
    if wheels.count:
        robot = with_stored(model.spec, robot, ca.DM(wheels.axes) @ state[nq + n :])
    Q = state[:nq]
    v = state[nq : nq + n]
    if kind.disturbed:
        Q = _integrated(model.space, Q, noise[:n])
        v = v + noise[n:]
    setpoint = u[: u.numel() - driven_size]
    if kind.is_pushed:  # joints follow their setpoints under the force that thrusters give
        wrench = ca.SX.sym("wrench", model.space.n_twist)
        base_force = _force_on_base(model, wheels, kind.tick)(Q, wrench, state[nq + n :])
        return [state, u, noise, wrench], law(Q, v, setpoint, robot, base_force)
    driven = [u[u.numel() - driven_size :]] if kind.varies else []
    return [state, u, noise], law(Q, v, setpoint, robot, *driven)


def _motion(model: RobotModel, robot: ca.SX, friction: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Derive the rate of the integrated state of a robot under a force that is held over a tick.

    Friction acts between the links: it does work, but has no impulse on the whole. The rate becomes a function that
    each stage of an integration step calls, not an expression written out: as C it compiles in a third of the time.

    Args:
        model: The robot.
        robot: True inertial parameters.
        friction: Vector of a `JointFriction`: viscous (n,), Coulomb (n,), width (1,).

    Returns:
        z = [Q; v; impulse; work; momenta of wheels]; the held external force, then torques of wheels; dz/dt.
    """
    n = model.n
    nq = model.nq
    wheels = Wheels.of(model.spec)
    momentum_size = model.parts["base"].stop
    z = ca.SX.sym("z", nq + n + momentum_size + 1 + wheels.count)
    held = ca.SX.sym("F", n + wheels.count)
    viscous, coulomb, width = ca.vertsplit(friction, [0, n, 2 * n, 2 * n + 1])
    Q = z[:nq]
    v = z[nq : nq + n]
    momenta = z[nq + n + momentum_size + 1 :]
    F_external, net_force, torque, power_of_wheels, robot = _gyrostat(model, wheels, held, momenta, robot)
    acting = net_force - viscous * v - coulomb * ca.tanh(v / width)
    Qdot = model.space.rate(ca.vertsplit(Q), ca.vertsplit(v))
    vdot = model.dynamics.forward(Q, v, acting, robot)
    # on a base that does not move, the external force is that of its mount
    external = F_external if model.spec.moved_by.moves else model.dynamics.inverse(Q, v, vdot, robot)
    impulse_rate = model.space.external_wrench(ca.vertsplit(Q), ca.vertsplit(external))
    power = ca.dot(acting, v) + power_of_wheels
    return z, held, ca.vertcat(*Qdot, vdot, *impulse_rate, power, torque)


def _integrated(space: ConfigurationSpace, Q: ca.SX, step: ca.SX) -> ca.SX:
    return ca.SX(ca.vertcat(*space.integrate(ca.vertsplit(Q), ca.vertsplit(step))))


def _runge_kutta(flow: ca.Function, z: ca.MX, held: list[ca.MX], kind: TickKind, attitudes: list[slice]) -> ca.MX:
    """Return z after a tick of classical Runge-Kutta steps, the other arguments of the flow held.

    After each of them the quaternions, given by their rows, are made unit ones, from which they differ by the step's
    error.
    """
    h = kind.tick / kind.substeps
    for _ in range(kind.substeps):
        z = runge_kutta(lambda z: flow(z, *held), z, h)
        for rows in attitudes:
            q = z[rows]
            z = ca.vertcat(z[: rows.start], q / ca.norm_2(q), z[rows.stop :])
    return z
