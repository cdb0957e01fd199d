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
from psmpc_cli.robot.actuators.wheels import Wheels, by_expressions
from psmpc_cli.robot.configuration import ConfigurationSpace
from psmpc_cli.robot.dynamics import of_driven, with_stored
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
        "grasps": (law.parameters + 1) * grippers,
        "p": 2 * w + 2 * n + 1 + 2 * of_body + 1,
        "limits": 2 * n + model.space.n_twist * kind.is_pushed,
    }
    z, u, noise, external_force, grasps, p, limits = (ca.MX.sym(name, size) for name, size in sizes.items())
    moving, filtered = ca.vertsplit(z, [0, flow.size1_in(0), sizes["z"]])
    wheels = Wheels.of(model.spec)
    of_object = flow.size1_in(0) - sum(law.sizes)
    state, _, momenta, target_object = ca.vertsplit(
        moving, [0, nx, of_object - wheels.count, of_object, flow.size1_in(0)]
    )
    bushings, closed = ca.vertsplit(grasps, [0, law.parameters * grippers, sizes["grasps"]])
    robot, believed, friction, body, described, follows = ca.vertsplit(
        p, np.cumsum([0, w, w, 2 * n + 1, of_body, of_body, 1]).tolist()
    )
    pose, rate = ca.vertsplit(target_object, [0, law.sizes[0], sum(law.sizes)])
    Q, v = ca.vertsplit(state, [0, model.nq, nx])
    _, _, _, wrenches, loads = law.forces(Q, v, pose, rate, bushings)
    holding = ca.vec(ca.repmat(closed.T, LOADS, 1))
    load = filtered + follows * holding * (ca.vec(loads) - filtered)
    measured = ca.vertsplit(_measured(model)(state, noise) if kind.disturbed else state, [0, model.nq, nx])
    by_gripper = ca.horzsplit(ca.reshape(bushings, law.parameters, grippers))
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
    attitudes = model.space.attitudes_at(0, flow.size1_in(0) - sum(law.sizes))
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
    """Return the rates of z = [state; impulse; work; momenta of wheels; object], bushings, p under an external force.

    The force F is followed by the torques of wheels, see `_gyrostat`. p are the inertial parameters of the robot,
    viscous and Coulomb friction and its width, mass and inertia of the object.
    """
    model = law.model
    n = law.model.n
    nq = law.model.nq
    base = law.model.parts["base"].stop
    w = model.nominal.vector.size
    no = sum(law.sizes)
    moments = len(law.body.inertia)
    wheels = Wheels.of(model.spec)
    sizes = (
        ("z", nq + n + base + 1 + wheels.count + no),
        ("F", n + wheels.count),
        ("g", law.parameters * len(law.grippers)),
    )
    z, F, g = (ca.SX.sym(*size) for size in sizes)
    p = ca.SX.sym("p", w + 2 * n + 1 + 1 + moments)
    robot, viscous, coulomb, width, body = ca.vertsplit(p, np.cumsum([0, w, n, n, 1, 1 + moments]).tolist())
    Q = z[:nq]
    v = z[nq : nq + n]
    pose = z[z.numel() - no : z.numel() - law.sizes[1]]
    rate = z[z.numel() - law.sizes[1] :]
    momenta = z[z.numel() - no - wheels.count : z.numel() - no]
    force, wrench, power, _, _ = law.forces(Q, v, pose, rate, g)
    F_external, net, torque, power_of_wheels, robot = _gyrostat(model, wheels, F, momenta, robot)
    acting = net - viscous * v - coulomb * ca.tanh(v / width)
    target_object = FreeBody(body[0], ca.vertsplit(body[1:]))
    pose_rate, velocity_rate = target_object.rates(ca.vertsplit(pose), ca.vertsplit(rate), ca.vertsplit(wrench))
    vdot = model.dynamics.forward(Q, v, acting + force, robot)
    Qdot = model.space.rate(ca.vertsplit(Q), ca.vertsplit(v))
    on_robot = (
        F_external if model.spec.moved_by.moves else model.dynamics.inverse(Q, v, vdot, robot) - force
    )  # by the mount
    external = model.space.external_wrench(ca.vertsplit(Q), ca.vertsplit(on_robot))
    power += ca.dot(acting, v) + power_of_wheels
    zdot = ca.vertcat(*Qdot, vdot, *external, power, torque, *pose_rate, *velocity_rate)
    return ca.Function("flow", [z, F, g, p], [zdot])


def _law(of_grasps: GraspLaw, known: bool, kind: TickKind) -> ca.Function:
    """Return the low-level law: all hold, Q, v, u and more -> F (n,).

    More are rates in task space, what of the base is driven if that varies, grasps, inertial parameters, object, and
    where thrusters push the base the force on it and its mean over the period of pulses. While all grippers hold an
    object that is known, the force is that of `held_force`.
    """
    model = of_grasps.model
    space = model.space
    sizes = {
        "Q": model.nq,
        "v": model.n,
        "u": model.n,
        "rates": model.n_twists if kind.in_task_space else 0,
        "driven": space.n_twist * kind.varies,
        "grasps": (space.n_pose + 2) * len(of_grasps.grippers),
        "w": model.nominal.vector.size,
        "body": 1 + space.n_principal,
        "base_force": 2 * space.n_twist * kind.is_pushed,
    }
    arguments = [ca.SX.sym(name, size) for name, size in sizes.items()]
    Q, v, u, rates, driven, grasps, w, body, base_force = arguments
    of_base = [driven] if kind.varies else []
    now_and_mean = ca.vertsplit(base_force, space.n_twist) if kind.is_pushed else []
    if kind.is_pushed:
        of_base = now_and_mean[:1]
    F = law_of(model, kind)(Q, v, rates if kind.in_task_space else u, w, *of_base)
    if not kind.is_pushed:
        arguments = arguments[:-1]
    if not known:
        return ca.Function("law", [ca.SX.sym("all_hold"), *arguments], [F])
    free = ca.Function("free", arguments, [F])
    if kind.is_pushed:
        loaded = pushed_held_force(model, of_grasps.grippers)
    elif kind.varies:
        loaded = of_driven(model.spec, held_force(model, of_grasps.grippers), driven)
    else:
        loaded = held_force(model, of_grasps.grippers, model.driven())
    held = loaded(Q, v, u, grasps, w, body, *(now_and_mean or of_base))
    return ca.Function.if_else("law", ca.Function("loaded", arguments, [held]), free)


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
    return of_driven(model.spec, model.law(every), ca.SX.sym("driven", model.space.n_twist))


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
        torques = wheels.unloading_torques(ca.vertsplit(momenta), tick, by_expressions)
        force[space.rotation] -= ca.vertcat(*wheels.along_base(torques))
    return ca.Function("force_on_base", [Q, wrench, momenta], [ca.cse(force[space.base])])


def _thrust(model: RobotModel, limits: ca.MX) -> list[ca.MX]:
    """Return the wrench of thrusters and its mean over the period, which the limits of a tick have."""
    return [limits[: model.space.n_twist], limits[2 * model.n :]]


def tick_function(model: RobotModel, kind: TickKind) -> ca.Function:
    """Return one tick z, u -> z_next, F, torques of wheels: the law (7) sets F once.

    z = [state; impulse (3,) or (6,); work; momenta of wheels].

    In task space the law is `F = J' F_m`, and in the place of u are the rates of the frames' velocities. Where it
    varies what of the base is driven (n_twist,), that follows u.

    A disturbed one has the further arguments noise (2n,), external force (n,) and p: the inertial parameters of the
    robot and of the law, then the vector of a `JointFriction`. A limited one has the vector of `ForceLimits` last, and
    returns after F also the force that the law commanded, before it was cut there. Where thrusters push the base the
    limits are those of `ForceLimits.holding_base`, and behind them stands the mean wrench of the period (n_twist,): the
    torques of the joints are those for the one and the other, see `LowLevelLaw.force`.
    """
    return model.derived((tick_function, kind), lambda: _tick_function(model, kind))


def _tick_function(model: RobotModel, kind: TickKind) -> ca.Function:
    """Derive what `tick_function` returns."""
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
    momenta = z[z.numel() - wheels.count :]
    seen = ca.vertcat(z[:nx], momenta) if wheels.count else z[:nx]
    pushes = _thrust(model, limits)[:1] if kind.is_pushed else []
    commanded = law(seen, u, *([noise, p] if kind.disturbed else []), *pushes)
    of_base = u[u.numel() - model.space.n_twist :] if kind.varies else ca.DM(model.driven())
    commanded, F, external, torque = _with_wheels(model, wheels, kind)(
        z[: model.nq], commanded, limits[: 2 * n], momenta, of_base
    )
    held = [ca.vertcat(external + external_force, torque), p] if kind.disturbed else [ca.vertcat(external, torque)]
    after = _runge_kutta(flow, z, held, kind, model.space.attitudes_at(0))
    arguments = [z, u, *([noise, external_force, p] if kind.disturbed else []), *([limits] if kind.limited else [])]
    results = [after, F, *([commanded] if kind.limited else []), *([torque] if wheels.count else [])]
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
    """Return what limits and wheels make of a commanded force: Q, commanded, limits, momenta, driven -> four of them.

    They are the force that is commanded, with what balances the unloading of wheels; the force that acts; the part of
    it that is external, without the motors of wheels; and their torques. See `WheelDrive`, which does the same.
    """
    cut = _cut(model) if kind.limited else None
    if not wheels.count:

        def plain(Q: ca.MX, commanded: ca.MX, limits: ca.MX, momenta: ca.MX, driven: ca.MX) -> list[ca.MX]:
            F = commanded if cut is None else cut(Q, commanded, limits)
            return [commanded, F, F, ca.MX(0, 1)]

        return plain
    n = model.n
    rotation = model.space.rotation
    F, h, driven = (ca.SX.sym(*size) for size in (("F", n), ("h", wheels.count), ("driven", model.space.n_twist)))
    stored = ca.vertsplit(h)

    def along_base(torque: ca.SX) -> ca.SX:
        moment = ca.SX.zeros(n)
        moment[rotation] = ca.vertcat(*wheels.along_base(ca.vertsplit(torque)))
        return moment

    unloading = driven[0] * ca.vertcat(*wheels.unloading_torques(stored, kind.tick, by_expressions))
    unloads = ca.Function("unloads", [F, h, driven], [F + along_base(unloading)])
    by_wheels = (1 - driven[0]) * driven[-1]
    moment = ca.vertsplit(F[rotation])
    turning = by_wheels * ca.vertcat(*wheels.turning_torques(moment, stored, kind.tick, by_expressions))
    torque = unloading + turning
    external = ca.SX(F)
    external[rotation] *= 1 - by_wheels
    turns = ca.Function("turns", [F, h, driven], [external - along_base(torque), external, torque])

    def driving(Q: ca.MX, commanded: ca.MX, limits: ca.MX, momenta: ca.MX, driven: ca.MX) -> list[ca.MX]:
        commanded = unloads(commanded, momenta, driven)
        within = commanded if cut is None else cut(Q, commanded, limits)
        return [commanded, *turns(within, momenta, driven)]

    return driving


def _gyrostat(
    model: RobotModel, wheels: Wheels, F: ca.SX, momenta: ca.SX, robot: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX | float, ca.SX]:
    """Split what acts on a robot with wheels.

    Args:
        model: The robot.
        wheels: Its wheels.
        F: External generalized force, then the torques of the motors (n + W,).
        momenta: What the wheels store (W,).
        robot: Its inertial parameters.

    Returns:
        The external force (n,), that with what the motors do to the base (n,), their torques (W,), the power of what
        they do to the wheels, and the inertial parameters with what the wheels store.
    """
    if not wheels.count:
        return F, F, ca.SX(0, 1), 0.0, robot
    external, torque = ca.vertsplit(F, [0, model.n, model.n + wheels.count])
    net = ca.SX(external)
    net[model.space.rotation] -= ca.vertcat(*wheels.along_base(ca.vertsplit(torque)))
    power = ca.dot(torque, momenta / ca.DM(wheels.inertia))
    return external, net, torque, power, with_stored(model.spec, robot, ca.DM(wheels.axes) @ momenta)


def _law_and_flow(model: RobotModel, kind: TickKind) -> tuple[ca.Function, ca.Function]:
    """Return the low-level law state, u, noise, p -> F, and the rate of z at z, F, p with the external force in F.

    The state is followed by momenta of wheels, and F by their torques, see `_gyrostat`. Where thrusters push the base
    the last argument of the law is their wrench along its axes.
    Of an undisturbed plant noise and p are constant, and no arguments. Friction acts between the links: it does work,
    but has no impulse on the whole. The flow is called, not written out, in each stage of an integration step: as C it
    compiles in a third of the time.
    """
    n = model.n
    nq = model.nq
    base = model.parts["base"].stop
    w = model.nominal.vector
    nominal = np.concatenate([w, w, JointFriction.none(n).vector])
    p = ca.SX.sym("p", nominal.size) if kind.disturbed else ca.SX(nominal)
    robot, believed, viscous, coulomb, width = ca.vertsplit(p, np.cumsum([0, w.size, w.size, n, n, 1]).tolist())
    of_inputs = law_of(model, kind)
    driven = model.space.n_twist * kind.varies
    wheels = Wheels.of(model.spec)
    sizes = (
        ("x", nq + n + wheels.count),
        ("u", of_inputs.size1_in(2) + driven),
        ("noise", 2 * n),
        ("z", nq + n + base + 1 + wheels.count),
        ("F", n + wheels.count),
    )
    state, u, noise, z, F = (ca.SX.sym(*size) for size in sizes)
    if wheels.count:
        believed = with_stored(model.spec, believed, ca.DM(wheels.axes) @ state[nq + n :])
    measured_Q = state[:nq]
    measured_v = state[nq : nq + n]
    if kind.disturbed:
        measured_Q = _integrated(model.space, measured_Q, noise[:n])
        measured_v = measured_v + noise[n:]
    of_base = [u[u.numel() - driven :]] if kind.varies else []
    wrench = ca.SX.sym("wrench", model.space.n_twist * kind.is_pushed)
    pushes = [wrench] if kind.is_pushed else []
    if kind.is_pushed:
        of_base = [_force_on_base(model, wheels, kind.tick)(measured_Q, wrench, state[nq + n :])]
    commanded = of_inputs(measured_Q, measured_v, u[: u.numel() - driven], believed, *of_base)
    Q = z[:nq]
    v = z[nq : nq + n]
    F_external, net, torque, power, robot = _gyrostat(model, wheels, F, z[nq + n + base + 1 :], robot)
    acting = net - viscous * v - coulomb * ca.tanh(v / width)
    Qdot = model.space.rate(ca.vertsplit(Q), ca.vertsplit(v))
    vdot = model.dynamics.forward(Q, v, acting, robot)
    external = (
        F_external if model.spec.moved_by.moves else model.dynamics.inverse(Q, v, vdot, robot)
    )  # that of the mount
    impulse_rate = model.space.external_wrench(ca.vertsplit(Q), ca.vertsplit(external))
    rate = ca.vertcat(*Qdot, vdot, *impulse_rate, ca.dot(acting, v) + power, torque)
    if not kind.disturbed:
        law = ca.Function("law", [state, u, *pushes], ca.cse([commanded]))
        return law, ca.Function("flow", [z, F], ca.cse([rate]))
    return ca.Function("law", [state, u, noise, p, *pushes], [commanded]), ca.Function("flow", [z, F, p], [rate])


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
