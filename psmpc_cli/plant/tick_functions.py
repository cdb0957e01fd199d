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

N_LOADS = len(GRASP_LOADS)


@dataclass(frozen=True)
class TickKind:
    """What distinguishes functions of a tick: each takes no more arguments than a plant and its task need.

    Attributes:
        tick: Length of the tick [s].
        substeps: Steps of the integrator in it.
        disturbed: Whether noise, an external force and inertial parameters are arguments.
        limited: Whether limits of the force are an argument.
        in_task_space: Whether the law follows rates of the velocities J_C v of base and end-effectors.
        driven_varies: Whether an argument tells the law on which coordinates of the base something acts.
        is_pushed: Whether thrusters push the base; then their wrench is an argument.
    """

    tick: float
    substeps: int
    disturbed: bool
    limited: bool
    in_task_space: bool = False
    driven_varies: bool = False
    is_pushed: bool = False


def capture_tick(capture: Capture, kind: TickKind) -> ca.Function:
    """Return one tick of a robot with an object that it may hold, as a CasADi function that plants compile.

    Its arguments are, in this order:

    - z = [state of the robot; impulse; work; momenta of wheels; pose and velocity of the object; filtered loads].
    - u (n,), followed in task space by the rates of the frames' velocities, and by which coordinates of the base are
      driven (n_twist,) if that varies.
    - The noise (2n,) of a disturbed tick.
    - The external force (n,).
    - The parameters of the bushings (springs and dampers between grippers and object), then which grippers are closed.
    - The inertial parameters of the robot, and those that the law takes for them; a `JointFriction`; mass and inertia
      of the object, and those that the law takes for them; the share by which filtered loads follow the loads.
    - The vector of `ForceLimits` of a limited tick. For one in which thrusters push the base see `tick_function`.

    Its results are z after the tick, the force that acts F, the commanded force, the wrenches of grippers on the
    object, and the torques of wheels if there are any. Wrenches and loads are those where the tick begins. The law
    moves the object, too, while all grippers hold it, if the task lets the law know it.

    Args:
        capture: The object and its grasps.
        kind: Which arguments the tick has.
    """
    law = capture.law
    known = bool(capture.spec.known)
    # derived once for each key, which has all that the function depends on
    return law.model.derived((capture_tick, law.grippers, known, kind), lambda: _capture_tick(law, known, kind))


def _capture_tick(law: GraspLaw, known: bool, kind: TickKind) -> ca.Function:
    """Derive what `capture_tick` returns.

    Args:
        law: The bushings between grippers and object.
        known: Whether the low-level law may account for the object.
        kind: Which arguments the tick has.
    """
    model = law.model
    n = model.n
    nx = model.nq + n
    grippers = len(law.grippers)
    w = model.nominal.vector.size
    of_body = 1 + len(law.body.inertia)
    flow = _capture_flow(law)
    rates = model.n_twists if kind.in_task_space else 0
    driven = model.space.n_twist * kind.driven_varies
    sizes = {
        "z": flow.size1_in(0) + N_LOADS * grippers,
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
    holding = ca.vec(ca.repmat(closed.T, N_LOADS, 1))
    load = filtered + follows * holding * (ca.vec(loads) - filtered)
    measured = ca.vertsplit(_noisy_state(model)(state, noise) if kind.disturbed else state, [0, model.nq, nx])
    by_gripper = ca.horzsplit(ca.reshape(bushings, law.n_parameters, grippers))
    stiff = ca.vertcat(*(bushing[:-2] for bushing in by_gripper))  # without the dampings
    if wheels.count:
        believed = with_stored(model.spec, believed, ca.DM(wheels.axes) @ momenta)
    inputs = *ca.vertsplit(u, [0, n, n + rates, n + rates + driven]), stiff, believed, described
    if kind.is_pushed:
        on_base = _force_on_base(model, wheels, kind.tick)
        inputs = (
            *inputs,
            ca.vertcat(*(on_base(measured[0], wrench, momenta) for wrench in _thruster_wrenches(model, limits))),
        )
    commanded = _law_with_capture(law, known, kind)(ca.mmin(closed), *measured, *inputs)
    of_base = u[n + rates :] if kind.driven_varies else ca.DM(model.driven())
    commanded, F, external, torque = _limiter_with_wheels(model, wheels, kind)(
        Q, commanded, limits[: 2 * n], momenta, of_base
    )
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
        law: The bushings, springs and dampers, between grippers and object.

    Returns:
        Function of z, F, the parameters of the bushings and p, with the result dz/dt. The integrated state is z = [Q;
        v; impulse; work; momenta of wheels; pose and velocity of the object]. F is the external force, then the torques
        of wheels. p are the inertial parameters of the robot, viscous friction (n,), Coulomb friction (n,), its width,
        and mass and inertia of the object.
    """
    model = law.model
    n = model.n
    nq = model.nq
    momentum_size = model.space.n_twist
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
    F_external, net_force, torque, power_of_wheels, robot = _split_held_force(model, wheels, F, momenta, robot)
    acting = net_force - viscous * v - coulomb * ca.tanh(v / width)
    target_object = FreeBody(object_parameters[0], ca.vertsplit(object_parameters[1:]))
    pose_rate, velocity_rate = target_object.rates(
        ca.vertsplit(object_pose), ca.vertsplit(object_velocity), ca.vertsplit(wrench_on_object)
    )
    vdot = model.dynamics.forward(Q, v, acting + grasp_force, robot)
    Qdot = model.space.rate(ca.vertsplit(Q), ca.vertsplit(v))
    # On a base that does not move, the external force is that of its mount: what the motion takes besides the grasps.
    external_force = (
        F_external if model.spec.moved_by.moves else model.dynamics.inverse(Q, v, vdot, robot) - grasp_force
    )
    external_wrench = model.space.external_wrench(ca.vertsplit(Q), ca.vertsplit(external_force))
    power += ca.dot(acting, v) + power_of_wheels
    zdot = ca.vertcat(*Qdot, vdot, *external_wrench, power, torque, *pose_rate, *velocity_rate)
    return ca.Function("flow", [z, F, bushings, p], [zdot])


def _law_with_capture(grasp_law: GraspLaw, object_is_known: bool, kind: TickKind) -> ca.Function:
    """Build the low-level law of a robot that may hold an object, as a function that switches between two laws.

    While all grippers hold an object that the law knows of, the force is that of `held_force`, which moves the object
    too. Otherwise it is the law of the robot alone.

    Args:
        grasp_law: The bushings, springs and dampers, between grippers and object.
        object_is_known: Whether the law may account for the object.
        kind: Which arguments the tick has.

    Returns:
        Function with the result F (n,). Its arguments are 1 if all grippers hold the object, else 0; Q; v; u; rates in
        task space; driven coordinates of the base; grasps, a parameter vector without dampings for each gripper; the
        inertial parameters of the robot; mass and inertia of the object. Where thrusters push the base, the last
        argument is the force on it, then its mean over the period of pulses. What `kind` does not have is empty.
    """
    model = grasp_law.model
    space = model.space
    argument_sizes = {
        "Q": model.nq,
        "v": model.n,
        "u": model.n,
        "rates": model.n_twists if kind.in_task_space else 0,
        "driven": space.n_twist * kind.driven_varies,
        "grasps": (space.n_pose + 2) * len(grasp_law.grippers),  # of each its anchor and both stiffnesses
        "w": model.nominal.vector.size,
        "body": 1 + space.n_principal,
        "base_force": 2 * space.n_twist * kind.is_pushed,
    }
    arguments = [ca.SX.sym(name, size) for name, size in argument_sizes.items()]
    Q, v, u, twist_rates, driven, grasps, inertial_parameters, object_parameters, base_force = arguments
    # last arguments of both laws, which say what acts on the base
    base_alone = base_with_object = [driven] if kind.driven_varies else []
    if kind.is_pushed:
        now_and_mean = ca.vertsplit(base_force, space.n_twist)
        base_alone = now_and_mean[:1]  # the law of the robot alone does not need the mean
        base_with_object = now_and_mean
    else:
        arguments = arguments[:-1]  # there is no force of thrusters
    F_alone = law_without_object(model, kind)(
        Q, v, twist_rates if kind.in_task_space else u, inertial_parameters, *base_alone
    )
    if not object_is_known:
        # the same arguments as with a known object, of which the first has no effect
        return ca.Function("law", [ca.SX.sym("all_hold"), *arguments], [F_alone])
    law_alone = ca.Function("free", arguments, [F_alone])
    if kind.is_pushed:
        law_with_object = pushed_held_force(model, grasp_law.grippers)
    elif kind.driven_varies:
        law_with_object = law_with_driven_coordinates(model.spec, held_force(model, grasp_law.grippers), driven)
    else:
        law_with_object = held_force(model, grasp_law.grippers, model.driven())
    F_with_object = law_with_object(Q, v, u, grasps, inertial_parameters, object_parameters, *base_with_object)
    return ca.Function.if_else("law", ca.Function("loaded", arguments, [F_with_object]), law_alone)


def _noisy_state(model: RobotModel) -> ca.Function:
    """Return the function of a state [Q; v] and noise (2n,) whose result is the state that the law reads."""
    n = model.n
    state, noise = (ca.SX.sym(name, size) for name, size in (("x", model.nq + n), ("noise", 2 * n)))
    Q = _displaced(model.space, state[: model.nq], noise[:n])
    return ca.Function("measured", [state, noise], [ca.vertcat(Q, state[model.nq :] + noise[n:])])


def law_without_object(model: RobotModel, kind: TickKind) -> ca.Function:
    """Return the low-level law of a robot that holds nothing: the function Q, v, u, inertial parameters -> F (n,).

    A further argument is the force on the base where thrusters push it, or else which coordinates of the base are
    driven if that varies. In task space the rates of the frames' velocities take the place of u.

    Args:
        model: The robot.
        kind: Which arguments the tick has.
    """
    if kind.in_task_space:
        return _pushed_task_law(model) if kind.is_pushed else model.task_space.law
    if kind.is_pushed:
        return model.pushed_law
    if not kind.driven_varies:
        return model.law()
    all_driven = (1.0,) * model.space.n_twist
    return law_with_driven_coordinates(model.spec, model.law(all_driven), ca.SX.sym("driven", model.space.n_twist))


def _pushed_task_law(model: RobotModel) -> ca.Function:
    """Return the law in task space of a robot whose base thrusters push, which give it another force than it asks for.

    The joints accelerate as they would under the force that the law asks for.

    Returns:
        Function Q, v, rates of the frames' velocities, inertial parameters, force on the base -> F (n,). The force on
        the base in F is the one that the law asks for; the thrusters' own is given by the limits of the tick.
    """
    task_space = model.task_space
    motion = task_space.law.sx_in()
    base_force = ca.SX.sym("base_force", model.space.n_twist)
    Q, v, _, w = motion
    pushed = model.pushed_law(Q, v, task_space.acceleration(*motion), w, base_force)
    asked = task_space.law(*motion)
    F = ca.vertcat(asked[model.space.base], pushed[model.space.joint_rates])
    return ca.Function("pushed_task_law", [*motion, base_force], [ca.cse(F)])


def _force_on_base(model: RobotModel, wheels: Wheels, tick: float) -> ca.Function:
    """Return the function of the force on the base that joints have to allow for where thrusters push it.

    Returns:
        Function Q, wrench of the thrusters along the base's axes, momenta of wheels -> generalized force on the base
        (n_twist,). It is the wrench less what balances motors that unload wheels, see `WheelDrive.without_unloading`.
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


def _thruster_wrenches(model: RobotModel, limits: ca.MX) -> list[ca.MX]:
    """Return the wrench of thrusters (n_twist,) and its mean over the period of pulses, from the limits of a tick.

    Where thrusters push the base, the lower limits begin with their wrench and the upper ones are followed by the mean.
    """
    return [limits[: model.space.n_twist], limits[2 * model.n :]]


def tick_function(model: RobotModel, kind: TickKind) -> ca.Function:
    """Return one tick of a robot without an object, as a CasADi function that plants compile.

    A tick is one period of the low-level loop: the law (7) sets a force F once, then the motion is integrated. The
    arguments are z and u, the results are z after the tick, F and the torques of wheels, with z = [Q; v; impulse;
    work; momenta of wheels]. Where these hold of `kind`, there are further arguments and results:

    - in_task_space: the law is `F = J' F_m`, and u are the rates of the frames' velocities.
    - driven_varies: which coordinates of the base are driven (n_twist,) follows u.
    - disturbed: noise (2n,), external force (n,) and p: the inertial parameters of the robot and of the law, then the
      vector of a `JointFriction`.
    - limited: the vector of `ForceLimits` is the last argument; the force before it was cut is returned after F.
    - is_pushed: thrusters push the base. The limits are those of `ForceLimits.vectors_fixing_base_wrench`, followed by
      the mean wrench over the period of pulses (n_twist,), see `LowLevelLaw.force`.

    The function is derived once for each model and kind.
    """
    return model.derived((tick_function, kind), lambda: _tick_function(model, kind))


def _tick_function(model: RobotModel, kind: TickKind) -> ca.Function:
    """Derive one tick of a robot without an object: the law, what limits and wheels make of its force, integration.

    Args:
        model: The robot.
        kind: Which arguments the tick has.

    Returns:
        The function, whose arguments and results are those that `tick_function` says.
    """
    n = model.n
    nx = model.nq + n
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
    wrench_of_thrusters = _thruster_wrenches(model, limits)[:1] if kind.is_pushed else []
    commanded = law(law_state, u, *([noise, p] if kind.disturbed else []), *wrench_of_thrusters)
    driven = u[u.numel() - model.space.n_twist :] if kind.driven_varies else ca.DM(model.driven())
    commanded, F, external, torque = _limiter_with_wheels(model, wheels, kind)(
        z[: model.nq], commanded, limits[: 2 * n], wheel_momenta, driven
    )
    held_arguments = (
        [ca.vertcat(external + external_force, torque), p] if kind.disturbed else [ca.vertcat(external, torque)]
    )
    z_next = _runge_kutta(flow, z, held_arguments, kind, model.space.attitudes_at(0))
    arguments = [z, u, *([noise, external_force, p] if kind.disturbed else []), *([limits] if kind.limited else [])]
    results = [z_next, F, *([commanded] if kind.limited else []), *([torque] if wheels.count else [])]
    return ca.Function("disturbed" if kind.disturbed else "tick", arguments, results)


def _force_limiter(model: RobotModel) -> ca.Function:
    """Return the function Q, F, vector of `ForceLimits` -> F that cuts a generalized force at the limits."""
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


def _limiter_with_wheels(model: RobotModel, wheels: Wheels, kind: TickKind) -> Callable[..., list[ca.MX]]:
    """Build the step from the force that the law commands to the one that acts: limits, then motors of wheels.

    Where thrusters push the base, the motors unload the wheels (bring their momenta back to the first ones), and
    thrusters balance that; where only the attitude is driven, they turn the base. `WheelDrive` does the same with
    numbers.

    Args:
        model: The robot.
        wheels: The robot's wheels; without any only the limits act.
        kind: Which arguments the tick has.

    Returns:
        Function on CasADi expressions: position Q, commanded force, limits, momenta of wheels, driven coordinates of
        the base -> the commanded force with what balances the unloading of wheels (n,); the force that acts (n,); the
        part of that which is external, without the motors of wheels (n,); and their torques (W,).
    """
    cut = _force_limiter(model) if kind.limited else None
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

    # Thrusters push the base where its first coordinate is driven; wheels turn it where only its attitude is. Both are
    # 1 or 0.
    is_pushed = driven[0]
    wheels_turn = (1 - driven[0]) * driven[-1]
    unloading = is_pushed * ca.vertcat(*wheels.unloading_torques(stored, kind.tick, clip_expressions))
    with_unloading = ca.Function("unloads", [F, h, driven], [F + force_of_moment(unloading)])
    moment = ca.vertsplit(F[rotation])
    turning = wheels_turn * ca.vertcat(*wheels.turning_torques(moment, stored, kind.tick, clip_expressions))
    torque = unloading + turning
    external = ca.SX(F)  # a copy: what follows changes it in place
    external[rotation] *= 1 - wheels_turn  # a moment that wheels give is not external
    with_turning = ca.Function("turns", [F, h, driven], [external - force_of_moment(torque), external, torque])

    def limited_with_wheels(Q: ca.MX, commanded: ca.MX, limits: ca.MX, momenta: ca.MX, driven: ca.MX) -> list[ca.MX]:
        commanded = with_unloading(commanded, momenta, driven)
        limited = commanded if cut is None else cut(Q, commanded, limits)
        return [commanded, *with_turning(limited, momenta, driven)]

    return limited_with_wheels


def _split_held_force(
    model: RobotModel, wheels: Wheels, F: ca.SX, momenta: ca.SX, inertial_parameters: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX | float, ca.SX]:
    """Split a held force into what the dynamics of a robot and those of its reaction wheels need.

    The motors' torques act on the wheels and, opposite, on the base. The wheels are not bodies of the robot model: it
    is a gyrostat, a body that has angular momentum inside. So what they store goes with the inertial parameters.

    Args:
        model: The robot.
        wheels: The robot's wheels; there may be none.
        F: External generalized force, then the torques of the motors (n + W,).
        momenta: Angular momenta that the wheels store (W,) [N m s].
        inertial_parameters: Inertial parameters of the robot.

    Returns:
        The external force (n,); the same with what the motors do to the base (n,); the torques of the motors (W,); the
        power of what they do to the wheels [W]; and the inertial parameters with what the wheels store.
    """
    if not wheels.count:
        return F, F, ca.SX(0, 1), 0.0, inertial_parameters
    external, torque = ca.vertsplit(F, [0, model.n, model.n + wheels.count])
    net_force = ca.SX(external)
    net_force[model.space.rotation] -= ca.vertcat(*wheels.along_base(ca.vertsplit(torque)))
    power = ca.dot(torque, momenta / ca.DM(wheels.inertia))  # torque times absolute speed of the wheel
    return (
        external,
        net_force,
        torque,
        power,
        with_stored(model.spec, inertial_parameters, ca.DM(wheels.axes) @ momenta),
    )


def _law_and_flow(model: RobotModel, kind: TickKind) -> tuple[ca.Function, ca.Function]:
    """Derive the two functions that a tick of a robot consists of: the low-level law, and motion under a held force.

    Args:
        model: The robot.
        kind: Which arguments the tick has. Of an undisturbed tick noise and p are constants, not arguments.

    Returns:
        The law: [Q; v; momenta of wheels], u, noise, p -> F; where thrusters push the base, their wrench along its axes
        is the last argument. And the motion: z, [external force; torques of wheels], p -> dz/dt, with z = [Q; v;
        impulse; work; momenta of wheels]. p are the true inertial parameters, those that the law takes for them, then
        the vector of a `JointFriction`.
    """
    n = model.n
    w = model.nominal.vector
    # the law knows the robot exactly, and there is no friction
    nominal = np.concatenate([w, w, JointFriction.none(n).vector])
    p = ca.SX.sym("p", nominal.size) if kind.disturbed else ca.SX(nominal)
    true_robot, robot_of_law, friction = ca.vertsplit(p, np.cumsum([0, w.size, w.size, 2 * n + 1]).tolist())
    arguments, F = _law_at_state(model, kind, robot_of_law)
    z, held, rate = _motion_under_held_force(model, true_robot, friction)
    if not kind.disturbed:
        state, u, _, *wrench = arguments  # the law does not depend on noise here
        law = ca.Function("law", [state, u, *wrench], ca.cse([F]))
        return law, ca.Function("flow", [z, held], ca.cse([rate]))
    state, u, noise, *wrench = arguments
    return ca.Function("law", [state, u, noise, p, *wrench], [F]), ca.Function("flow", [z, held, p], [rate])


def _law_at_state(model: RobotModel, kind: TickKind, robot: ca.SX) -> tuple[list[ca.SX], ca.SX]:
    """Derive the force of the low-level law at a state that it reads with noise, if the tick is a disturbed one.

    Args:
        model: The robot.
        kind: Which arguments the tick has.
        robot: Inertial parameters that the law takes for the robot's.

    Returns:
        The symbols on which the force depends: [Q; v; momenta of wheels], u, noise and, where thrusters push the base,
        their wrench along its axes. Then the force F (n,) as an expression in them.
    """
    n = model.n
    nq = model.nq
    law = law_without_object(model, kind)
    wheels = Wheels.of(model.spec)
    driven_size = model.space.n_twist * kind.driven_varies
    state = ca.SX.sym("x", nq + n + wheels.count)
    u = ca.SX.sym("u", law.size1_in(2) + driven_size)
    noise = ca.SX.sym("noise", 2 * n)
    if wheels.count:
        robot = with_stored(model.spec, robot, ca.DM(wheels.axes) @ state[nq + n :])
    Q = state[:nq]
    v = state[nq : nq + n]
    if kind.disturbed:
        Q = _displaced(model.space, Q, noise[:n])
        v = v + noise[n:]
    setpoint = u[: u.numel() - driven_size]  # the driven coordinates of the base follow it in u
    if kind.is_pushed:  # joints follow their setpoints under the force that thrusters give
        wrench = ca.SX.sym("wrench", model.space.n_twist)
        base_force = _force_on_base(model, wheels, kind.tick)(Q, wrench, state[nq + n :])
        return [state, u, noise, wrench], law(Q, v, setpoint, robot, base_force)
    driven = [u[u.numel() - driven_size :]] if kind.driven_varies else []
    return [state, u, noise], law(Q, v, setpoint, robot, *driven)


def _motion_under_held_force(model: RobotModel, robot: ca.SX, friction: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Derive the rate of the integrated state of a robot under a force that is held over a tick.

    Friction acts between the links: it does work, but has no impulse on the robot as a whole. The caller makes the rate
    a function that each stage of an integration step calls; written out in all of them it takes three times as long to
    compile.

    Args:
        model: The robot.
        robot: True inertial parameters.
        friction: Vector of a `JointFriction`: viscous (n,), Coulomb (n,), width (1,).

    Returns:
        The symbols z = [Q; v; impulse; work; momenta of wheels] and [external force; torques of wheels], and the
        expression dz/dt.
    """
    n = model.n
    nq = model.nq
    wheels = Wheels.of(model.spec)
    momentum_size = model.space.n_twist
    z = ca.SX.sym("z", nq + n + momentum_size + 1 + wheels.count)
    held = ca.SX.sym("F", n + wheels.count)
    viscous, coulomb, width = ca.vertsplit(friction, [0, n, 2 * n, 2 * n + 1])
    Q = z[:nq]
    v = z[nq : nq + n]
    momenta = z[nq + n + momentum_size + 1 :]
    F_external, net_force, torque, power_of_wheels, robot = _split_held_force(model, wheels, held, momenta, robot)
    acting = net_force - viscous * v - coulomb * ca.tanh(v / width)
    Qdot = model.space.rate(ca.vertsplit(Q), ca.vertsplit(v))
    vdot = model.dynamics.forward(Q, v, acting, robot)
    # On a base that does not move, the external force is that of its mount, which inverse dynamics gives.
    external = F_external if model.spec.moved_by.moves else model.dynamics.inverse(Q, v, vdot, robot)
    impulse_rate = model.space.external_wrench(ca.vertsplit(Q), ca.vertsplit(external))
    power = ca.dot(acting, v) + power_of_wheels
    return z, held, ca.vertcat(*Qdot, vdot, *impulse_rate, power, torque)


def _displaced(space: ConfigurationSpace, Q: ca.SX, step: ca.SX) -> ca.SX:
    """Return coordinates Q (nq,) after a displacement (n,), by which attitudes rotate."""
    return ca.SX(ca.vertcat(*space.integrate(ca.vertsplit(Q), ca.vertsplit(step))))


def _runge_kutta(flow: ca.Function, z: ca.MX, held: list[ca.MX], kind: TickKind, attitudes: list[slice]) -> ca.MX:
    """Integrate over a tick by classical Runge-Kutta steps.

    Args:
        flow: The function z, further arguments -> dz/dt.
        z: Integrated state where the tick begins.
        held: The further arguments, constant over the tick.
        kind: Length of the tick and number of steps in it.
        attitudes: Rows of quaternions in z. A step leaves their norms only about 1, so they are normalized.

    Returns:
        z at the end of the tick.
    """
    h = kind.tick / kind.substeps
    for _ in range(kind.substeps):
        z = runge_kutta(lambda z: flow(z, *held), z, h)
        for rows in attitudes:
            quaternion = z[rows]
            z = ca.vertcat(z[: rows.start], quaternion / ca.norm_2(quaternion), z[rows.stop :])
    return z
